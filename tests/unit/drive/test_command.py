"""`seqid drive` and `seqid replay` from files, as a user types them."""

import json
from pathlib import Path

import pytest

from seqid_cli.commands.app import run
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.encode import encode
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from tests.plants.driven import DH, GEAR, multisine, simulate_drive
from tests.unit.drive.test_drive import arm
from tests.unit.logs.writers import write_parquet


def bench(folder: Path) -> list[str]:
    """Write a robot file, a model and two logs; returns the words for both files."""
    alpha, a, d, theta0 = DH[0]
    (folder / "robot.toml").write_text(
        'schema = "seqid/robot@1"\nname = "driven"\ngravity = [0.0, 0.0, -9.81]\n'
        f'[[joint]]\nname = "joint_1"\ngear_ratio = {GEAR}\n'
        f"dh = {{ alpha = {alpha}, a = {a}, d = {d}, theta0 = {theta0} }}\n"
    )
    robot = load_robot(folder / "robot.toml")
    model = ParameterFile(
        **head("seqid/params@1", "2026-01-01T00:00:00Z"),
        robot=robot_id(robot),
        inputs=[],
        stages=arm().stages(),
    )
    (folder / "inertia.json").write_text(encode(model))
    for number in (0, 1):
        log = simulate_drive(arm(), multisine(number, 1, 8.0), 8.0, seed=number)
        write_parquet(
            folder / f"log_{number}.parquet",
            log.t,
            robot.joint_names,
            log.q,
            torque=log.tau,
            command=log.command,
        )
    return ["-r", str(folder / "robot.toml")]


def test_from_logs_to_a_replayed_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = bench(tmp_path)
    drive = str(tmp_path / "drive.json")
    log, held_out = (str(tmp_path / f"log_{k}.parquet") for k in (0, 1))
    model = ["-p", str(tmp_path / "inertia.json")]
    assert run(["drive", log, *robot, *model, "-o", drive, "--strict"]) == 0
    shown = capsys.readouterr().out
    assert "command_delay" in shown
    assert "drive: good" in shown

    assert run(["replay", held_out, *robot, "-p", drive, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    joint = document["joints"]["joint_1"]
    assert document["schema"] == "seqid/replay@1"
    assert joint["position"]["rms"] < 0.2 * joint["delayed_command"]["rms"]

    # A file of another kind is refused by name.
    assert run(["replay", held_out, *robot, *model]) == 2
    assert "seqid drive" in capsys.readouterr().err
