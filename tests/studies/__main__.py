"""Run the studies: `python -m tests.studies [--quick] [--only NAME ...]`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests import ROOT
from tests.studies import (
    closed_loop,
    coverage,
    fused_motion,
    imu_mounting,
    motion_sources,
    noise_floor,
    one_joint,
    planned,
    planned_errors,
    planned_separation,
    planned_session,
    planted,
    recorded,
    recorded_effects,
    six_joint,
    table_two,
    two_joint,
    undeclared,
)
from tests.studies.tables import placed

MEASURED = ROOT / "docs" / "measured.md"

Study = Callable[[argparse.Namespace], str]
STUDIES: Mapping[str, Study] = {
    "one_joint": lambda chosen: one_joint.study(1 if chosen.quick else 8),
    "two_joint": lambda chosen: two_joint.study(1 if chosen.quick else 6),
    "six_joint": lambda chosen: "" if chosen.quick else six_joint.study(3),
    "recorded": lambda chosen: recorded.study(),
    "table_two": table_two.study,
    "motion_sources": motion_sources.study,
    "imu_mounting": lambda chosen: imu_mounting.study(
        2 if chosen.quick else 100, folder=None if chosen.quick else chosen.cache / "imu_mounting"
    ),
    "imu_deflecting": lambda chosen: imu_mounting.study(
        1 if chosen.quick else 10,
        cases=imu_mounting.DEFLECTING,
        folder=None if chosen.quick else chosen.cache / "imu_mounting",
    ),
    "fused_motion": lambda chosen: fused_motion.study(quick=chosen.quick, tell=sys.stderr.write),
    "noise_floor": lambda chosen: noise_floor.study(1 if chosen.quick else 8, chosen.processes),
    "undeclared": undeclared.study,
    "closed_loop": closed_loop.study,
    "coverage": coverage.study,
    "planted": planted.study,
    "planned": lambda chosen: planned.study(chosen.cache / "peers", quick=chosen.quick),
    "planned_errors": lambda chosen: "" if chosen.quick else planned_errors.study(3),
    "planned_session": lambda chosen: "" if chosen.quick else planned_session.study(),
    "planned_separation": planned_separation.study,
    "recorded_effects": lambda chosen: "" if chosen.quick else recorded_effects.study(),
}
LONG = (
    "closed_loop",
    "fused_motion",
    "table_two",
    "motion_sources",
    "noise_floor",
    "undeclared",
    "coverage",
    "planned",
    "planned_errors",
    "planned_session",
    "planned_separation",
    "planted",
    "recorded_effects",
    "imu_mounting",
    "imu_deflecting",
)  # only where asked for by name
DOCUMENTS: Mapping[str, Path] = {  # the others: MEASURED
    "table_two": table_two.DOCUMENT,
    "motion_sources": motion_sources.DOCUMENT,
    "fused_motion": fused_motion.DOCUMENT,
    "noise_floor": noise_floor.DOCUMENT,
    "undeclared": undeclared.DOCUMENT,
    "closed_loop": closed_loop.DOCUMENT,
    "coverage": coverage.DOCUMENT,
    "planned": planned.DOCUMENT,
    "planned_errors": planned_errors.DOCUMENT,
    "planned_session": planned_session.DOCUMENT,
    "planned_separation": planned.DOCUMENT,
    "planted": planted.DOCUMENT,
    "recorded_effects": recorded_effects.DOCUMENT,
    "imu_mounting": imu_mounting.DOCUMENT,
    "imu_deflecting": imu_mounting.DOCUMENT,
}


def main(arguments: Sequence[str]) -> int:
    """Print the tables; a full run also puts them into their document."""
    usual = [name for name in STUDIES if name not in LONG]
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one rig each; documents stay")
    parser.add_argument("--only", nargs="+", choices=list(STUDIES), default=usual)
    undeclared.add_arguments(parser)
    table_two.add_arguments(parser)
    coverage.add_arguments(parser)
    chosen = parser.parse_args(arguments)
    kept = [name for name in chosen.only if not written(name, chosen)]
    for name in set(chosen.only) - set(kept):  # a missing marker shows before the work is done
        placed(DOCUMENTS.get(name, MEASURED).read_text(encoding="utf-8"), name, "")
    for name in chosen.only:
        start = time.monotonic()
        content = STUDIES[name](chosen)
        sys.stdout.write(f"## {name}\n\n{content or 'left out by --quick'}\n\n")
        sys.stdout.flush()
        sys.stderr.write(f"{name}: {time.monotonic() - start:.0f} s\n")
        if name not in kept:
            path = DOCUMENTS.get(name, MEASURED)
            text = path.read_text(encoding="utf-8")
            path.write_text(placed(text, name, content), encoding="utf-8")
    return 0


def written(name: str, chosen: argparse.Namespace) -> bool:
    """Whether a study's tables go into its document: not those of a part of it."""
    if chosen.quick:
        return False
    if name == "coverage":
        return coverage.whole(chosen)
    return name != "undeclared" or undeclared.choice_of(chosen).whole


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
