"""What a channel may have been taken for: one family of hypotheses of its scale.

A channel that holds x should hold k x. Motion and torque of a log measure k, with a
standard error: the factor of all angles by the robot's equations (`dynamics.angles`),
that of velocities by the slopes of the positions (`channels.velocities`), that of
torques by the URDF's gravity (`dynamics.weights`). A hypothesis is a unit, a constant
of the drive or a speed of playing that gives a k of its own. Advice follows only where
both agree within the error, and then it is that of one hypothesis, the first that
agrees: the likeliest stand first.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.logs.drives import DEGREE, TURN, percent_of_range, unit_of_positions
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

SIGMAS = 3.0  # standard errors by which a factor may differ from that of a hypothesis
# Share by which it may differ besides: models and motions are no better.
EXACT = 0.03
HARDLY_KNOWN = 0.2  # relative error of a factor
# Counts of encoders in a turn that joints of arms have, the most usual first.
COUNTS_PER_TURN = (4096, 1024, 4000, 8192, 16384, 65536, 2**17, 2**18, 2**19, 2**20)


@dataclass(frozen=True, kw_only=True)
class Factor:
    """A measured factor k of one channel, or of those of all joints."""

    value: float
    std_error: float

    @property
    def relative_error(self) -> float:
        """Standard error as a share of the factor, never quite zero."""
        return self.std_error / max(abs(self.value), 1e-300)

    def agrees(self, other: float, tolerance: float = EXACT) -> bool:
        """Tell whether another factor is the same within errors.

        `tolerance` is the share by which both may differ besides.
        """
        if self.value * other <= 0.0:
            return False
        allowed = max(SIGMAS * self.relative_error, tolerance)
        return bool(abs(np.log(self.value / other)) < allowed)

    def __str__(self) -> str:
        """Return the factor with its error, in as many digits as it has."""
        return f"{self.value:.4g} +- {self.std_error:.1g}"


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A hypothesis: what a channel is, by which factors (n,) of the joints, in words.

    `remedy` is empty where the finding of the `code` has one.
    """

    code: str
    factors: Array
    text: str
    remedy: str = ""


def first_agreeing(
    measured: Sequence[tuple[int, Factor]],
    scales: Sequence[Scale],
    tolerance: float = EXACT,
) -> Scale | None:
    """Return the first hypothesis with which the factors of all joints agree.

    Parameters
    ----------
    measured : sequence of (int, Factor)
        Joints by number, with their factors.
    scales : sequence of Scale
        Hypotheses, the likeliest first.
    tolerance : float
        Share by which a factor may differ beside its error. One that is hardly known
        agrees with anything, and says nothing: it is left out.
    """
    telling = [
        (joint, factor)
        for joint, factor in measured
        if factor.relative_error <= HARDLY_KNOWN
    ]
    if not telling:
        return None
    for scale in scales:
        if all(
            factor.agrees(float(scale.factors[joint]), tolerance)
            for joint, factor in telling
        ):
            return scale
    return None


def angle_scales(robot: Robot) -> list[Scale]:
    """Return what the angles of a log may be, but for what they are taken for.

    A factor is NaN where the robot file lacks what it follows from.
    """
    taken = unit_of_positions(robot)
    return [
        scale
        for scale in _angle_scales(robot, taken)
        if np.isfinite(scale.factors).any()
        and not np.allclose(scale.factors, 1.0, rtol=1e-6)
    ]


def _angle_scales(robot: Robot, taken: Array) -> Iterator[Scale]:
    """Yield units of angles; `taken` (n,) rad is what one unit is taken for."""
    ones = np.ones(robot.n)
    yield Scale(
        code="position_in_degrees",
        factors=DEGREE * ones / taken,
        text="is in degrees",
    )
    yield Scale(
        code="position_scale",
        factors=ones / taken,
        text="is in rad",
        remedy='Write unit = "rad" under [channels] of the robot file.',
    )
    yield Scale(
        code="position_in_percent",
        factors=percent_of_range(robot) / taken,
        text="is in percent of its range",
    )
    gears = [joint.gear_ratio or np.nan for joint in robot.joints]
    yield Scale(
        code="position_motor_side",
        factors=ones / np.array(gears, np.float64) / taken,
        text="is that of the motor",
    )
    yield Scale(
        code="position_in_turns", factors=TURN * ones / taken, text="is in turns"
    )
    steps = [joint.encoder_resolution or np.nan for joint in robot.joints]
    yield Scale(
        code="position_in_counts",
        factors=np.array(steps, np.float64) / taken,
        text="is in counts of its encoder",
    )
    for count in COUNTS_PER_TURN:
        yield Scale(
            code="position_in_counts",
            factors=TURN / count * ones / taken,
            text=f"is in counts, {count} in a turn",
            remedy=(
                f'Write unit = "count" under [channels] and encoder_resolution ='
                f" {TURN / count:.7g} at the joints."
            ),
        )


def slope_scales(robot: Robot) -> list[Scale]:
    """Return what positions and velocities may be, by slopes over velocities.

    The unit of the robot file is applied to both. Where velocities are in rad/s, and
    one unit of the positions is u rad, slopes are 1 / u times the velocities, whatever
    that unit is. A factor is what the slopes are, (n,).
    """
    ones = np.ones(robot.n)
    taken = unit_of_positions(robot)
    scales = [
        replace(scale, factors=1.0 / (scale.factors * taken))
        for scale in angle_scales(robot)
        if scale.code in _OF_ONE_CHANNEL
    ]
    if (taken != 1.0).any():
        scales.append(
            Scale(
                code="velocity_inconsistent",
                factors=1.0 / taken,
                text="velocities are in rad/s, whatever the unit of the positions",
                remedy="Leave the velocity out, or log both in one unit.",
            )
        )
    gears = np.array([joint.gear_ratio or np.nan for joint in robot.joints], float)
    scales.append(
        Scale(
            code="velocity_in_degrees",
            factors=DEGREE * ones,
            text="velocities are in deg/s",
        )
    )
    for factors, unit in (
        (TURN / 60.0 * ones, "rpm"),
        (TURN * ones, "turns per second"),
        (1.0 / np.abs(gears), "rad/s of the motor"),
        (TURN / 60.0 / np.abs(gears), "rpm of the motor"),
    ):
        if np.isfinite(factors).any():
            scales.append(
                Scale(
                    code="velocity_inconsistent",
                    factors=factors,
                    text=f"velocities are in {unit}",
                    remedy="Convert to rad/s of the joint, or leave the velocity out.",
                )
            )
    return scales


# Units of positions whose velocities may be in rad/s all the same.
_OF_ONE_CHANNEL = frozenset(
    {"position_in_degrees", "position_in_turns", "position_in_counts"}
)


def likely_unit_of_time(
    rate_hz: float, *, slowest_hz: float = 5.0, fastest_hz: float = 50_000.0
) -> str:
    """Return the unit of times that give a rate as seconds; empty where none fits.

    Parameters
    ----------
    rate_hz : float
        Samples per second, times taken for seconds.
    slowest_hz, fastest_hz : float
        Rates at which robots are recorded.
    """
    for unit in ("ms", "us", "ns"):
        rate_hz *= 1000.0
        if slowest_hz <= rate_hz <= fastest_hz:
            return unit
    return ""


def remedy_of_time(unit: str) -> str:
    """Return what to do about times in a unit."""
    return f'Write time_unit = "{unit}" under [channels] of the robot file.'


def time_scales(robot: Robot) -> list[Scale]:
    """Return in which units the time may be, by slopes over velocities, (n,)."""
    ones = np.ones(robot.n)
    return [
        Scale(
            code="time_unit",
            factors=factor * ones,
            text=f"the time is in {unit}",
            remedy=remedy_of_time(unit),
        )
        for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
    ]


def effort_scales(robot: Robot, quantity: str) -> list[Scale]:
    """Return what torques or currents may be, by the URDF's gravity.

    Parameters
    ----------
    robot : Robot
        The arm; a factor is NaN where it lacks what that follows from.
    quantity : {"torque", "current"}
        What the log is taken for.

    Returns
    -------
    list of Scale
        Factors (n,) are the torque as it is taken over the one that it is.
    """
    ones = np.ones(robot.n)
    joints = robot.joints
    per_ampere = np.array([abs(j.torque_per_ampere or np.nan) for j in joints], float)
    if quantity == "current":
        gears = np.array([abs(joint.gear_ratio or np.nan) for joint in joints], float)
        return [
            Scale(code="current_in_ma", factors=1e3 * ones, text="it is in mA"),
            Scale(
                code="effort_is_torque", factors=per_ampere, text="it is torque already"
            ),
            Scale(
                code="torque_scale",
                factors=np.where(gears > 1.0, gears, np.nan),
                text="torque_constant is that of the joint, with the gear in it",
                remedy="Divide torque_constant by gear_ratio, or leave gear_ratio out.",
            ),
        ]
    scales = [
        Scale(code="effort_is_current", factors=1.0 / per_ampere, text="it is current"),
        Scale(
            code="effort_is_current",
            factors=1e3 / per_ampere,
            text="it is current, in mA",
            remedy='Convert to A, and write effort = "current" under [channels].',
        ),
    ]
    units = {"mN m": 1e3, "N cm": 1e2, "kgf cm": 10.197, "lbf in": 8.851}
    scales += [
        Scale(
            code="torque_scale",
            factors=factor * ones,
            text=f"it is in {unit}",
            remedy="Convert to N m.",
        )
        for unit, factor in units.items()
    ]
    return scales


def winding_scales(robot: Robot) -> list[Scale]:
    """Return what torque constants may be meant for: values close to each other."""
    ones = np.ones(robot.n)
    words = {
        2.0**0.5: "the current is a peak value, torque_constant per RMS ampere",
        2.0**-0.5: "the current is RMS, torque_constant per peak ampere",
        3.0**0.5: "torque_constant is that of the other winding (star for delta)",
        3.0**-0.5: "torque_constant is that of the other winding (delta for star)",
    }
    return [
        Scale(code="torque_scale", factors=factor * ones, text=text)
        for factor, text in words.items()
    ]
