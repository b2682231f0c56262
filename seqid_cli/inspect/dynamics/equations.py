"""The robot's equations against the log: axes, zeros, order of joints, and the size of torque.

Two comparisons. The structural one needs no inertial parameters: all joints share one
set of base parameters (gravity and inertia), so a joint whose axis, zero or place is
another one spoils the fit, and mending it restores the fit. The nominal one needs a
URDF with inertials: the measured torque is split into s times its gravity torque,
inertia and friction; s is near one where torque is torque. Each cause of a misfit is
the change to log or robot that undoes it.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from seqid_cli.inspect.dynamics.friction import Sample, scaled_fit
from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Array, Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Mask


@dataclass(frozen=True)
class Cause:
    """A change that mends the fit: of which kind, of which joints.

    The two `joints` exchange their motion, their torque or both; then motion and torque
    are multiplied, and zeros shifted, all (n,).
    """

    code: str
    joints: tuple[int, ...]
    text: str
    channel: str = "position"
    exchanged: tuple[bool, bool] = (False, False)  # motion, torque
    motion: Array | float = 1.0
    torque: Array | float = 1.0
    shift: Array | float = 0.0
    gravity: Array | None = None  # (3,) m/s^2, that acts instead
    # gravity as the URDF's inertials give it is added to the torque
    weighed: bool = False

    def on(self, sample: Sample) -> Sample:
        """Return the sample as it would be."""
        if self.gravity is not None:
            robot = replace(sample.robot, gravity=self.gravity)
            return replace(sample, robot=robot, basis=base_parameters(robot, rotor=()))
        order = np.arange(sample.robot.n)
        order[list(self.joints)] = self.joints[::-1]
        tau = sample.tau[:, order] if self.exchanged[1] else sample.tau
        if self.exchanged[0]:
            moving = tuple(sorted(order[list(sample.moving)].tolist()))
            sample = replace(sample.mapped(lambda x: x[:, order]), moving=moving)
        return replace(
            sample,
            q=sample.q * self.motion + self.shift,
            dq=sample.dq * self.motion,
            ddq=sample.ddq * self.motion,
            tau=(tau + sample.nominal()[0] if self.weighed else tau) * self.torque,
            direction=sample.direction * np.sign(self.motion),
        )


def causes_of(data: LogData, sample: Sample, *, units: bool = False) -> Iterator[Cause]:
    """Yield common faults of axes, zeros, signs, angles, order; `units`: current for torque."""
    joints, every = sample.robot.joints, np.arange(sample.robot.n)

    def at(own: Sequence[int], value: float, usual: float = 1.0) -> Array:
        return np.where(np.isin(every, own), value, usual)

    # less in degrees is no motion to speak of
    far = np.abs(sample.q).max(axis=0) > 2.0 * np.pi
    turning = tuple(j for j, joint in enumerate(joints) if not joint.prismatic)
    degrees = [(j,) for j in turning] + ([turning] if len(turning) > 1 else [])
    for group in (group for group in degrees if far[list(group)].any()):
        yield Cause(
            "position_in_degrees",
            group,
            "is in degrees",
            motion=at(group, np.pi / 180.0),
        )
    for j in every.tolist():
        back, own = at([j], -1.0), (j,)
        yield Cause(
            "axis_flipped", own, "turns the other way round", motion=back, torque=back
        )
        yield Cause("sign_mismatch", own, "its torque is reversed", torque=back)
        yield Cause("sign_mismatch", own, "its position is reversed", motion=back)
        if j in turning:
            for turns, angle in (
                ("a quarter", 0.5),
                ("minus a quarter", -0.5),
                ("half a", 1.0),
            ):
                text = f"its zero is {turns} turn off"
                yield Cause(
                    "position_zero", own, text, shift=at([j], angle * np.pi, 0.0)
                )
    # Exchanging a joint that stands with one that moves changes what is compared.
    for pair in combinations(sample.moving, 2):
        for text, exchanged in (
            ("are exchanged", (True, True)),
            ("have exchanged positions", (True, False)),
            ("have exchanged torques", (False, True)),
        ):
            if joints[pair[0]].prismatic == joints[pair[1]].prismatic:
                yield Cause("joints_swapped", pair, text, exchanged=exchanged)
    yield from _of_efforts(data, units=units)


def _of_efforts(data: LogData, *, units: bool) -> Iterator[Cause]:
    """Yield that the effort is the other quantity, or lacks gravity."""
    quantity, _ = data.effort() or ("torque", None)
    robot, every_joint = data.robot, tuple(range(data.robot.n))
    factor = np.array([abs(joint.torque_per_ampere or 0.0) for joint in robot.joints])
    if units and factor.all():
        other, scale = (
            ("torque", 1.0 / factor) if quantity == "current" else ("current", factor)
        )
        text = f"carry {other}, not {quantity}"
        yield Cause(f"effort_is_{other}", every_joint, text, quantity, torque=scale)
    told = robot.channels.effort == "gravity_compensated" or robot.nominal is None
    # a driver subtracts it
    if quantity == "torque" and not told and robot.gravity.any():
        text = "gravity is not in it"
        yield Cause("effort_without_gravity", every_joint, text, "torque", weighed=True)


def mounted(gravity: Array) -> Cause:
    """Gravity (3,) m/s^2 that acts in another direction."""
    text = str([float(f"{x:.3g}") + 0.0 for x in gravity])
    return Cause("gravity_direction", (), text, gravity=gravity)


BETTER = 0.8  # of another cause's error: less of a difference decides nothing
# ratio of errors of all equations that a zero changes, and a centre of mass not
CLEARLY = 1.02
HEAVY = 1e-3  # N m
# How a finding of the mounting reads where one direction alone fits.
GRAVITY = re.compile(r"gravity acts along (\[[^\]]*\]);")
Measure = Callable[[Sample], float]


def geometry_findings(
    data: LogData, sample: Sample, friction: list[InspectionFinding]
) -> list[InspectionFinding]:
    """Compare a log with the robot's equations, besides what `friction` shows.

    Another cause that mends the equations explains that as well: a zero that is off
    leaves gravity in the torque, which may look like friction of any sign.
    """
    if not data.modelled or not sample.moving:
        return friction
    structural = [*_structural(data, sample)]
    if friction:
        mends = [f for f in structural if f.code != "model_mismatch"]
        known, told = (
            {(f.code, *sorted(f.joint.split(", "))) for f in x}
            for x in (friction, mends)
        )
        return friction if known & told or not mends else mends
    return structural or [*_scale(data, sample.thinned())]


def _structural(
    data: LogData,
    sample: Sample,
    *,
    suspicious: float = 0.1,
    poor: float = 0.6,
    min_steps: int = 10,
) -> Iterator[InspectionFinding]:
    thin = sample.thinned()
    error = _structural_error(thin)
    if error < suspicious:
        yield from _nearly_right(thin, error)
        return
    mended = _mending(
        thin, error, _structural_error, [*causes_of(data, thin, units=True)]
    )
    seen = (sample.rms_speeds > min_steps * data.step)[list(sample.moving)].all()
    if mended is not None:
        yield mended
    elif error > poor and seen:
        text = f"the equations leave {percent(error, 0)} of the torque's RMS"
        yield found("model_mismatch", text)


def _nearly_right(
    sample: Sample, error: float, *, max_ratio: float = 0.5, max_left: float = 0.1
) -> Iterator[InspectionFinding]:
    """Find gravity turned round, or a zero that is off, where the equations leave little.

    Free parameters take up nearly all of such a fault, so what it leaves is small
    against the torque, but large against what the right robot leaves: `max_ratio` of
    the `error` or less. The URDF's inertials cannot take up a zero that is off: what
    they leave beyond the free parameters must fall as far, to `max_left` of the torque
    or less. A centre of mass that the URDF has wrong looks alike in the torque of that
    joint alone, not in the equations of all joints, which then decide between the two.
    """
    against = mounted(-sample.robot.gravity)
    causes = [against] if sample.robot.gravity.any() else []
    causes += _shifted(sample, _structural_error)
    errors = [_structural_error(cause.on(sample)) for cause in causes]
    best = int(np.argmin(errors)) if causes else 0
    if causes and errors[best] <= max_ratio * error:
        yield _found(sample.robot, [causes[best]], _fall(error, errors[best]))
        return

    if sample.robot.nominal is None:
        return
    causes = _shifted(sample, _nominal_error)
    errors = [_nominal_error(cause.on(sample)) for cause in causes]
    if not causes:
        return
    best = int(np.argmin(errors))
    cause, shifted = causes[best], _structural_error(causes[best].on(sample))
    before = float(np.sqrt(max(_nominal_error(sample) ** 2 - error**2, 0.0)))
    after = float(np.sqrt(max(errors[best] ** 2 - shifted**2, 0.0)))
    if after > min(max_ratio * before, max_left):
        return
    fall = _fall(
        before, after, "what the URDF's inertials leave beyond free parameters"
    )
    if shifted < error / CLEARLY:
        yield _found(sample.robot, [cause], fall)
    elif shifted < error * CLEARLY:
        name = sample.robot.joint_names[cause.joints[0]]
        text = (
            f"{cause.text}, or its centre of mass is not where the URDF has it; {fall}"
        )
        yield found("zero_or_mass", text, name, "position")


def _shifted(
    sample: Sample,
    measure: Measure,
    *,
    slightly: float = 0.05,
    min_gain: float = 0.03,
    few_rows: int = 250,
    angles: int = 12,
    precise: float = 1e-3,
) -> list[Cause]:
    """Shift the zero of each revolute joint to where it fits best.

    Parameters
    ----------
    sample : Sample
        Rows of the log.
    measure : callable
        Error of a sample [-], a smooth function of the angle.
    slightly : float
        Angle [rad] either way by which a joint is tried first.
    min_gain : float
        Share by which that must lower the error, else the joint is left alone.
    few_rows : int
        Rows of the first try and of the search, which costs an evaluation for each
        angle.
    angles : int
        Angles over a turn from which the search begins at the best.
    precise : float
        Angle [rad] to which the shift is found.
    """
    few = sample.thinned(few_rows)
    robot, causes = sample.robot, []
    for j in (j for j in sample.moving if not robot.joints[j].prismatic):

        def error(angle: float, j: int = j) -> float:
            return measure(_zero_off(robot, j, angle).on(few))

        usual = error(0.0)
        if min(error(slightly), error(-slightly)) > (1.0 - min_gain) * usual:
            continue
        around = 2.0 * np.pi * np.arange(angles) / angles
        start = float(min(around, key=error))
        reach = 2.0 * np.pi / angles
        ends = (start - reach, start + reach)
        best = minimize_scalar(
            error, bounds=ends, method="bounded", options={"xatol": precise}
        )
        angle = float((best.x + np.pi) % (2.0 * np.pi) - np.pi)
        if abs(angle) > slightly / 2.0:
            causes.append(_zero_off(robot, j, angle))
    return causes


def _zero_off(robot: Robot, j: int, angle: float) -> Cause:
    """A revolute joint whose positions lack `angle` [rad]."""
    shift = np.where(np.arange(robot.n) == j, angle, 0.0)
    return Cause(
        "position_zero", (j,), f"its zero is {-angle:.3g} rad off", shift=shift
    )


def _fall(before: float, after: float, what: str = "the equations' error") -> str:
    """Say how far a change lowers an error."""
    return f"{what} falls from {percent(before)} to {percent(after)}"


def _mending(
    sample: Sample,
    before: float,
    measure: Measure,
    causes: Sequence[Cause],
    *,
    max_ratio: float = 0.5,
    max_error: float = 0.35,
    max_rivals: int = 8,
    max_alike: int = 3,
    few_rows: int = 250,
) -> InspectionFinding | None:
    """Find the change that mends a fit; none where too many do.

    One of the causes, gravity along an axis of the base, or in any direction: of these
    kinds the first counts, unless a later one leaves clearly less. Where several of a
    kind do as well, the inertials of a URDF decide: gravity turned round fits as well
    with parameters of the other sign.
    """
    few = sample.thinned(few_rows)
    kinds = [sorted(causes, key=lambda cause: measure(cause.on(few)))[:max_rivals]]
    strength = float(np.linalg.norm(sample.robot.gravity))
    if strength:
        axes = [mounted(g) for g in strength * np.vstack([np.eye(3), -np.eye(3)])]
        kinds += [axes, _slanted(few, axes, measure)]
    chosen, least = [], np.inf
    for kind in kinds:
        fits = [(measure(cause.on(sample)), cause) for cause in kind]
        mends = [fit for fit in fits if fit[0] <= min(max_ratio * before, max_error)]
        best = min((error for error, _ in mends), default=np.inf)
        alike = [cause for error, cause in mends if error < best / BETTER]
        if (
            best < BETTER * least
            and len({frozenset(c.joints) for c in alike}) <= max_alike
        ):
            chosen, least = alike, best
    if not chosen:
        return None
    if sample.robot.nominal is not None:
        chosen.sort(key=lambda cause: _nominal_error(cause.on(sample)))
    return _found(sample.robot, chosen, _fall(before, least))


def _found(robot: Robot, alike: Sequence[Cause], fall: str) -> InspectionFinding:
    """Tell the first of causes that mend a fit alike, and the others."""
    cause, names = alike[0], robot.joint_names
    if not cause.joints:
        along = " or ".join(
            each.text for each in alike[: 2 if robot.nominal is None else 1]
        )
        return found(cause.code, f"gravity acts along {along}; {fall}")
    told = [(", ".join(names[j] for j in each.joints), each) for each in alike]
    others = [
        f"{own}: {x.text}" for own, x in told if set(x.joints) != set(cause.joints)
    ]
    text = f"{cause.text}; {fall}" + (
        f" (as well with {'; or '.join(others)})" if others else ""
    )
    return found(cause.code, text, told[0][0], cause.channel)


def _slanted(
    sample: Sample,
    axes: Sequence[Cause],
    measure: Measure,
    *,
    reach: float = 0.5,
    precise: float = 2e-3,
    evaluations: int = 60,
) -> list[Cause]:
    """Gravity in the direction that fits best, from the best of the `axes`, and against it."""
    start = min(axes, key=lambda axis: measure(axis.on(sample))).gravity
    assert start is not None
    strength, across = np.linalg.norm(start), np.linalg.svd(start[None])[2][1:]

    def gravity(x: Array) -> Array:
        turned = start + strength * (x @ across)
        return np.asarray(turned * strength / np.linalg.norm(turned))

    def error(x: Array) -> float:
        return measure(mounted(gravity(x)).on(sample))

    simplex = reach * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {
        "initial_simplex": simplex,
        "xatol": precise,
        "fatol": np.inf,
        "maxfev": evaluations,
    }
    best = minimize(error, np.zeros(2), method="Nelder-Mead", options=options).x  # type: ignore[call-overload]
    return [mounted(sign * gravity(best)) for sign in (1.0, -1.0)]


def _sliding(sample: Sample, *, min_speed: float = 0.2) -> Mask:
    """Where (N, n) joints that move slide: at rest friction takes any value."""
    sliding = np.abs(sample.dq) > min_speed * sample.rms_speeds
    return np.asarray(sliding & np.isin(np.arange(sample.robot.n), sample.moving))


def _structural_error(sample: Sample) -> float:
    """RMS that rigid body and friction leave of the torques, each as a share of its own."""
    assert sample.basis is not None
    tau, n = sample.tau, sample.robot.n
    # no joint has those of another
    each = sample.own_columns()[:, :, None] * np.eye(n)[:, :, None]
    Y = base_regressor(sample.robot, sample.basis, sample.q, sample.dq, sample.ddq)
    X = np.concatenate([Y, each.reshape(len(tau), n, -1)], axis=2)
    sliding = _sliding(sample)
    squares = np.where(sliding, tau, 0.0) ** 2
    size = np.sqrt(squares.sum(axis=0) / np.maximum(sliding.sum(axis=0), 1)).clip(1e-12)
    *_, left = scaled_fit((X / size[:, None])[sliding], (tau / size)[sliding])
    return float(np.sqrt(np.mean(left**2)))


@lru_cache(maxsize=1)
def largest_gravity(robot: Robot, *, postures: int = 200) -> Array:
    """Largest gravity torque (n,) by the URDF's inertials over postures spread evenly; else 0."""
    if robot.nominal is None:
        return np.zeros(robot.n)
    root = 2.0 ** (1.0 / (robot.n + 1))  # powers of it step through all angles evenly
    turns = np.outer(np.arange(postures), root ** -np.arange(1, robot.n + 1)) % 1.0
    slides = np.array([joint.prismatic for joint in robot.joints])
    q = np.where(slides, turns - 0.5, 2.0 * np.pi * turns)
    still = np.zeros_like(q)
    torque = inverse_dynamics(
        robot.chain, robot.gravity, robot.nominal, q, still, still
    )
    return np.asarray(np.abs(torque).max(axis=0))


def _nominal_error(sample: Sample) -> float:
    """RMS that the URDF's inertials and friction leave of torques, each as a share of its own."""
    left = sample.tau - np.sum(sample.nominal(), axis=0)
    own, slides = sample.own_columns(), _sliding(sample)
    shares = []
    for j in (j for j in sample.moving if slides[:, j].any()):
        rows = slides[:, j]
        remains = scaled_fit(own[rows, j], left[rows, j])[2]
        shares.append(
            np.mean(remains**2) / max(float(sample.tau[rows, j].var()), 1e-300)
        )
    return float(np.sqrt(np.mean(shares))) if shares else 0.0


def _weights(
    sample: Sample, *, min_load: float = 0.2, min_acting: float = 0.1
) -> Iterator[tuple[int, float, float]]:
    """Compare the torque of moving joints with gravity by the URDF's inertials: ratio and error.

    Only of joints that carry a fair share of the weight: a small one of another passes
    for it. It is `min_load` of the most in the log, and `min_acting` of the joint's
    most in any posture.
    """
    robot = sample.robot
    if robot.nominal is None or not robot.gravity.any():
        return
    gravity, inertia = sample.nominal()
    rms, could, own = gravity.std(axis=0), largest_gravity(robot), sample.own_columns()
    for j in sample.moving:
        # Forces and torques are not to be compared.
        alike = [
            i
            for i in sample.moving
            if robot.joints[i].prismatic == robot.joints[j].prismatic
        ]
        if rms[j] < max(
            min_load * max(float(rms[alike].max()), HEAVY), min_acting * could[j]
        ):
            continue
        X = np.column_stack([gravity[:, j], inertia[:, j], own[:, j]])
        theta, inverse, left = scaled_fit(X, sample.tau[:, j])
        variance = float(np.mean(left**2)) * sample.memory
        yield j, float(theta[0]), float(np.sqrt(variance * (inverse[0] @ inverse[0])))


def _scale(
    data: LogData,
    sample: Sample,
    *,
    sigmas: float = 3.0,  # from a ratio to its limits
    # of the expected gravity torque, in the opposite direction
    min_opposite: float = 0.25,
    # ratios to the expected gravity torque, beyond which a torque is off
    small: float = 0.25,
    large: float = 4.0,
) -> Iterator[InspectionFinding]:
    """Judge the size of the torque at the joints that carry weight."""
    off = []
    for j, ratio, error in _weights(sample):
        low, high = ratio - sigmas * error, ratio + sigmas * error
        if high < small or max(low, -high) > large:
            off.append((j, ratio, error, high))
    if not off:
        return
    causes = [*causes_of(data, sample)]
    if mended := _mending(sample, _nominal_error(sample), _nominal_error, causes):
        yield mended
        return
    quantity, _ = data.effort() or ("torque", None)
    for j, ratio, error, high in off:
        joint = data.robot.joints[j]
        text = (
            f"the torque is {ratio:.3g} +- {error:.1g} of the expected gravity torque"
        )
        factor = abs(joint.torque_per_ampere or 0.0)
        in_amperes = abs(ratio) / factor if factor else 0.0
        code = "torque_scale"
        if high < -min_opposite:
            code = "axis_flipped"
        elif quantity == "current" and 300.0 < abs(ratio) < 3000.0:
            code = "current_in_ma"
        elif quantity == "current" and 0.4 < in_amperes < 2.5:
            code = "effort_is_torque"
        elif quantity == "torque" and 0.4 < abs(ratio) * factor < 2.5:
            code = "effort_is_current"
        yield found(code, text, joint.name, quantity)
