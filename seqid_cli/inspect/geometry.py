"""The robot's equations against the log: axes, zeros, order of joints, and the size of torque.

Two comparisons. The structural one needs no inertial parameters: all joints share one set of base
parameters (gravity and inertia), so a joint whose axis, zero or place is another one spoils the
fit, and mending it restores the fit. The nominal one needs a URDF with inertials: the measured
torque is split into s times its gravity torque, inertia and friction; s is near one where torque
is torque.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.inspect.dynamics import Sample, joint_columns
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.report import Finding, found
from seqid_cli.robot.base import base_regressor
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]

SUSPICIOUS = 0.1  # of the torque's RMS left by the equations, from where a cause is looked for
POOR = 0.6
MENDED = 0.5  # of the error, that a cause may leave
SOUND = 0.35  # of the torque's RMS, that a mended fit may leave
BETTER = 0.8  # of the next best cause's error
ROWS = 900
SLIDES = 0.2  # of the RMS speed
SIGMAS = 3.0
SMALL, LARGE = 0.25, 4.0
LOADED = 0.2  # of the largest gravity torque, that a joint must carry to be judged
HEAVY = 1e-3  # N m
KINDS = ("axis_flipped", "position_zero", "joints_swapped")


@dataclass(frozen=True)
class Cause:
    """A change to the log that mends the fit: of which kind, of which joints."""

    code: str
    joints: tuple[int, ...]
    text: str
    change: Callable[[Sample], Sample]


@dataclass(frozen=True)
class Weight:
    """Measured over nominal gravity torque of one joint, its error, and the nominal's RMS."""

    joint: int
    ratio: float
    error: float
    rms: float


def geometry_findings(data: LogData, sample: Sample, tainted: frozenset[str]) -> Iterator[Finding]:
    """Compare a log with the robot's equations; `tainted` names joints already found faulty."""
    robot = data.robot
    if not data.modelled or not sample.moving:
        return
    weights = _weights(robot, sample)
    if tainted:
        return
    structural = [*_structural(data, sample)]
    yield from structural
    if not structural:
        yield from _scale(data, sample, weights)


def _structural(data: LogData, sample: Sample) -> Iterator[Finding]:
    robot = data.robot
    thin = _thinned(sample)
    error = _error(robot, thin)
    if error < SUSPICIOUS:
        return
    finding = _mending(robot, thin, error, _error)
    if finding is not None:
        yield finding
    elif error > POOR:
        yield found("model_mismatch", f"the equations leave {error:.0%} of the torque's RMS")


def _mending(
    robot: Robot, sample: Sample, error: float, measure: Callable[[Robot, Sample], float]
) -> Finding | None:
    """Find the one change that mends a fit, by its error; None where none or several do."""
    tried = [(cause, measure(robot, cause.change(sample))) for cause in _causes(robot, sample)]
    tried.sort(key=lambda pair: pair[1])
    cause, left = tried[0]
    rivals = [e for other, e in tried if set(other.joints) != set(cause.joints)]
    if left > min(MENDED * error, SOUND) or (rivals and left > BETTER * min(rivals)):
        return None
    names = ", ".join(robot.joint_names[j] for j in cause.joints)
    text = f"{cause.text}; the equations' error falls from {error:.1%} to {left:.1%}"
    return found(cause.code, text, joint=names, channel="position")


def _thinned(sample: Sample) -> Sample:
    rows = slice(None, None, max(1, len(sample.q) // ROWS))
    return replace(
        sample, q=sample.q[rows], dq=sample.dq[rows], ddq=sample.ddq[rows], tau=sample.tau[rows]
    )


def _error(robot: Robot, sample: Sample) -> float:
    """RMS that rigid body and friction leave of the torques, each as a share of its own."""
    assert sample.basis is not None
    Y = base_regressor(robot, sample.basis, sample.q, sample.dq, sample.ddq)
    X = np.concatenate([Y, joint_columns(robot, sample)], axis=2)
    tau = sample.tau
    sliding = np.zeros(tau.shape, dtype=bool)  # at rest friction takes any value
    for j in sample.moving:
        sliding[:, j] = np.abs(sample.dq[:, j]) > SLIDES * sample.rms_speed(j)
    squares = np.where(sliding, tau, 0.0) ** 2
    size = np.sqrt(squares.sum(axis=0) / np.maximum(sliding.sum(axis=0), 1))
    size = np.maximum(size, 1e-12)
    W = (X / size[:, None])[sliding]
    W = W / np.maximum(np.sqrt(np.mean(W**2, axis=0)), 1e-12)
    y = (tau / size)[sliding]
    left = y - W @ np.linalg.lstsq(W, y, rcond=1e-8)[0]
    return float(np.sqrt(np.mean(left**2)))


def _causes(robot: Robot, sample: Sample) -> Iterator[Cause]:
    turning = tuple(j for j in range(robot.n) if not robot.joints[j].prismatic)
    for joints in [(j,) for j in turning] + ([turning] if len(turning) > 1 else []):
        yield Cause("position_in_degrees", joints, "is in degrees", _in_radians(joints))
    for j in range(robot.n):
        yield Cause("axis_flipped", (j,), "turns the other way round", _flipped(j))
        if not robot.joints[j].prismatic:
            for turns, angle in (("a quarter", 0.5), ("minus a quarter", -0.5), ("half a", 1.0)):
                text = f"its zero is {turns} turn off"
                yield Cause("position_zero", (j,), text, _shifted(j, angle * np.pi))
    # Exchanging a joint that stands with one that moves changes what is compared.
    for a, b in combinations(sample.moving, 2):
        yield Cause("joints_swapped", (a, b), "are exchanged", _swapped(a, b, tau=True))
        yield Cause("joints_swapped", (a, b), "have exchanged positions", _swapped(a, b, tau=False))


def _flipped(j: int) -> Callable[[Sample], Sample]:
    def change(sample: Sample) -> Sample:
        sign = np.ones(sample.q.shape[1])
        sign[j] = -1.0
        return replace(
            sample,
            q=sample.q * sign,
            dq=sample.dq * sign,
            ddq=sample.ddq * sign,
            tau=sample.tau * sign,
        )

    return change


def _in_radians(joints: tuple[int, ...]) -> Callable[[Sample], Sample]:
    def change(sample: Sample) -> Sample:
        factor = np.ones(sample.q.shape[1])
        factor[list(joints)] = np.pi / 180.0
        return replace(sample, q=sample.q * factor, dq=sample.dq * factor, ddq=sample.ddq * factor)

    return change


def _shifted(j: int, angle: float) -> Callable[[Sample], Sample]:
    def change(sample: Sample) -> Sample:
        shift = np.zeros(sample.q.shape[1])
        shift[j] = angle
        return replace(sample, q=sample.q + shift)

    return change


def _swapped(a: int, b: int, *, tau: bool) -> Callable[[Sample], Sample]:
    def change(sample: Sample) -> Sample:
        order = list(range(sample.q.shape[1]))
        order[a], order[b] = b, a
        moving = tuple(sorted({a: b, b: a}.get(j, j) for j in sample.moving))
        return replace(
            sample,
            q=sample.q[:, order],
            dq=sample.dq[:, order],
            ddq=sample.ddq[:, order],
            tau=sample.tau[:, order] if tau else sample.tau,
            moving=moving,
        )

    return change


def _weights(robot: Robot, sample: Sample) -> list[Weight]:
    """Compare the torque of each moving joint with gravity by the URDF's inertials.

    Only joints that carry a fair share of the weight, by which a URDF can be judged.
    """
    if robot.nominal is None or not robot.gravity.any():
        return []
    gravity, inertia = _nominal(robot, sample)
    rms = gravity.std(axis=0)
    heaviest = max(float(rms[list(sample.moving)].max()), HEAVY)
    columns = joint_columns(robot, sample)
    result = []
    for j in sample.moving:
        if rms[j] < LOADED * heaviest:
            continue
        own = columns[:, j, 4 * j : 4 * j + 4]
        X = np.column_stack([gravity[:, j], inertia[:, j], own])
        scale = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-12)
        inverse = np.linalg.pinv(X / scale, rcond=1e-8) / scale[:, None]
        theta = inverse @ sample.tau[:, j]
        left = sample.tau[:, j] - X @ theta
        variance = float(np.mean(left**2)) * sample.memory
        error = float(np.sqrt(variance * (inverse[0] @ inverse[0])))
        result.append(Weight(j, float(theta[0]), error, float(rms[j])))
    return result


def _nominal(robot: Robot, sample: Sample) -> tuple[Array, Array]:
    """Gravity and inertia torque (N, n) by the URDF's inertials."""
    assert robot.nominal is not None
    chain, g, phi = robot.chain, robot.gravity, robot.nominal
    still = np.zeros_like(sample.q)
    gravity = inverse_dynamics(chain, g, phi, sample.q, still, still)
    return gravity, inverse_dynamics(chain, g, phi, sample.q, sample.dq, sample.ddq) - gravity


def _nominal_error(robot: Robot, sample: Sample) -> float:
    """RMS that the URDF's inertials and friction leave of the torques of loaded joints."""
    gravity, inertia = _nominal(robot, sample)
    rms = gravity.std(axis=0)
    columns = joint_columns(robot, sample)
    total, size = 0.0, 0.0
    for j in sample.moving:
        if rms[j] >= LOADED * float(rms[list(sample.moving)].max()):
            own = columns[:, j, 4 * j : 4 * j + 4]
            y = sample.tau[:, j] - gravity[:, j] - inertia[:, j]
            left = y - own @ np.linalg.lstsq(own, y, rcond=1e-8)[0]
            total += float(np.mean(left**2))
            size += float(np.var(sample.tau[:, j]))
    return float(np.sqrt(total / max(size, 1e-300)))


def _scale(data: LogData, sample: Sample, weights: list[Weight]) -> Iterator[Finding]:
    """Judge the size of the torque at the joints that carry weight."""
    off = [w for w in weights if _is_off(w)]
    if not off:
        return
    thin = _thinned(sample)
    mended = _mending(data.robot, thin, _nominal_error(data.robot, thin), _nominal_error)
    if mended is not None:
        yield mended
        return
    effort = data.effort()
    for w in off:
        joint = data.robot.joints[w.joint]
        text = f"the torque is {w.ratio:.3g} +- {w.error:.1g} of the expected gravity torque"
        code = "axis_flipped" if w.ratio + SIGMAS * w.error < -SMALL else _unit_code(data, w)
        yield found(code, text, joint=joint.name, channel=effort[0] if effort else "torque")


def _is_off(weight: Weight) -> bool:
    low = weight.ratio + SIGMAS * weight.error < SMALL
    return low or abs(weight.ratio) - SIGMAS * weight.error > LARGE


def _unit_code(data: LogData, weight: Weight) -> str:
    joint = data.robot.joints[weight.joint]
    factor = abs(joint.torque_per_ampere or 0.0)
    effort = data.effort()
    current = effort is not None and effort[0] == "current"
    if current and 300.0 < abs(weight.ratio) < 3000.0:
        return "current_in_ma"
    if factor and current and 0.4 < abs(weight.ratio) / factor < 2.5:
        return "effort_is_torque"
    if factor and not current and 0.4 < abs(weight.ratio) * factor < 2.5:
        return "effort_is_current"
    return "torque_scale"
