"""Names that steer a terminal are shown, not obeyed."""

import json
import re
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.__main__ import main
from seqid_cli.commands.screen.layout import visible, visible_cell
from seqid_cli.commands.screen.render import Screen
from tests import ROOT
from tests.unit.logs.writers import write_raw

SAMPLES = ROOT / "sample_logs" / "one_joint"
EVIL = "a\x1b]0;owned\x07\x9b2J\u202etxt\x00b"
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


def test_they_are_escaped_as_json_does() -> None:
    assert visible("a\x1b[2Jb\tc\n") == "a\\u001b[2Jb\tc\n"
    assert visible_cell("a\tb\nc") == "a\\tb\\nc"
    assert visible("Gelenk ö, 关节") == "Gelenk ö, 关节"


@given(st.text())
def test_nothing_that_steers_is_left(text: str) -> None:
    shown = visible(text)
    assert not STEERING.search(shown)
    shown.encode("utf-8")


@pytest.mark.parametrize("color", [False, True])
def test_every_way_to_the_screen_shows_them(
    color: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    screen = Screen("inspect", verbose=True, color=color)
    screen.table(("log", "x"), [(EVIL, "1")])
    screen.result(EVIL)
    screen.warn(EVIL)
    screen.remark(EVIL)
    screen.detail(EVIL)
    shown = capsys.readouterr()
    assert "]0;owned" in shown.out
    assert not re.search("\x1b\\]|[\x00\x07\x9b\u202e]", shown.out + shown.err)


def test_json_stays_json(capsys: pytest.CaptureFixture[str]) -> None:
    Screen("inspect", json=True).document({"name": EVIL})
    text = capsys.readouterr().out
    assert not STEERING.search(text)
    assert json.loads(text) == {"name": EVIL}


def test_a_file_s_name_does_not_reach_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / f"{EVIL.replace(chr(0), '')}.parquet"
    shutil.copy(next((SAMPLES / "friction").iterdir()), log)
    for arguments in (["inspect", str(log)], ["inspect", str(log), "--json"]):
        assert main(arguments) == 0
        shown = capsys.readouterr()
        assert not STEERING.search(shown.out + shown.err)
    assert main(["friction", str(log) + "x", "-r", str(SAMPLES / "robot.toml")]) == 2
    assert not STEERING.search(capsys.readouterr().err)


def test_a_topic_s_name_does_not_reach_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = {f"/{EVIL}": ("cdr", EVIL, "ros2msg", b"float64 x")}
    log = write_raw(tmp_path / "log.mcap", topics, [(f"/{EVIL}", 0, b"")])
    for more in ([], ["--json"], ["-r", str(SAMPLES / "robot.toml")]):
        assert main(["inspect", str(log), *more]) == 2
        shown = capsys.readouterr()
        assert "owned" in shown.err
        assert not STEERING.search(shown.out + shown.err)


def test_a_long_name_does_not_fill_the_screen(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "x" * 100_000]) == 2
    said = capsys.readouterr().err
    assert len(said) < 10_000
    assert "error" in said
