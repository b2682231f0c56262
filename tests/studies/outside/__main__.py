"""Run cases: `python -m tests.studies.outside --group NAME --set tuning --seeds A:B
[--cache FOLDER]`.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tests.studies.outside.cases import answered
from tests.studies.outside.groups import GROUPS
from tests.studies.outside.plan import RESERVED
from tests.studies.outside.tabulate import tables
from tests.studies.records import results, seeds_of
from tests.studies.tables import show


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.outside", description=__doc__
    )
    parser.add_argument("--group", choices=[*GROUPS], default="mixed")
    parser.add_argument("--set", choices=("tuning", "reserved"), default="tuning")
    parser.add_argument("--seeds", type=seeds_of, default="0:80", metavar="A:B")
    parser.add_argument("--cache", type=Path, default=Path("out") / "outside")
    parser.add_argument(
        "--coarser", type=float, default=1.0, help="counts of the encoders, times"
    )
    parser.add_argument(
        "--whole", action="store_true", help="published arms, all their joints"
    )
    parser.add_argument(
        "--write", action="store_true", help="write the tables into the document"
    )
    chosen = parser.parse_args()
    if any((seed >= RESERVED) != (chosen.set == "reserved") for seed in chosen.seeds):
        parser.error(f"tuning seeds are below {RESERVED}, reserved ones are not")
    drawing: dict[str, Any] = {}
    name = f"outside_{chosen.set}" + "_whole" * chosen.whole
    cache = chosen.cache
    if chosen.group == "mixed":
        drawing = {"coarser": chosen.coarser, "whole": chosen.whole}
    else:
        name = f"outside_{chosen.group}_{chosen.set}"
        cache /= chosen.group
        if chosen.whole or chosen.coarser != 1.0:
            parser.error("--whole and --coarser are for the group mixed")
    rows = answers(chosen.seeds, cache, group=chosen.group, **drawing)
    content = tables(rows, chosen.group)
    show("evidence/outside.md", name, content, kept=chosen.write)


def answers(seeds: Sequence[int], cache: Path, **drawing: Any) -> list[dict[str, Any]]:
    """Answers of the seeds' cases, drawn as `answered` is told, from the cache where
    they are kept.
    """
    work, cases = (
        partial(answered, cache=cache, **drawing),
        {str(seed): seed for seed in seeds},
    )
    return [
        *results(
            cases, work, dict[str, Any], cache / "outside.jsonl", told=_told
        ).values()
    ]


def _told(row: dict[str, Any]) -> str:
    names = [(item["effect"], item["joint"]) for item in row.get("findings", ())]
    hidden = row["variant"] or row["kinds"]
    return f"{row['flow']} {hidden} {row['joints']}: {names} {row['error']}"


if __name__ == "__main__":
    main()
