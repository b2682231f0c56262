"""Documents: what they hold, how numbers are written, and what schemas and readers refuse."""

import json
import math
import re
from pathlib import Path

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seqid_cli import __version__
from seqid_cli.model.effects.units import UNTOLD
from seqid_cli.params.document import present, refined, stale_stages, with_stage
from seqid_cli.params.encode import LARGEST, encode, plain
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.schema import SCHEMA, EffectOfJoint, Stages
from tests.unit.params.documents import (
    closed_loop,
    diagnosis_file,
    friction_file,
    friction_stage,
    full_file,
    inertia_file,
    log,
    rigid_stage,
    robot,
)
from tests.unit.params.generate import DOCUMENTS, json_schema, schema_path


def test_a_stage_is_added_to_what_was_there() -> None:
    before = friction_file()
    after = with_stage(before, robot(), [log("b", "gravity")], gravity=rigid_stage())
    assert after.stages.friction == before.stages.friction
    assert after.stages.gravity == rigid_stage()
    assert [f"{item.path} {item.stage}" for item in after.inputs] == ["a friction", "b gravity"]
    assert before.stages.gravity is None
    assert after.tool.version == __version__
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", after.created)


def test_what_rested_on_a_stage_goes_when_it_is_done_again() -> None:
    file = full_file()
    assert stale_stages(file, ["friction"]) == ("gravity", "inertia", "effects")
    assert stale_stages(file, ["imu"]) == ("inertia", "effects")
    assert stale_stages(file, ["friction", "inertia"]) == ("gravity", "effects")
    assert stale_stages(None, ["friction"]) == ()
    assert stale_stages(friction_file(), ["gravity"]) == ()
    again = with_stage(file, robot(), [], friction=friction_stage(good=False))
    assert list(present(again.stages)) == ["friction", "imu"]
    assert [item.stage for item in again.inputs] == ["imu"]
    assert again.closed_loop is None


def test_a_refined_file_keeps_every_input_and_replaces_the_stages() -> None:
    before = inertia_file()
    new = Stages(
        friction=friction_stage(good=False),
        inertia=rigid_stage("N m"),
        effects=[EffectOfJoint(effect="stribeck", joint="elbow")],
    )
    after = refined(before, robot(), [log("e", "effects")], new, closed_loop())
    assert after.stages.friction == new.friction
    assert after.stages.gravity == before.stages.gravity
    assert after.stages.imu == before.stages.imu
    assert after.stages.effects == new.effects
    assert after.inputs == [*before.inputs, log("e", "effects")]
    assert after.closed_loop == closed_loop()
    nothing = refined(before, robot(), [], before.stages, closed_loop())
    assert nothing.stages.effects == []  # that there are none is said


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_shipped_schema_is_the_generated_one(name: str) -> None:
    shipped = json.loads(schema_path(name).read_text())
    assert shipped == json_schema(name), "run python -m tests.unit.params.generate"
    jsonschema.Draft202012Validator.check_schema(shipped)


def refused_at(name: str, document: object) -> set[str]:
    validator = jsonschema.Draft202012Validator(json.loads(schema_path(name).read_text()))
    return {error.json_path for error in validator.iter_errors(document)}


def test_the_schema_refuses_what_breaks_the_contract() -> None:
    document = json.loads(encode(full_file()))
    document["schema"] = "seqid/params@2"
    document["stages"]["inertia"]["surprise"] = 1
    del document["robot"]["sha256"]
    assert refused_at(SCHEMA, document) == {"$.schema", "$.robot", "$.stages.inertia"}
    document = json.loads(encode(diagnosis_file()))
    document["verdict"] = "perhaps"
    del document["findings"][0]["separate_by"]
    document["joints"]["elbow"]["white"] = 1
    places = {"$.verdict", "$.findings[0]", "$.joints.elbow.white"}
    assert refused_at(DIAGNOSIS_SCHEMA, document) == places


finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-LARGEST, max_value=LARGEST)
documents = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | finite | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@settings(deadline=None, max_examples=40)
@given(documents, finite)
def test_text_is_json_of_the_document_rounded_once_to_twelve_digits(
    document: object, value: float
) -> None:
    assert json.loads(encode(document)) == plain(document)
    rounded = plain(value)
    assert isinstance(rounded, float)
    assert rounded == pytest.approx(value, rel=1e-11, abs=0.0)
    assert plain(rounded) == rounded
    assert len(f"{rounded!r}".split("e")[0].lstrip("-0.").replace(".", "").rstrip("0")) <= 12


def test_what_no_sample_shows_is_written_as_a_file_may_hold_it(tmp_path: Path) -> None:
    file = full_file()
    file.stages.gravity.parameters[0].std_error = 1e150
    (tmp_path / "model.json").write_text(encode(file))
    stage = read_parameters(tmp_path / "model.json").stages.gravity
    assert stage.parameters[0].std_error == LARGEST == UNTOLD


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_named(bad: float) -> None:
    stage = rigid_stage()
    stage.parameters[0].value = bad
    with pytest.raises(ValueError, match=r"^\$\.parameters\[0\]\.value is -?(nan|inf)"):
        encode(stage)
    with pytest.raises(TypeError, match=r"^\$\.a\[1\] is a complex"):
        encode({"a": [1, 2j]})


def test_stages_that_are_not_there_are_left_out() -> None:
    file = full_file()
    file.stages.gravity = None
    document = json.loads(encode(file))
    assert list(document["stages"]) == ["friction", "imu", "inertia", "effects"]
    assert document["stages"]["friction"]["cutoff_hz"] is None
    assert document["closed_loop"]["rounds"][0]["effect"] == "stribeck"
