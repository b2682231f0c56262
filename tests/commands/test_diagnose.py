"""`seqid diagnose`: what it passes on, writes, prints and returns; and on the sample
robots.
"""

import json
from collections.abc import Iterable
from pathlib import Path

import jsonschema
import msgspec
import pytest
from msgspec import structs

from seqid_cli.__main__ import main
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.inspect.findings import finding_of
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.results.diagnosis import (
    DIAGNOSIS_SCHEMA,
    ChangeCause,
    ChangedValues,
    DiagnosisFile,
    FindingEntry,
    UnexplainedPart,
)
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLE_LOGS, Reader, Rig, stand_in
from tests.unit.params.documents import diagnosis_file, gravity_file, inertia_file
from tests.unit.params.generate import json_schema

BASE = ["diagnose", "a.parquet", "b.parquet", "-r", "robot.toml", "-p", "p.json"]

FILE = diagnosis_file()
(STRIBECK,), (CURVE,) = FILE.findings, FILE.unexplained
PAYLOAD = FindingEntry(
    effect="payload",
    joint=None,
    confidence=0.6,
    explains=0.1,
    confusable_with=[],
    separate_by="",
    gain=0.05,
)
OTHER = structs.replace(
    CURVE, depends_on=["position", "other_joint:elbow"], rivals=STRIBECK.rivals
)
FOUND = structs.replace(
    FILE,
    findings=[structs.replace(STRIBECK, name_confidence=0.9), PAYLOAD],
    unexplained=[OTHER],
    events=[
        structs.replace(FILE.events[0], start=float(k), end=k + 0.5) for k in range(12)
    ],
    hidden=[
        *FILE.hidden,
        structs.replace(FILE.hidden[0], effect="spring", joint="elbow"),
    ],
)
REST = structs.replace(FOUND, findings=[], unexplained=[], events=[], hidden=[])
NOTHING = structs.replace(REST, verdict="nothing_missing")
CHANGED = structs.replace(
    REST,
    verdict="values_changed",
    changed=[
        ChangedValues(
            joint="elbow",
            rmse=0.3,
            floors=3.0,
            rmse_refitted=0.12,
            since="b.parquet",
            causes=[
                ChangeCause(
                    effect="friction_change",
                    joint="elbow",
                    probability=0.55,
                    log_gain=461.0,
                ),
                ChangeCause(
                    effect="payload", joint=None, probability=0.45, log_gain=458.0
                ),
            ],
        )
    ],
)
SHORT = structs.replace(REST, verdict="too_short")
UNSEEN = structs.replace(
    REST, verdict="nothing_seen", joints={"shoulder": FILE.joints["shoulder"]}
)
PART = UnexplainedPart(joint="elbow", depends_on=[], share=0.3)
OPEN = structs.replace(REST, verdict="unexplained", unexplained=[OTHER, PART])


class Library:
    """Stands in for the diagnosis: reads all recordings and returns what it was
    given.
    """

    def __init__(self) -> None:
        self.result = FOUND
        self.calls: list[tuple[int, Robot, Stages, DiscoverOptions]] = []

    def diagnose(
        self, recordings: Iterable[Recording], *given: object, options: DiscoverOptions
    ) -> DiagnosisFile:
        self.calls.append((len(list(recordings)), *given, options))  # type: ignore[arg-type]
        return self.result


@pytest.fixture
def library(
    rig: Rig, reader: Reader, gathering: None, monkeypatch: pytest.MonkeyPatch
) -> Library:
    fake = Library()
    stand_in(monkeypatch, "discover.diagnosis", diagnose=fake.diagnose)
    rig.params("p.json", inertia_file())
    return fake


def test_what_it_passes_on(rig: Rig, reader: Reader, library: Library) -> None:
    options = ["--motion", "imu", "--cutoff", "12", "--time", "log"]
    assert rig.run(*BASE, *options).code == 0
    ((count, robot, stages, given),) = library.calls
    assert count == 2
    assert robot.joint_names == ("shoulder", "elbow")
    assert stages.inertia is not None
    assert given == DiscoverOptions(
        InertiaOptions(motion=MotionOptions(12.0, origin="as given"), source="imu")
    )
    assert reader.reading.time_source == "log"


def test_the_document(rig: Rig, library: Library) -> None:
    done = rig.run(*BASE, "-o", "out.json", "--json")
    assert (done.code, done.out) == (0, (rig.folder / "out.json").read_text())
    jsonschema.validate(json.loads(done.out), json_schema(DIAGNOSIS_SCHEMA))
    file = msgspec.json.decode(done.out, type=DiagnosisFile)
    for name in ("verdict", "findings", "unexplained", "joints", "events", "hidden"):
        assert getattr(file, name) == getattr(FOUND, name)
    assert file.stages == ["friction", "gravity", "imu", "inertia"]
    assert [log.path for log in file.inputs] == ["a.parquet", "b.parquet"]
    assert file.parameters[0].path == "p.json"


@pytest.mark.parametrize(
    ("name", "result", "calls"),
    [
        ("found", FOUND, 4),
        ("nothing", NOTHING, 2),
        ("open", OPEN, 2),
        ("changed", CHANGED, 2),
        ("short", SHORT, 1),
        ("unseen", UNSEEN, 1),
    ],
)
def test_what_the_user_sees(
    rig: Rig, library: Library, name: str, result: DiagnosisFile, calls: int
) -> None:
    library.result = result
    rig.params("gravity.json", gravity_file())
    rig.check_transcript(f"diagnose_{name}")
    assert len(library.calls) == calls
    assert not (rig.folder / "none.json").exists()


def test_errors_of_the_logs_are_in_the_document(
    rig: Rig, reader: Reader, library: Library
) -> None:
    reader.findings = (
        finding_of("position_spikes", "jumps", joint="elbow", channel="position"),
        finding_of("clock_gap", "1 gaps"),
    )
    document = json.loads(rig.run(*BASE, "--json").out)
    jsonschema.validate(document, json_schema(DIAGNOSIS_SCHEMA))
    assert [verdict["joint"] for verdict in document["verdicts"]] == ["elbow"]
    assert "[position_spikes] a.parquet" in document["verdicts"][0]["reason"]
    assert any("[clock_gap] a.parquet" in note for note in document["notes"])
    library.result = NOTHING
    rig.check_transcript("diagnose_faulty")


def test_a_partly_read_log(rig: Rig, reader: Reader, library: Library) -> None:
    reader.partial, library.result = "the last 12 of 40 chunks are damaged", NOTHING
    rig.check_transcript("diagnose_partial")


@pytest.mark.parametrize(
    "case",
    [
        ("one_joint", (), "stiffness", "stiffness", {"rel": 0.25}),
        pytest.param(
            ("two_joint", ("--motion", "encoder"), "load_coefficient", "driving", {}),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["IMUs", "encoders that are too coarse for the model's cutoff"],
)
def test_the_effect_of_a_change_is_found_with_its_size(
    tmp_path: Path, case: tuple[str, tuple[str, ...], str, str, dict[str, float]]
) -> None:
    rig_name, more, name, true, error = case
    rig, output = SAMPLE_LOGS / rig_name, tmp_path / "diagnosis.json"
    model = ["-r", str(rig / "robot.toml"), "-p", str(rig / "golden.json"), *more]
    assert (
        main(["diagnose", str(rig / "changed"), *model, "-o", str(output), "-q"]) == 0
    )
    document = json.loads(output.read_text())
    truth = json.loads((rig / "truth.json").read_text())["changed"]
    assert document["verdict"] == "effect_found"
    (first,) = document["findings"]
    assert (first["effect"], first["joint"]) == (truth["effect"], truth["joint"])
    value = next(p for p in first["parameters"] if p["name"] == name)
    allowed = error or {"abs": 4 * value["std_error"]}
    assert value["value"] == pytest.approx(truth[true], **allowed)
    joint = document["joints"][truth["joint"]]
    assert joint["rmse_explained"] < 0.6 * joint["rmse"]
