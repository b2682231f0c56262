"""No number that no log can mean: of torques that say nothing, and of every command."""

import json
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.commands.app import COMMANDS
from tests.commands.conftest import Rig
from tests.senseless import senseless
from tests.studies.fuzz.command_lines import sound_lines
from tests.studies.fuzz.sound import sound_commands
from tests.unit.inspect.faults import SAMPLES, read_columns, write_columns

RIG = SAMPLES / "one_joint"
ROBOT = ("-r", str(RIG / "robot.toml"))
TRIAL = RIG / "friction" / "joint_1.parquet"
FOURIER = RIG / "validation" / "fourier_1.parquet"


def scaled_log(folder: Path, source: Path, factor: float) -> str:
    columns = read_columns(source)
    columns["joint_1.current"] *= factor
    write_columns(folder / "log.parquet", columns)
    return "log.parquet"


@pytest.mark.parametrize("factor", [0.0, 1e-300, 1e-320])
def test_friction_of_no_torque_is_told_by_its_channel(rig: Rig, factor: float) -> None:
    log = scaled_log(rig.folder, TRIAL, factor)
    done = rig.run("friction", log, *ROBOT, "-o", "f.json")
    assert done.code == 1
    assert "[torque_zero] joint_1 current" in done.err
    assert "seqid inspect says what it holds" in done.err


@pytest.mark.parametrize("factor", [0.0, 1e-300])
def test_no_torque_has_no_share(rig: Rig, factor: float) -> None:
    log = scaled_log(rig.folder, FOURIER, factor)
    assert rig.run("simultaneous", log, *ROBOT, "-o", "s.json").code == 0
    document = json.loads((rig.folder / "s.json").read_text())
    assert not list(senseless(document))
    verdicts = document["stages"]["inertia"]["verdicts"]
    assert {verdict["level"] for verdict in verdicts} == {"poor"}
    reasons = [verdict["reason"] for verdict in verdicts]
    assert "its torque is zero in all rows: nothing is known of it" in reasons


@pytest.mark.parametrize("kept", [100, 800])
def test_imu_calibration_names_an_imu_that_is_too_slow(rig: Rig, kept: int) -> None:
    """Of a reading in `kept` no motion can be made: 8 Hz, and two readings in all."""
    columns = read_columns(RIG / "imu" / "joint_1_posture_1.parquet")
    for name in columns:
        if name.startswith("imu"):
            values = columns[name]
            values[np.arange(len(values)) % kept > 0] = np.nan
    write_columns(rig.folder / "log.parquet", columns)
    done = rig.run("imu-calib", "log.parquet", *ROBOT, "-o", "i.json")
    assert done.code == 1, done.err
    assert "imu_a" in done.err


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["position", "current"])
def test_a_channel_that_is_mostly_missing_makes_no_good_model(
    rig: Rig, channel: str
) -> None:
    columns = read_columns(TRIAL)
    values = columns[f"joint_1.{channel}"]
    values[np.random.default_rng(0).random(len(values)) < 0.9] = np.nan
    write_columns(rig.folder / "log.parquet", columns)
    seen = rig.run("inspect", "log.parquet", *ROBOT)
    assert seen.code == 1
    assert "[values_lost]" in seen.out + seen.err
    done = rig.run("friction", "log.parquet", *ROBOT, "-o", "f.json", "--strict")
    assert done.code == 1
    assert "[values_lost] joint_1" in done.err


RESULTS = sound_lines()


def test_every_command_has_a_line_on_sound_files() -> None:
    assert {line[0] for line in RESULTS} == set(COMMANDS)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> list[list[str]]:
    work = tmp_path_factory.mktemp("sound")
    return [words for _, words in sound_commands(work)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", range(len(RESULTS)), ids=[" ".join(x[:2]) for x in RESULTS]
)
def test_no_command_says_a_number_without_sense(
    number: int, sound: list[list[str]], rig: Rig
) -> None:
    """Of every command in the table: what it prints as JSON, and every JSON file."""
    done = rig.run(*sound[number], "--json")
    assert done.code in (0, 1), done.err
    documents = {"--json": json.loads(done.out)}
    for path in rig.folder.rglob("*.json"):
        documents[path.name] = json.loads(path.read_text())
    for name, document in documents.items():
        assert not list(senseless(document, name)), name
