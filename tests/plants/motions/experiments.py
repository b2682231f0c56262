"""The logs that each stage needs, as references for a plant, and held-out ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tests import Array
from tests.plants.motions.trajectories import (
    Profile,
    Reference,
    fourier,
    hold,
    join,
    point_to_point,
    side_by_side,
    sweeps,
    together,
    trapezoid,
    zigzag,
)
from tests.plants.simulate import Plant


@dataclass(frozen=True)
class Trial:
    """One log to record: stage folder, file name, motion, and whether the arrays are recorded."""

    stage: str
    name: str
    reference: Reference
    imus: bool = False


def span_of(plant: Plant, joint: int, share: float = 0.95) -> tuple[float, float]:
    """Middle `share` of the position range of a joint, rad."""
    low, high = plant.position_limits[joint]
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    return float(middle - half), float(middle + half)


def limits_of(plant: Plant, share: float = 0.9) -> tuple[Array, Array, Array, Array]:
    """Ends of the ranges that moves use, and a share of the limits of speed and acceleration."""
    low, high = np.array([span_of(plant, joint) for joint in range(plant.arm.n)]).T
    return low, high, share * plant.velocity_limits, share * plant.acceleration_limits


def swept(
    plant: Plant,
    posture: Array,
    joint: int,
    shares: Sequence[float],
    rate_hz: float,
    *,
    span: float = 0.95,
    dwell: float = 0.25,
) -> Reference:
    """One joint both ways over a share `span` of its range, at `shares` of its top speed."""
    top, accel = float(plant.velocity_limits[joint]), float(plant.acceleration_limits[joint])
    ends, speeds = span_of(plant, joint, span), [top * share for share in shares]
    return sweeps(posture, joint, ends, speeds, accel, rate_hz=rate_hz, dwell=dwell)


def friction_trials(
    plant: Plant,
    postures: Sequence[Array],
    *,
    rate_hz: float = 1000.0,
    speeds: int = 12,
    lowest: float = 0.05,
) -> list[Trial]:
    """Each joint by itself, both ways over its range at every speed, once per locked posture."""
    trials = []
    for joint, name in enumerate(plant.arm.names):
        top, accel = float(plant.velocity_limits[joint]), float(plant.acceleration_limits[joint])
        pace = [float(v) for v in np.geomspace(lowest * top, top, speeds)]
        for number, posture in enumerate(postures, start=1):
            motion = sweeps(posture, joint, span_of(plant, joint), pace, accel, rate_hz=rate_hz)
            label = name if len(postures) == 1 else f"{name}_posture_{number}"
            trials.append(Trial("friction", label, motion))
    return trials


def gravity_trials(
    plant: Plant,
    postures: Sequence[Array],
    *,
    rate_hz: float = 1000.0,
    speeds: Sequence[float] = (0.15,),
) -> list[Trial]:
    """Slow single-joint moves from the last joint to the first, in several locked postures.

    One log per joint; between postures all joints move. `speeds` are shares of the velocity limit.
    """
    trials = []
    for joint in reversed(range(plant.arm.n)):
        parts: list[Reference] = []
        for posture in postures:
            sweep = swept(plant, posture, joint, speeds, rate_hz)
            parts += [transfer(plant, parts[-1].q[-1], sweep.q[0], rate_hz)] if parts else []
            parts.append(sweep)
        motion = join(parts)
        trials.append(Trial("gravity", plant.arm.names[joint], motion))
    return trials


def transfer(plant: Plant, here: Array, there: Array, rate_hz: float) -> Reference:
    """All joints from one posture to the next at half their limits, (n,) rad."""
    limits = zip(here, there, plant.velocity_limits, plant.acceleration_limits, strict=True)
    moves = [
        trapezoid(float(a), float(b), 0.5 * float(v), 0.5 * float(acc), rate_hz)
        for a, b, v, acc in limits
    ]
    return side_by_side(moves, rate_hz)


def swing(
    plant: Plant, posture: Array, joint: int, turns: int, *, share: float, rate_hz: float
) -> Reference:
    """One joint back and forth in triangles of speed, at its acceleration limit."""
    return swept(plant, posture, joint, [1.0] * turns, rate_hz, span=share, dwell=0.2)


def imu_trials(
    plant: Plant, postures: Sequence[Array], *, rate_hz: float = 1000.0, turns: int = 3
) -> list[Trial]:
    """Joint 1 rotates in each locked posture; then every other joint by itself."""
    trials = [
        Trial(
            "imu",
            f"{plant.arm.names[0]}_posture_{number}",
            swing(plant, posture, 0, turns, share=0.4, rate_hz=rate_hz),
            imus=True,
        )
        for number, posture in enumerate(postures, start=1)
    ]
    for joint in range(1, plant.arm.n):
        motion = swing(plant, postures[0], joint, turns, share=0.4, rate_hz=rate_hz)
        trials.append(Trial("imu", plant.arm.names[joint], motion, imus=True))
    return trials


def inertia_trials(
    plant: Plant,
    postures: Sequence[Array],
    rng: np.random.Generator,
    *,
    pairs: Sequence[tuple[int, int]] | None = None,
    seconds: float = 8.0,
    rate_hz: float = 1000.0,
) -> list[Trial]:
    """Two joints at a time in trapezoids at their limits of speed and acceleration.

    `pairs` is all of them unless given. The k-th pair runs in posture k modulo their number; a
    plant of one joint moves that joint.
    """
    n = plant.arm.n
    chosen = list(pairs) if pairs is not None else list(combinations(range(n), 2))
    groups: list[tuple[int, ...]] = [*chosen] or [(0,)]
    trials = []
    for number, group in enumerate(groups):
        posture = postures[number % len(postures)]
        moving = {
            joint: _busy(plant, joint, float(posture[joint]), rng, seconds, rate_hz)
            for joint in group
        }
        motion = together(posture, moving, rate_hz)
        start = hold(motion.q[0], 0.3, rate_hz)
        label = "__".join(plant.arm.names[joint] for joint in group)
        label += f"_{number + 1}" if groups.count(group) > 1 else ""
        trials.append(Trial("inertia", label, join([start, motion]), imus=True))
    return trials


def _busy(
    plant: Plant,
    joint: int,
    centre: float,
    rng: np.random.Generator,
    seconds: float,
    rate_hz: float,
) -> Profile:
    """Zigzag of one joint around `centre`, two thirds of its range wide, inside its limits."""
    low, high = span_of(plant, joint)
    half = (high - low) / 3.0
    centre = float(np.clip(centre, low + half, high - half))
    top, accel = float(plant.velocity_limits[joint]), float(plant.acceleration_limits[joint])
    return zigzag(rng, (centre - half, centre + half), top, accel, seconds, rate_hz)


def validation_trials(
    plant: Plant,
    rng: np.random.Generator,
    *,
    runs: int = 2,
    seconds: float = 20.0,
    points: int = 8,
    rate_hz: float = 1000.0,
) -> list[Trial]:
    """Motion of all joints that no stage sees: Fourier series, then moves between postures."""
    limits, harmonics = limits_of(plant), max(4, round(0.8 * seconds))
    series = [
        fourier(rng, *limits, seconds=seconds, harmonics=harmonics, rate_hz=rate_hz)
        for _ in range(runs)
    ]
    trials = [
        Trial("validation", f"fourier_{number}", motion, imus=True)
        for number, motion in enumerate(series, start=1)
    ]
    moves = point_to_point(rng, *limits, points=points, rate_hz=rate_hz)
    return [*trials, Trial("validation", "point_to_point", moves, imus=True)]
