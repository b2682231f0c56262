"""Fuzz every reader and parser: `python -m tests.studies.fuzz [--count N | --seconds S]`.

Damages sound files of every kind at random and gives them to the commands that read them. Every
one must end with a result or a message: no traceback, no exit code 70, no warning of a library, at
most 10 s of CPU time and 1 GiB. What is not answered so is kept in the folder of --keep. With
--write the table goes into docs/trust.md.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.studies.fuzz.run import Tally, fuzz, tell
from tests.studies.fuzz.targets import Target, targets
from tests.studies.tables import show, table

HEADER = ("file", "inputs", "read", "refused", "answers", "not well", "slowest, s", "peak, MiB")
ROUND = 250  # inputs of a target before the next has its turn


def main(arguments: Sequence[str]) -> int:
    """Run until the count or the time is reached; 1 if something was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10**9, help="inputs of each kind")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of CPU time, in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="kinds with this in their name")
    parser.add_argument("--keep", default="out/fuzz", help="folder for finds and rows of the table")
    parser.add_argument("--write", action="store_true", help="put the table into docs/trust.md")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        made = [t for t in targets(Path(name)) if chosen.only in t.name]
        tallies = {target.name: Tally() for target in made}
        _run(made, tallies, Path(name), chosen)
    finds = _kept(tallies, Path(chosen.keep))
    text = _with_earlier(rows(tallies), Path(chosen.keep) / "rows.json")
    show("trust.md", "fuzz", text, kept=chosen.write)
    return 1 if finds else 0


def _run(
    made: Sequence[Target], tallies: Mapping[str, Tally], work: Path, chosen: argparse.Namespace
) -> None:
    done, begun = 0, time.monotonic()
    while done < chosen.count and time.monotonic() - begun < chosen.seconds:
        for number, target in enumerate(made):
            folder = work / f"target_{number}"
            folder.mkdir(exist_ok=True)
            size = min(ROUND, chosen.count - done)
            fuzz(
                target, folder, size, hash_of(target.name, chosen.seed, done), tallies[target.name]
            )
            tell(f"{target.name}: {done + size}, {len(tallies[target.name].finds)} finds")
        done += ROUND


def hash_of(*parts: object) -> int:
    """A seed that is the same in every process."""
    return int.from_bytes(hashlib.sha256(repr(parts).encode()).digest()[:6])


def _kept(tallies: Mapping[str, Tally], folder: Path) -> int:
    finds = [(name, find) for name, tally in tallies.items() for find in tally.finds]
    for name, find in finds:
        folder.mkdir(parents=True, exist_ok=True)
        stem = f"{name.replace(' ', '_')}_{hashlib.sha256(find.data).hexdigest()[:8]}"
        (folder / stem).write_bytes(find.data)
        report = f"{find.why}\n{' '.join(find.line)}\n{find.damage}\n{find.said}\n"
        (folder / f"{stem}.txt").write_text(report, encoding="utf-8", errors="backslashreplace")
        tell(f"{folder / stem}: {find.why}")
    return len(finds)


def _with_earlier(new: Sequence[Sequence[Any]], path: Path) -> str:
    """The table of these rows and of those that runs before left in a file: counts add up."""
    known = json.loads(path.read_text()) if path.is_file() else {}
    for name, *numbers in new:
        before = known.get(name, [0] * len(numbers))
        counts = (k in (0, 1, 2, 4) for k in range(len(numbers)))
        both = zip(counts, before, numbers, strict=True)
        known[name] = [a + b if adds else max(a, b) for adds, a, b in both]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(known))
    return table(HEADER, [(name, *map(str, numbers)) for name, numbers in known.items()])


def rows(tallies: Mapping[str, Tally]) -> list[list[Any]]:
    """How each kind was answered."""
    cells: list[list[Any]] = []
    for name, tally in tallies.items():
        refused = tally.codes[2]
        read = sum(tally.codes[code] for code in (0, 1, 3))
        total = sum(tally.codes.values())
        numbers = (total, read, refused, len(tally.answers), len(tally.finds))
        cells.append([name, *numbers, round(tally.slowest, 1), tally.peak >> 10])
    return cells


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
