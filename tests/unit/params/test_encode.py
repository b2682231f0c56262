import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.model.effects.units import UNTOLD
from seqid_cli.params.encode import LARGEST, encode, plain
from seqid_cli.params.io import read_parameters
from tests.unit.params.documents import full_file, rigid_stage

finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-LARGEST, max_value=LARGEST)
documents = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | finite | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(documents)
def test_text_is_json_of_the_rounded_document(document: object) -> None:
    assert json.loads(encode(document)) == plain(document)


@given(finite)
def test_twelve_digits_are_kept_and_rounding_is_final(value: float) -> None:
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


def test_a_value_without_json_form_is_named() -> None:
    with pytest.raises(TypeError, match=r"^\$\.a\[1\] is a complex"):
        encode({"a": [1, 2j]})


def test_stages_that_are_not_there_are_left_out() -> None:
    file = full_file()
    file.stages.gravity = None
    document = json.loads(encode(file))
    assert list(document["stages"]) == ["friction", "imu", "inertia", "effects"]
    assert document["stages"]["friction"]["cutoff_hz"] is None
    assert document["closed_loop"]["rounds"][0]["effect"] == "stribeck"
