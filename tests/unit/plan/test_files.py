"""Files of planned moves, read back by somebody else's reader; which moves are
recorded.
"""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
from ruamel.yaml import YAML

from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.planned import compared
from seqid_cli.inspect.screening import Screened
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.planned import RATE_HZ, sampled
from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.plan.functions import plan
from seqid_cli.plan.options import PlanOptions
from tests.plants.robots.made import made_recording
from tests.plants.robots.sample import SAMPLES, sample_robot

SCALE = 0.5
ROBOT = sample_robot("six_joint")
NAMES = ROBOT.joint_names


@pytest.fixture(scope="module")
def planned_files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PlanFile]:
    folder = tmp_path_factory.mktemp("plan")
    options = PlanOptions(
        duration_s=10.0, move_s=5.0, pool=20, sweeps=0, speed_scale=SCALE
    )
    moves = plan("inertia", ROBOT, options=options, trajectories=folder / "moves")
    sweeps = plan("friction", ROBOT, options=options, trajectories=folder / "sweeps")
    return folder, msgspec.structs.replace(moves, moves=[*moves.moves, sweeps.moves[2]])


@pytest.mark.slow
def test_yaml_holds_the_slowed_move(planned_files: tuple[Path, PlanFile]) -> None:
    folder, file = planned_files
    move = file.moves[0]
    text = (folder / "moves" / f"{move.name}.yaml").read_text()
    loaded = YAML(typ="safe").load(text)["trajectory"]
    assert loaded["joint_names"] == list(NAMES)
    points = loaded["points"]
    times = [
        p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"]
        for p in points
    ]
    assert times[-1] == pytest.approx(move.duration_s / SCALE)

    t, q, dq, ddq = sampled(move, NAMES, 1000.0)
    quantities = {
        "positions": (q, 1),
        "velocities": (dq, SCALE),
        "accelerations": (ddq, SCALE**2),
    }
    for key, (as_planned, factor) in quantities.items():
        written = np.array([p[key] for p in points])
        tolerance = 2e-3 * np.abs(as_planned).max() + 1e-9
        for j in range(6):
            expected = factor * np.interp(np.array(times) * SCALE, t, as_planned[:, j])
            assert written[:, j] == pytest.approx(expected, abs=tolerance)


def test_straight_parts_are_left_out_of_the_files(
    planned_files: tuple[Path, PlanFile],
) -> None:
    folder, file = planned_files
    move = file.moves[-1]
    t, q, _, ddq = sampled(move, NAMES, RATE_HZ)
    rows = np.loadtxt(folder / "sweeps" / f"{move.name}.csv", delimiter=",", skiprows=1)
    assert len(rows) < 0.3 * len(t)
    assert len(rows) > np.sum(ddq.any(axis=1))
    read = [np.interp(t / SCALE, rows[:, 0], column) for column in rows[:, 1:7].T]
    assert np.abs(np.column_stack(read) - q).max() < 3e-6


def test_urscript_follows_the_move(planned_files: tuple[Path, PlanFile]) -> None:
    folder, file = planned_files
    text = (folder / "moves" / f"{file.moves[0].name}.script").read_text()
    assert re.match(r"def (\w+)\(\):\n.*\nend\n\1\(\)\n$", text, re.S)
    rows = re.findall(r"servoj\(\[(.*?)\]", text)
    poses = np.array([row.split(",") for row in rows], dtype=float)
    _, q, _, _ = sampled(file.moves[0], NAMES, 1000.0)
    assert len(poses) == round(50 * file.moves[0].duration_s / SCALE)
    assert np.abs(poses[0] - q[0]).max() < 1e-6
    middle = np.abs(q[:, None] - poses[len(poses) // 2]).sum(axis=2).min()
    assert middle < 0.01 * np.ptp(q, axis=0).max()


def test_urscript_of_strokes_keeps_speed_and_acceleration(
    planned_files: tuple[Path, PlanFile],
) -> None:
    folder, file = planned_files
    move = file.moves[-1]
    text = (folder / "sweeps" / f"{move.name}.script").read_text()
    commands = re.findall(r"movej\(\[(.*?)\], a=(\S+), v=(\S+)\)", text)[1:]
    j = NAMES.index(move.joints[0])
    for stroke, (pose, a, v) in zip(move.strokes, commands, strict=True):
        assert float(pose.split(",")[j]) == pytest.approx(stroke.end, abs=1e-6)
        assert float(v) == pytest.approx(SCALE * stroke.speed, rel=1e-4)
        assert float(a) == pytest.approx(SCALE**2 * stroke.acceleration, rel=1e-4)


def test_other_arms_get_no_urscript(tmp_path: Path) -> None:
    two = SAMPLES / "two_joint" / "robot.toml"
    options = PlanOptions(duration_s=5.0, move_s=5.0, pool=10, sweeps=0)
    plan("inertia", two, options=options, trajectories=tmp_path / "moves")
    kinds = {path.suffix for path in (tmp_path / "moves").iterdir()}
    assert kinds == {".csv", ".yaml"}


LOG_HZ = 100.0
TWO = sample_robot("two_joint").joint_names


@cache
def planned() -> PlanFile:
    options = PlanOptions(
        duration_s=12.0, move_s=4.0, pool=30, sweeps=1, speed_scale=0.5
    )
    return plan("inertia", sample_robot("two_joint"), options=options)


def log_of(*moves: PlannedMove, scale: float = 1.0) -> Recording:
    """Moves one after the other with rests, as an arm follows them."""
    rng = np.random.default_rng(0)
    parts = []
    for move in moves:
        q = sampled(move, TWO, LOG_HZ / scale)[1]
        parts += [np.tile(q[0], (70, 1)), q, np.tile(q[-1], (50, 1))]
    q = np.concatenate(parts) + 1e-3 * rng.normal(size=(sum(map(len, parts)), len(TWO)))
    return made_recording(q, rate_hz=LOG_HZ)


def status(*logs: Recording) -> list[str]:
    screened = [Screened(log, ()) for log in logs]
    return [part.status for part in compared(planned(), TWO, screened)]


def test_recorded_moves_are_found_where_they_are() -> None:
    first, second, third = planned().moves
    log = log_of(first, third)
    assert status(log) == ["recorded", "missing", "recorded"]
    assert status(log, log_of(second)) == ["recorded"] * 3
    part, _, _ = compared(planned(), TWO, [Screened(log, ())])
    assert abs(part.start - 0.7) < 0.1
    assert status() == ["missing"] * 3


def test_spoiled_moves_say_why() -> None:
    move = planned().moves[0]
    log = log_of(move)
    half = replace(log, t=log.t[:300], q=log.q[:300], valid=log.valid[:300])
    with_gap = replace(log, valid=(log.t < 2.0) | (log.t > 3.0))
    displacement = (log.q - log.q[0]) * np.array([1.0, 0.7])
    too_small = replace(log, q=log.q[0] + displacement)
    fault = finding_of("position_spikes", "bad")
    cases = [
        (Screened(log_of(move, scale=0.5), ()), "at 0.5 of the planned speed"),
        (Screened(half, ()), "of it is in the log"),
        (Screened(with_gap, ()), "of it is in the log"),
        (Screened(too_small, ()), f"joint {TWO[1]} is"),
        (Screened(log, (fault,)), "bad"),
    ]
    for spoiled, text in cases:
        part = compared(planned(), TWO, [spoiled])[0]
        assert part.status == "spoiled", text
        assert text in part.reason
        later = compared(planned(), TWO, [spoiled, Screened(log, ())])[0]
        assert (later.status, later.reason) == ("recorded", "")


def test_another_motion_is_no_part_of_the_plan() -> None:
    changed = msgspec.structs.replace(planned().moves[0])
    changed.fourier = {
        name: msgspec.structs.replace(motion, sine=motion.sine[::-1], centre=0.0)
        for name, motion in changed.fourier.items()
    }
    assert status(log_of(changed))[0] == "missing"
