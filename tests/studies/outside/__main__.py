"""Run cases: `python -m tests.studies.outside --set tuning --seeds A:B [--cache FOLDER]`.

Every case is kept in the cache as `SEED.json`, its diagnosis as `SEED.diagnosis.json`: a run that
was cut goes on, and a case is run anew when its file is gone.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec

from tests import ROOT
from tests.studies.outside.cases import run_case
from tests.studies.outside.plan import RESERVED
from tests.studies.outside.score import Row
from tests.studies.outside.tabulate import tables
from tests.studies.tables import placed

DOCUMENT = ROOT / "docs" / "outside.md"


def main(arguments: Sequence[str]) -> int:
    """Run what the cache does not hold, then write the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.outside", description=__doc__)
    parser.add_argument("--set", choices=("tuning", "reserved"), default="tuning")
    parser.add_argument("--seeds", default="0:80", metavar="A:B")
    parser.add_argument("--cache", type=Path, default=Path("out") / "outside")
    parser.add_argument("--keep", action="store_true", help="keep the logs and files in the cache")
    parser.add_argument("--coarser", type=float, default=1.0, help="counts of the encoders, times")
    parser.add_argument("--write", action="store_true", help="write the tables into the document")
    chosen = parser.parse_args(arguments)
    first, _, last = chosen.seeds.partition(":")
    seeds = range(int(first), int(last))
    if any((seed >= RESERVED) != (chosen.set == "reserved") for seed in seeds):
        parser.error(f"tuning seeds are below {RESERVED}, reserved ones are not")
    chosen.cache.mkdir(parents=True, exist_ok=True)
    text = tables([answered(seed, chosen.cache, chosen.keep, chosen.coarser) for seed in seeds])
    sys.stdout.write(text + "\n")
    if chosen.write:
        document = DOCUMENT.read_text(encoding="utf-8")
        DOCUMENT.write_text(placed(document, f"outside_{chosen.set}", text), encoding="utf-8")
    return 0


def answered(seed: int, cache: Path, keep: bool, coarser: float = 1.0) -> Row:
    """The answer to a case, from the cache or run; `coarser` needs a cache of its own."""
    file = cache / f"{seed}.json"
    if not file.exists():
        with tempfile.TemporaryDirectory() as name:
            folder = cache / f"logs_{seed}" if keep else Path(name)
            folder.mkdir(exist_ok=True)
            row, found = run_case(seed, folder, coarser)
        if found is not None:
            (cache / f"{seed}.diagnosis.json").write_bytes(msgspec.json.encode(found))
        file.write_text(json.dumps(row), encoding="utf-8")
        names = [(item["effect"], item["joint"]) for item in row.get("findings", ())]
        sys.stderr.write(f"{seed} {row['flow']} {row['kinds']}: {names} {row['error']}\n")
    known: Row = json.loads(file.read_text(encoding="utf-8"))
    return known


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
