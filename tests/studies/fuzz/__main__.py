"""Fuzz every command by every kind of input: `python -m tests.studies.fuzz [--count N |
--seconds S]`.

Damages sound files of every kind at random and gives them to the commands that read
them. Every one must end with a result or a message: no traceback, no exit code 70, no
warning of a library, no claim that does not hold, at most 10 s of CPU time and 1 GiB.
What is not answered so is kept in the folder of --keep. Inputs that got an answer of
their own are kept in its folder `corpus`, and are damaged further in the next run.
What came of each slice is written down in its file `tried.jsonl`: a run that was
stopped goes on behind it. With --write the table goes into docs/evidence/damage.md.
"""

import argparse
import hashlib
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tests.studies.fuzz.counts import HEADER, Counts, counted, row
from tests.studies.fuzz.run import LONGEST, SLICE, Outcome, Tally, fuzz
from tests.studies.fuzz.target import Target
from tests.studies.fuzz.targets import targets
from tests.studies.records import package_sources, results
from tests.studies.tables import show, table

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
        slices = _tried(made, Path(name), chosen)

    study = "fuzz_readers" if chosen.readers else "fuzz"
    rows = [row(target.name, slices[target.name]) for target in made]
    show("evidence/damage.md", study, table(HEADER, rows), kept=chosen.write)
    finds = [sum(counts.finds.values()) for each in slices.values() for counts in each]
    return 1 if any(finds) else 0


@dataclass(frozen=True, kw_only=True)
class Slice:
    """Inputs of one kind that are tried in one go.

    `seed` holds what the damages are drawn by. What came of them joins `tally`, and
    finds go to the folder `keep`.
    """

    target: Target
    folder: Path
    tally: Tally
    count: int
    seed: tuple[str, int, int]
    keep: Path


def _tried(
    made: Sequence[Target], work: Path, chosen: argparse.Namespace
) -> dict[str, list[Counts]]:
    """Try every kind in turn, a slice at a time; return what came of each slice."""
    counts: dict[str, list[Counts]] = {target.name: [] for target in made}
    corpus = chosen.keep / "corpus"
    tallies = {target.name: Tally(kept=_read(corpus, target)) for target in made}
    turn = ROUND if chosen.seconds == float("inf") else SHORT_ROUND
    end = time.monotonic() + chosen.seconds
    # Slices that were tried with another state of the program are tried again.
    sources = package_sources()

    for done in range(0, chosen.count, turn):
        for number, target in enumerate(made):
            if time.monotonic() > end:
                return counts
            piece = Slice(
                target=target,
                folder=work / f"target_{number}",
                tally=tallies[target.name],
                count=min(turn, chosen.count - done),
                seed=(target.name, chosen.seed, done),
                keep=chosen.keep,
            )
            of_slice = results(
                {repr((*piece.seed, piece.count, chosen.readers)): piece},
                work=_try,
                kind=Counts,
                path=chosen.keep / "tried.jsonl",
                sources=sources,
                told=lambda made: f"{sum(made.finds.values())} finds",
            )
            counts[target.name] += of_slice.values()
    return counts


def _try(piece: Slice) -> Counts:
    """Try the inputs of a slice, and keep what is worth it."""
    piece.folder.mkdir(exist_ok=True)
    digest = hashlib.sha256(repr(piece.seed).encode()).digest()
    before = len(piece.tally.outcomes)
    fuzz(
        piece.target,
        piece.folder,
        piece.count,
        int.from_bytes(digest[:6]),
        piece.tally,
    )
    outcomes = piece.tally.outcomes[before:]
    _keep(piece.target, outcomes, piece.keep)
    return counted(outcomes)


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


if __name__ == "__main__":
    sys.exit(main())
