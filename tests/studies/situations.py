"""Situations from public bug reports: what seqid says of each, beside what is right.

The logs are not part of this project: folders of scripts that write small logs of a
three-joint arm and run the commands that their owners would. The scripts are run in a
copy, further commands follow where the way out is asked for, and what was said is
compared with what is expected here.
"""

import os
import re
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import msgspec

from tests import ROOT
from tests.studies.tables import table

CASES = ROOT / ".." / "shared" / "cases"
# Standard errors of both fits, within which a parameter is that of the clean log.
NEAR = 3.0


@dataclass(frozen=True)
class Outcome:
    """What a situation came to: the folder, and all that was said in it."""

    folder: Path
    said: str

    def after(self, command: str) -> str:
        """Return what was said after a command line that begins so, each time."""
        parts = re.split(r"(?m)^\$ seqid ", self.said)[1:]
        return "\n".join(part for part in parts if part.startswith(command))

    def distance(self, result: str) -> float:
        """Return the largest difference from the clean fit, in standard errors."""
        clean = _parameters(self.folder.parent / "base" / "sim.json")
        found = _parameters(self.folder / result)
        if not clean.keys() <= found.keys():
            return float("inf")
        return max(
            abs(found[name][0] - value)
            / max((found[name][1] ** 2 + std_error**2) ** 0.5, 1e-9)
            for name, (value, std_error) in clean.items()
        )

    def level(self, result: str) -> str:
        """Return the worst verdict of the last stage of a result, "none" without it."""
        path = self.folder / result
        if not path.is_file():
            return "none"
        stage = msgspec.json.decode(path.read_bytes())["stages"]["inertia"]
        levels = [verdict["level"] for verdict in stage["verdicts"]]
        return min(levels, key=("poor", "usable", "good").index, default="none")


def _parameters(path: Path) -> dict[str, tuple[float, float]]:
    """Return value and standard error of each rigid-body parameter of a file."""
    if not path.is_file():
        return {}
    stages = msgspec.json.decode(path.read_bytes())["stages"]
    return {
        parameter["name"]: (parameter["value"], parameter["std_error"])
        for stage in ("gravity", "inertia")
        for parameter in (stages.get(stage) or {}).get("parameters", ())
    }


class Check(Protocol):
    """One thing that is expected of a situation."""

    def misses(self, outcome: Outcome) -> str:
        """Return what is not as expected, "" where all is."""
        ...

    def measured(self, outcome: Outcome) -> str:
        """Return the figure to show, "" where there is none."""
        ...


@dataclass(frozen=True)
class Says:
    """A text is said after a command, or is not."""

    command: str
    pattern: str
    expected: bool = True

    def misses(self, outcome: Outcome) -> str:
        """Return the text that was expected and is not said, or the other way round."""
        is_said = re.search(self.pattern, outcome.after(self.command)) is not None
        if is_said == self.expected:
            return ""
        verb = "does not say" if self.expected else "says"
        return f"{self.command}: {verb} {self.pattern!r}"

    def measured(self, outcome: Outcome) -> str:
        """Return the code of a finding that was looked for."""
        code = re.fullmatch(r"\\\[(\w+)\\\].*", self.pattern)
        return f"`[{code[1]}]`" if code and self.expected else ""


@dataclass(frozen=True)
class Near:
    """A result has the parameters of the clean log, within their errors."""

    result: str

    def misses(self, outcome: Outcome) -> str:
        """Return by how many errors a parameter is off."""
        distance = outcome.distance(self.result)
        return "" if distance < NEAR else f"{self.result}: z {distance:.1f}"

    def measured(self, outcome: Outcome) -> str:
        """Return the largest difference in standard errors."""
        return f"z {outcome.distance(self.result):.1f}"


@dataclass(frozen=True)
class Level:
    """The verdict of a result, that of its worst joint or of the whole arm."""

    result: str
    expected: str

    def misses(self, outcome: Outcome) -> str:
        """Return the verdict where it is another one."""
        level = outcome.level(self.result)
        return "" if level in self.expected.split() else f"{self.result}: {level}"

    def measured(self, outcome: Outcome) -> str:
        """Return the verdict."""
        return outcome.level(self.result)


@dataclass(frozen=True)
class Situation:
    """A folder of scripts, further commands, and what is to come of all.

    `edits` are changes of a file that a user makes before the further `commands`.
    """

    folder: str
    name: str
    checks: Sequence[Check]
    scripts: tuple[str, ...] = ("gen.py",)
    edits: tuple[tuple[str, str, str], ...] = ()
    commands: tuple[str, ...] = field(default=())


MADE = "simultaneous {log} -r made.toml -o made.json"
SITUATIONS = (
    Situation(
        "01_rostopic_echo_p",
        "`rostopic echo -p`",
        [Near("sim.json"), Near("made.json")],
        commands=(MADE.format(log="log.csv"),),
    ),
    Situation(
        "06_lerobot_state_pos_vel_torque",
        "LeRobot states of `.pos .vel .torque`",
        [
            Near("sim.json"),
            Says("inspect", r"\.(vel|torque) ", expected=False),
            Says("inspect", r"\[position_in_degrees\]"),
        ],
    ),
    Situation(
        "07_lerobot_percent",
        "LeRobot positions in percent",
        [
            Says("init", "in degrees or in percent of the range"),
            Says("inspect", r"\[position_scale\]"),
            Level("sim.json", "poor"),
            Near("told.json"),
        ],
        edits=(("told.toml", "[-3.1, 3.1]", "[-1.92, 1.92]"),),
        commands=(
            "init set --urdf nolimits.urdf --unit percent -o told.toml",
            "simultaneous set -r told.toml -o told.json",
        ),
    ),
    Situation(
        "08_time_ms_without_unit",
        "time in ms, without its unit",
        [
            Says("inspect", r"\[time_unit\]"),
            Says("simultaneous log.csv -r robot.toml", "looks like ms"),
            Near("made.json"),
        ],
        commands=(MADE.format(log="log.csv"),),
    ),
    Situation(
        "10_two_publishers_zeros",
        "two publishers, one of zeros",
        [Says("inspect", r"\[second_publisher\]"), Near("sim.json")],
    ),
    Situation(
        "11_published_twice_with_prefix",
        "joints published with a prefix",
        [Near("sim.json"), Near("sim2.json")],
    ),
    Situation(
        "12_effort_nan",
        "effort of NaN, of too few joints, of none",
        [
            Says("inspect all_nan", r"\[torque_missing\]"),
            Says("simultaneous one_nan", "neither torque nor current of joint"),
            Says("simultaneous short", "effort has 2 values for 3 names"),
            Says("inspect short", "damaged", expected=False),
        ],
    ),
    Situation(
        "14_namespaced_topics",
        "two robots on namespaced topics",
        # The right arm carries 3 kg that the URDF does not have.
        [
            Near("one.json"),
            Near("left.json"),
            Level("right.json", "poor"),
            Says("simultaneous two", "elbow_joint .*gravity is not that of the URDF"),
        ],
        edits=(("left.toml", "/right", "/left"), ("right.toml", "/left", "/right")),
        commands=(
            "simultaneous one.mcap -r made.toml -o one.json",
            "init two.mcap --urdf arm.urdf -o left.toml",
            "init two.mcap --urdf arm.urdf -o right.toml",
            "simultaneous two.mcap -r left.toml -o left.json",
            "simultaneous two.mcap -r right.toml -o right.json",
        ),
    ),
    Situation(
        "16_ros2_echo_csv",
        "`ros2 topic echo --csv`",
        [Near("sim.json")],
    ),
    Situation(
        "19_clock_of_16ms",
        "a clock of 15.6 ms for 250 Hz",
        [Says("inspect", r"\[stamps_coarse\]"), Near("sim.json")],
    ),
    Situation(
        "21_unsigned_current",
        "current without its sign",
        [
            Says("inspect abs", r"\[effort_unsigned\]"),
            Says("inspect wrap", r"\[effort_sign_bit\].*2\^16"),
            Says("inspect signmag", r"\[effort_sign_bit\].*2\^15"),
            Says("inspect", "Flip the sign", expected=False),
            Level("abs.json", "poor"),
            Level("wrap.json", "poor"),
            Level("signmag.json", "poor"),
        ],
    ),
    Situation(
        "34_urdf_numbers",
        "numbers of a URDF that are none",
        [
            Near("zero.json"),
            Near("swap.json"),
            Near("cont00.json"),
            Near("huge.json"),
            Says("init log.parquet --urdf comma", "is not 3 finite numbers"),
        ],
    ),
    Situation(
        "51_gear_inverse_and_units",
        "gear inverse, percent, shares, another winding",
        [
            Says("inspect amp.parquet -r inv", r"\[gear_inverse\]"),
            Says("inspect percent.parquet -r ok", r"\[torque_scale\]"),
            Says("inspect percent.parquet -r ok", "neither A nor N m"),
            Level("percentok.json", "poor"),
            Says("inspect percent.parquet -r bare", r"\[effort_limits\]"),
            Level("percentbare.json", "usable"),
            Says("inspect perunit.parquet -r ok", r"\[torque_scale\]"),
            Says("inspect perunit.parquet -r bare", "no log tells its unit"),
            Says("inspect peak.parquet", r"\[scale_or_mass\]"),
            Says("inspect percent_followed", r"\[scale_or_mass\]"),
            Level("followed.json", "usable poor"),
        ],
        scripts=("gen.py", "way.py"),
    ),
    Situation(
        "52_tool_in_some_logs",
        "a tool in one of three logs",
        [
            Level("robot_sim.json", "usable poor"),
            Says("simultaneous", "log2.parquet differs from the others"),
        ],
    ),
    Situation(
        "58_short_and_single",
        "logs of 1.5 s, joints that stand",
        [
            Says("simultaneous s15", "too short, or move too little"),
            Says("simultaneous s15", "on this robot", expected=False),
            Says("simultaneous elbow", "shoulder_lift_joint: poor: does not move"),
            Says("simultaneous", "Check unit and sign", expected=False),
        ],
        # The script stops at an error that is null, of what 1.5 s do not determine.
        commands=("simultaneous elbow.parquet -r robot.toml -o elbow.json",),
    ),
    Situation(
        "66_joint_left_out",
        "a joint of the chain left out",
        [
            Says("inspect moves", r"\[joint_left_out\]"),
            Says("simultaneous moves", "-> rc 2"),
            Says("inspect stands", r"\[joint_stands\]"),
        ],
    ),
    Situation(
        "69_gravity_sign_and_twice",
        "gravity of the other sign; a log twice",
        [
            Says("inspect log.parquet -r up.toml", r"\[gravity_direction\]"),
            Says("inspect log.parquet -r upbare.toml", r"\[gravity_direction\]"),
            Level("upbare.json", "poor"),
            Near("two.json"),
        ],
    ),
    Situation(
        "75_zero_offset",
        "a zero 0.1 or 0.3 rad off",
        [
            Says("inspect o01.parquet -r robot", r"\[position_zero\]"),
            Says("inspect o03.parquet -r robot", r"\[position_zero\]"),
            Says("inspect o01.parquet -r bare", r"\[position_zero\]"),
            Says("inspect o03.parquet -r bare", r"\[position_zero\]"),
            *(
                Level(f"{log}{arm}.json", "poor")
                for log in ("o01", "o03")
                for arm in ("robot", "bare")
            ),
            Says("diagnose o03.parquet", "lacks joint_zero at shoulder_lift_joint"),
            Says("diagnose", r"payload .*mass -", expected=False),
        ],
    ),
    Situation(
        "80_imu",
        "IMUs in bursts, alternating, without gravity, slow",
        [
            Says("inspect burst", r"\[stamps_coarse\]"),
            Says("imu-calib burst", "-> rc 0"),
            Says("inspect alternate", r"\[imu_alternates\]"),
            Says("imu-calib alternate", "-> rc 0"),
            Says("inspect nogravity", r"\[imu_without_gravity\]"),
            Says("imu-calib nogravity", "gravity is taken out of it"),
            Says("imu-calib imu10hz", "is too slow"),
        ],
        scripts=("gen.py", "way.py"),
    ),
)


def study(chosen: Namespace) -> str:
    """Return a table of all situations; a note where their scripts are not there."""
    if not CASES.is_dir():
        return "Left out: the scripts are not beside the project."
    root = chosen.cache / "situations"
    if not root.is_dir():
        shutil.copytree(CASES, root)
        for path in [root, *root.rglob("*")]:
            path.chmod(0o755)
    _script(root / "base" / "gen.py")
    rows = [_row(situation, root) for situation in SITUATIONS]
    met = sum(row[-1] == "yes" for row in rows)
    header = ["situation", "what shows", "as expected"]
    return f"{table(header, rows)}\n\nAs expected: {met} of {len(rows)}."


def _row(situation: Situation, root: Path) -> list[str]:
    """Run a situation, and return its row of the table."""
    folder = root / situation.folder
    said = "".join(_script(folder / script) for script in situation.scripts)
    for words in situation.commands:
        for name, old, new in situation.edits:
            path = folder / name
            if path.is_file():
                path.write_text(path.read_text().replace(old, new))
        said += _command(folder, words)

    outcome = Outcome(folder, said)
    missed = [text for check in situation.checks if (text := check.misses(outcome))]
    for text in missed:
        sys.stderr.write(f"{situation.folder}: {text}\n")
    shown = dict.fromkeys(check.measured(outcome) for check in situation.checks)
    figures = ", ".join(figure for figure in shown if figure) or "told in words"
    return [situation.name, figures, "no: " + "; ".join(missed) if missed else "yes"]


def _environment() -> dict[str, str]:
    """Return the variables of a process that runs this project's `seqid`."""
    return {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "NO_COLOR": "1",
        "COLUMNS": "200",
    }


def _script(path: Path) -> str:
    """Run a script of a situation, and return all that it said; once per cache."""
    record = path.with_suffix(".said")
    if record.is_file():
        return record.read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(path)],
        cwd=path.parent,
        env=_environment() | {"SEQID": str(_entry(path.parents[1]))},
        capture_output=True,
        text=True,
        check=False,
    )
    sys.stderr.write(f"{path.parent.name}/{path.name}: {done.returncode}\n")
    record.write_text(done.stdout + done.stderr, encoding="utf-8")
    return done.stdout + done.stderr


def _entry(folder: Path) -> Path:
    """Return a program that runs this project's `seqid`, whatever is installed."""
    path = folder / "seqid"
    if not path.is_file():
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m seqid_cli "$@"\n')
        path.chmod(0o755)
    return path


def _command(folder: Path, words: str) -> str:
    """Run a command in the folder of a situation, and return it with what it said."""
    done = subprocess.run(
        [sys.executable, "-m", "seqid_cli", *words.split()],
        cwd=folder,
        env=_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    return f"\n$ seqid {words} -> rc {done.returncode}\n{done.stdout}{done.stderr}\n"
