"""What the screen shows: tables, verdicts, progress;
names that steer are not obeyed.
"""

import io
import json
import re
import shutil
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.commands import export as export_command
from seqid_cli.commands.screen.drawing import table_text, with_colored_label
from seqid_cli.commands.screen.layout import visible_cell
from seqid_cli.commands.screen.progress import ProgressLine
from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show import show_stages, verdict_text
from seqid_cli.commands.screen.show_diagnosis import parameters_text
from seqid_cli.params.results.export import ExportedLink, ReplayedJoint
from seqid_cli.params.schema import EffectOfJoint, Parameter, Verdict
from seqid_cli.visible import visible
from tests.commands.conftest import ONE_JOINT, SAMPLE_LOGS, Rig
from tests.unit.logs.writers import write_raw
from tests.unit.params.documents import inertia_file, robot

EVIL = "a\x1b]0;owned\x07\x9b2J\u202etxt\x00b"
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@given(st.text())
def test_nothing_that_steers_is_left(text: str) -> None:
    assert visible("a\x1b[2Jb\tc\n") == "a\\u001b[2Jb\tc\n"
    assert visible_cell("Gelenk ö\tb\nc") == "Gelenk ö\\tb\\nc"
    shown = visible(text)
    assert not STEERING.search(shown)
    shown.encode("utf-8")


@pytest.mark.parametrize("color", [False, True])
def test_every_way_to_the_screen(
    color: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    screen = Screen(command="inspect", verbose=True, color=color)
    screen.table(("log", "x"), [(EVIL, "1")])
    for say in (screen.result, screen.warn, screen.remark, screen.detail):
        say(EVIL)
    shown = capsys.readouterr()
    assert "]0;owned" in shown.out
    assert not re.search("\x1b\\]|[\x00\x07\x9b\u202e]", shown.out + shown.err)
    Screen(command="inspect", json=True).document({"name": EVIL})
    text = capsys.readouterr().out
    assert not STEERING.search(text)
    assert json.loads(text) == {"name": EVIL}


def test_names_of_files_and_topics_do_not_reach_the_terminal(rig: Rig) -> None:
    log = str(rig.folder / f"{EVIL.replace(chr(0), '')}.parquet")
    shutil.copy(next((ONE_JOINT / "friction").iterdir()), log)
    topics = {f"/{EVIL}": ("cdr", EVIL, "ros2msg", b"float64 x")}
    bag = str(write_raw(rig.folder / "log.mcap", topics, [(f"/{EVIL}", 0, b"")]))
    (rig.folder / "robot.toml").rename(rig.folder / "other.toml")  # not this log's
    refused = (["friction", f"{log}x", "-r", "other.toml"], ["inspect", bag])
    for arguments in (["inspect", log], *refused):
        for more in ([], ["--json"]):
            done = rig.run(*arguments, *more)
            assert done.code == (2 if arguments in refused else 0)
            assert "owned" in done.out + done.err
            assert not STEERING.search(done.out + done.err)
    done = rig.run("inspect", "x" * 100_000)
    assert done.code == 2
    assert "error" in done.err
    assert len(done.err) < 10_000


def test_joints_that_slide_have_units_of_their_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Every row says its unit where joints of both kinds mix; else the heads say it."""
    screen, stages, arm = Screen(command="inertia"), inertia_file().stages, robot()
    arm.prismatic = ["elbow"]
    show_stages(screen, stages, arm)
    mixed = capsys.readouterr().out
    assert "N m" in mixed
    assert not re.search(r"error +N", mixed)
    assert re.findall(r"^(shoulder|elbow) +(N m|N) ", mixed, re.MULTILINE) == (
        [("shoulder", "N m"), ("elbow", "N")] * 3  # friction, gravity, inertia
    )
    arm.prismatic = list(arm.joints)
    show_stages(screen, stages, arm)
    assert "RMS error N " in capsys.readouterr().out


def test_what_an_export_loses_has_the_units_of_its_joints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arm = robot()
    arm.prismatic = list(arm.joints)
    link = ExportedLink(
        mass=1.0,
        center_of_mass=[0.0, 0.0, 0.0],
        inertia=[],
        rotor_inertia=0.0,
        armature=0.0,
        prior="",
        friction=None,
    )
    replayed = ReplayedJoint(samples=9, file_rmse=0.1, export_rmse=0.2, loss=0.3)
    file = SimpleNamespace(
        robot=arm,
        joints=dict.fromkeys(arm.joints, link),
        loss=dict.fromkeys(arm.joints, 0.1),
        replay=SimpleNamespace(
            logs=["a"],
            joints=dict.fromkeys(arm.joints, replayed),
            failures=[],
            passed=True,
        ),
    )
    screen = Screen(command="export")
    export_command._show_links(screen, file)
    export_command._show_replay(screen, file)
    out = capsys.readouterr().out
    assert "N m" not in out
    assert "loss N\n" in re.sub(" +", " ", out)


def test_a_verdict_names_every_reason() -> None:
    poor = [Verdict(joint="b", good=False, reason=reason) for reason in "xy"]
    texts = [
        verdict_text([Verdict(joint="a", good=True), *poor], name) for name in "abc"
    ]
    assert texts == ["good", "poor: x; y", "-"]


class Terminal(io.StringIO):
    """A text that takes itself for a terminal."""

    def isatty(self) -> bool:
        return True


ERASED = "\x1b[2K"  # the last that a line of progress writes


def test_progress_shows_after_a_while_and_vanishes() -> None:
    stream, now = Terminal(), [0.0]
    line = ProgressLine(stream, enabled=True, clock=lambda: now[0])
    line.show(1, 4, "a.mcap")
    with line.hidden():
        assert stream.getvalue() == ""
    now[0] = 1.0
    line.show(2, 4, "[b].mcap")
    assert "2/4 [b].mcap 0:00:00 -:--:-- left" in stream.getvalue()
    with line.hidden():
        assert stream.getvalue().endswith(ERASED)
    now[0] = 4.0
    line.show(3, 4, EVIL)
    line.close()
    shown = stream.getvalue()
    assert "3/4 a\\u001..." in shown  # a name is written out before it is shortened
    assert "0:00:03 0:00:03 left" in shown
    # no colour
    assert not re.search("\x1b\\]|[\x00\x07\x9b\u202e]|\x1b\\[[0-9;]*m", shown)
    assert shown.endswith(ERASED)
    line.show(4, 4, "c.mcap")
    assert stream.getvalue() == shown


@pytest.mark.parametrize("name", ["NO_COLOR", "TERM"])
def test_progress_writes_nothing_where_controls_are_unwanted(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, "dumb")
    forbidden, pipe = Terminal(), io.StringIO()
    for stream in (forbidden, pipe):
        now = [0.0]
        line = ProgressLine(stream, enabled=True, clock=lambda now=now: now[0])
        now[0] = 1.0
        line.show(1, 2, "a.mcap")
        line.close()
    assert forbidden.getvalue() == pipe.getvalue() == ""


def test_a_terminal_gets_colours_unless_they_are_unwanted(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ["report", "no.json", "-o", "page.html"]
    plain = rig.run(*asked)
    assert plain.err.startswith("seqid report: error: ")

    def shown(*more: str) -> str:
        stream = Terminal()
        with monkeypatch.context() as patch:
            patch.setattr("sys.stderr", stream)
            assert rig.run(*asked, *more).code == 2
        return stream.getvalue()

    assert "seqid report: \x1b[1;31merror\x1b[0m: " in shown()
    assert re.sub("\x1b\\[[0-9;]*m", "", shown()) == plain.err
    assert shown("--no-color") == plain.err
    monkeypatch.setenv("NO_COLOR", "1")
    assert shown() == plain.err


PATH = "recordings/monday/joint_1_forward_and_backward.parquet"


def test_a_table_takes_names_as_they_are_and_breaks_no_path() -> None:
    """Brackets are no markup; without a terminal every word can be searched for and
    copied.
    """
    heads = ("log", "verdict", "RMS error N m", "reason")
    reason = (
        "the [bold]torque[/bold] of joint [1] does not depend on its speed :warning:"
    )
    rows = [(PATH, "good", "0.25", "-"), ("[red]b[/red]", "poor", "12.5", reason)]
    assert table_text(heads, rows).splitlines() == [
        f"{'log':54}  verdict  RMS error N m  reason",
        f"{PATH}  good              0.25  -",
        f"{'[red]b[/red]':54}  poor              12.5  {reason}",
    ]
    for width in (40, 60, 80, 100):
        text = table_text(heads, rows, width=width)
        words = {word for row in rows for cell in row for word in cell.split()}
        assert words <= set(text.split())
        assert max(map(len, text.splitlines())) <= max(
            width, len(f"{PATH}  [bold]torque[/bold]")
        )
        narrow = table_text(heads, rows, width=width, whole_words=False)
        assert max(map(len, narrow.splitlines())) <= width


def test_a_coloured_message_is_one_line() -> None:
    message = f"seqid x: error: {PATH} [b]\t{PATH}" + " and more" * 20
    shown = with_colored_label(message, "error", start=len("seqid x: "))
    assert shown == message.expandtabs().replace("error", "\x1b[1;31merror\x1b[0m")


def test_a_coloured_table_is_the_plain_one_but_for_its_colours() -> None:
    heads, rows = ("joint", "verdict"), [("a", "good"), ("b", "usable: x")]
    text = table_text(heads, rows, color=True)
    assert "\x1b[32mgood" in text
    assert "\x1b[33musable: x" in text
    without = re.sub("\x1b\\[[0-9;]*m", "", text)
    assert [line.rstrip() for line in without.splitlines()] == (
        table_text(heads, rows).splitlines()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "inspect six_joint/validation -r six_joint/robot.toml",
        "compare two_joint/golden.json two_joint/golden.json",
        "export two_joint/golden.json -r two_joint/robot.toml -o arm.yaml",
        (
            "predict one_joint/validation -r one_joint/robot.toml -p"
            " one_joint/golden.json -o p.json"
        ),
    ],
)
def test_80_columns_hold_every_number(
    line: str, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [
        str(SAMPLE_LOGS / word) if "_joint/" in word else word for word in line.split()
    ]
    wide = rig.run(*words)
    for name, value in (("COLUMNS", "80"), ("NO_COLOR", "1")):
        monkeypatch.setenv(name, value)
    narrow = rig.run(*words)
    assert (wide.code, narrow.code) == (0, 0)
    assert (
        max(len(line) for line in narrow.out.splitlines() if " " in line.strip()) <= 80
    )
    numbers = {
        word
        for word in wide.out.split()
        if re.fullmatch(r"-?\d[\d.]*(e[-+]\d+)?", word)
    }
    assert len(numbers) > 3
    assert numbers <= set(narrow.out.split())


def test_parameters_are_shown_by_what_tells_a_person_something() -> None:
    """A smooth term by what it depends on;
    one that no sample shows without a number.
    """
    coefficients = [
        Parameter(name=f"c_{k}", value=0.1, std_error=0.0, unit="N m", joint="elbow")
        for k in range(12)
    ]
    settings = {"depends_on": "load direction", "knot_0": 2.0}
    own = {"parameters": coefficients, "settings": settings}
    text = parameters_text(EffectOfJoint(effect="unexplained", joint="elbow", **own))
    assert (
        text == "a smooth function of load, direction, 12 coefficients without errors"
    )
    parameters = [
        Parameter(name=name, value=0.5, std_error=error, unit="kg", joint="")
        for name, error in (("payload_m", 1e150), ("payload_mx", 0.1))
    ]
    own = {"parameters": parameters, "settings": {"from_log": 2.0}}
    text = parameters_text(EffectOfJoint(effect="payload", joint=None, **own))
    assert text == "payload_mx 0.5 +- 0.1 kg, from_log 2, not determined: payload_m"
