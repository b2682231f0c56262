"""The size of the torque at joints that carry weight, beside that of the URDF.

The measured torque is split into s times its gravity torque by the URDF's inertials,
inertia and friction; s is near one where torque is torque.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample, scaled_fit
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot

HEAVY = 1e-3  # N m
SIGMAS = 3.0  # standard errors, from a ratio to its limits


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
    for j in sample.moving:
        # Forces and torques are not to be compared.
        is_prismatic = robot.joints[j].prismatic
        of_kind = [
            i for i in sample.moving if robot.joints[i].prismatic == is_prismatic
        ]
        most_in_log = max(float(variation[of_kind].max()), HEAVY)
        if variation[j] < max(min_load * most_in_log, min_acting * largest[j]):
            continue
        X = np.column_stack([gravity[:, j], inertia[:, j], friction[:, j]])
        fit = scaled_fit(X, sample.tau[:, j])
        variance = float(np.mean(fit.residual**2)) * sample.memory
        of_gravity = fit.inverse[0]
        std_error = float(np.sqrt(variance * (of_gravity @ of_gravity)))
        yield Weight(joint=j, ratio=float(fit.theta[0]), std_error=std_error)


def wrong_weights(
    sample: Sample, *, small: float = 0.25, large: float = 4.0
) -> list[Weight]:
    """Return the weights of another size than expected.

    `small` and `large` are ratios to the expected gravity torque, beyond which a torque
    is off.
    """
    return [
        weight
        for weight in weights(sample)
        if weight.high < small or max(weight.low, -weight.high) > large
    ]


def weight_findings(
    data: LogData, wrong: Sequence[Weight], *, min_opposite: float = 0.25
) -> Iterator[InspectionFinding]:
    """Yield what may be wrong with a torque of another size, joint by joint.

    `min_opposite` is a share of the expected gravity torque, from which a torque in the
    opposite direction is that of an axis which turns the other way round.
    """
    effort = data.effort()
    quantity = "torque" if effort is None else effort[0]
    for weight in wrong:
        joint = data.robot.joints[weight.joint]
        text = (
            f"the torque is {weight.ratio:.3g} +- {weight.std_error:.1g} of the"
            " expected gravity torque"
        )
        is_opposite = weight.high < -min_opposite
        code = "axis_flipped"
        if not is_opposite:
            torque_per_ampere = abs(joint.torque_per_ampere or 0.0)
            code = _scale_code(quantity, abs(weight.ratio), torque_per_ampere)
        yield finding_of(code, text, joint.name, quantity)


def _scale_code(quantity: str, ratio: float, torque_per_ampere: float) -> str:
    """Return the code that explains a torque of `ratio` times the expected one.

    The drive makes `torque_per_ampere`; 0 where it is not known.
    """
    if quantity == "current":
        in_amperes = ratio / torque_per_ampere if torque_per_ampere else 0.0
        if 300.0 < ratio < 3000.0:
            return "current_in_ma"
        if 0.4 < in_amperes < 2.5:
            return "effort_is_torque"
    if quantity == "torque" and 0.4 < ratio * torque_per_ampere < 2.5:
        return "effort_is_current"
    return "torque_scale"
