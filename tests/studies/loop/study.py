"""The loop closed where the effect was in all logs: refined against told, inside and
outside.
"""

import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.held_out import held_out_error
from seqid_cli.discover.refinement.reidentify import RefinementData
from seqid_cli.discover.refinement.rounds import on_the_same_samples, refine
from tests.plants.robots.identified import sequential
from tests.studies.loop.logs import KINDS, case_of, recorded
from tests.studies.records import results
from tests.studies.tables import counted, grouped, number
from tests.studies.undeclared.cases import Condition, built
from tests.studies.undeclared.refine import NEAR, file_of, told_model

# Nothing was set on these: of two joints 11 to 14 were looked at, of six 30.
SEEDS = {"two": (19, 20, 21, 22), "six": (21, 22, 23, 24)}


@dataclass(frozen=True)
class Result:
    """Held-out RMSE [N m] at the effect's joint, and what was added."""

    kind: str
    rig: str
    before: float
    after: float
    told: float
    inside: float | None
    outside: float | None
    share: float | None
    added: tuple[str, ...]
    confirmed: tuple[bool, ...]
    refused: tuple[str, ...]
    seconds: float

    @property
    def ratio(self) -> float:
        return self.after / self.told

    @property
    def closed(self) -> bool:
        """Whether the right effect was added, confirmed, and the model is as good as
        told.
        """
        right = self.kind in {name.partition("@")[0] for name in self.added}
        return right and all(self.confirmed) and self.ratio <= NEAR


def run_case(case: Condition, cache: Path) -> Result:
    logs, options = recorded(case, cache), DiscoverOptions()
    robot, stages = logs.robot, sequential(logs.earlier, logs.robot)
    file = file_of(robot, stages, logs.earlier)
    clock = time.process_time()
    found = refine(logs.training, robot, file, earlier=logs.earlier, options=options)
    loop = confirm(found, logs.held_out).loop
    seconds = time.process_time() - clock
    options = on_the_same_samples(options, stages, robot)
    material = RefinementData(logs.training, logs.earlier, robot, options)
    told = told_model(material, stages, built(case)[1], late=False)
    error = held_out_error(logs.held_out, robot, told, options=options.motion)
    kind, joint, _ = case.effects[0]
    after = loop.after[name := robot.joint_names[joint]]
    tried = (*loop.rounds, *loop.unconfirmed, *loop.refused)
    rounds = [(f"{r.effect}@{r.joint}", r) for r in tried]
    return Result(
        kind=kind,
        rig=case.rig,
        before=loop.before[name].rmse,
        after=after.rmse,
        told=float(error.rmse()[joint]),
        inside=after.rmse_inside,
        outside=after.rmse_outside,
        share=after.share_outside,
        added=tuple(x for x, r in rounds if r.accepted),
        confirmed=tuple(bool(r.confirmed) for _, r in rounds if r.accepted),
        refused=tuple(x for x, r in rounds if not r.accepted),
        seconds=round(seconds, 1),
    )


def study(arguments: Namespace) -> str:
    every = [
        case_of(rig, k, seed) for rig in SEEDS for seed in SEEDS[rig] for k in KINDS
    ]
    cases = {case.key: case for case in every[: 1 if arguments.quick else None]}
    work, path = (
        partial(run_case, cache=arguments.cache),
        arguments.cache / "closed_loop.jsonl",
    )
    found = results(cases, work, Result, path, run=not arguments.tables, told=_told)
    return rendered(list(found.values()))


def _told(r: Result) -> str:
    return f"{', '.join(r.added) or 'nothing added'}, {r.ratio:.3f} of told"


def rendered(found: Sequence[Result]) -> str:
    groups: dict[str, list[Result]] = {}
    for rig in SEEDS:
        mine = [r for r in found if r.rig == rig]
        groups |= {
            f"{kind}, {rig} joints": [r for r in mine if r.kind == kind]
            for kind in KINDS
        }
        groups[f"all, {rig} joints"] = mine

    def middle(name: str) -> Callable[[Sequence[Result]], str]:
        return lambda own: number(median(getattr(r, name) for r in own))

    columns = {
        "cases": counted,
        **{name: middle(name) for name in ("before", "after", "told")},
        "after over told, worst": lambda own: number(max(r.ratio for r in own), 3),
        **{name: middle(name) for name in ("inside", "outside")},
        "share outside": lambda own: (
            f"{100 * median(r.share or 0.0 for r in own):.0f} %"
        ),
        f"confirmed and within {NEAR}": lambda own: (
            f"{sum(r.closed for r in own)} of {len(own)}"
        ),
        "also added": lambda own: str(
            sum(not x.startswith(r.kind) for r in own for x in r.added)
        ),
    }
    return grouped("effect in all logs", groups, columns)
