from pathlib import Path

import pytest

from seqid_cli.compare import compare
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.document import now, tool
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    Measured,
    PayloadFile,
)
from seqid_cli.params.results.plan import (
    PLAN_SCHEMA,
    FourierMotion,
    JointLimits,
    PlanFile,
    PlannedMove,
    PlannedStage,
    PredictedParameter,
)
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import Verdict
from seqid_cli.report.collection import collect
from seqid_cli.report.make import make_report
from tests.unit.params.documents import JOINTS, inertia_file, log, robot
from tests.unit.report.pages import good_documents, source


def payload_file(used: FileId) -> PayloadFile:
    joint = JointWithPayload(
        before=2.5, after=0.125, relative=0.0625, samples=100, friction_change=0.04
    )
    return PayloadFile(
        schema=PAYLOAD_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot(),
        inputs=[log("loaded.parquet", "")],
        models=[used],
        payload=CarriedBodyEntry(
            frame="of joint elbow",
            mass=Measured(value=2.345, std_error=0.012, unit="kg"),
            center_of_mass=[
                Measured(value=0.01, std_error=0.001, unit="m"),
                Measured(value=0.02, std_error=0.001, unit="m"),
                Measured(value=None, std_error=None, unit="m"),
            ],
        ),
        parameters=[],
        covariance=[],
        settings={"urscript": "set_payload(2.345, [0.01, 0.02, 0.0])"},
        joints=dict.fromkeys(JOINTS, joint),
        verdicts=[Verdict(good=True, reason="mass 2.345 kg, standard error 0.012 kg")],
        notes=["friction differs from the model's"],
    )


def plan_file() -> PlanFile:
    move = PlannedMove(
        name="pair_1",
        stage="inertia",
        joints=list(JOINTS),
        duration_s=8.0,
        start=dict.fromkeys(JOINTS, 0.0),
        fourier={JOINTS[0]: FourierMotion(centre=0.0, sine=[0.5] * 5, cosine=[0.0] * 5)},
        torque_share=0.625,
        torque={name: [10.0, 20.0] for name in JOINTS},
    )
    limit = JointLimits(position=[-1.0, 1.0], speed=1.0, acceleration=2.0, torque=40.0, moves=True)
    error = PredictedParameter(
        name="Izz_2", joint="elbow", unit="kg m^2", std_error=0.0375, value=None
    )
    return PlanFile(
        schema=PLAN_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot(),
        what="inertia",
        seed=1,
        parameters=[],
        limits=dict.fromkeys(JOINTS, limit),
        noise_density=dict.fromkeys(JOINTS, 0.01),
        noise_origin="",
        moves=[move],
        stages={"inertia": PlannedStage(parameters=[error], rank=9, structural_rank=10)},
        duration_s=8.0,
        total_s=12.0,
    )


def test_a_payload_has_a_section_with_its_settings() -> None:
    parameters, prediction = good_documents()
    used = FileId(path=parameters.path, sha256=parameters.sha256)
    extra = [source("payload.json", payload_file(used)), source("plan.json", plan_file())]
    made = make_report([parameters, prediction, *extra])
    assert [section.id for section in made.sections][-2:] == ["payload", "plan"]
    for text in ("2.345", "not determined", "set_payload(2.345", "of joint elbow"):
        assert text in made.html
    for text in ("pair_1", "0.0375", "9 of 10", "62.5", "torque over its limit"):
        assert text in made.html


def test_without_them_there_is_no_such_section() -> None:
    sections = make_report(good_documents()).sections
    assert not {"payload", "plan"} & {section.id for section in sections}


def test_a_payload_of_an_older_model_is_refused() -> None:
    parameters, _ = good_documents()
    used = FileId(path=parameters.path, sha256="1" * 64)
    with pytest.raises(ConfigError, match="has changed since") as caught:
        collect([parameters, source("payload.json", payload_file(used))])
    assert "seqid payload" in (caught.value.hint or "")


def test_plans_are_not_compared(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write_json_atomic(tmp_path / name, plan_file())
    with pytest.raises(UsageError, match="is a plan file"):
        compare(tmp_path / "a.json", tmp_path / "b.json")
    write_json_atomic(tmp_path / "c.json", inertia_file())
    with pytest.raises(UsageError, match="is a plan file"):
        compare(tmp_path / "c.json", tmp_path / "a.json")
