"""Model files of refined arms: held-out errors beside those of the files themselves.

An arm is identified from its training logs and refined. URDF and MJCF of the file
before and after refinement are written, read back and run over the held-out logs, on
the same samples behind the same low-pass.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seqid_cli.discover.functions import refine
from seqid_cli.export import export
from seqid_cli.export.motions import FullModel
from seqid_cli.export.replay import replayed
from seqid_cli.identify.functions import simultaneous
from seqid_cli.params.io import read_parameters
from seqid_cli.robot.file import load_robot
from tests import Array
from tests.studies.tables import number, table
from tests.unit.export import recordings
from tests.unit.export.plants import CASES, Recorded, recorded

# Simulated arms of other noise and motion than those of the tests.
SEED, OTHER_SEED = 10131, 10157
FORMS = {"URDF": "urdf", "MJCF": "xml"}


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Parameter files of an arm before and after refinement, and the logs to replay."""

    name: str
    robot: Path
    before: Path
    after: Path
    held_out: Sequence[Path]


def study(chosen: Namespace) -> str:
    """Return a table for each arm; the simulated arm of one joint alone with
    `--quick`.
    """
    with TemporaryDirectory() as place:
        arms = _simulated(["one_joint"] if chosen.quick else list(CASES))
        parts = [_rendered(arm, Path(place)) for arm in arms]
        if not chosen.quick:
            parts += [_rendered(arm, Path(place)) for arm in _recorded(Path(place))]
    return "\n\n".join(parts)


def _simulated(names: Sequence[str]) -> Iterator[Arm]:
    for name in names:
        case: Recorded = recorded(name, SEED, OTHER_SEED)
        yield Arm(
            name=f"simulated, {name.replace('_', ' ')}",
            robot=case.robot,
            before=case.simultaneous,
            after=case.refined,
            held_out=case.held_out,
        )


def _recorded(place: Path) -> Iterator[Arm]:
    for name, (training, held_out) in recordings.ROBOTS.items():
        source = recordings.DATA / name
        if not source.is_dir():
            sys.stderr.write(f"{name}: left out, its logs are not beside the project\n")
            continue
        robot = source / "robot.toml"
        before, after = (
            place / f"{name}_{which}.json" for which in ("before", "after")
        )
        logs = [source / log for log in training]
        simultaneous(logs, robot, output=before)
        refine(logs, source / held_out, robot, before, output=after)
        yield Arm(
            name=name,
            robot=robot,
            before=before,
            after=after,
            held_out=[source / held_out],
        )


def _rendered(arm: Arm, place: Path) -> str:
    """Return the table of one arm."""
    robot = load_robot(arm.robot)
    full = FullModel.of(robot, read_parameters(arm.after).stages)
    rows: dict[str, Array] = {}
    loss = np.zeros(robot.n)
    for form, suffix in FORMS.items():
        for when, file in (("unrefined", arm.before), ("refined", arm.after)):
            target = place / f"arm.{suffix}"
            done = export(file, arm.robot, target, replay=arm.held_out)
            assert done.replay is not None
            of_file = [joint.file_rmse or 0.0 for joint in done.replay.joints.values()]
            rows.setdefault(f"{when} file", np.array(of_file))
            found = replayed(target, form, full, arm.held_out, {})
            of_form = [joint.export_rmse or 0.0 for joint in found.values()]
            rows[f"{when}, as {form}"] = np.array(of_form)
            if when == "refined":
                loss = np.array([done.loss[name] or 0.0 for name in robot.joint_names])
    ratio = rows["refined, as URDF"] / rows["unrefined, as URDF"]
    lines = [
        [name, *(number(float(x), 3) for x in values)] for name, values in rows.items()
    ]
    lines.append(["refined by unrefined URDF", *(f"{x:.4f}" for x in ratio)])
    lines.append(["stated loss", *(number(float(x), 3) for x in loss)])
    header = [f"{arm.name}, RMSE, N m", *(f"joint {k + 1}" for k in range(robot.n))]
    sys.stderr.write(f"{arm.name}: {ratio.max():.4f}\n")
    return table(header, lines)
