"""The logs of a study of undeclared effects: training and held-out, minutes apart."""

from dataclasses import dataclass, replace

import numpy as np

from tests import Array
from tests.plants.motions import trajectories as line
from tests.plants.motions.experiments import spans
from tests.plants.motions.trajectories import Reference
from tests.plants.simulate import Log, Plant, simulate

RATE_HZ = 1000.0  # of the control
EVERY = 2  # control periods per row
PERIODS = (5.626, 6.126, 6.374)  # s: whole rows, but no whole number of mains periods
FADE = 1.0  # s
REST = 1.5  # s
SEED_STRIDE = 1000


@dataclass(frozen=True)
class Drill:
    """One log to record.

    Where the motion repeats, its periods of `period` s begin `FADE` s after the first
    row.
    """

    name: str
    reference: Reference
    start: float  # s since power-on
    period: float | None = None
    held_out: bool = False


def _bounds(plant: Plant, share: float) -> tuple[Array, ...]:
    """Limits of motion at `share` of the top speed; accelerations fall half as fast."""
    accel = 0.9 * float(np.sqrt(share)) * plant.acceleration_limits
    return *spans(plant), share * plant.velocity_limits, accel


def waves(
    plant: Plant,
    rng: np.random.Generator,
    *,
    period: float,
    share: float,
    seconds: float = 20.0,
) -> Reference:
    """Fourier series of all joints over whole periods, three of them in 20 s."""
    return line.periodic(
        rng,
        *_bounds(plant, share),
        period=period,
        periods=max(1, round((seconds - 2.0 * FADE) / period)),
        harmonics=6 if share > 0.4 else 3,
        rate_hz=RATE_HZ,
        fade=FADE,
    )


def moves(
    plant: Plant, rng: np.random.Generator, *, share: float, seconds: float = 20.0
) -> Reference:
    """Moves between postures, with rests between them and a longer one at both ends."""
    limits, points = _bounds(plant, share), 2
    state = rng.bit_generator.state
    while True:
        rng.bit_generator.state = state
        motion = line.point_to_point(rng, *limits, points=points, rate_hz=RATE_HZ)
        if motion.duration >= seconds - 2.0 * REST:
            return _rested(motion)
        points += 1


def zigzags(
    plant: Plant, rng: np.random.Generator, *, share: float, seconds: float = 20.0
) -> Reference:
    """All joints in trapezoids of their own, at rest at both ends."""
    low, high, speed, accel = _bounds(plant, share)
    length = max(seconds - 2.0 * REST - 3.0, 0.5)
    profiles = {
        joint: line.zigzag(rng, (a, b), top, push, length, RATE_HZ)
        for joint, (a, b, top, push) in enumerate(
            np.array([low, high, speed, accel]).T.tolist()
        )
    }
    return _rested(line.together(0.5 * (low + high), profiles, RATE_HZ))


def _rested(motion: Reference) -> Reference:
    first, last = (line.hold(motion.q[k], REST, RATE_HZ) for k in (0, -1))
    return line.join([first, motion, last])


def drills(plant: Plant, seed: int, *, seconds: float = 20.0) -> tuple[Drill, ...]:
    """Five training and two held-out logs of about `seconds` s, in the order of their
    starts.
    """
    rng = np.random.default_rng([seed, 5])
    one, two, three = (float(x) for x in rng.permutation(PERIODS))
    plan = (
        ("fast", waves, 0.9, one),
        ("moves", moves, 0.6, None),
        ("held_waves", waves, 0.6, two),
        ("slow", waves, 0.15, three),
        ("zigzag", zigzags, 0.8, None),
        ("held_moves", moves, 0.8, None),
        ("middle", waves, 0.45, two),
    )
    made = []
    for name, make, share, period in plan:
        more = {} if period is None else {"period": period}
        motion = make(plant, rng, share=share, seconds=seconds, **more)
        made.append(Drill(name, motion, 0.0, period, name.startswith("held")))
    pauses = rng.uniform(120.0, 240.0, len(plan)).round(3)
    starts = 20.0 + np.cumsum(pauses) - pauses[0]
    return tuple(replace(x, start=float(s)) for x, s in zip(made, starts, strict=True))


def run_drill(plant: Plant, drill: Drill, seed: int) -> Log:
    return simulate(plant, drill.reference, seed, every=EVERY, start=drill.start)
