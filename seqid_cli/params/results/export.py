"""The result of an export, `seqid/export@1`, beside the file itself."""

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import OfRobot

EXPORT_SCHEMA = "seqid/export@1"


class ExportedParameter(Struct, kw_only=True):
    """A base parameter as it was identified and as the exported bodies have it.

    `refitted` is the value that loses least of the file's torque in this form, and
    `std_errors` says how far the bodies are from it; null where the identified one is
    that value.
    """

    name: str
    unit: str
    identified: float
    exported: float
    std_error: float | None
    std_errors: float | None
    refitted: float | None = None


class ExportedFriction(Struct, kw_only=True):
    """Coulomb and viscous friction in place of the surface; the RMS values are N m."""

    coulomb: float
    viscous: float
    offset: float
    rms_misfit: float
    rms: float
    speed_range: list[float]


class ExportedLink(Struct, kw_only=True):
    """A link: kg, m, kg m^2; `prior` says where what was not identified is from."""

    mass: float
    center_of_mass: list[float]
    inertia: list[list[float]]
    rotor_inertia: float
    armature: float
    prior: str
    friction: ExportedFriction | None


class CollisionLimits(Struct, kw_only=True):
    """Limits at which a momentum observer raises an alarm at a joint, N m and rad/s.

    Beyond `limit`, and slower than `slow` beyond `limit` and `stiction`; null where the
    error of the joint's torque is not known.
    """

    limit: float | None
    stiction: float
    slow: float


class ReplayedJoint(Struct, kw_only=True):
    """RMS errors of a joint on replayed logs, N m, by parameter file and by export.

    `loss` is what the form loses of the file's torque on these logs; null where it
    holds all. The samples are those at which the joint slides; without any the errors
    are null.
    """

    file_rmse: float | None
    export_rmse: float | None
    loss: float | None
    samples: int


class Replay(Struct, kw_only=True):
    """Replay of logs with the written file; `failures` are messages."""

    logs: list[str]
    joints: dict[str, ReplayedJoint]
    passed: bool
    failures: list[str]


class ExportFile(OfRobot, kw_only=True):
    """The whole document; `largest_deviation` is in standard errors.

    `refitted` says that links and friction are those that lose least of the file's
    torque on the motion of the logs `fitted_on` (made motions where there are none).
    `loss` is how much each joint loses on motion that no number was fitted to, RMS in
    N m: that of the held-out or replayed logs, else that of left-out pieces of
    `fitted_on`; null where the joint slides in none, empty where the form holds all.
    `loss_range` is the smallest and the largest in a single log. `replay` is null where
    nothing was replayed. `observer_gain` [1/s] goes with `collision`.
    """

    format: str
    path: str
    parameters: list[FileId]
    stages: list[str]
    exact: bool
    largest_deviation: float
    base_parameters: list[ExportedParameter]
    joints: dict[str, ExportedLink]
    refitted: bool = False
    fitted_on: list[str] = []
    loss: dict[str, float | None] = {}
    loss_range: dict[str, list[float]] = {}
    replay: Replay | None = None
    observer_gain: float | None = None
    collision: dict[str, CollisionLimits] = {}
    notes: list[str]
