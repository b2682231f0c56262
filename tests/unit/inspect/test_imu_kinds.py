"""IMUs as drivers send them: slow, in bursts, in turns with zeros, without gravity."""

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.errors import QualityError
from seqid_cli.identify.functions import imu_calib
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.kinematics import link_motion
from tests import Array
from tests.plants.robots.sample import sample_robot
from tests.unit.inspect.faults import SAMPLES, SIX, WAVES
from tests.unit.inspect.test_faults import sound_columns
from tests.unit.logs.writers import imu_messages, joint_messages, write_messages

# Of what is wrong with a log a stage warns.
pytestmark = pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")

T0 = 1_700_000_000_000_000_000
FOLDER = SAMPLES / "six_joint"


@cache
def arm() -> dict[str, Array]:
    """A log of six joints that wave, and of a triad with a gyro behind the last."""
    columns = sound_columns("six_joint", WAVES, False, True)
    return {
        "t": columns["t"],
        "q": np.column_stack([columns[f"{name}.position"] for name in SIX]),
        "effort": np.column_stack([columns[f"{name}.current"] for name in SIX]),
        "force": np.column_stack([columns[f"imu_b.a{axis}"] for axis in "xyz"]),
        "rate": np.column_stack([columns[f"imu_b.g{axis}"] for axis in "xyz"]),
    }


def gravity_in_the_imu() -> Array:
    """Gravity (N, 3) in the frame of the IMU, by its mounting as calibrated."""
    log = arm()
    robot = sample_robot("six_joint")
    still = np.zeros_like(log["q"].T)
    motion = link_motion(robot.chain, robot.gravity, log["q"].T, still, still)
    # The map from the link's to the IMU's frame that fits best holds the mounting.
    at_link = motion.a[-1].T
    mounting = np.linalg.lstsq(at_link, log["force"], rcond=None)[0]
    u, _, v = np.linalg.svd(mounting)
    return np.asarray(at_link @ (u @ v))


def written(folder: Path, kind: str) -> Path:
    """Write the log with an IMU of some kind, and its robot file; return the log."""
    log = arm()
    stamps = T0 + np.rint(1e9 * (log["t"] - log["t"][0])).astype(np.int64)
    count = len(stamps)
    imu_stamps = stamps
    force = log["force"].copy()
    rate = log["rate"].copy()
    rows = np.arange(count)
    if kind == "bursts":
        imu_stamps = T0 + (stamps - T0) // 50_000_000 * 50_000_000
    elif kind == "in turns":
        force[rows % 2 == 0] = 0.0
        rate[rows % 2 == 1] = 0.0
    elif kind == "without gravity":
        force -= gravity_in_the_imu()
    elif kind != "sound":
        rate_hz = float(kind.removesuffix(" Hz"))
        stride = round((count - 1) / (log["t"][-1] - log["t"][0]) / rate_hz)
        rows = rows[::stride]

    messages = joint_messages(stamps, SIX, log["q"], effort=log["effort"])
    messages += imu_messages(imu_stamps[rows], "/imu_b/data", force[rows], rate[rows])
    path = write_messages(
        folder / "log.mcap", sorted(messages, key=lambda x: x[1]), encoding="cdr"
    )
    shutil.copy(FOLDER / "six_joint.urdf", folder)
    text = (FOLDER / "robot.toml").read_text()
    imu = '[[imu]]\nname = "imu_b"\nafter_joint = "wrist_3"\ngyro = true\n\n'
    end = text.index("[channels]")
    (folder / "robot.toml").write_text(text[: text.index("[[imu]]")] + imu + text[end:])
    return path


def findings(path: Path) -> list[InspectionFinding]:
    inspected = inspect_log(path, load_robot(path.with_name("robot.toml")))
    return list(inspected.findings)


def calibrated(path: Path) -> Rotation:
    result = imu_calib([path], path.with_name("robot.toml"))
    assert result.stages.imu is not None
    return Rotation.from_matrix(result.stages.imu.imus["imu_b"].rotation)


@cache
def sound_mounting(folder: Path) -> Rotation:
    return calibrated(written(folder, "sound"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "code"),
    [("10 Hz", "imu_slow"), ("without gravity", "imu_without_gravity")],
)
def test_readings_that_are_of_no_use_are_named_and_not_calibrated(
    kind: str, code: str, tmp_path: Path
) -> None:
    path = written(tmp_path, kind)
    found = findings(path)
    assert [(finding.code, finding.joint) for finding in found] == [(code, "imu_b")]
    with pytest.raises(QualityError) as refused:
        imu_calib([path], tmp_path / "robot.toml")
    assert found[0].message in refused.value.message
    assert refused.value.hint == found[0].remedy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "codes"),
    [
        ("bursts", {"stamps_coarse", "imu_delay"}),
        ("in turns", {"imu_alternates"}),
        ("50 Hz", set()),
    ],
)
def test_readings_of_other_kinds_are_calibrated_as_sound_ones(
    kind: str, codes: set[str], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = written(tmp_path, kind)
    assert {finding.code for finding in findings(path)} == codes
    turn = calibrated(path) * sound_mounting(tmp_path_factory.mktemp("sound")).inv()
    assert np.degrees(turn.magnitude()) < 0.5
