"""`seqid diagnose` around a fake diagnosis: what it passes on, writes, prints and returns."""

import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from types import ModuleType

import jsonschema
import pytest
from msgspec import structs

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.inspect.findings import found
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.evidence_schema import RivalEntry
from seqid_cli.params.results.diagnosis import (
    DIAGNOSIS_SCHEMA,
    DiagnosisFile,
    EventEntry,
    FindingEntry,
    HiddenEntry,
    UnexplainedPart,
)
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests.commands.conftest import Reader, Rig
from tests.unit.params.documents import diagnosis_file, diagnosis_of, gravity_file, inertia_file
from tests.unit.params.generate import json_schema

BASE = ["diagnose", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json"]

FILE = diagnosis_file()
STRIBECK = structs.replace(
    FILE.findings[0],
    name_confidence=0.9,
    note="a remark on it",
    rivals=[
        FILE.findings[0].rivals[0],
        RivalEntry(
            effect="quadratic_drag", joint="elbow", log_gain=120.0, why_not="explains 60.0 % less"
        ),
    ],
)
PAYLOAD = FindingEntry(
    effect="payload",
    joint=None,
    confidence=0.6,
    name_confidence=0.6,
    explains=0.1,
    confusable_with=[],
    separate_by="",
    gain=0.05,
)
SPRING = RivalEntry(
    effect="spring", joint="shoulder", log_gain=20.0, why_not="explains 75.0 % less"
)
CURVE = structs.replace(
    FILE.unexplained[0],
    depends_on=["position", "other_joint:elbow"],
    log_gain=80.0,
    rivals=[SPRING],
)
DRIFT = structs.replace(FILE.joints["elbow"].tried[0], effect="drift", joint="shoulder")
JOINTS = {
    "shoulder": structs.replace(FILE.joints["elbow"], tried=[DRIFT]),
    "elbow": FILE.joints["shoulder"],
}
FOUND = diagnosis_of(
    "effect_found",
    [STRIBECK, PAYLOAD],
    [CURVE],
    JOINTS,
    events=[
        EventEntry(log="a.parquet", start=float(k), end=k + 0.5, joints=["elbow"])
        for k in range(12)
    ],
    hidden=[
        HiddenEntry(effect="base_tilt", joint=None, visible=0.02),
        HiddenEntry(effect="spring", joint="elbow", visible=0.001),
    ],
    notes=["a remark"],
)
NOTHING = diagnosis_of("nothing_missing", joints=JOINTS)
OPEN = diagnosis_of(
    "unexplained",
    unexplained=[CURVE, UnexplainedPart(joint="elbow", depends_on=[], share=0.3)],
    joints=JOINTS,
)


@dataclass
class Library:
    """Stands in for the diagnosis: reads all recordings and returns what it was given."""

    result: DiagnosisFile | Exception = FOUND
    calls: list[object] = field(default_factory=list)

    def diagnose(
        self,
        recordings: Iterable[Recording],
        robot: Robot,
        stages: Stages,
        *,
        options: DiscoverOptions,
    ) -> DiagnosisFile:
        self.calls.append((len(list(recordings)), robot, stages, options))
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@pytest.fixture
def library(rig: Rig, reader: Reader, gathering: None, monkeypatch: pytest.MonkeyPatch) -> Library:
    fake = Library()
    module = ModuleType("seqid_cli.discover.diagnosis")
    module.diagnose = fake.diagnose  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    rig.params("p.json", inertia_file())
    return fake


def test_what_it_passes_on(rig: Rig, reader: Reader, library: Library) -> None:
    options = ["--motion", "imu", "--cutoff", "12", "--time", "log"]
    assert rig.run(*BASE, *options).code == 0
    ((count, robot, stages, given),) = library.calls  # type: ignore[misc]
    assert count == 2
    assert robot.joint_names == ("shoulder", "elbow")
    assert stages.inertia is not None
    assert given == DiscoverOptions(InertiaOptions(MotionOptions(12.0, origin="as given"), "imu"))
    assert reader.time_source == "log"


def test_the_document(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json", "--json")
    assert done.code == 0
    assert done.out == (rig.folder / "out.json").read_text()
    document = json.loads(done.out)
    jsonschema.validate(document, json_schema(DIAGNOSIS_SCHEMA))
    assert document.keys() >= {"verdict", "findings", "unexplained", "joints"}
    first, other = document["findings"]
    told = {"effect", "joint", "confidence", "explains", "confusable_with", "separate_by"}
    assert first.keys() >= told
    assert document["unexplained"][0].keys() >= {"joint", "depends_on", "share"}
    assert document["joints"]["elbow"].keys() >= {"rmse", "noise_floor", "white"}
    assert first["parameters"] == [
        {"name": "stribeck_torque", "value": 1.5, "std_error": 0.05, "unit": "N m"}
    ]
    assert (other["effect"], other["joint"]) == ("payload", None)
    assert document["joints"]["elbow"]["rmse"] is None
    assert document["stages"] == ["friction", "gravity", "imu", "inertia"]
    assert [log["path"] for log in document["inputs"]] == ["a.parquet", "b.parquet"]
    assert document["parameters"][0]["path"] == "p.json"


def test_the_story_of_a_joint(rig: Rig, library: Library) -> None:
    """What was taken there comes with its rivals; other joints' findings do not."""
    done = rig.run(*BASE, "-o", "out.json", "--explain", "shoulder")
    assert done.code == 0
    assert (rig.folder / "out.json").exists()
    lines = done.out.splitlines()
    assert (
        " ".join(lines[1].split()) == "payload whole arm 60.0 % 10.0 % not determined by these logs"
    )
    assert "stribeck" not in done.out
    part = next(line for line in lines if "other_joint:elbow" in line)
    assert part.split()[:5] == ["shoulder", "position,", "other_joint:elbow", "40.0", "%"]
    spring = next(line for line in lines if line.startswith("spring"))
    assert spring.endswith("explains 75.0 % less")
    drift = next(line for line in lines if line.startswith("drift"))
    assert drift.endswith("gain of 0.9 standard errors; 2 are asked at least")
    joint = next(line.split() for line in lines if line.split()[:2] == ["shoulder", "0.3"])
    assert joint == ["shoulder", "0.3", "0.1", "0.08", "to", "0.13", "3", "0.12", "no"]


def test_the_story_of_a_finding(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "--explain", "elbow")
    lines = done.out.splitlines()
    assert lines[1].startswith("stribeck")
    choice = "stribeck at elbow (90.0 % by this name): could also be"
    assert f"{choice} presliding_hysteresis or quadratic_drag" in lines
    assert any("takes away 70.0 % of the squared error" in line for line in lines)
    assert any("times direction" in line for line in lines)
    drag = next(line for line in lines if line.startswith("quadratic_drag"))
    assert drag.split()[:3] == ["quadratic_drag", "elbow", "120"]
    assert any(line.endswith("record: slow reversals at two accelerations") for line in lines)
    assert "shoulder" not in done.out.replace("of shoulder", "")
    assert "2 effects these motions cannot show" in done.err


def test_an_unknown_joint_cannot_be_explained(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json", "--explain", "knee")
    assert done.code == 2
    assert "--explain names no joint of this robot: 'knee'" in done.err
    assert "shoulder, elbow" in done.err
    assert done.out == ""
    assert not (rig.folder / "out.json").exists()
    assert library.calls == []


def test_what_the_user_sees(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json")
    lines = done.out.splitlines()
    assert lines[0] == (
        "The model lacks stribeck at elbow, payload; a part stays unexplained"
        " (shoulder: position, other_joint:elbow)."
    )
    assert lines[1].split() == ["effect", "joint", "confidence", "explains", "parameters"]
    assert "stribeck_torque 1.5 +- 0.05 N m, stribeck_speed 0.05 rad/s, exponent 2" in lines[2]
    assert lines[3].split()[:3] == ["payload", "whole", "arm"]
    assert lines[3].endswith("not determined by these logs")
    assert lines[4] == (
        "stribeck at elbow (90.0 % by this name): could also be"
        " presliding_hysteresis or quadratic_drag"
    )
    assert lines[5] == "  to tell them apart, record: slow reversals at two accelerations"
    assert "payload: could also be" not in done.out
    assert "residual of shoulder N m: * before, o after" in done.out
    assert "position rad" in done.out
    joint = lines[next(k for k, line in enumerate(lines) if "noise floor" in line) + 1].split()
    assert joint == ["shoulder", "0.3", "0.1", "0.08", "to", "0.13", "3", "0.12", "no"]
    assert "note: stribeck at elbow: a remark on it" in done.err
    assert "note: a remark" in done.err
    assert "next: seqid refine LOG... --holdout LOG... -r robot.toml -p p.json -o" in done.err


def test_long_lists_are_for_those_who_ask(rig: Rig, library: Library) -> None:
    brief = rig.run(*BASE)
    assert brief.out.count("a.parquet") == 10
    assert "2 more such events: -v" in brief.err
    assert "2 effects these motions cannot show: -v lists them." in brief.err
    assert "base_tilt" not in brief.out
    whole = rig.run(*BASE, "-v")
    assert whole.out.count("a.parquet") == 12
    assert "base_tilt" in whole.out


@pytest.mark.parametrize(("found", "strict"), [(FOUND, 1), (OPEN, 1), (NOTHING, 0)])
def test_strict_is_about_the_verdict(
    rig: Rig, library: Library, found: DiagnosisFile, strict: int
) -> None:
    library.result = found
    assert rig.run(*BASE).code == 0
    assert rig.run(*BASE, "--strict").code == strict


def test_errors_of_the_logs_are_in_the_document(rig: Rig, reader: Reader, library: Library) -> None:
    reader.findings = (
        found("position_spikes", "jumps", joint="elbow", channel="position"),
        found("clock_gap", "1 gaps"),
    )
    done = rig.run(*BASE, "--json")
    document = json.loads(done.out)
    jsonschema.validate(document, json_schema(DIAGNOSIS_SCHEMA))
    assert [verdict["joint"] for verdict in document["verdicts"]] == ["elbow"]
    assert "[position_spikes] a.parquet" in document["verdicts"][0]["reason"]
    assert any("[clock_gap] a.parquet" in note for note in document["notes"])
    assert "elbow: poor" in rig.run(*BASE).out
    assert rig.run(*BASE, "--strict").code == 1


def test_a_partly_read_log(rig: Rig, reader: Reader, library: Library) -> None:
    reader.partial = "the last 12 of 40 chunks are damaged"
    assert rig.run(*BASE).code == 3
    assert rig.run(*BASE, "--strict").code == 1


@pytest.mark.parametrize("options", [[], ["--motion", "imu"]])
def test_a_missing_stage(rig: Rig, library: Library, options: list[str]) -> None:
    rig.params("p.json", gravity_file())
    done = rig.run(*BASE, *options)
    assert done.code == 2
    assert "p.json: there is no inertia stage" in done.err
    assert "Run seqid inertia first" in done.err
    assert "From logs of any motion, seqid simultaneous gives one." in " ".join(done.err.split())
    assert library.calls == []
