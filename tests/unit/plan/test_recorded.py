"""Which moves of a plan are recorded: found by their positions, spoiled ones with the reason."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from seqid_cli.inspect.screening import Screened
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.moves.trajectories import sampled
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.recorded import compared
from tests.plants.robots.sample import sample_robot

RATE_HZ = 100.0
NAMES = sample_robot("two_joint").joint_names


@cache
def plan() -> PlanFile:
    robot = sample_robot("two_joint")
    limits = limits_of(robot, ramp_s=0.3)
    options = PlanOptions(duration_s=12.0, move_s=4.0, pool=30, sweeps=1, speed_scale=0.5)
    return make_plan("inertia", robot, limits, Stages(), options)


def log_of(*moves: PlannedMove, scale: float = 1.0, error: float = 1e-3) -> Recording:
    """Moves one after the other with rests, as an arm follows them."""
    rng = np.random.default_rng(0)
    parts = []
    for move in moves:
        q = sampled(move, NAMES, RATE_HZ / scale)[1]
        parts += [np.tile(q[0], (70, 1)), q, np.tile(q[-1], (50, 1))]
    q = np.concatenate(parts) + error * rng.normal(size=(sum(map(len, parts)), len(NAMES)))
    t = np.arange(len(q)) / RATE_HZ
    health = Health(rate_hz=RATE_HZ, jitter=0.0)
    valid = np.ones(len(q), dtype=bool)
    return Recording(Path("log"), "0" * 64, "made", t=t, q=q, valid=valid, health=health)


def status(*logs: Recording, findings: tuple[InspectionFinding, ...] = ()) -> list[str]:
    parts = compared(plan(), NAMES, [Screened(log, findings) for log in logs])
    return [part.status for part in parts]


def test_recorded_moves_are_found_where_they_are() -> None:
    first, second, third = plan().moves
    log = log_of(first, third)
    assert status(log) == ["recorded", "missing", "recorded"]
    assert status(log, log_of(second)) == ["recorded"] * 3
    (found, _, _) = compared(plan(), NAMES, [Screened(log, ())])
    assert abs(found.start - 0.7) < 0.1
    assert status() == ["missing"] * 3


def test_spoiled_moves_say_why() -> None:
    move = plan().moves[0]
    whole = log_of(move)
    half = replace(whole, t=whole.t[:300], q=whole.q[:300], valid=whole.valid[:300])
    gap = replace(whole, valid=(whole.t < 2.0) | (whole.t > 3.0))
    off = replace(whole, q=whole.q[0] + (whole.q - whole.q[0]) * np.array([1.0, 0.7]))
    fault = InspectionFinding(
        code="x", severity="error", log="log", joint="", channel="", message="bad", remedy=""
    )
    cases = [
        (Screened(log_of(move, scale=0.5), ()), "at 0.5 of the planned speed"),
        (Screened(half, ()), "of it is in the log"),
        (Screened(gap, ()), "of it is in the log"),
        (Screened(off, ()), f"joint {NAMES[1]} is"),
        (Screened(whole, (fault,)), "bad"),
    ]
    for log, text in cases:
        part = compared(plan(), NAMES, [log])[0]
        assert part.status == "spoiled", text
        assert text in part.reason
        later = compared(plan(), NAMES, [log, Screened(whole, ())])[0]
        assert (later.status, later.reason) == ("recorded", "")


def test_another_motion_is_no_part_of_the_plan() -> None:
    other = msgspec.structs.replace(plan().moves[0])
    other.fourier = {
        name: msgspec.structs.replace(motion, sine=motion.sine[::-1], centre=0.0)
        for name, motion in other.fourier.items()
    }
    assert status(log_of(other))[0] == "missing"


OPTIONS = PlanOptions(duration_s=12.0, move_s=4.0, pool=30, sweeps=1)
