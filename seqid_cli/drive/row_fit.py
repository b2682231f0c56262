"""What a fit by rows says of a joint's controller."""

from dataclasses import dataclass

from seqid_cli.drive.equations import Delays
from seqid_cli.drive.limits import Limit


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """The controller of a joint.

    Attributes
    ----------
    names : tuple of str
        The parts that are there.
    values, std_errors : dict of str to float
        Of these, of `command_delay` and of `torque_lag`.
    own_shares : dict of str to float
        Share of each part's column that no other explains, before any was taken out.
    refused : dict of str to float
        Standard errors of parts that were taken out.
    delays : Delays
    course : str
        What commands do between two stamps.
    course_is_known : bool
        Whether the logs tell it.
    left : float
        Share of the torque's RMS that is left.
    rmse : float
        N m.
    rows : int
    offset : float
        N m, mean of all logs.
    limit : Limit, optional
    speed_limit : Limit, optional
        rad/s.
    largest_torque, largest_speed : float
        N m, rad/s, that the logs show.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    std_errors: dict[str, float]
    own_shares: dict[str, float]
    refused: dict[str, float]
    delays: Delays
    course: str
    course_is_known: bool
    left: float
    rmse: float
    rows: int
    offset: float
    limit: Limit | None
    speed_limit: Limit | None
    largest_torque: float
    largest_speed: float
