"""The payload file, `seqid/payload@1`: what a robot carries."""

from collections.abc import Iterator

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import (
    InputLog,
    Matrix,
    OfRobot,
    Parameter,
    UsedSettings,
    Verdict,
)

PAYLOAD_SCHEMA = "seqid/payload@1"


class Measured(Struct, kw_only=True):
    """A number with its standard error; null where the logs do not determine it."""

    value: float | None
    std_error: float | None
    unit: str


class CarriedBodyEntry(Struct, kw_only=True):
    """The body in the axes of the last joint's frame, at its origin.

    `inertia` (3, 3) kg m^2 is about the centre of mass; both matrices are empty where
    the logs do not determine it. `distance` says by how many standard errors the
    least-squares estimate is from the nearest body that can exist, which is the one
    that is given; 0 where it is one.
    """

    frame: str
    mass: Measured
    center_of_mass: list[Measured]
    inertia: Matrix = []
    inertia_std_errors: Matrix = []
    distance: float = 0.0

    def __post_init__(self) -> None:
        lengths = list(map(len, self.inertia))
        error_lengths = list(map(len, self.inertia_std_errors))
        is_square = lengths == error_lengths and lengths in ([], [3, 3, 3])
        if len(self.center_of_mass) != 3 or not is_square:
            raise ValueError("a centre of mass has 3 numbers, an inertia 3 rows of 3")

    def numbers(self) -> Iterator[tuple[str, Measured]]:
        """Yield all numbers by name, of the inertia the upper triangle row by row."""
        yield "mass", self.mass
        for axis, coordinate in zip("xyz", self.center_of_mass, strict=True):
            yield f"centre of mass {axis}", coordinate
        for i, row in enumerate(self.inertia):
            for k in range(i, 3):
                moment = Measured(
                    value=row[k], std_error=self.inertia_std_errors[i][k], unit="kg m^2"
                )
                yield f"inertia {'xyz'[i]}{'xyz'[k]}", moment


class JointWithPayload(Struct, kw_only=True):
    """RMS of a joint's torque error, N m, without the body (`before`) and with it.

    It is over the samples in which the joint slides.

    `friction_change` is the share by which its friction was found to differ from the
    model's.
    """

    before: float | None
    after: float | None
    relative: float | None
    samples: int
    friction_change: float


class PayloadFile(OfRobot, kw_only=True):
    """The whole document.

    `parameters` are the ten standard parameters of the body by least squares (inertia
    about the frame's origin), those that the logs determine, with their `covariance`.
    `settings` holds, by robot controller, the payload in its own words.
    """

    inputs: list[InputLog]
    models: list[FileId]
    payload: CarriedBodyEntry
    parameters: list[Parameter]
    covariance: Matrix
    settings: dict[str, str]
    joints: dict[str, JointWithPayload]
    cutoff_origin: str = ""
    verdicts: list[Verdict] = []
    notes: list[str] = []
    effective_settings: UsedSettings | None = None
