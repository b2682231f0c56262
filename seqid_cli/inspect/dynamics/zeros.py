"""Zeros of joints by the robot's equations alone, without inertials of a URDF.

Free parameters take up most of what a zero that is off does: gravity of one joint is a
sine and a cosine of its angle, whatever its zero. Not all: joints share the parameters,
and frames of the others are where the zero puts them. With a shift s of each joint the
torque is Y(q + s, dq, ddq) pi + friction; the shifts are found by Gauss and Newton, the
parameters eliminated. What the equations do not tell, such as the zero of a vertical
first axis, has a standard error without bounds. The errors count as many rows as one as
the residual itself says: noise of a fast sensor is forgotten at once, and physics that
the equations lack lasts.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from seqid_cli.inspect.dynamics.friction import Sample, memory_of
from seqid_cli.inspect.dynamics.structure import (
    sliding,
    structural_error,
    structural_residual,
)
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.scales import Factor
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.typing import Array

CLEAR = 4.0  # standard errors of a shift; recorded arms whose zeros are right reach 2.6


def zero_findings(
    sample: Sample,
    *,
    rows: int = 250,
    max_error: float = 0.1,
    min_shift: float = 0.05,
    max_left: float = 0.05,
) -> Iterator[InspectionFinding]:
    """Find the joint whose zero the equations contradict most.

    Parameters
    ----------
    sample : Sample
        Filtered motion and torque, with the robot's base parameters.
    rows : int
        Rows on which shifts are searched for; all of them have the last word.
    max_error : float
        Standard error [rad] from which on a shift is not known.
    min_shift : float
        Shift [rad] that matters.
    max_left : float
        Share of the torque's RMS that the equations leave at most.
    """
    robot = sample.robot
    joints = [j for j in sample.moving if not robot.joints[j].prismatic]
    # Without gravity, or where the equations leave much, a zero shows in nothing.
    if not joints or not robot.gravity.any() or structural_error(sample) > max_left:
        return
    shifts = _shifts(sample, joints, rows=rows)
    known = {j: s for j, s in shifts.items() if s.std_error < max_error}
    off = {
        j: abs(s.value) / s.std_error
        for j, s in known.items()
        if abs(s.value) > max(CLEAR * s.std_error, min_shift)
    }
    # Zeros that all seem off are those of another arm.
    if len(off) != 1:
        return
    worst = max(off, key=lambda j: off[j])
    found = Factor(value=-known[worst].value, std_error=known[worst].std_error)
    text = f"its zero is {found} rad off, by the equations of all joints"
    yield finding_of("position_zero", text, robot.joint_names[worst], "position")


def _shifts(
    sample: Sample,
    joints: list[int],
    *,
    rows: int,
    rounds: int = 5,
    largest_step: float = 0.2,
    done: float = 1e-3,
    slope: float = 1e-3,
    ridge: float = 1e-9,
) -> dict[int, Factor]:
    """Fit a shift [rad] for each joint, with its standard error; none where none shows.

    The last of the `rounds` sees all rows, those before it about `rows` of them.
    `largest_step`, the step at which it is `done`, and the change by which a `slope` is
    taken are in rad; `ridge` is the share of the information that bounds what is not
    determined.
    """
    n = sample.robot.n
    shift = np.zeros(n)
    seen = sample.thinned(rows)
    is_last = False

    def left(change: Array) -> Array:
        return structural_residual(replace(seen, q=seen.q + shift + change))

    for number in range(rounds):
        is_last = is_last or number == rounds - 1
        if is_last:
            seen = sample
        r = left(np.zeros(n))
        slopes = []
        for j in joints:
            direction = slope * np.isin(np.arange(n), [j]).astype(np.float64)
            slopes.append((left(direction) - left(-direction)) / (2.0 * slope))
        J = np.array(slopes).T
        information = J.T @ J
        trace = float(np.trace(information))
        if trace < 1e-12:  # no torque depends on any zero
            return {}
        size = trace * np.eye(len(joints))
        # Steps along what is hardly determined would go nowhere.
        step = -np.linalg.solve(information + 1e3 * ridge * size, J.T @ r)
        step = np.clip(step, -largest_step, largest_step)
        shift[joints] += step
        if is_last:
            break
        is_last = bool(np.abs(step).max() < done)

    variance = float(np.mean(r**2)) * _memory(sample, r)
    errors = np.sqrt(np.diag(np.linalg.inv(information + ridge * size)) * variance)
    return {
        j: Factor(value=float(shift[j]), std_error=float(error))
        for j, error in zip(joints, errors, strict=True)
    }


def _memory(sample: Sample, residual: Array) -> float:
    """Return how many rows count as one, by a `structural_residual` (R,)."""
    slides = sliding(sample)
    by_joint = np.zeros(slides.shape)
    by_joint[slides] = residual
    return float(np.mean([memory_of(by_joint[:, j]) for j in sample.moving]))
