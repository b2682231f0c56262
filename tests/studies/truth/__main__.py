"""Run arms: `python -m tests.studies.truth --set tuning --seeds A:B [--only
delay,offset]`.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tests.studies.records import package_sources, results, seeds_of, sources_of
from tests.studies.tables import show
from tests.studies.truth import tabulate
from tests.studies.truth.fixed import ROWS, fixed_case
from tests.studies.truth.plan import CLEAN, KINDS, RESERVED, Case, drawn
from tests.studies.truth.rigs import COUNTS, RIGS, label_of, rig_row, rig_tables
from tests.studies.truth.score import Row, scored
from tests.studies.truth.session import sources

PAGE = "evidence/truth_study.md"


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        prog="python -m tests.studies.truth", description=__doc__
    )
    made.add_argument("--set", choices=("tuning", "reserved"), default="tuning")
    made.add_argument("--seeds", type=seeds_of, default="0:20", metavar="A:B")
    made.add_argument(
        "--only",
        type=_names,
        default=[],
        metavar="KIND,KIND",
        help=f"{CLEAN}, {', '.join(KINDS)}",
    )
    made.add_argument(
        "--alone", action="store_true", help="every arm has one imperfection"
    )
    made.add_argument(
        "--fixed",
        action="store_true",
        help="one two-joint arm instead, sizes always the same",
    )
    made.add_argument(
        "--rigs",
        action="store_true",
        help="the paper's two rigs instead, the paper's encoders",
    )
    made.add_argument("--cache", type=Path, default=Path("out") / "truth")
    made.add_argument("--processes", type=int, default=1)
    made.add_argument(
        "--tables", action="store_true", help="of what is there: run nothing"
    )
    made.add_argument(
        "--write", action="store_true", help="write the tables into the document"
    )
    return made


def _names(text: str) -> list[str]:
    names = text.split(",")
    if unknown := [name for name in names if name not in (CLEAN, *KINDS)]:
        raise argparse.ArgumentTypeError(f"no such kind: {', '.join(unknown)}")
    return names


def main() -> None:
    """Run what the cache does not hold, and print the tables."""
    program = parser()
    chosen = program.parse_args()
    if any((seed >= RESERVED) != (chosen.set == "reserved") for seed in chosen.seeds):
        program.error(f"tuning seeds are below {RESERVED}, reserved ones are not")
    if chosen.fixed:
        cases = [fixed_case(name, seed) for seed in chosen.seeds for name in ROWS]
        rows = rows_of(cases, chosen)
        show(PAGE, "truth_fixed", tabulate.fixed(rows), kept=chosen.write)
        return
    if chosen.rigs:
        rigs = [
            (rig, counts, seed)
            for rig in RIGS
            for counts in COUNTS
            for seed in chosen.seeds
        ]
        found = results(
            {label_of(*rig): rig for rig in rigs},
            _rig,
            dict[str, Any],
            chosen.cache / "rigs.jsonl",
            sources=package_sources(),
            run=not chosen.tables,
            processes=chosen.processes,
            told=_told_of_rig,
        )
        show(PAGE, "truth_rigs", rig_tables([*found.values()]), kept=chosen.write)
        return
    cases = [drawn(seed, chosen.only, alone=chosen.alone) for seed in chosen.seeds]
    rows = rows_of(cases, chosen)
    alone = "_alone" * chosen.alone
    show(PAGE, f"truth_{chosen.set}{alone}", tabulate.tables(rows), kept=chosen.write)


def rows_of(cases: Sequence[Case], chosen: argparse.Namespace) -> list[Row]:
    """Return the rows of cases, from the cache where package and study are the same."""
    compared = sources_of(Path(__file__).parent, but=("__", "tabulate", "rigs"))
    versions = f"{package_sources()} {sources()} {compared}"
    work = partial(scored, cache=chosen.cache)
    found = results(
        {case.label: case for case in cases},
        work,
        dict[str, Any],
        chosen.cache / "truth.jsonl",
        sources=versions,
        run=not chosen.tables,
        processes=chosen.processes,
        told=_told,
    )
    return [*found.values()]


def _rig(rig: tuple[str, int, int]) -> Row:
    return rig_row(*rig)


def _told_of_rig(row: Row) -> str:
    worst = max((abs(p["error"]) for p in row.get("parameters", ())), default=0.0)
    return f"{row['seconds']:.0f} s; largest error {100 * worst:.1f} % {row['failed']}"


def _told(row: Row) -> str:
    wrong = [f"{x.stage} {x.name}" for x in tabulate.silent_wrongs([row])]
    seconds = f"{row['simulated_s']:.0f} + {row['seconds']:.0f} s"
    return (
        f"{seconds}; {tabulate.said(row)}; silent wrongs: {', '.join(wrong) or 'none'}"
    )


if __name__ == "__main__":
    main()
