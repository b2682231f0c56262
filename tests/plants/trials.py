"""The logs of a study of undeclared effects: training and held-out, minutes apart."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.plants.experiments import span_of
from tests.plants.simulate import Log, Plant, Truth, simulate
from tests.plants.trajectories import (
    Reference,
    hold,
    join,
    periodic,
    point_to_point,
    together,
    zigzag,
)

Array = NDArray[np.float64]

RATE_HZ = 1000.0  # of the control
EVERY = 2  # control periods per row
PERIODS = (5.626, 6.126, 6.374)  # s: whole rows, but no whole number of mains periods
FADE = 1.0  # s
REST = 1.5  # s
SEED_STRIDE = 1000


@dataclass(frozen=True)
class Drill:
    """One log to record: `start` s since power-on.

    Where the motion repeats, its periods of `period` s begin `FADE` s after the first row.
    """

    name: str
    reference: Reference
    start: float
    period: float | None = None
    held_out: bool = False


@dataclass(frozen=True)
class Recorded:
    """A drill and what the plant made of it."""

    drill: Drill
    log: Log


@dataclass(frozen=True)
class _Bounds:
    low: Array
    high: Array
    speed: Array
    accel: Array


def _bounds(plant: Plant, share: float) -> _Bounds:
    """Limits of motion at `share` of the top speed; accelerations fall half as fast."""
    low, high = np.array([span_of(plant, joint) for joint in range(plant.arm.n)]).T
    speed = share * plant.velocity_limits
    return _Bounds(low, high, speed, 0.9 * float(np.sqrt(share)) * plant.acceleration_limits)


def waves(
    plant: Plant, rng: np.random.Generator, *, period: float, share: float, seconds: float = 20.0
) -> Reference:
    """Fourier series of all joints over whole periods, three of them in 20 s."""
    b = _bounds(plant, share)
    periods = max(1, round((seconds - 2.0 * FADE) / period))
    return periodic(
        rng,
        b.low,
        b.high,
        b.speed,
        b.accel,
        period=period,
        periods=periods,
        harmonics=6 if share > 0.4 else 3,
        rate_hz=RATE_HZ,
        fade=FADE,
    )


def moves(
    plant: Plant, rng: np.random.Generator, *, share: float, seconds: float = 20.0
) -> Reference:
    """Moves between postures, with rests between them and a longer one at both ends."""
    b = _bounds(plant, share)
    points = 2
    state = rng.bit_generator.state
    while True:
        rng.bit_generator.state = state
        motion = point_to_point(
            rng, b.low, b.high, b.speed, b.accel, points=points, rate_hz=RATE_HZ
        )
        if motion.duration >= seconds - 2.0 * REST:
            return _rested(motion)
        points += 1


def zigzags(
    plant: Plant, rng: np.random.Generator, *, share: float, seconds: float = 20.0
) -> Reference:
    """All joints in trapezoids of their own, at rest at both ends."""
    b = _bounds(plant, share)
    length = seconds - 2.0 * REST
    profiles = {
        joint: zigzag(
            rng,
            (float(b.low[joint]), float(b.high[joint])),
            float(b.speed[joint]),
            float(b.accel[joint]),
            max(length - 3.0, 0.5),
            RATE_HZ,
        )
        for joint in range(plant.arm.n)
    }
    return _rested(together(0.5 * (b.low + b.high), profiles, RATE_HZ))


def _rested(motion: Reference) -> Reference:
    ends = hold(motion.q[0], REST, RATE_HZ), hold(motion.q[-1], REST, RATE_HZ)
    return join([ends[0], motion, ends[1]])


def drills(
    plant: Plant, seed: int, *, seconds: float = 20.0, repeat: bool = False
) -> tuple[Drill, ...]:
    """Five training and two held-out logs of about `seconds` s, in the order of their starts.

    Fourier series fast, slow and in between, moves between postures, and trapezoids of all joints
    at once; held out are one Fourier series and one set of moves. Starts are 2 to 4 minutes apart.
    With `repeat` the first log's motion is run again at the end, as training.
    """
    rng = np.random.default_rng([seed, 5])
    one, two, three = (float(x) for x in rng.permutation(PERIODS))
    plan: list[tuple[str, Reference, float | None, bool]] = [
        ("fast", waves(plant, rng, period=one, share=0.9, seconds=seconds), one, False),
        ("moves", moves(plant, rng, share=0.6, seconds=seconds), None, False),
        ("held_waves", waves(plant, rng, period=two, share=0.6, seconds=seconds), two, True),
        ("slow", waves(plant, rng, period=three, share=0.15, seconds=seconds), three, False),
        ("zigzag", zigzags(plant, rng, share=0.8, seconds=seconds), None, False),
        ("held_moves", moves(plant, rng, share=0.8, seconds=seconds), None, True),
        ("middle", waves(plant, rng, period=two, share=0.45, seconds=seconds), two, False),
    ]
    if repeat:
        plan.append(("fast_again", plan[0][1], one, False))
    pauses = rng.uniform(120.0, 240.0, len(plan)).round(3)
    starts = 20.0 + np.cumsum(pauses) - pauses[0]
    return tuple(
        Drill(name, reference, float(start), period, held)
        for (name, reference, period, held), start in zip(plan, starts, strict=True)
    )


def record(
    plant: Plant,
    chosen: Sequence[Drill],
    seed: int,
    *,
    imus: bool = False,
    cache: Path | None = None,
    label: str = "",
) -> tuple[Recorded, ...]:
    """Run drills on a plant, noise seeds 1000 seed + number of the drill.

    With a `cache` folder a run is stored under `label` (which must say what the plant is: its rig,
    injection, joint and size), the drill, the seed and a hash of the simulator's sources, and read
    back from there the next time.
    """
    out = []
    for number, drill in enumerate(chosen):
        noise = SEED_STRIDE * seed + number
        if cache is None:
            log = run_drill(plant, drill, noise, imus=imus)
        else:
            key = f"{label}|{drill.start!r}|{noise}|{imus}|{_digest(drill.reference)}|{_sources()}"
            path = cache / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npz"
            log = _stored(path, plant, drill, noise, imus=imus)
        out.append(Recorded(drill, log))
    return tuple(out)


def run_drill(plant: Plant, drill: Drill, seed: int, *, imus: bool = False) -> Log:
    """Run one drill, recorded at 500 Hz."""
    return simulate(plant, drill.reference, seed, every=EVERY, imus=imus, start=drill.start)


def _stored(path: Path, plant: Plant, drill: Drill, seed: int, *, imus: bool) -> Log:
    if path.is_file():
        return load_log(path)
    log = run_drill(plant, drill, seed, imus=imus)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_log(path, log)
    return log


def _digest(reference: Reference) -> str:
    return hashlib.sha256(np.ascontiguousarray(reference.q).tobytes()).hexdigest()


def _sources() -> str:
    """Hash of the simulator's own files, so that a change of physics makes new logs."""
    here = Path(__file__).parent
    files = [x for x in sorted(here.glob("*.py")) if not x.name.startswith("test_")]
    return hashlib.sha256(b"".join(x.read_bytes() for x in files)).hexdigest()


def save_log(path: Path, log: Log) -> None:
    """Write a log as npz, whole or not at all."""
    truth = {f"truth_{x}": getattr(log.truth, x) for x in Truth.__dataclass_fields__}
    arrays = {f"imu_{name}": readings for name, readings in log.accelerometers.items()}
    warm = {} if log.temperature is None else {"temperature": log.temperature}
    plain = {"t": log.t, "q": log.q, "current": log.current, "start": np.array(log.start)}
    part = path.with_suffix(".part")
    with part.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **plain, **truth, **arrays, **warm)
    part.replace(path)


def load_log(path: Path) -> Log:
    """Read what `save_log` wrote."""
    with np.load(path, allow_pickle=False) as data:
        return Log(
            t=data["t"],
            q=data["q"],
            current=data["current"],
            accelerometers={x[4:]: data[x] for x in data.files if x.startswith("imu_")},
            truth=Truth(*(data[f"truth_{x}"] for x in Truth.__dataclass_fields__)),
            start=float(data["start"]),
            temperature=data["temperature"] if "temperature" in data.files else None,
        )
