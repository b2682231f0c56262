"""The sample robots with motion from encoders, from IMUs and from both: parameters, held-out logs.

All stages before inertia are the same; `--motion` decides for inertia and for the prediction.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage, Stages
from tests.plants.robots.identified import HeldOut, summed
from tests.plants.robots.sample import Rig
from tests.studies.tables import number, table

Array = NDArray[np.float64]

RIGS = ("one_joint", "two_joint", "six_joint")
SOURCES = ("encoder", "imu", "fused")
COMMON_HZ = 10.0


@dataclass(frozen=True)
class Found:
    """What one source gives: parameters' errors and standard errors (p,), % of the largest."""

    error: Array
    std_error: Array
    held_out: HeldOut


def found(rig: Rig, stages: Stages, options: InertiaOptions) -> Found:
    """Identify inertia, and predict the held-out logs, with the same options."""
    stage = identify_inertia(rig.logs("inertia"), rig.robot, stages, options=options)
    whole = replace_inertia(stages, stage)
    torques = list(predict(rig.logs("validation"), rig.robot, whole, options=options))
    true = np.array([rig.true_value(p) for p in stage.parameters])
    size = largest(stage, true)
    error = np.array([p.value for p in stage.parameters]) - true
    std_error = np.array([p.std_error for p in stage.parameters])
    return Found(100 * error / size, 100 * std_error / size, summed(torques))


def replace_inertia(stages: Stages, stage: RigidStage) -> Stages:
    """The stages with another inertia stage."""
    return Stages(friction=stages.friction, gravity=stages.gravity, imu=stages.imu, inertia=stage)


def largest(stage: RigidStage, true: Array) -> Array:
    """Size (p,) of the largest true value with each parameter's unit."""
    units = [p.unit for p in stage.parameters]
    most = {u: max(abs(x) for x, v in zip(true, units, strict=True) if v == u) for u in set(units)}
    return np.array([most[u] for u in units])


def stages_of(rig: Rig) -> Stages:
    """Friction, gravity and IMUs from the sample logs."""
    return Stages(friction=rig.friction, gravity=rig.gravity, imu=rig.imu)


def rows_of(name: str, sources: Sequence[str] = SOURCES) -> list[list[str]]:
    """A row of the table per source, for one robot."""
    rig = Rig(name)
    stages = stages_of(rig)
    rows = []
    for source in sources:
        own = InertiaOptions(source=source)
        first = found(rig, stages, own)
        second = found(rig, stages, replace(own, motion=MotionOptions(COMMON_HZ)))
        rows.append([name, source, *cells(first), *cells(second)])
    return rows


def cells(one: Found) -> list[str]:
    """Cut-off, median error and standard error, share within two of them, held-out RMSE."""
    cutoffs = sorted({number(hz) for hz in one.held_out.cutoff_hz}, key=float)
    inside = np.mean(np.abs(one.error) <= 2 * one.std_error)
    return [
        ", ".join(cutoffs),
        number(float(np.median(np.abs(one.error)))),
        number(float(np.median(one.std_error))),
        f"{100 * inside:.0f} %",
        ", ".join(number(x) for x in one.held_out.sliding),
    ]


def table_of(rows: Sequence[Sequence[str]]) -> str:
    """Two tables: the cut-off that each source chooses, and one for all."""
    header = ["robot", "motion", "Hz", "error, %", "std error, %", "within 2", "held-out RMSE, N m"]
    own = table(header, [row[:7] for row in rows])
    common = table(header, [[*row[:2], *row[7:]] for row in rows])
    return (
        f"Each with the cut-off chosen from the log:\n\n{own}\n\n"
        f"All with `--cutoff {COMMON_HZ:g}`:\n\n{common}"
    )


def study(chosen: argparse.Namespace) -> str:
    """Both tables; a quick run is of the smallest robot."""
    names = RIGS[:1] if chosen.quick else RIGS
    return table_of([row for name in names for row in rows_of(name)])
