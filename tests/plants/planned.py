"""Planned moves on a plant: as references, and recorded as a robot's controller would
run them.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.planned import sampled
from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.robot.types import Array
from tests.plants.arms import rigs
from tests.plants.motions.trajectories import Reference, hold, join
from tests.plants.robots.lab import recording_of, write_log
from tests.plants.simulate import Plant, simulate

RATE_HZ = 1000.0
REST_S = 0.5  # before and after each move
PAUSE_S = 10.0  # between moves


def limits_used(belief: Belief, move: PlannedMove, rate_hz: float = 500.0) -> Array:
    """Largest share of the limits of position (about the middle), speed, acceleration,
    torque.
    """
    limits = belief.limits
    t, q, dq, ddq = sampled(move, belief.robot.joint_names, rate_hz)
    middle, half = (limits.lower + limits.upper) / 2, limits.range / 2
    most = (half, limits.speed, limits.acceleration)
    states = zip((np.abs(q - middle), np.abs(dq), np.abs(ddq)), most, strict=True)
    shares = [np.max((used / limit)[:, limits.moves]) for used, limit in states]
    loads = []
    # little memory
    for part in (slice(start, start + 2000) for start in range(0, len(t), 2000)):
        moves = Moves(t[part], *(x[None, part] for x in (q, dq, ddq)))
        loads.append(belief.overload(moves, belief.regressor(moves))[0])
    return np.array([*shares, max(loads)])


def reference_of(move: PlannedMove, plant: Plant) -> Reference:
    _, q, dq, ddq = sampled(move, plant.arm.names, RATE_HZ)
    first, last = (hold(q[k], REST_S, RATE_HZ) for k in (0, -1))
    return join([first, Reference(q, dq, ddq, RATE_HZ), last])


def recorded(
    plant: Plant,
    moves: Sequence[PlannedMove],
    seed: int,
    *,
    every: int = 2,
    start: float = 0.0,
) -> list[Recording]:
    logs = []
    for number, move in enumerate(moves):
        motion = reference_of(move, plant)
        noise = int(np.random.default_rng([seed, number]).integers(2**31))
        log = simulate(plant, motion, noise, every=every, start=start)
        logs.append(recording_of(plant, move.name, log))
        start += motion.duration + PAUSE_S
    return logs


def record(plan: PlanFile, folder: Path) -> None:
    """Write the logs of a plan for a sample robot as `STAGE/MOVE.parquet`."""
    plant, start = getattr(rigs, plan.robot.name)(), 0.0
    for seed, move in enumerate(plan.moves):
        motion, imus = (
            reference_of(move, plant),
            move.stage not in ("friction", "gravity"),
        )
        log = simulate(plant, motion, seed, every=4, imus=imus, start=start)
        start += motion.duration + PAUSE_S
        part = move.stage.removesuffix("-calib")  # of the IMUs
        write_log(folder / part / f"{move.name}.parquet", plant, log)


if __name__ == "__main__":
    record(
        msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=PlanFile),
        Path(sys.argv[2]),
    )
