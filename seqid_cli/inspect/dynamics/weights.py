"""The size of the torque at joints that carry weight, beside that of the URDF.

The measured torque is split into s times its gravity torque by the URDF's inertials,
inertia and friction; s is near one where torque is torque.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import structs

from seqid_cli.inspect.dynamics.friction import Sample, scaled_fit
from seqid_cli.inspect.dynamics.structure import sliding
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.scales import (
    EXACT,
    Factor,
    effort_scales,
    first_agreeing,
    winding_scales,
)
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot

HEAVY = 1e-3  # N m
SIGMAS = 3.0  # standard errors, from a ratio to its limits
# Ratio, or its inverse, from which on a torque is off: masses of a URDF are as rough.
NEARLY = 1.2
# Common factor, or its inverse, that no URDF's masses explain; stages call it poor.
FAR = 2.5
# Share of the expected gravity torque, from which a torque in the opposite direction is
# that of an axis which turns the other way round.
MIN_OPPOSITE = 0.25


@lru_cache(maxsize=1)
def largest_gravity(robot: Robot, *, postures: int = 200) -> Array:
    """Return the largest gravity torque (n,) N m by the URDF's inertials; else 0.

    It is over so many postures, spread evenly.
    """
    if robot.nominal is None:
        return np.zeros(robot.n)
    # Powers of this root step through all angles evenly.
    root = 2.0 ** (1.0 / (robot.n + 1))
    turns = np.outer(np.arange(postures), root ** -np.arange(1, robot.n + 1)) % 1.0
    is_prismatic = np.array([joint.prismatic for joint in robot.joints])
    q = np.where(is_prismatic, turns - 0.5, 2.0 * np.pi * turns)
    still = np.zeros_like(q)
    torque = inverse_dynamics(
        robot.chain, robot.gravity, robot.nominal, q, still, still
    )
    return np.asarray(np.abs(torque).max(axis=0))


class Weight(NamedTuple):
    """Torque of a joint over its gravity torque by the URDF's inertials."""

    joint: int
    ratio: float
    std_error: float

    @property
    def factor(self) -> Factor:
        """The ratio as a factor of the torque."""
        return Factor(value=self.ratio, std_error=self.std_error)

    @property
    def low(self) -> float:
        """The least that the ratio may be."""
        return self.ratio - SIGMAS * self.std_error

    @property
    def high(self) -> float:
        """The most that the ratio may be."""
        return self.ratio + SIGMAS * self.std_error


def weights(
    sample: Sample, *, min_load: float = 0.2, min_acting: float = 0.1
) -> Iterator[Weight]:
    """Yield the weight of each joint that carries a fair share of the arm.

    A small weight of another joint passes for it. It is `min_load` of the most in the
    log, and `min_acting` of the joint's most in any posture.
    """
    robot = sample.robot
    if robot.nominal is None or not robot.gravity.any():
        return
    gravity, inertia = sample.nominal()
    variation = gravity.std(axis=0)
    largest = largest_gravity(robot)
    friction = sample.friction_columns()
    slides = sliding(sample)
    for j in sample.moving:
        # Forces and torques are not to be compared.
        is_prismatic = robot.joints[j].prismatic
        of_kind = [
            i for i in sample.moving if robot.joints[i].prismatic == is_prismatic
        ]
        most_in_log = max(float(variation[of_kind].max()), HEAVY)
        if variation[j] < max(min_load * most_in_log, min_acting * largest[j]):
            continue
        # At rest friction holds any share of the weight.
        rows = slides[:, j]
        X = np.column_stack([gravity[:, j], inertia[:, j], friction[:, j]])
        fit = scaled_fit(X[rows], sample.tau[rows, j])
        variance = float(np.mean(fit.residual**2)) * sample.memory
        of_gravity = fit.inverse[0]
        std_error = float(np.sqrt(variance * (of_gravity @ of_gravity)))
        yield Weight(joint=j, ratio=float(fit.theta[0]), std_error=std_error)


def common_factor(
    found: Sequence[Weight], *, max_spread: float = 0.25, min_joints: int = 2
) -> Factor | None:
    """Return the factor that all joints share, or None where they do not.

    Parameters
    ----------
    found : sequence of Weight
        Joints that carry weight.
    max_spread : float
        Share of the logarithm of the factor by which that of a joint may differ, beside
        its error: inertials of a URDF are not all wrong by as much.
    min_joints : int
        Joints below which a factor is not common, but of a robot with fewer.
    """
    if not found or any(weight.low <= 0.0 for weight in found):
        return None
    precision = np.array([(w.ratio / w.std_error) ** 2 for w in found])
    logs = np.log([weight.ratio for weight in found])
    mean = float(precision @ logs / precision.sum())
    common = Factor(value=float(np.exp(mean)), std_error=0.0)
    tolerance = max(EXACT, max_spread * abs(mean))
    if not all(w.factor.agrees(common.value, tolerance) for w in found):
        return None
    if len(found) < min_joints:
        return None
    by_noise = 1.0 / np.sqrt(precision.sum())
    relative = float(np.hypot(by_noise, np.std(logs)))
    return Factor(value=common.value, std_error=common.value * relative)


def weight_findings(
    data: LogData,
    found: Sequence[Weight],
    *,
    small: float = 0.25,
    large: float = 4.0,
) -> Iterator[InspectionFinding]:
    """Yield what may be wrong with torques of another size than the URDF's gravity.

    One hypothesis that explains all joints counts; else the factor that all share; else
    joints that are off by themselves.

    Parameters
    ----------
    data : LogData
        The log.
    found : sequence of Weight
        Joints that carry weight.
    small, large : float
        Ratios to the expected gravity torque, beyond which one joint by itself is off.
    """
    effort = data.effort()
    quantity = "torque" if effort is None else effort[0]
    measured = [(weight.joint, weight.factor) for weight in found]
    near = float(np.log(NEARLY))
    if all(factor.agrees(1.0, near) for _, factor in measured):
        return
    scale = first_agreeing(measured, effort_scales(data.robot, quantity), near)
    if scale is not None:
        for weight in found:
            text = f"{_in_words(weight)}: {scale.text}"
            yield _named(data.robot, weight, scale.code, text, quantity, scale.remedy)
        return

    common = common_factor(found, min_joints=min(2, data.robot.n))
    if common is not None:
        yield from _of_common(data, found, common, quantity)
        return
    if len(found) > 1 and all(weight.high < -MIN_OPPOSITE for weight in found):
        yield from _of_all_opposite(data, found, quantity)
        return
    for weight in found:
        if weight.high < small or max(weight.low, -weight.high) > large:
            yield _of_joint(data, weight, quantity)


def _of_all_opposite(
    data: LogData, found: Sequence[Weight], quantity: str
) -> Iterator[InspectionFinding]:
    """Yield that all torques have the other sign, or gravity the other direction.

    Some controllers log the torque that acts on the drive, not on the link.
    """
    ends = sorted(weight.ratio for weight in found)
    text = (
        "the torques of all joints that carry weight are opposite to the URDF's"
        f" gravity ({ends[0]:.3g} to {ends[-1]:.3g} times it): all are logged with the"
        " other sign, or gravity points the other way"
    )
    flip = 'effort = "current" with torque_constant = 1 and gear_ratio = -1'
    if quantity == "current":
        flip = "the other sign of every gear_ratio"
    remedy = (
        f"Where the sign is the controller's, {flip} turns it; where the robot hangs,"
        " write gravity in the robot file."
    )
    for weight in found:
        yield _named(data.robot, weight, "sign_mismatch", text, quantity, remedy)


def _of_common(
    data: LogData, found: Sequence[Weight], common: Factor, quantity: str
) -> Iterator[InspectionFinding]:
    """Yield that the torques of all joints are off by one factor.

    A URDF's masses may be as well: from `NEARLY` on it is said, from `FAR` on, which a
    stage calls poor, it is an error.
    """
    # A load in the hand is none of the URDF's: it hardly shows near the base.
    is_beyond = [not 1.0 / NEARLY < weight.ratio < NEARLY for weight in found]
    if not all(is_beyond):
        return
    is_far = not 1.0 / FAR < common.value < FAR
    ends = sorted(weight.ratio for weight in found)
    text = (
        f"the torques of all joints that carry weight are {common} times the URDF's"
        f" gravity ({ends[0]:.3g} to {ends[-1]:.3g})"
    )
    remedy = ""
    if quantity == "current":
        measured = [(weight.joint, common) for weight in found]
        winding = first_agreeing(measured, winding_scales(data.robot))
        if winding is not None:
            text += f": as where {winding.text}"
        elif is_far:
            text += f": neither A nor N m{_rated(common.value)}"
        remedy = (
            f"Look up torque_constant and the unit of the current: torque_constant"
            f" {1.0 / common.value:.3g} times as large would fit."
        )
    for weight in found:
        code = "torque_scale" if is_far else "scale_or_mass"
        yield _named(data.robot, weight, code, text, quantity, remedy)


def _rated(factor: float) -> str:
    """Return in words of which rated current a factor would be a share."""
    if factor < 1.0:
        return f"; in shares of a rated current of {1.0 / factor:.3g} A it would be so"
    if factor < 100.0:
        return (
            f"; in percent of a rated current of {100.0 / factor:.3g} A it would be so"
        )
    return f"; in per mille of a rated current of {1e3 / factor:.3g} A it would be so"


def _of_joint(data: LogData, weight: Weight, quantity: str) -> InspectionFinding:
    """Return what is wrong with the torque of one joint by itself."""
    text = _in_words(weight)
    if weight.high < -MIN_OPPOSITE:
        return _named(data.robot, weight, "axis_flipped", text, quantity)
    measured = Factor(value=abs(weight.ratio), std_error=weight.std_error)
    near = float(np.log(NEARLY))
    scale = first_agreeing(
        [(weight.joint, measured)], effort_scales(data.robot, quantity), near
    )
    if scale is None:
        return _named(data.robot, weight, "torque_scale", text, quantity)
    text = f"{text}: {scale.text}"
    return _named(data.robot, weight, scale.code, text, quantity, scale.remedy)


def _in_words(weight: Weight) -> str:
    """Return in words how large the torque of a joint is."""
    return (
        f"the torque is {weight.ratio:.3g} +- {weight.std_error:.1g} of the expected"
        " gravity torque"
    )


def _named(
    robot: Robot,
    weight: Weight,
    code: str,
    text: str,
    quantity: str,
    remedy: str = "",
) -> InspectionFinding:
    """Return a finding at the joint of a weight, with a remedy of its own if any."""
    finding = finding_of(code, text, robot.joint_names[weight.joint], quantity)
    return structs.replace(finding, remedy=remedy or finding.remedy)
