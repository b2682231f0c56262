"""From logs to parameters: friction, gravity, IMUs, inertia, prediction; a function for each."""

from seqid_cli.identify.functions import (
    friction,
    gravity,
    imu_calib,
    inertia,
    predict,
    simultaneous,
)
from seqid_cli.identify.options import (
    FrictionOptions,
    LogOptions,
    PredictOptions,
    RigidOptions,
    SimultaneousOptions,
)

__all__ = [
    "FrictionOptions",
    "LogOptions",
    "PredictOptions",
    "RigidOptions",
    "SimultaneousOptions",
    "friction",
    "gravity",
    "imu_calib",
    "inertia",
    "predict",
    "simultaneous",
]
