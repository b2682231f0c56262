"""`seqid refine`: which logs go where and when, documents, screen, exit codes."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from msgspec import structs

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement import rounds as deciding
from seqid_cli.discover.refinement.confirm import Confirmed
from seqid_cli.discover.refinement.held_out import WholeLogs
from seqid_cli.discover.refinement.log_sets import find_earlier
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import (
    SCHEMA,
    ClosedLoop,
    EffectOfJoint,
    EffectOfPlace,
    InputLog,
    Parameter,
    ParameterFile,
    StoppedAt,
)
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.commands.conftest import ONE_JOINT, Reader, Rig, content, sha256, stand_in
from tests.unit.params.documents import (
    closed_loop,
    friction_file,
    full_file,
    inertia_file,
    rival,
)
from tests.unit.params.generate import json_schema

BASE = [
    "refine",
    "a.parquet",
    "--holdout",
    "b.parquet",
    "-r",
    "robot.toml",
    "-p",
    "p.json",
]
LOOP = structs.replace(closed_loop(), evaluated_on=["b.parquet"], held_out=[])
EFFECT = structs.replace(
    full_file().stages.effects[0],
    parameters=[
        Parameter(name="stribeck_torque", value=1.5, std_error=0.05, unit="N m")
    ],
)


class Library:
    """Stands in for the refinement; keeps the logs that it was called with."""

    def __init__(self) -> None:
        self.loop: ClosedLoop = LOOP
        self.effects: list[EffectOfJoint] | None = [EFFECT]

    def refine(
        self,
        training: Sequence[Recording],
        robot: Robot,
        file: ParameterFile,
        **more: Any,
    ) -> SimpleNamespace:
        self.options: DiscoverOptions = more["options"]
        self.training = [str(log.path) for log in training]
        logs = more["earlier"]
        self.earlier = {
            stage: [str(log.path) for log in own] for stage, own in logs.items()
        }
        self.shared = sum(
            log is own for x in logs.values() for log in x for own in training
        )
        return SimpleNamespace(
            stages=structs.replace(file.stages, effects=self.effects)
        )

    def confirm(
        self,
        found: SimpleNamespace,
        held_out: Sequence[Recording],
        whole: WholeLogs | None,
        *,
        keep_unconfirmed: bool,
    ) -> Confirmed:
        assert whole is None
        self.held_out = [str(log.path) for log in held_out]
        self.keep_unconfirmed = keep_unconfirmed
        return Confirmed(stages=found.stages, loop=self.loop)


@pytest.fixture
def library(
    rig: Rig, reader: Reader, gathering: None, monkeypatch: pytest.MonkeyPatch
) -> Library:
    fake = Library()
    stand_in(monkeypatch, "discover.refinement.rounds", refine=fake.refine)
    stand_in(monkeypatch, "discover.refinement.confirm", confirm=fake.confirm)
    for number, name in enumerate("cd", start=2):
        (rig.folder / f"{name}.parquet").write_bytes(content(number))
    rig.params("p.json", inertia_file())
    return fake


def test_what_it_passes_on(rig: Rig, reader: Reader, library: Library) -> None:
    options = [
        "--rounds",
        "2",
        "--with-unexplained",
        "--motion",
        "encoder",
        "--cutoff",
        "9",
    ]
    holdout = ["--holdout", "c.*", "--time", "log"]
    assert rig.run(*BASE, "d.parquet", *holdout, *options).code == 0
    assert library.training == ["a.parquet", "d.parquet"]
    assert library.held_out == ["b.parquet", "c.parquet"]
    assert library.options == DiscoverOptions(
        InertiaOptions(motion=MotionOptions(9.0, origin="as given"), source="encoder"),
        max_effects=2,
        with_unexplained=True,
    )
    assert reader.reading.time_source == "log"
    assert not library.keep_unconfirmed


def test_what_it_passes_on_where_nothing_is_said(rig: Rig, library: Library) -> None:
    """No limit of rounds; what is not confirmed stays only where that is asked for."""
    assert rig.run(*BASE).code == 0
    assert library.options.max_effects is None
    assert not library.keep_unconfirmed
    assert rig.run(*BASE, "--keep-unconfirmed").code == 0
    assert library.keep_unconfirmed


def test_the_document(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json", "--json")
    assert (done.code, done.out) == (0, (rig.folder / "out.json").read_text())
    jsonschema.validate(json.loads(done.out), json_schema(SCHEMA))
    file = read_parameters(rig.folder / "out.json")
    (log,) = file.closed_loop.held_out
    assert (log.path, log.sha256) == ("b.parquet", sha256(content(1)))
    notes = file.closed_loop.notes[-len(LOOP.notes) :]
    loop = structs.replace(file.closed_loop, held_out=[], notes=notes, settings=None)
    assert loop == LOOP
    assert file.closed_loop.settings is not None
    assert file.stages.effects == [EFFECT]
    stages = zip(
        ("a", "b", "c", "d"), ("friction", "gravity", "imu", "inertia"), strict=True
    )
    inputs = [(log.path, log.stage) for log in file.inputs]
    assert inputs == [*stages, ("a.parquet", "effects")]


DOUBTFUL = structs.replace(
    LOOP.rounds[0], held_out_gain=0.02, interval=[-0.3, 0.34], confirmed=False
)
NOT_KEPT = structs.replace(
    DOUBTFUL,
    joint="shoulder",
    reason="its gain on the held-out logs is not certainly more than nothing",
)
STOPPED = StoppedAt(
    rounds=2,
    untried=[
        EffectOfPlace(effect="presliding_hysteresis", joint="shoulder"),
        EffectOfPlace(effect="presliding_hysteresis", joint="elbow"),
        EffectOfPlace(effect="payload"),
    ],
)
SCREENS = {  # what a refinement found
    "refine": LOOP,
    "refine_refused": structs.replace(LOOP, rounds=[], after=LOOP.before),
    "refine_nothing": structs.replace(LOOP, rounds=[], refused=[], after=LOOP.before),
    "refine_not_kept": structs.replace(
        LOOP, unconfirmed=[NOT_KEPT], stopped_at=STOPPED
    ),
    "refine_nothing_kept": structs.replace(
        LOOP, rounds=[], unconfirmed=[NOT_KEPT], refused=[], after=LOOP.before
    ),
    "refine_unconfirmed": structs.replace(
        LOOP, verdict="poor", rounds=[DOUBTFUL], refused=[]
    ),
}


@pytest.mark.parametrize("name", SCREENS)
def test_what_the_user_sees(rig: Rig, library: Library, name: str) -> None:
    library.loop = SCREENS[name]
    library.effects = [EFFECT] if library.loop.rounds else None
    swapped = inertia_file()
    swapped.robot.joints = swapped.robot.joints[::-1]
    rig.params("swapped.json", swapped)
    rig.params("f.json", friction_file())
    (rig.folder / "copy.parquet").write_bytes(content(0))
    rig.check_transcript(name)
    file = read_parameters(rig.folder / "out.json")
    assert file.stages.effects == (library.effects or [])
    assert not (rig.folder / "no.json").exists()
    loop = library.loop
    assert (file.closed_loop.verdict, file.closed_loop.rounds) == (
        loop.verdict,
        loop.rounds,
    )


def test_a_joint_is_explained(rig: Rig, library: Library) -> None:
    """What was tried there, what each log says of it, and why it was not taken."""
    disproved = structs.replace(
        LOOP.refused[0],
        joint="elbow",
        reason="does not certainly predict whole logs that were left out",
        whole_logs_gain=-0.2,
        whole_logs_interval=[-0.7, 0.1],
        gain_by_log={"a.parquet": 0.1, "walk.parquet": -0.5},
    )
    library.loop = structs.replace(
        LOOP,
        refused=[disproved],
        tried={"elbow": [rival("backlash", 3.0, "log evidence of 3.0, as of noise")]},
    )
    library.effects = [EFFECT]
    plain = rig.run(*BASE).out
    done = rig.run(*BASE, "--explain", "elbow")
    assert done.code == 0
    assert "tried" not in plain
    for told in (
        "tried for stribeck at elbow",
        "explains 97.0 % less",
        "spring at elbow: refused: does not certainly predict whole logs",
        "walk.parquet",
        "tried beside that",
        "log evidence of 3.0, as of noise",
    ):
        assert told in done.out
    elsewhere = rig.run(*BASE, "--explain", "shoulder").out
    assert "tried for" not in elsewhere


def test_a_joint_that_the_robot_does_not_have_is_not_explained(rig: Rig) -> None:
    done = rig.run(*BASE, "--explain", "hip")
    assert done.code == 2
    assert "--explain names no joint of this robot: 'hip'" in done.err


def test_a_partly_read_log(rig: Rig, reader: Reader, library: Library) -> None:
    reader.partial = "the end is missing"
    library.loop, library.effects = SCREENS["refine_nothing"], None
    rig.check_transcript("refine_partial")


def earlier_file(rig: Rig, **paths: tuple[str, bytes]) -> None:
    """Write p.json as identified from logs of the given stages, paths and contents."""
    file = inertia_file()
    file.inputs = [
        InputLog(path=path, sha256=sha256(data), samples=5, stage=stage)
        for stage, (path, data) in paths.items()
    ]
    rig.params("p.json", file)


def test_logs_of_earlier_stages_are_read_again(rig: Rig, library: Library) -> None:
    (rig.folder / "moved").mkdir()
    (rig.folder / "moved" / "f.parquet").write_bytes(content(9))
    earlier_file(
        rig,
        friction=("f.parquet", content(9)),
        gravity=("c.parquet", content(2)),
        imu=("gone.parquet", content(7)),
        inertia=("d.parquet", content(99)),  # another log has its name now
    )
    (rig.folder / "p.json").rename(rig.folder / "moved" / "p.json")
    done = rig.run(*BASE[:-1], "moved/p.json", "-o", "out.json")
    assert done.code == 0
    assert library.earlier == {
        "friction": ["moved/f.parquet"],
        "gravity": ["c.parquet"],
    }
    note, _ = read_parameters(rig.folder / "out.json").closed_loop.notes
    assert (
        "no longer there or have changed: gone.parquet, d.parquet; the model is fitted"
        in note
    )
    assert f"note: {note}" in done.err


def test_a_log_fitted_again_is_read_once_and_a_held_out_one_not(
    rig: Rig, library: Library
) -> None:
    earlier_file(
        rig,
        inertia=("elsewhere/a.parquet", content(0)),
        imu=("b.parquet", content(1)),
        gravity=("c.parquet", content(2)),
    )
    done = rig.run(*BASE)
    assert library.earlier == {"inertia": ["a.parquet"], "gravity": ["c.parquet"]}
    assert library.shared == 1
    assert "no longer there" not in done.err
    assert "the model that came in was identified from it: b.parquet" in done.err


def test_earlier_trials_that_are_too_long_are_left_aside(
    rig: Rig, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier_file(
        rig, friction=("c.parquet", content(2)), inertia=("d.parquet", content(3))
    )
    monkeypatch.setattr(
        "seqid_cli.discover.refinement.earlier_logs.likely_rows", lambda *_: 10**9
    )
    done = rig.run(*BASE)
    assert done.code == 0
    assert library.earlier == {"friction": [], "inertia": ["d.parquet"]}
    assert "the 1 logs of earlier stages are too long" in done.err


@pytest.mark.parametrize(
    "path", ["", ".", "/dev/zero", "robot.toml", "a\0b", "x" * 5000, ".."]
)
def test_paths_of_a_parameter_file_are_not_trusted(tmp_path: Path, path: str) -> None:
    log = InputLog(path=path, sha256="0" * 64, samples=1, stage="friction")
    found = find_earlier([log], [tmp_path], at_hand={}, held_out=[])
    assert found.paths == {}
    assert found.incomplete == {"friction"}
    assert len(found.notes) == 1


def test_a_stage_that_lacks_a_log_is_not_whole(tmp_path: Path) -> None:
    """One log is lost and one held out: of their stages nothing is whole."""
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(name)
    digests = {name: sha256(name.encode()) for name in ("a.csv", "b.csv")}
    inputs = [
        InputLog(path=path, sha256=digests.get(path, "0"), samples=1, stage=stage)
        for path, stage in (
            ("a.csv", "friction"),
            ("gone.csv", "friction"),
            ("a.csv", "gravity"),
            ("b.csv", "inertia"),
        )
    ]
    found = find_earlier(
        inputs,
        [tmp_path],
        at_hand={digests["a.csv"]: tmp_path / "a.csv"},
        held_out=[tmp_path / "b.csv"],
    )
    assert found.incomplete == {"friction", "inertia"}
    assert found.by_stage == {
        "friction": [digests["a.csv"]],
        "gravity": [digests["a.csv"]],
    }


HELD_OUT = "held_out.parquet"
LINE = (
    "refine",
    "fourier.parquet",
    "trapezoids.parquet",
    "--holdout",
    HELD_OUT,
    "-p",
    "p.json",
)


@pytest.fixture
def real(rig: Rig) -> Rig:
    """Logs to fit, a held-out one that is not there yet, and a model that names it as
    its own.
    """
    for name in ("robot.toml", "changed/fourier.parquet", "changed/trapezoids.parquet"):
        shutil.copy(ONE_JOINT / name, rig.folder)
    file = read_parameters(ONE_JOINT / "golden.json")
    for log in file.inputs:
        log.path = str(ROOT / log.path)
    own = InputLog(path=HELD_OUT, sha256="0" * 64, samples=1, stage="inertia")
    file.inputs = [*file.inputs, own]
    rig.params("p.json", file)
    (rig.folder / HELD_OUT).write_bytes(b"not a log yet")
    return rig


@pytest.mark.slow
def test_held_out_logs_are_read_after_the_last_decision(
    real: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that cannot be read is only found out then, and one that is recorded then is
    judged.
    """
    log, decide = ONE_JOINT / "changed" / HELD_OUT, deciding.refine
    decided: list[object] = []

    def refine(*given: Any, **more: Any) -> object:
        if decided:
            shutil.copy(log, real.folder)  # now it is recorded
        else:
            decided.append(decide(*given, **more))
        return decided[0]

    monkeypatch.setattr(deciding, "refine", refine)
    done = real.run(*LINE, "-r", "robot.toml", "-o", "out.json", "--json")
    assert done.code == 2
    assert HELD_OUT in done.err
    assert len(decided) == 1
    assert not (real.folder / "out.json").exists()
    done = real.run(*LINE, "-r", "robot.toml", "-o", "out.json", "--json")
    assert done.code == 0, done.err
    jsonschema.validate(json.loads(done.out), json_schema(SCHEMA))
    file = read_parameters(real.folder / "out.json")
    loop = file.closed_loop
    assert loop.evaluated_on == [HELD_OUT]
    assert [own.sha256 for own in loop.held_out] == [sha256(log.read_bytes())]
    assert any("held out, although" in note for note in loop.notes)
    assert loop.after["joint_1"].rmse < 0.6 * loop.before["joint_1"].rmse
    assert [(tried.effect, tried.joint) for tried in loop.rounds[:1]] == [
        ("spring", "joint_1")
    ]
    assert len(file.stages.effects or []) == len(loop.rounds)
    assert real.run("predict", HELD_OUT, "-r", "robot.toml", "-p", "out.json").code == 0
