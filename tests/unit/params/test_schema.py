from __future__ import annotations

import json

import jsonschema
import pytest

from seqid_cli.params.encode import encode
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests.unit.params.documents import (
    diagnosis_file,
    friction_file,
    full_file,
    gravity_file,
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
