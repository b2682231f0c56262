"""Measured and predicted torque of a log or of a part of it, and notes on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.inertia_equations import slowest_speeds
from seqid_cli.model.torque import TorqueModel, friction_surfaces
from seqid_cli.params.schema import MotionUse, Stages
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

OUTSIDE_NOTE = 0.01  # share of samples outside the identified friction worth a note


@dataclass(frozen=True)
class LogPrediction:
    """Measured and predicted torque (N, n) N m of one log, both low-passed alike.

    `predicted` is the model's own value, whatever was measured. `used` (N,) marks the samples that
    count, away from ends and gaps; `sliding` (N, n) those of them at which a joint certainly
    slides. Elsewhere friction is known only as an interval, and the model allows torques between
    `low` and `high` (N, n) N m; where the joint slides these are `predicted`. `q`, `dq`, `ddq`
    (N, n) are the joint motion behind the prediction, `start` [s] is the first sample of the log
    on its own clock.

    `outside` (N, n) marks sliding samples beyond the identified friction.

    A long log comes in several parts, one behind the other: `samples` are those of the whole log,
    `part` counts its parts from 0, and only the `last` one has `notes` and `motion`.
    """

    path: Path
    sha256: str
    samples: int
    cutoff_hz: float
    t: Array
    tau: Array
    predicted: Array
    low: Array
    high: Array
    used: Mask
    sliding: Mask
    notes: tuple[str, ...] = ()
    q: Array | None = None
    dq: Array | None = None
    ddq: Array | None = None
    motion: MotionUse | None = None
    start: float = 0.0
    part: int = 0
    last: bool = True
    outside: Mask | None = None

    @property
    def residual(self) -> Array:
        """Measured minus predicted torque (N, n) N m."""
        return self.tau - self.predicted

    @property
    def beyond(self) -> Array:
        """Measured torque minus the nearest that the model allows (N, n) N m."""
        return self.tau - np.clip(self.tau, self.low, self.high)


def slides_from(model: TorqueModel, options: InertiaOptions) -> Array:
    """Speeds (n,) rad/s (m/s where prismatic) from which joints certainly slide."""
    if options.slides_from is not None:
        return np.array(options.slides_from)
    return slowest_speeds(model.surfaces)


def lacking(stages: Stages, robot: Robot) -> dict[str, list[str]]:
    """What the file does not hold of each joint's torque, though there is something to identify."""
    found: dict[str, list[str]] = {name: [] for name in robot.joint_names}
    without_inertia = stages.inertia is None and not free_basis(robot).gravity.all()
    surfaces = friction_surfaces(stages, robot)
    for name, surface in zip(robot.joint_names, surfaces, strict=True):
        if surface is None:
            found[name].append("the file holds no friction of this joint")
        if without_inertia:
            found[name].append("the file holds no inertia stage")
    return found


def notes_on(model: TorqueModel, stages: Stages, share: Array) -> Iterator[str]:
    """Say what a prediction lacks.

    `share` (n,): of the samples at which a joint slides, those outside its identified friction.
    """
    names = model.robot.joint_names
    if stages.inertia is None:
        yield "no inertia stage in the parameter file: inertial torque is taken as zero"
    unknown = [n for n, s in zip(names, model.surfaces, strict=True) if s is None]
    if unknown:
        yield f"no friction in the parameter file, taken as zero: {', '.join(unknown)}"
    far = [
        f"{name} {percent(part, 0)}"
        for name, part in zip(names, share, strict=True)
        if part > OUTSIDE_NOTE
    ]
    if far:
        yield (
            "outside the speeds or positions at which friction was identified, so that it is "
            f"extrapolated: {', '.join(far)} of the samples"
        )
