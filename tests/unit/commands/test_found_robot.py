"""The robot file that is taken where -r is left out."""

from pathlib import Path

import pytest

from seqid_cli.commands.robot_file import found_robot, found_robot_if_any
from seqid_cli.commands.screen.render import Screen
from seqid_cli.errors import UsageError

SCREEN = Screen(command="friction")


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two arms' folders, with a log each in a folder of a stage,
    and a working folder.
    """
    for arm in ("left", "right"):
        (tmp_path / arm / "friction").mkdir(parents=True)
        (tmp_path / arm / "friction" / "a.parquet").touch()
        (tmp_path / arm / "robot.toml").touch()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path


@pytest.mark.parametrize(
    "log",
    ["left", "left/friction", "left/friction/a.parquet", "left/friction/*.parquet"],
)
def test_it_is_the_one_beside_the_logs(
    lab: Path, log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = found_robot(SCREEN, [f"../{log}", f"../{log}"])
    assert found.resolve() == lab / "left" / "robot.toml"
    assert (
        f"robot file: {found} (beside the logs; -r names another)"
        in capsys.readouterr().err
    )


def test_the_working_folder_comes_first(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("robot.toml").touch()
    assert found_robot(SCREEN, ["../left/friction"]) == Path("robot.toml")
    assert "robot file: robot.toml (-r names another)" in capsys.readouterr().err


def test_two_robots_are_not_guessed_between(lab: Path) -> None:
    with pytest.raises(UsageError, match=r"several robot files .*left.*right"):
        found_robot(SCREEN, ["../left/friction", "../right/friction"])


def test_without_one_it_is_an_error_or_none(lab: Path) -> None:
    (lab / "left" / "robot.toml").unlink()
    with pytest.raises(UsageError, match=r"no robot\.toml here or beside the logs"):
        found_robot(SCREEN, ["../left/friction", "s3://bucket/left"])
    assert found_robot_if_any(SCREEN, ["../left/friction"]) is None
