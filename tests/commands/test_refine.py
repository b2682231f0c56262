"""`seqid refine` around a fake refinement: which logs go where, documents, screen, exit codes."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import pytest
from msgspec import structs

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import WholeLogs
from seqid_cli.discover.refinement.log_sets import find_earlier
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.inspect.screening import Screened
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import (
    SCHEMA,
    ClosedLoop,
    EffectOfJoint,
    InputLog,
    Parameter,
    ParameterFile,
)
from seqid_cli.robot.types import Robot
from tests.commands.conftest import Reader, Rig, stand_in
from tests.commands.transcripts import check_transcript
from tests.unit.params.documents import closed_loop, friction_file, full_file, inertia_file
from tests.unit.params.generate import json_schema

BASE = ["refine", "a.parquet", "--holdout", "b.parquet", "-r", "robot.toml", "-p", "p.json"]


LOOP = structs.replace(closed_loop(), evaluated_on=["b.parquet"], held_out=[])
EFFECT = structs.replace(
    full_file().stages.effects[0],
    parameters=[Parameter(name="stribeck_torque", value=1.5, std_error=0.05, unit="N m")],
)


def content(number: int) -> bytes:
    return b"PAR1" + bytes([number]) * 16 + b"PAR1"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@dataclass
class Library:
    """Stands in for the refinement; keeps what it was called with."""

    loop: ClosedLoop = LOOP
    effects: list[EffectOfJoint] | None = field(default_factory=lambda: [EFFECT])
    training: list[str] = field(default_factory=list)
    held_out: list[str] = field(default_factory=list)
    earlier: dict[str, list[str]] = field(default_factory=dict)
    shared: int = 0
    options: DiscoverOptions | None = None

    def refine(
        self,
        training: Sequence[Recording],
        robot: Robot,
        file: ParameterFile,
        *,
        earlier: Mapping[str, Sequence[Recording]],
        options: DiscoverOptions,
    ) -> SimpleNamespace:
        self.training = [str(log.path) for log in training]
        self.earlier = {stage: [str(log.path) for log in logs] for stage, logs in earlier.items()}
        self.shared = sum(
            log is other for logs in earlier.values() for log in logs for other in training
        )
        self.options = options
        return SimpleNamespace(stages=structs.replace(file.stages, effects=self.effects))

    def confirm(
        self, found: object, held_out: Sequence[Recording], whole: WholeLogs | None
    ) -> ClosedLoop:
        assert whole is None
        self.held_out = [str(log.path) for log in held_out]
        return self.loop


@pytest.fixture
def library(rig: Rig, reader: Reader, gathering: None, monkeypatch: pytest.MonkeyPatch) -> Library:
    fake = Library()
    stand_in(monkeypatch, "discover.refinement.rounds", refine=fake.refine)
    stand_in(monkeypatch, "discover.refinement.confirm", confirm=fake.confirm)
    # Recordings carry the digest of the file, as those of the real reader do.
    read = reader.read_screened

    def digested(path: Path, robot: Robot, *, time_source: str, imus: bool) -> Screened:
        recording, findings = read(path, robot, time_source=time_source, imus=imus)
        return replace(recording, sha256=sha256(path.read_bytes())), findings

    monkeypatch.setattr("seqid_cli.identify.log_set.read_screened", digested)
    for number, name in enumerate(("a.parquet", "b.parquet", "c.parquet", "d.parquet")):
        (rig.folder / name).write_bytes(content(number))
    rig.params("p.json", inertia_file())
    return fake


def test_what_it_passes_on(rig: Rig, reader: Reader, library: Library) -> None:
    options = ["--rounds", "2", "--with-unexplained", "--motion", "encoder", "--cutoff", "9"]
    holdout = ["--holdout", "c.*", "--time", "log"]
    assert rig.run(*BASE, "d.parquet", *holdout, *options).code == 0
    assert library.training == ["a.parquet", "d.parquet"]
    assert library.held_out == ["b.parquet", "c.parquet"]
    assert library.options == DiscoverOptions(
        InertiaOptions(MotionOptions(9.0, origin="as given"), "encoder"),
        max_effects=2,
        with_unexplained=True,
    )
    assert reader.time_source == "log"


def test_the_document(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json", "--json")
    assert done.code == 0
    assert done.out == (rig.folder / "out.json").read_text()
    document = json.loads(done.out)
    jsonschema.validate(document, json_schema(SCHEMA))
    loop = document["closed_loop"]
    (told,) = loop["rounds"]
    assert (told["effect"], told["confirmed"], told["interval"]) == ("stribeck", True, [0.5, 0.63])
    assert (loop["verdict"], loop["refused"][0]["confirmed"]) == ("good", None)
    assert loop["after"]["elbow"]["rmse_outside"] == pytest.approx(0.2)
    assert loop["evaluated_on"] == ["b.parquet"]
    assert [(log["path"], log["sha256"]) for log in loop["held_out"]] == [
        ("b.parquet", sha256(content(1)))
    ]
    file = read_parameters(rig.folder / "out.json")
    assert file.stages.effects == [EFFECT]
    assert [(log.path, log.stage) for log in file.inputs] == [
        ("a", "friction"),
        ("b", "gravity"),
        ("c", "imu"),
        ("d", "inertia"),
        ("a.parquet", "effects"),
    ]


DOUBTFUL = structs.replace(
    LOOP.rounds[0], held_out_gain=0.02, interval=[-0.3, 0.34], confirmed=False
)
SCREENS = {  # what a refinement found
    "refine": LOOP,
    "refine_refused": structs.replace(LOOP, rounds=[], after=LOOP.before),
    "refine_nothing": structs.replace(LOOP, rounds=[], refused=[], after=LOOP.before),
    "refine_unconfirmed": structs.replace(LOOP, verdict="poor", rounds=[DOUBTFUL], refused=[]),
}


@pytest.mark.parametrize("name", SCREENS)
def test_what_the_user_sees(rig: Rig, library: Library, name: str) -> None:
    library.loop = SCREENS[name]
    library.effects = [EFFECT] if library.loop.rounds else None
    swapped = inertia_file()
    swapped.robot.joints = swapped.robot.joints[::-1]
    rig.params("swapped.json", swapped)
    rig.params("f.json", friction_file())
    check_transcript(rig, name)
    file = read_parameters(rig.folder / "out.json")
    assert file.stages.effects == (library.effects or [])
    loop = library.loop
    assert (file.closed_loop.verdict, file.closed_loop.rounds) == (loop.verdict, loop.rounds)


def test_a_partly_read_log(rig: Rig, reader: Reader, library: Library) -> None:
    reader.partial = "the end is missing"
    library.loop, library.effects = SCREENS["refine_nothing"], None
    check_transcript(rig, "refine_partial")


def test_a_copy_of_what_was_fitted_is_refused_when_it_is_opened(rig: Rig, library: Library) -> None:
    (rig.folder / "copy.parquet").write_bytes(content(0))
    done = rig.run(*BASE, "--holdout", "copy.parquet", "-o", "out.json")
    assert done.code == 2
    assert "copy.parquet (a.parquet): is given both" in done.err
    assert not (rig.folder / "out.json").exists()


def earlier_file(rig: Rig, paths: Mapping[str, tuple[str, bytes]]) -> None:
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
        {
            "friction": ("f.parquet", content(9)),
            "gravity": ("c.parquet", content(2)),
            "imu": ("gone.parquet", content(7)),
            "inertia": ("d.parquet", content(99)),  # another log has its name now
        },
    )
    (rig.folder / "p.json").rename(rig.folder / "moved" / "p.json")
    done = rig.run(*BASE[:-1], "moved/p.json", "-o", "out.json")
    assert done.code == 0
    assert library.earlier == {"friction": ["moved/f.parquet"], "gravity": ["c.parquet"]}
    note = (
        "logs of earlier stages that are no longer there or have changed: gone.parquet, d.parquet;"
        " the model is fitted again without them"
    )
    assert f"note: {note}" in done.err
    loop = read_parameters(rig.folder / "out.json").closed_loop
    assert loop.notes == [note, "a remark"]


def test_a_log_that_is_fitted_again_is_read_once(rig: Rig, library: Library) -> None:
    earlier_file(rig, {"inertia": ("elsewhere/a.parquet", content(0))})
    done = rig.run(*BASE)
    assert library.earlier == {"inertia": ["a.parquet"]}
    assert library.shared == 1
    assert "no longer there" not in done.err


def test_a_held_out_log_is_never_fitted_as_an_earlier_one(rig: Rig, library: Library) -> None:
    earlier_file(rig, {"inertia": ("b.parquet", content(1)), "gravity": ("c.parquet", content(2))})
    done = rig.run(*BASE)
    assert library.earlier == {"gravity": ["c.parquet"]}
    assert "the model that came in was identified from it: b.parquet" in done.err


@pytest.mark.parametrize("path", ["", ".", "/dev/zero", "robot.toml", "a\0b", "x" * 5000, ".."])
def test_paths_of_a_parameter_file_are_not_trusted(tmp_path: Path, path: str) -> None:
    log = InputLog(path=path, sha256="0" * 64, samples=1, stage="friction")
    found = find_earlier([log], [tmp_path], at_hand={}, held_out=[])
    assert found.paths == {}
    assert len(found.notes) == 1
