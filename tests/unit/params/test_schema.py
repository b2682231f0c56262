from __future__ import annotations

import json
import subprocess
import sys

import jsonschema
import pytest

from seqid_cli.params.document import now, tool
from seqid_cli.params.encode import encode
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.results.prediction import (
    PREDICTION_SCHEMA,
    FileId,
    JointError,
    LogPredictionError,
    PredictionFile,
)
from seqid_cli.params.schema import SCHEMA
from tests.unit.params.documents import (
    diagnosis_file,
    friction_file,
    full_file,
    gravity_file,
    log,
    robot,
)
from tests.unit.params.generate import DOCUMENTS, json_schema, schema_path

REMEDY = "run python -m tests.unit.params.generate"


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_shipped_schema_is_the_generated_one(name: str) -> None:
    shipped = json.loads(schema_path(name).read_text())
    assert shipped == json_schema(name), REMEDY
    jsonschema.Draft202012Validator.check_schema(shipped)


def validator(name: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(schema_path(name).read_text()))


@pytest.mark.parametrize("make", [friction_file, gravity_file, full_file])
def test_parameter_files_follow_the_schema(make: type) -> None:
    validator(SCHEMA).validate(json.loads(encode(make())))


def test_the_schema_refuses_what_the_reader_refuses() -> None:
    document = json.loads(encode(full_file()))
    document["schema"] = "seqid/params@2"
    document["stages"]["inertia"]["surprise"] = 1
    del document["robot"]["sha256"]
    found = {error.json_path for error in validator(SCHEMA).iter_errors(document)}
    assert found == {"$.schema", "$.robot", "$.stages.inertia"}


def test_predictions_follow_the_schema() -> None:
    error = JointError(
        rmse=0.1,
        relative_rmse=None,
        max_abs=0.2,
        samples=3,
        rmse_all=None,
        samples_all=3,
        share_sliding=1.0,
    )
    part = LogPredictionError(
        path="v", sha256="0", samples=3, cutoff_hz=12.0, joints={"elbow": error}
    )
    file = PredictionFile(
        schema=PREDICTION_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot(),
        inputs=[log("v", "")],
        parameters=[FileId(path="p.json", sha256="0")],
        stages=["friction"],
        joints={"elbow": error},
        logs=[part],
    )
    validator(PREDICTION_SCHEMA).validate(json.loads(encode(file)))


def test_diagnoses_follow_the_schema_and_the_contract() -> None:
    document = json.loads(encode(diagnosis_file()))
    validator(DIAGNOSIS_SCHEMA).validate(document)
    assert document.keys() >= {"verdict", "findings", "unexplained", "joints"}
    assert document["findings"][0].keys() >= {
        "effect",
        "joint",
        "confidence",
        "explains",
        "confusable_with",
        "separate_by",
    }
    assert document["unexplained"][0].keys() >= {"joint", "depends_on", "share"}
    assert document["joints"]["elbow"].keys() >= {"rmse", "noise_floor", "white"}


def test_the_schema_refuses_a_diagnosis_that_breaks_the_contract() -> None:
    document = json.loads(encode(diagnosis_file()))
    document["verdict"] = "perhaps"
    del document["findings"][0]["separate_by"]
    document["joints"]["elbow"]["white"] = 1
    found = {error.json_path for error in validator(DIAGNOSIS_SCHEMA).iter_errors(document)}
    assert found == {"$.verdict", "$.findings[0]", "$.joints.elbow.white"}


def test_closed_loops_follow_the_contract() -> None:
    document = json.loads(encode(full_file()))["closed_loop"]
    assert document.keys() >= {"rounds", "before", "after", "noise_floor", "evaluated_on"}
    assert document["rounds"][0].items() >= {"effect": "stribeck", "joint": "elbow"}.items()
    assert document["before"] == {"elbow": {"rmse": 0.2}}


def test_params_need_no_numpy() -> None:
    program = (
        "import sys, seqid_cli.params.io, tests.unit.params.generate\n"
        "heavy = {'numpy', 'scipy', 'pinocchio', 'pyarrow'} & sys.modules.keys()\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
