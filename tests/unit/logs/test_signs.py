"""Efforts without a sign, and signed ones that only seem to lack it."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.signs import sign_bit, with_signs
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml_schema import Channels
from tests import ROOT, Array
from tests.unit.inspect.faults import SIX, SIX_ROBOT, read_columns, write_columns
from tests.unit.inspect.planting import Columns
from tests.unit.logs import writers
from tests.unit.logs.format_writers import write_bag
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot

FOLDER = ROOT / "sample_logs" / "six_joint"
LOG = FOLDER / "validation" / "fourier_1.parquet"


def columns() -> Columns:
    return {name: x for name, x in read_columns(LOG).items() if "imu" not in name}


def stream(**channels: Array) -> Stream:
    logged = columns()
    position = np.column_stack([logged[f"{name}.position"] for name in SIX])
    stamps = np.rint(1e9 * logged["t"]).astype(np.int64)
    return Stream("joints", stamps, {"position": position, **channels})


def currents() -> Array:
    logged = columns()
    return np.column_stack([logged[f"{name}.current"] for name in SIX])


def written(folder: Path, logged: Columns) -> Path:
    write_columns(folder / "log.parquet", logged)
    text = (FOLDER / "robot.toml").read_text()
    end = text.index("[channels]")
    (folder / "robot.toml").write_text(text[: text.index("[[imu]]")] + text[end:])
    (folder / "six_joint.urdf").write_text((FOLDER / "six_joint.urdf").read_text())
    return folder / "log.parquet"


def test_magnitudes_are_named_and_no_other_cause_is(tmp_path: Path) -> None:
    logged = columns()
    for name in SIX:
        logged[f"{name}.current"] = np.abs(logged[f"{name}.current"])
    path = written(tmp_path, logged)
    report = inspect_log(path, load_robot(tmp_path / "robot.toml"))
    assert {finding.code for finding in report.findings} == {"effort_unsigned"}
    assert {finding.joint for finding in report.findings} == set(SIX)


def test_commands_give_the_sign_back(tmp_path: Path) -> None:
    """A servo drives towards its goal, by more the more torque it needs."""
    logged = columns()
    truth = currents()
    for name in SIX:
        current = logged[f"{name}.current"]
        logged[f"command.{name}"] = logged[f"{name}.position"] + 0.01 * current
        logged[f"{name}.current"] = np.abs(current)
    path = written(tmp_path, logged)
    robot = load_robot(tmp_path / "robot.toml")
    per_ampere = [joint.torque_per_ampere for joint in robot.joints]
    tau = read_recording(path, robot).tau
    np.testing.assert_allclose(tau, truth * per_ampere, atol=1e-9)
    codes = {finding.code for finding in inspect_log(path, robot).findings}
    assert codes == {"sign_by_command"}


def test_signs_by_commands_that_do_not_fit_are_no_reversed_channel(
    tmp_path: Path,
) -> None:
    """Of one joint all are wrong, and still it is the commands that are to blame."""
    logged = columns()
    for name in SIX:
        current = logged[f"{name}.current"]
        side = -1.0 if name == "wrist_3" else 1.0
        logged[f"command.{name}"] = logged[f"{name}.position"] + 0.01 * side * current
        logged[f"{name}.current"] = np.abs(current)
    path = written(tmp_path, logged)
    report = inspect_log(path, load_robot(tmp_path / "robot.toml"))
    assert {finding.code for finding in report.findings} == {"sign_by_command"}


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_commands_of_their_own_messages_give_the_sign_back(
    tmp_path: Path, kind: str
) -> None:
    motion = make_motion(grid(400))
    stamps = 1_700_000_000_000_000_000 + np.rint(motion.t * 1e9).astype(np.int64)
    noise = np.random.default_rng(1).standard_normal(motion.tau.shape)
    tau = motion.tau + 0.05 * motion.tau.std() * noise
    states = writers.joint_messages(stamps, JOINTS, motion.q, effort=np.abs(tau))
    # Each command is sent a millisecond before the state that it leads to.
    commands = writers.joint_messages(
        stamps - 1_000_000,
        JOINTS,
        motion.q + 0.01 * tau,
        topic="/joint_commands",
    )
    messages = sorted([*states, *commands], key=lambda each: each[1])
    if kind == "bag":
        path = write_bag(tmp_path / "bag", messages)
    else:
        path = writers.write_messages(tmp_path / "log.mcap", messages, encoding="cdr")

    robot = make_robot(channels=Channels(command_topic="/joint_commands"))
    recording = read_recording(path, robot)
    said = " ".join(recording.health.warnings)
    assert "its sign is taken from command minus position" in said
    np.testing.assert_allclose(recording.tau, tau, atol=1e-9)


def test_signed_efforts_and_one_sided_loads_keep_their_sign() -> None:
    current = currents()
    for values in (current, current + 1.2 * np.abs(current).max(axis=0)):
        notes: list[str] = []
        kept = with_signs(stream(current=values), SIX_ROBOT, notes)
        assert notes == []
        np.testing.assert_array_equal(kept.channels["current"], values)


@pytest.mark.parametrize(("bits", "size"), [(16, 65.536), (15, 32.768)])
def test_a_sign_bit_that_is_read_as_a_number_is_named(bits: int, size: float) -> None:
    counts = np.rint(1000.0 * currents()[:, 1])
    if bits == 16:
        raw = np.where(counts < 0, 2**16 + counts, counts)
    else:
        raw = np.where(counts < 0, 2**15 - counts, counts)
    words = sign_bit(raw / 1000.0)
    assert f"2^{bits}" in words
    assert float(words.split()[2]) == pytest.approx(size, rel=2e-3)
    assert sign_bit(counts / 1000.0) == ""
