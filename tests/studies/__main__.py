"""Run studies and benchmarks: `python -m tests.studies [--quick] [--only NAME ...]`."""

import argparse
import sys
import time
from collections.abc import Callable, Mapping

from tests import ROOT
from tests.benchmarks import (
    discovery,
    exported,
    ingestion,
    kernels,
    processes,
    whole_run,
)
from tests.studies import (
    bands,
    confirmed,
    exported_effects,
    recorded,
    recorded_all,
    reduced,
    settings,
    situations,
    tables,
    unseen,
)
from tests.studies.coverage import study as coverage
from tests.studies.loop import study as closed_loop
from tests.studies.planned import errors, floor, separation
from tests.studies.rigs import one_joint, six_joint, table_two, two_joint
from tests.studies.undeclared import study as undeclared

MEASURED = "evidence/measured.md"
RECORDED = "evidence/recorded.md"
COSTS = "evidence/benchmarks.md"
# page of docs/, study
STUDIES: Mapping[str, tuple[str, Callable[[argparse.Namespace], str]]] = {
    "one_joint": (MEASURED, one_joint.study),
    "two_joint": (MEASURED, two_joint.study),
    "six_joint": (MEASURED, six_joint.study),
    "recorded": (RECORDED, recorded.classical),
    "table_two": ("evidence/motion_study.md", table_two.study),
    "undeclared": ("evidence/effects_study.md", undeclared.study),
    "closed_loop": ("evidence/closed_loop_study.md", closed_loop.study),
    "confirmed": ("evidence/closed_loop_study.md", confirmed.study),
    "coverage": ("evidence/coverage.md", coverage.study),
    "bands": ("evidence/coverage.md", bands.study),
    "unseen": ("evidence/unseen.md", unseen.study),
    "planned_errors": ("evidence/planned.md", errors.study),
    "planned_separation": ("evidence/planned.md", separation.study),
    "planned_floor": ("evidence/planned.md", floor.study),
    "recorded_effects": (RECORDED, recorded.effects),
    "recorded_all": (RECORDED, recorded_all.study),
    "reduced": (RECORDED, reduced.study),
    "ingestion": (COSTS, ingestion.study),
    "fixed": (COSTS, processes.fixed),
    "inspected": (COSTS, processes.inspected),
    "beside_figaroh": (COSTS, processes.beside_figaroh),
    "over_size": (COSTS, processes.over_size),
    "kernels": (COSTS, kernels.study),
    "whole_run": (COSTS, whole_run.study),
    "smoother": (COSTS, kernels.smoother),
    "discovery": (COSTS, discovery.study),
    "short_logs": (COSTS, discovery.short_logs),
    "exported_step": (COSTS, exported.study),
    "exported_effects": ("evidence/exported.md", exported_effects.study),
    "settings": ("reference/settings.md", settings.study),
    "situations": ("evidence/situations.md", situations.study),
}
USUAL = ("one_joint", "two_joint", "six_joint", "recorded")  # where none is named
SLOW = ("six_joint", "planned_errors", "recorded_effects")  # even of one rig


def main() -> None:
    """Print the tables; a full run also puts them into their document."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies", description=__doc__
    )
    parser.add_argument(
        "--quick", action="store_true", help="one rig each; documents stay"
    )
    parser.add_argument("--only", nargs="+", choices=list(STUDIES), default=list(USUAL))
    undeclared.add_arguments(parser)
    table_two.add_arguments(parser)
    chosen = parser.parse_args()
    for name in chosen.only:  # a missing marker shows before the work is done
        if written(name, chosen):
            page = ROOT / "docs" / STUDIES[name][0]
            tables.placed(page.read_text(encoding="utf-8"), name, "")
    for name in chosen.only:
        page_name, study = STUDIES[name]
        start = time.monotonic()
        content = (
            "left out by --quick" if chosen.quick and name in SLOW else study(chosen)
        )
        sys.stdout.write(f"## {name}\n\n")
        tables.show(page_name, name, content + "\n", kept=written(name, chosen))
        sys.stdout.flush()
        sys.stderr.write(f"{name}: {time.monotonic() - start:.0f} s\n")


def written(name: str, chosen: argparse.Namespace) -> bool:
    """Whether a study's tables go into its document: not those of a part of it."""
    whole = {"coverage": coverage.whole, "undeclared": undeclared.whole}
    return not chosen.quick and (name not in whole or whole[name](chosen))


if __name__ == "__main__":
    main()
