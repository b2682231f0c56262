"""`--show-settings` and `--set` as a user meets them."""

import json
from dataclasses import fields

import pytest

from seqid_cli.commands.run_logs import STAGES
from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS, words_for_step
from seqid_cli.settings import entries
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


@pytest.mark.parametrize("command", sorted(SETTINGS_OF_COMMANDS))
def test_every_command_with_settings_shows_them_and_takes_others(
    rig: Rig, command: str
) -> None:
    *_, last = entries(SETTINGS_OF_COMMANDS[command])
    given = f"{last.name}={last.high:g}"
    shown = rig.run(command, "--show-settings", "--set", given, "--json")
    assert shown.code == 0, shown.err
    values = {each["name"]: each["value"] for each in json.loads(shown.out)["settings"]}
    assert values == {
        entry.name: last.high if entry.name == last.name else entry.default
        for entry in entries(SETTINGS_OF_COMMANDS[command])
    }


@pytest.mark.parametrize("command", ["inspect", "plan"])
def test_settings_without_a_stage_stand_in_the_document(rig: Rig, command: str) -> None:
    words = {
        "inspect": ("inspect", str(ONE_JOINT / "gravity")),
        "plan": ("plan", "friction"),
    }
    given = {"inspect": "channels.max_speed=3", "plan": "margins.floor_clearance=0.05"}
    robot = ("-r", str(ONE_JOINT / "robot.toml"))
    done = rig.run(*words[command], *robot, "--set", given[command], "--json", "-q")
    assert done.code == 0, done.err
    name, value = given[command].split("=")
    document = json.loads(done.out)
    assert document["settings"]["changed"] == {name: float(value)}


@pytest.mark.slow
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


def test_a_run_has_the_settings_of_its_steps() -> None:
    """Of each group one, so that a name means the same in all of them."""
    steps = (*STAGES, "predict", "diagnose", "refine")
    of_steps = {
        group.name: getattr(SETTINGS_OF_COMMANDS[step], group.name)
        for step in steps
        for group in fields(SETTINGS_OF_COMMANDS[step])
    }
    of_run = SETTINGS_OF_COMMANDS["run"]
    assert {group.name: getattr(of_run, group.name) for group in fields(of_run)} == (
        of_steps
    )
    for step in steps:
        for group in fields(SETTINGS_OF_COMMANDS[step]):
            assert (
                getattr(SETTINGS_OF_COMMANDS[step], group.name)
                == (of_steps[group.name])
            )


@pytest.mark.slow
def test_a_run_passes_settings_on_to_the_steps_that_have_them(rig: Rig) -> None:
    given = ["judging.clear_sigma=3", "surface.max_error=0.001"]
    both = ["--set", given[0], "--set", given[1]]
    assert words_for_step("friction", given) == both
    assert words_for_step("gravity", given) == both[:2]
    assert words_for_step("report", given) == []
    words = [word for text in given for word in ("--set", text)]
    robot = ("-r", str(ONE_JOINT / "robot.toml"))
    done = rig.run("run", str(ONE_JOINT), *robot, "-o", "out", *words)
    assert done.code == 1, done.err
    assert "stopped at friction: its verdict is poor" in done.err
    made = json.loads((rig.folder / "out" / "friction.json").read_text())
    assert made["stages"]["friction"]["settings"]["changed"] == {
        "judging.clear_sigma": 3.0,
        "surface.max_error": 0.001,
    }
    shown = rig.run("run", "--show-settings", *words)
    assert shown.code == 0, shown.err
    assert "0.001 (default 0.15)" in shown.out
    wrong = rig.run("run", str(ONE_JOINT), *robot, "-o", "no", "--set", "max_error=1")
    assert wrong.code == 2
    assert "Did you mean" in wrong.err
    assert not (rig.folder / "no").exists()


def test_the_page_of_the_settings_is_as_the_classes_are() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.rewritten(text) == text, "run python -m tests.unit.docs.settings"
    assert text.count("| `") > 40


def test_what_a_study_measured_stands_behind_what_was_written_by_hand() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    place = ("inertia", "cutoff.hopeless")
    first = page.rewritten(text, {place: "nothing at 1 and 3"})
    again = page.rewritten(first, {place: "another one at 3"})
    (row,) = [line for line in again.splitlines() if "`cutoff.hopeless`" in line]
    assert row.endswith(f"chooses the same. {page.SAMPLES}another one at 3 |")
    assert page.rewritten(again) == again
    others = [line for line in again.splitlines() if "`cutoff.hopeless`" not in line]
    assert others == [
        line for line in text.splitlines() if "`cutoff.hopeless`" not in line
    ]
