"""Arms drawn at random, with coarse encoders: silent when sound, and faults found all the same."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.robot.file import load_robot
from tests.plants.arms.drawn import drawn_arm
from tests.plants.motions.experiments import span_of
from tests.plants.motions.trajectories import Reference, hold, join, sweeps
from tests.plants.motions.trials import waves
from tests.plants.robotfile import robot_toml
from tests.plants.simulate import Plant as Robot
from tests.plants.simulate import simulate
from tests.unit.inspect import planting as p
from tests.unit.inspect.faults import write_columns
from tests.unit.inspect.planting import Columns, Plant

pytestmark = pytest.mark.slow

RATE_HZ, EVERY = 1000.0, 10
COUNTS = {21: 1000, 24: 2**16}  # per turn of the joint, by the arm's seed
SECONDS = 9.0


@cache
def arm(seed: int) -> Robot:
    plant = drawn_arm(seed)
    return replace(plant, encoder_step=np.full(plant.arm.n, 2.0 * np.pi / COUNTS[seed]))


def slow(plant: Robot) -> Reference:
    """Sweep joint 2 at a few percent of its top speed, a long rest at both ends."""
    top = float(plant.velocity_limits[1])
    low, high = span_of(plant, 1, 0.1)
    home = 0.4 * plant.position_limits[:, 1]
    sweep = sweeps(home, 1, (low, high), [0.08 * top], 1.0, rate_hz=RATE_HZ)
    return join([hold(sweep.q[0], 2.0, RATE_HZ), sweep, hold(sweep.q[-1], 2.0, RATE_HZ)])


@cache
def sound(seed: int, motion: str) -> Columns:
    plant = arm(seed)
    rng = np.random.default_rng(seed)
    reference = (
        slow(plant)
        if motion == "slow"
        else waves(plant, rng, period=3.5, share=0.7, seconds=SECONDS)
    )
    log = simulate(plant, reference, seed, every=EVERY)
    columns = {"t": log.t}
    for k, name in enumerate(plant.arm.names):
        columns[f"{name}.position"] = log.q[:, k]
        columns[f"{name}.current"] = log.current[:, k]
    return columns


def found(seed: int, motion: str, folder: Path, plant: Plant) -> set[tuple[str, str]]:
    columns = {name: values.copy() for name, values in sound(seed, motion).items()}
    plant(columns, np.random.default_rng(seed))
    write_columns(folder / "log.parquet", columns)
    (folder / "robot.toml").write_text(robot_toml("drawn", arm(seed)))
    report = inspect_log(folder / "log.parquet", load_robot(folder / "robot.toml"))
    return {(finding.code, finding.joint) for finding in report.findings}


@pytest.mark.parametrize("motion", ["waves", "slow"])
@pytest.mark.parametrize("seed", COUNTS)
def test_nothing_is_found_in_a_sound_log(seed: int, motion: str, tmp_path: Path) -> None:
    assert found(seed, motion, tmp_path, p.nothing) == set()


@pytest.mark.parametrize(
    ("seed", "plant", "expected"),
    [
        (21, p.held("axis_3.position", 4), {("channel_held", "axis_3")}),
        (21, p.clipped("axis_2.current", 0.55), {("torque_saturated", "axis_2")}),
        (21, p.negated("axis_3.current"), {("sign_mismatch", "axis_3")}),
        (
            21,
            p.swapped(("axis_2.current", "axis_4.current")),
            {("joints_swapped", "axis_2, axis_4")},
        ),
        (
            24,
            p.swapped(("axis_1.current", "axis_3.current")),
            {("joints_swapped", "axis_1, axis_3")},
        ),
        (24, p.constant("axis_2.current", 0.3), {("torque_constant_value", "axis_2")}),
    ],
)  # fmt: skip
def test_faults_are_found(
    seed: int, plant: Plant, expected: set[tuple[str, str]], tmp_path: Path
) -> None:
    assert found(seed, "waves", tmp_path, plant) == expected
