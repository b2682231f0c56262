"""The factor of all angles by the robot's equations.

With q the positions as they are taken and k q the true ones, the torque is

    tau = Y(k q, k dq, k ddq) pi + friction,

in which gravity depends on the sine and cosine of k q, so that free parameters pi do
not take k up. log k is found by Gauss and Newton, with the parameters eliminated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from seqid_cli.inspect.dynamics.friction import Sample
from seqid_cli.inspect.dynamics.structure import structural_error, structural_residual
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.scales import Factor, Scale, angle_scales, first_agreeing
from seqid_cli.logs.drives import DEGREE, unit_of_positions
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.typing import Array

CLEAR = 4.0  # standard errors by which factors differ
# Relative error of a factor from which on motion and equations say nothing of a unit.
MAX_ERROR = 0.05
# Times a radian, or part of it, within which there is no unit of angles: percent of a
# range of half a turn is 0.03, a turn is 6.3.
NEAR_ONE = 3.0
BY_EQUATIONS = "by the equations"  # how a message says that a unit was measured


@dataclass(frozen=True, kw_only=True)
class AngleFactors:
    """Factors by which angles are to be multiplied: one for all, and one for each.

    `of_joints` is empty where the common one is one within its error.
    """

    common: Factor
    of_joints: dict[int, Factor]

    @property
    def agree(self) -> bool:
        """Whether each joint has the common factor, within errors."""
        common = self.common
        return all(
            abs(np.log(max(factor.value, 1e-300) / common.value))
            < CLEAR * np.hypot(factor.relative_error, common.relative_error)
            for factor in self.of_joints.values()
        )


def angle_factors(
    sample: Sample,
    *,
    rows: int = 250,
    start: float = 1.0,
    min_difference: float = 0.05,
) -> AngleFactors | None:
    """Measure by which factor all angles of a log are off.

    Parameters
    ----------
    sample : Sample
        Filtered motion and torque, with the robot's base parameters.
    rows : int
        Rows that are looked at.
    start : float
        Factor from which the search begins.
    min_difference : float
        Share by which a factor must differ from one to matter; that of each joint is
        measured from there on only.

    Returns
    -------
    AngleFactors or None
        None where no revolute joint moves.
    """
    few = sample.thinned(rows)
    joints = [j for j in sample.moving if not sample.robot.joints[j].prismatic]
    if not joints:
        return None
    (common,) = _fitted(few, [joints], start)
    if abs(np.log(common.value)) < max(CLEAR * common.relative_error, min_difference):
        return AngleFactors(common=common, of_joints={})
    each = _fitted(few, [[j] for j in joints], common.value)
    return AngleFactors(common=common, of_joints=dict(zip(joints, each, strict=True)))


def _fitted(
    sample: Sample,
    groups: Sequence[Sequence[int]],
    start: float,
    *,
    rounds: int = 6,
    largest_step: float = 0.3,
    done: float = 1e-3,
    slope: float = 1e-3,
) -> list[Factor]:
    """Fit one factor for each group of joints by at most so many `rounds`.

    `largest_step` of a round, the step at which it is `done`, and the change by which
    its `slope` is taken are of the logarithm.
    """
    n = sample.robot.n
    log_k = np.zeros(n)
    log_k[[j for group in groups for j in group]] = np.log(start)
    directions = [np.isin(np.arange(n), group).astype(np.float64) for group in groups]

    def left(change: Array) -> Array:
        return structural_residual(_multiplied(sample, np.exp(log_k + change)))

    for _ in range(rounds):
        r = left(np.zeros(n))
        slopes = [
            (left(slope * d) - left(-slope * d)) / (2.0 * slope) for d in directions
        ]
        J = np.array(slopes).T
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        step = np.clip(step, -largest_step, largest_step)
        for d, size in zip(directions, step, strict=True):
            log_k += size * d
        if np.abs(step).max() < done:
            break

    variance = float(np.mean(r**2)) * sample.memory
    errors = np.sqrt(np.diag(np.linalg.pinv(J.T @ J)) * variance)
    k = np.exp(log_k)
    return [
        Factor(value=float(k[group[0]]), std_error=float(k[group[0]] * error))
        for group, error in zip(groups, errors, strict=True)
    ]


def _multiplied(sample: Sample, k: Array) -> Sample:
    """Return the sample with angles and their derivatives times k (n,)."""
    return replace(sample, q=sample.q * k, dq=sample.dq * k, ddq=sample.ddq * k)


def angle_findings(sample: Sample) -> Iterator[InspectionFinding]:
    """Find another unit of all angles, with the factor that fits and its error."""
    factors = angle_factors(sample)
    if factors is None or not factors.of_joints or not factors.agree:
        return
    if factors.common.relative_error > MAX_ERROR:
        return
    robot = sample.robot
    scale = first_agreeing([*factors.of_joints.items()], angle_scales(robot))
    unit = factors.common.value * float(unit_of_positions(robot)[sample.moving[0]])
    if scale is None and 1.0 / NEAR_ONE < unit < NEAR_ONE:
        # No unit is near a radian: the model lacks something that angles make up for.
        return
    names = ", ".join(robot.joint_names[j] for j in factors.of_joints)
    yield scale_finding(sample, factors.common, scale, names)


def unit_by_equations(sample: Sample) -> InspectionFinding | None:
    """Find in which unit angles are that are known to be in another one."""
    thin = sample.thinned()
    return far_angle_finding(thin, structural_error(thin))


def far_angle_finding(
    sample: Sample,
    error: float,
    *,
    max_ratio: float = 0.5,
    max_error: float = 0.35,
    max_speed: float = 20.0,
    max_turns: float = 3.0,
) -> InspectionFinding | None:
    """Find angles in another unit where the equations leave much as they are.

    Parameters
    ----------
    sample : Sample
        Rows of the log.
    error : float
        What the equations leave of it, in shares of the torque.
    max_ratio, max_error : float
        Share of the error, and error, that another unit leaves at most.
    max_speed, max_turns : float
        RMS speeds [rad/s] and angles in turns that no arm goes beyond.
    """
    few = sample.thinned(250)
    joints = [j for j in sample.moving if not sample.robot.joints[j].prismatic]
    best: Scale | None = None
    least = min(max_ratio * error, max_error)
    for scale in angle_scales(sample.robot) if joints else ():
        if not np.isfinite(scale.factors[joints]).all():
            continue
        trial = _multiplied(few, np.nan_to_num(scale.factors, nan=1.0))
        is_wild = trial.rms_speeds[joints].max() > max_speed
        if is_wild or np.abs(trial.q[:, joints]).max() > 2.0 * np.pi * max_turns:
            continue
        left = float(np.sqrt(np.mean(structural_residual(trial) ** 2)))
        if left < least:
            best = scale
            least = left
    if best is None:
        return None

    factors = angle_factors(sample, start=float(best.factors[joints[0]]))
    if factors is None or not factors.of_joints:
        return None
    agreeing = first_agreeing([*factors.of_joints.items()], [best])
    names = ", ".join(sample.robot.joint_names[j] for j in factors.of_joints)
    return scale_finding(sample, factors.common, agreeing, names)


def scale_finding(
    sample: Sample, factor: Factor, scale: Scale | None, joints: str
) -> InspectionFinding:
    """Return the finding of angles that are off by a factor.

    Parameters
    ----------
    sample : Sample
        The log.
    factor : Factor
        What angles are to be multiplied by.
    scale : Scale or None
        The hypothesis that agrees with it.
    joints : str
        Names of the joints that it was measured at.
    """
    taken = float(unit_of_positions(sample.robot)[sample.moving[0]])
    unit = Factor(value=factor.value * taken, std_error=factor.std_error * taken)
    text = f"{BY_EQUATIONS} one unit of all angles is {unit} rad"
    if scale is not None:
        finding = finding_of(scale.code, f"{scale.text}: {text}", joints, "position")
        remedy = scale.remedy or finding.remedy
        if scale.code == "position_in_degrees":  # and not in percent
            remedy = 'Write unit = "deg" under [channels] of the robot file.'
        return structs.replace(finding, remedy=remedy)
    text += (
        f": neither a degree ({DEGREE:.4g}) nor another unit that is known. Percent of"
        f" a range of +-{100.0 * unit.value:.3g} rad would be so"
    )
    return finding_of("position_scale", text, joints, "position")
