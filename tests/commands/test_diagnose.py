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
from tests.commands.transcripts import check_transcript
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

    result: DiagnosisFile = FOUND
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


@pytest.mark.parametrize(
    ("name", "result", "calls"), [("found", FOUND, 4), ("nothing", NOTHING, 2), ("open", OPEN, 2)]
)
def test_what_the_user_sees(
    rig: Rig, library: Library, name: str, result: DiagnosisFile, calls: int
) -> None:
    library.result = result
    rig.params("gravity.json", gravity_file())
    check_transcript(rig, f"diagnose_{name}")
    assert len(library.calls) == calls
    assert not (rig.folder / "none.json").exists()


def test_errors_of_the_logs_are_in_the_document(rig: Rig, reader: Reader, library: Library) -> None:
    reader.findings = (
        found("position_spikes", "jumps", joint="elbow", channel="position"),
        found("clock_gap", "1 gaps"),
    )
    document = json.loads(rig.run(*BASE, "--json").out)
    jsonschema.validate(document, json_schema(DIAGNOSIS_SCHEMA))
    assert [verdict["joint"] for verdict in document["verdicts"]] == ["elbow"]
    assert "[position_spikes] a.parquet" in document["verdicts"][0]["reason"]
    assert any("[clock_gap] a.parquet" in note for note in document["notes"])
    library.result = NOTHING
    check_transcript(rig, "diagnose_faulty")


def test_a_partly_read_log(rig: Rig, reader: Reader, library: Library) -> None:
    reader.partial, library.result = "the last 12 of 40 chunks are damaged", NOTHING
    check_transcript(rig, "diagnose_partial")
