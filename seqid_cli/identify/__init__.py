"""From logs to parameters: a function per stage, and one for predicted torques.

Rooms, each above the ones before: `regression`, `friction_surface`, `rigid`,
`prediction`; `imu_calibration` stands alone. `inputs`, `options` and `log_set` lie
below them, `functions` above.
"""

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
from seqid_cli.identify.settings import (
    FrictionSettings,
    GravitySettings,
    ImuCalibSettings,
    InertiaSettings,
    JudgingSettings,
    PredictSettings,
    SimultaneousSettings,
)
from seqid_cli.identify.surfaces import FrictionValues, friction_values
from seqid_cli.logs.reading import LogPart

__all__ = [
    "FrictionOptions",
    "FrictionSettings",
    "FrictionValues",
    "GravitySettings",
    "ImuCalibSettings",
    "InertiaSettings",
    "JudgingSettings",
    "LogOptions",
    "LogPart",
    "PredictOptions",
    "PredictSettings",
    "RigidOptions",
    "SimultaneousOptions",
    "SimultaneousSettings",
    "friction",
    "friction_values",
    "gravity",
    "imu_calib",
    "inertia",
    "predict",
    "simultaneous",
]
