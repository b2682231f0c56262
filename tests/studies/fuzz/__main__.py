"""Fuzz every reader and parser: `python -m tests.studies.fuzz [--count N | --seconds
S]`.

Damages sound files of every kind at random and gives them to the commands that read
them. Every one must end with a result or a message: no traceback, no exit code 70, no
warning of a library, at most 10 s of CPU time and 1 GiB. What is not answered so is
kept in the folder of --keep. With --write the table goes into docs/evidence/damage.md.
"""

import argparse
import hashlib
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from tests.studies.fuzz.run import Tally, fuzz
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
ROUND = 250  # inputs of a target before the next has its turn


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.fuzz", description=__doc__
    )
    parser.add_argument("--count", type=int, default=10**9, help="inputs of each kind")
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="of CPU time, in all"
    )
    parser.add_argument("--seed", type=int, default=0)
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
        tallies = {target.name: Tally() for target in made}
        done, begun = 0, time.monotonic()
        while done < chosen.count and time.monotonic() - begun < chosen.seconds:
            for number, target in enumerate(made):
                folder, tally = Path(name) / f"target_{number}", tallies[target.name]
                folder.mkdir(exist_ok=True)
                parts = repr((target.name, chosen.seed, done)).encode()
                seed = int.from_bytes(hashlib.sha256(parts).digest()[:6])
                fuzz(target, folder, min(ROUND, chosen.count - done), seed, tally)
                told = f"{len(tally.outcomes)}, {len(tally.finds)} finds"
                sys.stderr.write(f"{target.name}: {told}\n")
            done += ROUND
    show("evidence/damage.md", "fuzz", table(HEADER, rows(tallies)), kept=chosen.write)
    return 1 if _kept(tallies, chosen.keep) else 0


def _kept(tallies: Mapping[str, Tally], folder: Path) -> int:
    finds = [(name, find) for name, tally in tallies.items() for find in tally.finds]
    for name, find in finds:
        folder.mkdir(parents=True, exist_ok=True)
        stem = f"{name.replace(' ', '_')}_{hashlib.sha256(find.data).hexdigest()[:8]}"
        (folder / stem).write_bytes(find.data)
        report = f"{find.why}\n{' '.join(find.line)}\n{find.damage}\n{find.said}\n"
        (folder / f"{stem}.txt").write_text(
            report, encoding="utf-8", errors="backslashreplace"
        )
        sys.stderr.write(f"{folder / stem}: {find.why}\n")
    return len(finds)


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
