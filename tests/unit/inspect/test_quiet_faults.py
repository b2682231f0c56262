"""Faults that free parameters nearly take up, and what only looks like a fault."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.robot.file import load_robot
from tests import Array
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns, write_columns
from tests.unit.inspect.planting import Columns

FOLDER = SAMPLES / "six_joint"


def inspected(
    columns: Columns, folder: Path, changes: dict[str, str]
) -> list[tuple[str, str]]:
    """Return codes and joints of a six-joint log with a changed robot file."""
    kept = {name: values for name, values in columns.items() if "imu" not in name}
    write_columns(folder / "log.parquet", kept)
    text = (FOLDER / "robot.toml").read_text()
    imus, end = text.index("[[imu]]"), text.index("[channels]")
    text = text[:imus] + text[end:]
    urdf = (FOLDER / "six_joint.urdf").read_text()
    for old, new in changes.items():
        assert old in text + urdf
        text, urdf = text.replace(old, new), urdf.replace(old, new)
    (folder / "six_joint.urdf").write_text(urdf)
    (folder / "robot.toml").write_text(text)
    report = inspect_log(folder / "log.parquet", load_robot(folder / "robot.toml"))
    return [(finding.code, finding.joint) for finding in report.findings]


BARE = {"<inertial>": "<!-- ", "</inertial>": " -->"}


@pytest.mark.slow
@pytest.mark.parametrize("bare", [False, True])
def test_gravity_turned_round_is_found_with_and_without_inertials(
    bare: bool, tmp_path: Path
) -> None:
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    changes = BARE if bare else {}
    assert inspected(columns, tmp_path, changes) == []
    turned = changes | {"[0.0, 0.0, -9.81]": "[0.0, 0.0, 9.81]"}
    assert inspected(columns, tmp_path, turned) == [("gravity_direction", "")]


@pytest.mark.slow
@pytest.mark.parametrize(("shift", "expected"), [(0.25, True), (0.0, False)])
def test_a_zero_is_told_by_the_equations_of_all_joints_without_inertials(
    shift: float, expected: bool, tmp_path: Path
) -> None:
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    columns["shoulder_lift.position"] += shift
    wide = {"[-2.7, 0.3]": "[-4.0, 4.0]"} if shift else {}
    found = inspected(columns, tmp_path, BARE | wide)
    assert found == ([("position_zero", "shoulder_lift")] if expected else [])


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "code"), [(1.0, ""), (40.0, "effort_limits")])
def test_torques_beyond_all_limits_have_another_unit(
    factor: float, code: str, tmp_path: Path
) -> None:
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    for name in SIX:
        columns[f"{name}.current"] *= factor
    found = inspected(columns, tmp_path, BARE)
    assert {each for each, _ in found} == ({code} if code else set())


@pytest.mark.slow
def test_whoever_has_no_inertials_is_asked_for_the_unit_of_the_current(
    tmp_path: Path,
) -> None:
    columns = read_columns(FOLDER / "validation" / "fourier_1.parquet")
    inspected(columns, tmp_path, BARE)
    robot = load_robot(tmp_path / "robot.toml")
    bare = inspect_logs([tmp_path / "log.parquet"], robot)
    assert "no log tells its unit" in " ".join(bare.advice)

    inspected(columns, tmp_path, {})
    robot = load_robot(tmp_path / "robot.toml")
    weighed = inspect_logs([tmp_path / "log.parquet"], robot)
    assert "its unit" not in " ".join(weighed.advice)


def noise(kind: str, count: int) -> Array:
    """Noise (N,) of a velocity, rad/s."""
    white = np.random.default_rng(5).standard_normal(count)
    if kind == "low-passed":
        return np.convolve(0.05 * white, np.full(9, 1 / 9), "same")
    return 0.05 * np.sin(0.7 * np.arange(count)) if kind == "hum" else 0.02 * white


@pytest.mark.parametrize("kind", ["white", "low-passed", "hum", "motion"])
def test_noise_in_the_velocity_of_a_held_joint_is_no_fault(
    kind: str, tmp_path: Path
) -> None:
    columns = read_columns(FOLDER / "friction" / "elbow.parquet")
    count = len(columns["t"]) // 3
    columns = {name: values[:count] for name, values in columns.items()}
    for name in SIX:
        slope = np.gradient(columns[f"{name}.position"], columns["t"])
        columns[f"{name}.velocity"] = slope + noise(kind, count)
    expected = []
    if kind == "motion":  # which the position of a held joint does not show
        columns["wrist_1.velocity"] += 0.2 * np.sin(
            0.8 * (columns["t"] - columns["t"][0])
        )
        expected = [("position_stuck", "wrist_1")]
    assert inspected(columns, tmp_path, {}) == expected
