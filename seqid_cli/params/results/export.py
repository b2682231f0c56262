"""The result of an export, `seqid/export@1`, beside the file itself."""

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import OfRobot

EXPORT_SCHEMA = "seqid/export@1"


class ExportedParameter(Struct, kw_only=True):
    """A base parameter as it was identified and as the exported bodies have it."""

    name: str
    unit: str
    identified: float
    exported: float
    std_error: float | None
    std_errors: float | None


class ExportedFriction(Struct, kw_only=True):
    """Coulomb and viscous friction in the place of the surface; `rms_misfit` of `rms`, N m."""

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


class ExportFile(OfRobot, kw_only=True):
    """The whole document; `largest_deviation` is in standard errors."""

    format: str
    path: str
    parameters: list[FileId]
    stages: list[str]
    exact: bool
    largest_deviation: float
    base_parameters: list[ExportedParameter]
    joints: dict[str, ExportedLink]
    notes: list[str]
