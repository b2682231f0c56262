"""Fuzz every command by every kind of input: `python -m tests.studies.fuzz [--count N |
--seconds S]`.

Damages sound files of every kind at random and gives them to the commands that read
them. Every one must end with a result or a message: no traceback, no exit code 70, no
warning of a library, no claim that does not hold, at most 10 s of CPU time and 1 GiB.
What is not answered so is kept in the folder of --keep. Inputs that got an answer of
their own are kept in its folder `corpus`, and are damaged further in the next run. With
--write the table goes into docs/evidence/damage.md.
"""

import argparse
import hashlib
import re
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tests.studies.fuzz.run import LONGEST, SLICE, Outcome, Tally, fuzz
from tests.studies.fuzz.target import Target
from tests.studies.fuzz.targets import targets
from tests.studies.tables import show, table

HEADER = (
    "file",
    "inputs",
    "read",
    "refused",
    "answers",
    "not well",
    "slowest, s",
    "peak, MiB",
)
# Inputs of a target before the next has its turn, and where time is short.
ROUND, SHORT_ROUND = SLICE, 10


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.fuzz", description=__doc__
    )
    parser.add_argument("--count", type=int, default=10**9, help="inputs of each kind")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--readers", action="store_true", help="without commands around the readers"
    )
    parser.add_argument("--only", default="", help="kinds with this in their name")
    parser.add_argument(
        "--keep", type=Path, default=Path("out/fuzz"), help="folder for finds"
    )
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        made = [target for target in targets(Path(name)) if chosen.only in target.name]
        if chosen.readers:
            made = [
                replace(target, lines=[target.alone]) for target in made if target.alone
            ]
        corpus = chosen.keep / "corpus"
        tallies = {target.name: Tally(kept=_read(corpus, target)) for target in made}
        turn = ROUND if chosen.seconds == float("inf") else SHORT_ROUND
        end = time.monotonic() + chosen.seconds
        for done in range(0, chosen.count, turn):
            for number, target in enumerate(made):
                if time.monotonic() > end:
                    break
                folder, tally = Path(name) / f"target_{number}", tallies[target.name]
                folder.mkdir(exist_ok=True)
                parts = repr((target.name, chosen.seed, done)).encode()
                seed = int.from_bytes(hashlib.sha256(parts).digest()[:6])
                before = len(tally.outcomes)
                fuzz(target, folder, min(turn, chosen.count - done), seed, tally)
                _keep(target, tally.outcomes[before:], chosen.keep)
                told = f"{len(tally.outcomes)}, {len(tally.finds)} finds"
                sys.stderr.write(f"{target.name}: {told}\n")
            if time.monotonic() > end:
                break
    study = "fuzz_readers" if chosen.readers else "fuzz"
    show("evidence/damage.md", study, table(HEADER, rows(tallies)), kept=chosen.write)
    return 1 if any(tally.finds for tally in tallies.values()) else 0


def _folder(corpus: Path, target: Target) -> Path:
    return corpus / re.sub(r"\W+", "_", target.name)


def _read(corpus: Path, target: Target) -> list[bytes]:
    """Return the inputs that earlier runs have kept."""
    return [path.read_bytes() for path in sorted(_folder(corpus, target).glob("*"))]


def _keep(target: Target, outcomes: Sequence[Outcome], keep: Path) -> None:
    """Keep finds with what was said of them, and inputs with answers of their own."""
    corpus = _folder(keep / "corpus", target)
    corpus.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        name = hashlib.sha256(outcome.data).hexdigest()[:12]
        if not outcome.why and 0 < len(outcome.data) < LONGEST:
            (corpus / name).write_bytes(outcome.data)
        if not outcome.why:
            continue
        path = keep / f"{corpus.name}_{name}"
        path.write_bytes(outcome.data)
        parts = (outcome.why, " ".join(outcome.line), outcome.damage, outcome.said)
        path.with_suffix(".txt").write_text(
            "\n".join(parts), encoding="utf-8", errors="backslashreplace"
        )
        sys.stderr.write(f"{path}: {outcome.why}: {' '.join(outcome.line)}\n")


def rows(tallies: Mapping[str, Tally]) -> list[list[str]]:
    cells = []
    for name, tally in tallies.items():
        codes, every = tally.codes, tally.outcomes
        read = sum(codes[code] for code in (0, 1, 3))
        counts = (len(every), read, codes[2], len(tally.answers), len(tally.finds))
        slowest = max((outcome.seconds for outcome in every), default=0.0)
        peak = max((outcome.peak for outcome in every), default=0) >> 10
        cells.append([name, *map(str, counts), f"{slowest:.1f}", str(peak)])
    return cells


if __name__ == "__main__":
    sys.exit(main())
