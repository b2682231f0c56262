"""Every command as a function: same names, same results, nothing printed."""

from __future__ import annotations

import importlib
import inspect as signatures
import json
import warnings
from pathlib import Path

import pytest

from seqid_cli import api
from seqid_cli.commands.app import COMMANDS, run
from seqid_cli.errors import ConfigError, InputError

SAMPLES = Path(__file__).parents[1] / "sample_logs" / "one_joint"
ROBOT = SAMPLES / "robot.toml"
ON_SCREEN_ONLY = {"context", "strict", "form", "explain"}
WITHOUT = {"completion", "init", "run"}  # a shell's script, a template, and the others in a row


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - WITHOUT))
def test_functions_take_what_commands_take(name: str) -> None:
    command = importlib.import_module(f"seqid_cli.commands.{COMMANDS[name].module}")
    asked = set(signatures.signature(command.run).parameters) - ON_SCREEN_ONLY
    function = getattr(api, COMMANDS[name].module)
    assert set(signatures.signature(function).parameters) == asked
    assert function.__doc__


def test_the_result_is_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    by_hand, by_api = tmp_path / "command.json", tmp_path / "api.json"
    logs = SAMPLES / "friction"
    assert run(["friction", str(logs), "-r", str(ROBOT), "-o", str(by_hand)]) == 0
    capsys.readouterr()
    found = api.friction(logs, ROBOT, output=by_api)
    shown = capsys.readouterr()
    assert not shown.out
    assert not shown.err
    assert found.stages.friction is not None
    one, other = (json.loads(path.read_text()) for path in (by_hand, by_api))
    assert one.pop("created") <= other.pop("created")
    assert one == other


def test_files_pass_from_one_function_to_the_next(tmp_path: Path) -> None:
    friction, gravity = tmp_path / "friction.json", tmp_path / "gravity.json"
    api.friction(str(SAMPLES / "friction"), str(ROBOT), output=friction)
    found = api.gravity([SAMPLES / "gravity"], ROBOT, friction, output=gravity)
    assert found.stages.gravity is not None
    same = api.compare(gravity, gravity)
    assert same["changed"] == 0


def test_problems_are_exceptions(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        api.friction(tmp_path / "none.parquet", ROBOT)
    damaged = tmp_path / "damaged.json"
    damaged.write_text("{")
    with pytest.raises(ConfigError):
        api.gravity(SAMPLES / "gravity", ROBOT, damaged)


def test_warnings_are_pythons(tmp_path: Path) -> None:
    friction = tmp_path / "friction.json"
    api.friction(SAMPLES / "friction", ROBOT, output=friction)
    other = tmp_path / "robot.toml"
    other.write_text(ROBOT.read_text().replace("gear_ratio = ", "gear_ratio = 2"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        api.gravity(SAMPLES / "gravity", other, friction)
    assert any(issubclass(w.category, api.SeqidWarning) for w in caught)
