"""Sound logs get no finding; recorded ones only findings that are true."""

from pathlib import Path

import pytest

from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.logs.storage.files import expand
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.sample import sample_robot
from tests.unit.inspect.faults import SAMPLES

RIGS = {"one_joint": 1, "two_joint": 2, "six_joint": 6}  # joints of each
SERVES = {
    "friction": "friction",
    "gravity": "gravity",
    "imu": "imu-calib",
} | dict.fromkeys(("inertia", "validation", "changed"), "inertia")
FOLDERS = [
    (rig, stage) for rig in RIGS for stage in SERVES if (SAMPLES / rig / stage).is_dir()
]


def logs_of(*folders: Path) -> list[Path]:
    files = expand([str(folder) for folder in folders])
    return files[::4] if len(files) > 5 else files


@pytest.mark.parametrize(
    ("rig", "stage"),
    [
        pytest.param(*one, marks=[pytest.mark.slow] * (one[0] == "six_joint"))
        for one in FOLDERS
    ],
)
def test_sample_logs_are_good(rig: str, stage: str) -> None:
    report = inspect_logs(logs_of(SAMPLES / rig / stage), sample_robot(rig))
    assert report.findings == []
    assert all(SERVES[stage] in log.serves for log in report.logs)


@pytest.mark.parametrize("rig", RIGS)
def test_sample_logs_are_good_without_a_robot_file(rig: str) -> None:
    report = inspect_logs(logs_of(SAMPLES / rig / "validation", SAMPLES / rig / "imu"))
    assert report.findings == []
    assert {len(log.joints) for log in report.logs} == {RIGS[rig]}


UR5E = ("0_train", "0_holdout", "5_train", "5_holdout")
# What is really wrong with the recordings, looked at one by one.
TRUE = {
    # the position advances by up to 1 rad between two samples: samples were lost
    # without a gap
    "laas_cogging/acc_current": {"position_jump"},
    # one row per stop, at uneven times; the velocity is that of the standing motor
    **{f"ur5e_joints/joint_{part}": {"samples_lost"} for part in UR5E},
    "laas_cogging/stopped_data": {"jitter", "velocity_zero"},
    "dfki_simple_pendulum/gravity_compensation": {"torque_echo"},
    "dfki_simple_pendulum/pd_1nm_torque_limited_swingup_failure": {"torque_echo"},
    # the source says of these that the torque does not explain the motion
    "dfki_simple_pendulum/energy_shaping": {"model_mismatch"},
    "dfki_simple_pendulum/energy_shaping___1kg": {"model_mismatch"},
    "dfki_simple_pendulum/sac": {"model_mismatch"},
    # rows were dropped from it
    "ur10e_innopolis/identification__ur-20_02_19_15harm50secLoad": {"clock_gap"},
}


def name_of(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}"


def codes(*given: Path | Robot) -> set[str]:
    return {finding.code for finding in inspect_log(*given).findings}


# Logs of one robot are much alike: every fourth of the many of the UR10e, one of the
# TX40's two long ones, and all with something wrong.
CHOSEN = [
    path
    for k, path in enumerate(
        sorted((SAMPLES / "../../shared/data").glob("*/*.parquet"))
    )
    if name_of(path) != "staubli_tx40/train"
    and (path.parent.name != "ur10e_innopolis" or k % 4 == 0 or name_of(path) in TRUE)
]


@pytest.mark.slow
@pytest.mark.parametrize("path", CHOSEN, ids=[name_of(path) for path in CHOSEN])
def test_findings_on_recorded_logs_are_true(path: Path) -> None:
    robot_file = path.parent / "robot.toml"
    if not robot_file.exists():  # one for each joint that a log is named after
        robot_file = path.with_name(f"{path.stem.rpartition('_')[0]}_robot.toml")
    expected = TRUE.get(name_of(path), set())
    assert codes(path, load_robot(robot_file)) == expected
    if expected or path.parent.name != "ur10e_innopolis":  # without the model's part
        assert codes(path) == expected - {"model_mismatch"}
