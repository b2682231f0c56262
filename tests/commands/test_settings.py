"""`--show-settings` and `--set` as a user meets them."""

import json

import pytest

from tests.commands.conftest import ONE_JOINT, Rig
from tests.unit.docs import settings as page


def test_settings_are_shown_without_logs(rig: Rig) -> None:
    done = rig.run("friction", "--show-settings")
    assert done.code == 0, done.err
    assert done.err == ""
    assert "judging.max_gravity_factor" in done.out
    assert "by which gravity may differ from that of the URDF's inertials" in done.out


def test_settings_that_would_be_in_force_are_shown(rig: Rig) -> None:
    given = ("--set", "judging.max_gravity_factor=3")
    for line in (("--show-settings", *given), (*given, "--show-settings")):
        done = rig.run("inertia", *line, "--json")
        shown = {one["name"]: one for one in json.loads(done.out)["settings"]}
        assert shown["judging.max_gravity_factor"]["value"] == 3.0
        assert shown["judging.max_gravity_factor"]["default"] == 2.5
        assert shown["judging.max_gravity_factor"]["unit"] == "times"


def test_a_wrong_setting_stops_before_anything_is_read(rig: Rig) -> None:
    line = ("friction", "a.parquet", "--set", "judging.max_factor=3", "-o", "out.json")
    done = rig.run(*line)
    assert done.code == 2
    assert "there is no setting 'judging.max_factor'" in done.err
    assert "Did you mean judging.max_gravity_factor" in done.err
    assert not (rig.folder / "out.json").exists()


def test_settings_decide_and_stand_in_the_result(rig: Rig) -> None:
    logs = (str(ONE_JOINT / "friction"), "-r", str(ONE_JOINT / "robot.toml"))
    orders = ("--position-order", "2", "--velocity-order", "3")
    given = ("--set", "surface.max_error=0.001", "--set", "surface.sign_narrowness=50")
    found = []
    for settings in ((), given):
        done = rig.run("friction", *logs, *orders, *settings, "--json", "--quiet")
        assert done.code == 0, done.err
        found.append(json.loads(done.out)["stages"]["friction"])
    usual, changed = found
    assert usual["settings"]["changed"] == {}
    assert usual["settings"]["values"]["surface.max_error"] == 0.15
    assert changed["settings"]["changed"] == {
        "surface.max_error": 0.001,
        "surface.sign_narrowness": 50.0,
    }
    joints = [stage["joints"]["joint_1"] for stage in found]
    assert joints[1]["sign_width"] == pytest.approx(joints[0]["sign_width"] / 2.0)
    assert not changed["verdicts"][0]["good"]


def test_the_page_of_the_settings_is_as_the_classes_are() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.rewritten(text) == text, "run python -m tests.unit.docs.settings"
    assert text.count("| `") > 40
