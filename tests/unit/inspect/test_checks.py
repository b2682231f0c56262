"""Checks on their own numbers, and the documents' table of what they find."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.channels.torques import _spikes, _starts_or_stops
from seqid_cli.inspect.channels.values import _refined, lattice
from seqid_cli.inspect.dynamics.causes import Cause
from seqid_cli.inspect.dynamics.equations import _structural_error
from seqid_cli.inspect.dynamics.friction import Friction, Sample, _exchanged
from seqid_cli.inspect.findings import ERRORS, WARNINGS
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests import ROOT
from tests.plants.robots.small import planar_2r
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns, write_columns


@pytest.mark.parametrize(
    ("own", "pairs"), [((0.02, 0.05), [(0, 1)]), ((2.1, 1.6), []), ((0.0, 0.3), [])]
)
def test_torques_are_exchanged_only_where_friction_of_their_own_is_known_to_lack(
    own: tuple[float, float], pairs: list[tuple[int, int]]
) -> None:
    # Joint 0 moves and drags joint 1, which stands within its stiction, by 0.2 N m.
    fits = {0: Friction({0: own}, 3.0, 0.05), 1: Friction({0: (0.2, 0.01)}, 0.4, 0.1)}
    assert _exchanged(fits, (0,)) == pairs


@pytest.fixture(scope="module")
def noise() -> Sample:
    """Two joints that shake, their torques nothing but noise."""
    q, dq, ddq, tau, direction = np.random.default_rng(2).normal(size=(5, 400, 2))
    basis = base_parameters(planar_2r(), rotor=[])
    return Sample(planar_2r(), q, dq, ddq, tau, direction, 1.0, (0, 1), basis)


def test_a_cause_changes_all_that_it_says(noise: Sample) -> None:
    factor, turn = np.array([-1.0, 1.0]), np.array([0.0, 0.5])
    found = Cause("", (0, 1), "", motion=factor, shift=turn).on(noise)
    swapped = Cause("", (0, 1), "", exchanged=(True, False), torque=2.0).on(noise)
    np.testing.assert_array_equal(found.q, noise.q * factor + turn)
    np.testing.assert_array_equal(swapped.tau, 2.0 * noise.tau)
    for name in ("dq", "ddq", "direction"):
        np.testing.assert_array_equal(getattr(found, name), getattr(noise, name) * factor)
        np.testing.assert_array_equal(getattr(swapped, name), getattr(noise, name)[:, ::-1])


@pytest.mark.parametrize(("own", "explained"), [([0, 1], True), ([1, 0], False)])
def test_each_joint_has_a_friction_of_its_own(
    noise: Sample, own: list[int], *, explained: bool
) -> None:
    friction = noise.dq * np.array([1.0, 3.0]) + 0.5 * noise.direction + 1.0
    error = _structural_error(replace(noise, tau=friction[:, own])).error
    assert error < 1e-6 if explained else error > 0.5


@pytest.mark.parametrize(("length", "found"), [(1, 1), (2, 2), (3, 0)])
def test_what_lasts_three_samples_is_no_spike(length: int, found: int) -> None:
    values = np.sin(np.arange(1000) / 100.0)
    values[400 : 400 + length] += 5.0
    assert len(_spikes(values)) == found


def test_a_torque_that_starts_or_stops_a_motion_is_no_spike() -> None:
    speed = np.repeat([0.0, 0.2, 0.0, 0.2, 0.25], 100)
    at = np.array([50, 100, 150, 200, 300, 350, 400])
    ends = np.isin(at, (100, 200, 300))
    step = 1e-4
    q = np.round(np.cumsum(speed) / 100.0 / step) * step
    q[20:80:3] += step  # noise of the encoder at rest
    np.testing.assert_array_equal(_starts_or_stops(q, at, step), ends)


@pytest.mark.parametrize("log", ["validation/fourier_1", "inertia/shoulder_lift__elbow"])
def test_a_driver_that_subtracts_gravity_is_told_from_a_mounting(tmp_path: Path, log: str) -> None:
    folder = SAMPLES / "six_joint"
    robot = load_robot(folder / "robot.toml")
    assert robot.nominal is not None
    columns = read_columns(folder / f"{log}.parquet")
    q = np.column_stack([columns[f"{name}.position"] for name in SIX])
    still = np.zeros_like(q)
    weight = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, still, still)
    for joint, own in zip(robot.joints, weight.T, strict=True):
        current = columns.pop(f"{joint.name}.current")
        columns[f"{joint.name}.torque"] = current * joint.torque_per_ampere - own
    write_columns(tmp_path / "log.parquet", columns)
    shutil.copy(folder / "six_joint.urdf", tmp_path)
    text = (folder / "robot.toml").read_text()
    for effort, codes in (("torque", {"effort_without_gravity"}), ("gravity_compensated", set())):
        own_text = text.replace('effort = "current"', f'effort = "{effort}"')
        (tmp_path / "robot.toml").write_text(own_text)
        found = inspect_log(tmp_path / "log.parquet", load_robot(tmp_path / "robot.toml")).findings
        assert {finding.code for finding in found} == codes


def test_the_step_is_found_to_all_digits() -> None:
    counts = np.random.default_rng(0).integers(-500, 500, 2000)
    assert lattice(counts * 0.0123) == pytest.approx(0.0123, rel=1e-9)


def test_levels_within_half_a_step_leave_it_as_it_is() -> None:
    with np.errstate(all="raise"):
        assert _refined(np.array([0.0, 0.1, 0.2, 50.0, 90.0]), 1.0) == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("lost", [0, 80])
def test_the_hole_between_episodes_is_no_gap(tmp_path: Path, lost: int) -> None:
    t, episode = np.tile(np.arange(0.0, 10.0, 0.01), 3), np.repeat([0.0, 1.0, 2.0], 1000)
    kept = np.delete(np.arange(3000), slice(1500, 1500 + lost))
    table = {
        "t": t,
        "episode_index": episode,
        "a.position": np.round(np.sin(t) / 1e-4) * 1e-4,
        "a.torque": np.cos(1.3 * t) + 0.5 * np.sign(np.cos(t)),
    }
    write_columns(tmp_path / "log.parquet", {name: x[kept] for name, x in table.items()})
    found = [f for f in inspect_log(tmp_path / "log.parquet").findings if f.code == "clock_gap"]
    assert [f.message.split(",")[0] for f in found] == ["1 gaps"] * bool(lost)


ROW = re.compile(r"^\| `(\w+)` \| (error|warning) \| [^|]+ \| [^|]+ \| ([^|]+) \|$", re.MULTILINE)


def test_the_table_of_codes_is_the_packages_own() -> None:
    rows = ROW.findall((ROOT / "docs" / "inspect.md").read_text())
    assert len(rows) == len(ERRORS) + len(WARNINGS)
    assert {code: remedy for code, severity, remedy in rows if severity == "error"} == ERRORS
    assert {code: remedy for code, severity, remedy in rows if severity == "warning"} == WARNINGS
