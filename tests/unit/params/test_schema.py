import json

import jsonschema
import pytest

from seqid_cli.params.encode import encode
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests.unit.params.documents import diagnosis_file, full_file
from tests.unit.params.generate import DOCUMENTS, json_schema, schema_path

REMEDY = "run python -m tests.unit.params.generate"


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_shipped_schema_is_the_generated_one(name: str) -> None:
    shipped = json.loads(schema_path(name).read_text())
    assert shipped == json_schema(name), REMEDY
    jsonschema.Draft202012Validator.check_schema(shipped)


def validator(name: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(schema_path(name).read_text()))


def test_the_schema_refuses_what_the_reader_refuses() -> None:
    document = json.loads(encode(full_file()))
    document["schema"] = "seqid/params@2"
    document["stages"]["inertia"]["surprise"] = 1
    del document["robot"]["sha256"]
    found = {error.json_path for error in validator(SCHEMA).iter_errors(document)}
    assert found == {"$.schema", "$.robot", "$.stages.inertia"}


def test_the_schema_refuses_a_diagnosis_that_breaks_the_contract() -> None:
    document = json.loads(encode(diagnosis_file()))
    document["verdict"] = "perhaps"
    del document["findings"][0]["separate_by"]
    document["joints"]["elbow"]["white"] = 1
    found = {error.json_path for error in validator(DIAGNOSIS_SCHEMA).iter_errors(document)}
    assert found == {"$.verdict", "$.findings[0]", "$.joints.elbow.white"}
