"""The logs that each stage needs, as references for a plant, and held-out ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tests import Array
from tests.plants.motions import trajectories as line
from tests.plants.motions.trajectories import Profile, Reference, hold, join
from tests.plants.simulate import Plant


@dataclass(frozen=True)
class Trial:
    """One log to record: stage folder, file name, motion, and whether the arrays are
    recorded.
    """

    stage: str
    name: str
    reference: Reference
    imus: bool = False


def span_of(plant: Plant, joint: int, share: float = 0.95) -> tuple[float, float]:
    """Middle `share` of the position range of a joint, rad."""
    low, high = plant.position_limits[joint]
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    return float(middle - half), float(middle + half)


def spans(plant: Plant) -> Array:
    """Ends of the ranges that moves use, (2, n) rad."""
    return np.array([span_of(plant, joint) for joint in range(plant.arm.n)]).T


def top_of(plant: Plant, joint: int) -> tuple[float, float]:
    return float(plant.velocity_limits[joint]), float(plant.acceleration_limits[joint])


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
    """One joint both ways over a share `span` of its range, at `shares` of its top
    speed.
    """
    top, accel = top_of(plant, joint)
    ends, speeds = span_of(plant, joint, span), [top * share for share in shares]
    return line.sweeps(
        posture, joint, ends, speeds, accel, rate_hz=rate_hz, dwell=dwell
    )


def friction_trials(
    plant: Plant,
    posture: Array,
    *,
    rate_hz: float = 1000.0,
    speeds: int = 12,
    lowest: float = 0.05,
) -> list[Trial]:
    """Each joint by itself, both ways over its range at every speed, in a locked
    posture.
    """
    trials = []
    for joint, name in enumerate(plant.arm.names):
        (top, accel), ends = top_of(plant, joint), span_of(plant, joint)
        pace = np.geomspace(lowest * top, top, speeds).tolist()
        motion = line.sweeps(posture, joint, ends, pace, accel, rate_hz=rate_hz)
        trials.append(Trial("friction", name, motion))
    return trials


def gravity_trials(
    plant: Plant,
    postures: Sequence[Array],
    *,
    rate_hz: float = 1000.0,
    speeds: Sequence[float] = (0.15,),
) -> list[Trial]:
    """Slow single-joint moves from the last joint to the first, in several locked
    postures.
    """
    trials, limits = [], (0.5 * plant.velocity_limits, 0.5 * plant.acceleration_limits)
    for joint in reversed(range(plant.arm.n)):
        parts: list[Reference] = []
        for posture in postures:
            sweep = swept(plant, posture, joint, speeds, rate_hz)
            if parts:
                parts.append(
                    line.trapezoids(parts[-1].q[-1], sweep.q[0], *limits, rate_hz)
                )
            parts.append(sweep)
        trials.append(Trial("gravity", plant.arm.names[joint], join(parts)))
    return trials


def swing(
    plant: Plant,
    posture: Array,
    joint: int,
    turns: int,
    *,
    share: float,
    rate_hz: float,
) -> Reference:
    """One joint back and forth in triangles of speed, at its acceleration limit."""
    return swept(plant, posture, joint, [1.0] * turns, rate_hz, span=share, dwell=0.2)


def imu_trials(
    plant: Plant, postures: Sequence[Array], *, rate_hz: float = 1000.0, turns: int = 3
) -> list[Trial]:
    """Joint 1 rotates in each locked posture; then every other joint by itself."""
    names, how = plant.arm.names, {"share": 0.4, "rate_hz": rate_hz}
    asked = [
        (f"{names[0]}_posture_{k}", posture, 0)
        for k, posture in enumerate(postures, start=1)
    ]
    asked += [(names[joint], postures[0], joint) for joint in range(1, plant.arm.n)]
    return [
        Trial("imu", name, swing(plant, *at, turns, **how), imus=True)
        for name, *at in asked
    ]


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

    `pairs` is all of them unless given. The k-th pair runs in posture k modulo their
    number; a plant of one joint moves that joint.
    """
    chosen = combinations(range(plant.arm.n), 2) if pairs is None else pairs
    groups: list[tuple[int, ...]] = [*chosen] or [(0,)]
    trials = []
    for number, group in enumerate(groups):
        posture = postures[number % len(postures)]
        moving = {
            j: _busy(plant, j, float(posture[j]), rng, seconds, rate_hz) for j in group
        }
        motion = line.together(posture, moving, rate_hz)
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
    rate: float,
) -> Profile:
    """Zigzag of one joint around `centre`, two thirds of its range wide, inside its
    limits.
    """
    low, high = span_of(plant, joint)
    half = (high - low) / 3.0
    centre = float(np.clip(centre, low + half, high - half))
    return line.zigzag(
        rng, (centre - half, centre + half), *top_of(plant, joint), seconds, rate
    )


def validation_trials(
    plant: Plant,
    rng: np.random.Generator,
    *,
    seconds: float = 20.0,
    points: int = 8,
    rate_hz: float = 1000.0,
) -> list[Trial]:
    """Motion of all joints that no stage sees: a Fourier series, then moves between
    postures.
    """
    limits = *spans(plant), 0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits
    harmonics = max(4, round(0.8 * seconds))
    series = line.fourier(
        rng, *limits, seconds=seconds, harmonics=harmonics, rate_hz=rate_hz
    )
    moves = line.point_to_point(rng, *limits, points=points, rate_hz=rate_hz)
    named = (("fourier_1", series), ("point_to_point", moves))
    return [Trial("validation", name, motion, imus=True) for name, motion in named]
