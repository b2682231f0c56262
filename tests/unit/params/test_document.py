"""Documents: what they hold, how numbers are written, and what schemas and readers
refuse.
"""

import json
import math
import re
import tomllib
from functools import reduce
from operator import getitem
from pathlib import Path

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from seqid_cli.errors import ConfigError
from seqid_cli.params import io
from seqid_cli.params.document import (
    join,
    present,
    refined,
    stages_before,
    stale_stages,
    with_stage,
)
from seqid_cli.params.encode import LARGEST, encode, plain
from seqid_cli.params.io import read_parameters, write_json_atomic
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.schema import (
    SCHEMA,
    UNDETERMINED_STD_ERROR,
    EffectOfJoint,
    Stages,
)
from tests import ROOT
from tests.senseless import senseless
from tests.unit.params import documents as made
from tests.unit.params.documents import (
    diagnosis_file,
    full_file,
    gravity_file,
    log,
    robot,
)
from tests.unit.params.generate import (
    DOCUMENTS,
    ROBOT_SCHEMA,
    json_schema,
    schema_path,
)


def test_what_rested_on_a_stage_goes_when_it_is_done_again() -> None:
    file = full_file()
    assert stale_stages(file, ["friction"]) == ("gravity", "inertia", "effects")
    assert stale_stages(file, ["imu"]) == ("inertia", "effects")
    assert stale_stages(file, ["friction", "inertia"]) == ("gravity", "effects")
    assert stale_stages(None, ["friction"]) == ()
    assert stale_stages(made.friction_file(), ["gravity"]) == ()
    again = with_stage(file, robot(), [], friction=made.friction_stage(good=False))
    assert list(present(again.stages)) == ["friction", "imu"]
    assert [item.stage for item in again.inputs] == ["imu"]
    assert again.closed_loop is None


def test_what_came_into_a_refinement_is_kept_where_it_has_changed() -> None:
    before = made.inertia_file()
    old = before.stages
    model = Stages(friction=old.friction, gravity=old.gravity, inertia=old.inertia)
    effects = [EffectOfJoint(effect="stribeck", joint="elbow")]
    assert stages_before(before, Stages(effects=effects)) is None
    assert stages_before(before, replace(old, effects=effects)) is None

    new = Stages(friction=made.friction_stage(good=False), effects=effects)
    assert new.friction != old.friction
    assert stages_before(before, new) == model

    # A second refinement keeps what came into the first.
    loop = replace(made.closed_loop(), incoming=model)
    once = refined(before, robot(), [log("e", "effects")], new, loop)
    assert stages_before(once, Stages(effects=effects)) == model


def test_a_refined_file_keeps_every_input_and_replaces_the_stages() -> None:
    before = made.inertia_file()
    old, effects = before.stages, [EffectOfJoint(effect="stribeck", joint="elbow")]
    friction, inertia = made.friction_stage(good=False), made.rigid_stage("N m")
    new = Stages(friction=friction, inertia=inertia, effects=effects)
    after = refined(before, robot(), [log("e", "effects")], new, made.closed_loop())
    for name, source in (
        ("friction", new),
        ("gravity", old),
        ("imu", old),
        ("effects", new),
    ):
        assert getattr(after.stages, name) == getattr(source, name)
    assert after.inputs == [*before.inputs, log("e", "effects")]
    assert after.closed_loop == made.closed_loop()
    nothing = refined(before, robot(), [], before.stages, made.closed_loop())
    assert nothing.stages.effects == []  # that there are none is said


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_shipped_schema_is_the_generated_one(name: str) -> None:
    shipped = json.loads(schema_path(name).read_text())
    assert shipped == json_schema(name), "run python -m tests.unit.params.generate"
    jsonschema.Draft202012Validator.check_schema(shipped)


def refused_at(name: str, document: object) -> set[str]:
    validator = jsonschema.Draft202012Validator(
        json.loads(schema_path(name).read_text())
    )
    return {error.json_path for error in validator.iter_errors(document)}


def test_the_schema_refuses_what_breaks_the_contract() -> None:
    document = json.loads(encode(full_file())) | {"schema": "seqid/params@2"}
    document["stages"]["inertia"]["surprise"] = 1
    del document["robot"]["sha256"]
    assert refused_at(SCHEMA, document) == {"$.schema", "$.robot", "$.stages.inertia"}
    document = json.loads(encode(diagnosis_file())) | {"verdict": "perhaps"}
    del document["findings"][0]["separate_by"]
    document["joints"]["elbow"]["white"] = 1
    places = {"$.verdict", "$.findings[0]", "$.joints.elbow.white"}
    assert refused_at(DIAGNOSIS_SCHEMA, document) == places


def robot_files() -> list[Path]:
    return sorted((ROOT / "sample_logs").glob("*/robot.toml"))


@pytest.mark.parametrize("path", robot_files(), ids=lambda path: path.parent.name)
def test_the_schema_of_robot_files_takes_the_samples(path: Path) -> None:
    assert refused_at(ROBOT_SCHEMA, tomllib.loads(path.read_text())) == set()


def test_the_schema_of_robot_files_refuses_what_reading_refuses() -> None:
    document = tomllib.loads(robot_files()[0].read_text())
    document["joint"][0]["gear_ration"] = 6.0
    document["gravity"] = [0.0, -9.81]
    places = {"$.joint[0]", "$.gravity"}
    assert refused_at(ROBOT_SCHEMA, document) == places


def test_every_key_of_a_robot_file_is_described() -> None:
    tables = json_schema(ROBOT_SCHEMA)["$defs"]
    assert isinstance(tables, dict)
    bare = {
        (table, key)
        for table, content in tables.items()
        for key, value in content["properties"].items()
        if "description" not in value and "const" not in value
    }
    # Tables of their own say what they are themselves.
    assert bare == {
        ("RobotFile", "imu"),
        ("RobotFile", "effect"),
        ("RobotFile", "channels"),
    }


finite = st.floats(
    allow_nan=False, allow_infinity=False, min_value=-LARGEST, max_value=LARGEST
)
documents = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | finite | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(deadline=None, max_examples=40)
@given(documents, finite)
def test_text_is_json_of_rounded_numbers(document: object, value: float) -> None:
    assert json.loads(encode(document)) == plain(document)
    rounded = plain(value)
    assert isinstance(rounded, float)
    assert rounded == pytest.approx(value, rel=1e-11, abs=0.0)
    assert plain(rounded) == rounded
    assert (
        len(f"{rounded!r}".split("e")[0].lstrip("-0.").replace(".", "").rstrip("0"))
        <= 12
    )


@pytest.mark.parametrize("error", [None, LARGEST, 1e150])
def test_what_no_sample_shows_has_no_error(error: float | None, tmp_path: Path) -> None:
    file = full_file()
    stage = file.stages.gravity
    stage.parameters[0] = replace(stage.parameters[0], std_error=error)
    text = encode(file)
    assert not list(senseless(json.loads(text)))
    (tmp_path / "p.json").write_text(text)
    parameter = read_parameters(tmp_path / "p.json").stages.gravity.parameters[0]
    assert parameter.std_error is None
    assert parameter.uncertainty == UNDETERMINED_STD_ERROR


def test_an_error_of_an_earlier_file_that_nothing_determines_is_none(
    tmp_path: Path,
) -> None:
    document = json.loads(encode(full_file()))
    document["stages"]["gravity"]["parameters"][0]["std_error"] = LARGEST
    (tmp_path / "p.json").write_text(json.dumps(document))
    stage = read_parameters(tmp_path / "p.json").stages.gravity
    assert stage.parameters[0].std_error is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_named(bad: float) -> None:
    stage = made.rigid_stage()
    stage.parameters[0].value = bad
    with pytest.raises(ValueError, match=r"^\$\.parameters\[0\]\.value is -?(nan|inf)"):
        encode(stage)
    with pytest.raises(TypeError, match=r"^\$\.a\[1\] is a complex"):
        encode({"a": [1, 2j]})


def edited(key: str, value: object) -> str:
    """The full file with another value at a place such as `robot.joints.1`."""
    document = json.loads(encode(full_file()))
    *at, last = [int(word) if word.isdigit() else word for word in key.split(".")]
    reduce(getitem, at, document)[last] = value
    return json.dumps(document)


def problem(path: Path, text: str | bytes) -> ConfigError:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(ConfigError) as caught:
        read_parameters(path)
    assert caught.value.where == str(path)
    assert caught.value.hint
    return caught.value


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path, given = tmp_path / "p.json", full_file()
    write_json_atomic(path, given)
    file, before = read_parameters(path), path.read_bytes()
    assert plain(file) == plain(given)
    write_json_atomic(path, file)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "truncated at line 1, column 1"),
        (
            '{"schema": "seqid/params@1",\n "created": nan}',
            "invalid character at line 2, column",
        ),
        ('{\n\n  "a": 1,}', "trailing comma in object at line 3, column 10"),
        (b'{"schema": "\xff"}', "not UTF-8"),
        ("[" * 100_000, "Expected `object`, got `array`"),
        ('{"x":' + "[" * 100_000, "nested too deeply"),
        ("[1, 2]", "Expected `object`, got `array`"),
        (b"\x89MCAP0\r\n", "not valid JSON"),
        ('{"a": 1e999}', "Number out of range"),
        ("{}", "`schema` is missing"),
        ('{"schema": 3}', "`schema` is 3"),
        ('{"schema": "seqid/params@0"}', "`schema` is 'seqid/params@0'"),
        ('{"schema": "seqid/prediction@1"}', "is a prediction file"),
        (
            '{"schema": "seqid/params@7", "stages": []}',
            "newer version seqid/params@7; this seqid",
        ),
    ],
)
def test_what_is_no_parameter_file(
    tmp_path: Path, text: str | bytes, message: str
) -> None:
    assert message in problem(tmp_path / "p.json", text).message


LOOP, ELBOW = "closed_loop", "stages.friction.joints.elbow"
GONE = "$.closed_loop.unconfirmed[0]"
NOT_KEPT = {
    "effect": "spring",
    "joint": "shoulder",
    "accepted": True,
    "confirmed": False,
}
STOPPED = {"rounds": 1, "untried": [{"effect": "spring", "joint": "knee"}]}
SHOWN = f"{LOOP}.rounds.0.evidence"
SESSION, IT = "stages.effects.0.session", "$.stages.effects[0].session"
# a key of the full file, its value, what is said of it, or of another key: $...
WRONG = [
    ("robot.joints.1", 4, "Expected `str`, got `int`"),
    ("stages.inertia.rnak", 4, "$.stages.inertia: Object contains unknown field"),
    ("robot.joints.1", "shoulder", "$.robot.joints: must name each joint"),
    (f"{ELBOW}.positive", [[1.0]], "must have 2 rows of 1"),
    (f"{ELBOW}.sign_width", 0, "must be positive"),
    (f"{ELBOW}.speed_range", [2.0, 1.0], "must be two numbers"),
    (f"{ELBOW}.covariance", [[1.0]], "must be square with 2 rows"),
    (
        f"{ELBOW}.covariance",
        [[1.0, 9.0], [9.0, 2.0]],
        "must have its largest number on the diagonal",
    ),
    ("stages.gravity.covariance", [[1.0, 2.0]], "must be square with 1"),
    ("stages.gravity.parameters.0.std_error", -1, "must not be negative"),
    (
        "stages.gravity.parameters.0.joint",
        "knee",
        "joint 'knee' is none of the robot's: shou",
    ),
    (
        "stages.imu.imus.imu_a.rotation.0.0",
        1.0,
        "$.stages.imu.imus.imu_a.rotation: is no rotation",
    ),
    ("stages.effects.0.joint", "knee", "joint 'knee'"),
    ("stages.effects.0.covariance", [[1.0, 0.0], [0.0, 1.0]], "must be square with 1"),
    (SESSION, {"logs": ["a"], "starts": [0.0, 1.0], "origin": 0.0}, f"{IT}.starts"),
    (SESSION, {"logs": ["a"], "starts": [0.0]}, f"{IT}.origin"),
    (SESSION, {"logs": ["a"], "origin": 5.0}, f"{IT}.origin"),
    (f"{LOOP}.rounds.0.joint", "knee", "joint 'k"),
    (f"{SHOWN}.of", "knee", "joint 'knee'"),
    (f"{SHOWN}.after", [0.1], "$.closed_loop.rounds[0].evidence: x, count, before and"),
    (f"{LOOP}.rounds.0.accepted", False, ""),
    (
        f"{LOOP}.unconfirmed",
        [NOT_KEPT | {"accepted": False}],
        f"{GONE}.accepted: contradicts",
    ),
    (
        f"{LOOP}.unconfirmed",
        [NOT_KEPT | {"confirmed": True}],
        f"{GONE}.confirmed: contradicts",
    ),
    (
        f"{LOOP}.unconfirmed",
        [NOT_KEPT | {"joint": "knee"}],
        f"{GONE}.joint: joint 'knee'",
    ),
    (
        f"{LOOP}.stopped_at",
        STOPPED,
        "$.closed_loop.stopped_at.untried[0].joint: joint 'knee'",
    ),
    (f"{LOOP}.refused.0.interval", [1.0], "mu"),
    (f"{LOOP}.before", {"knee": {"rmse": 1.0}}, "joint 'knee'"),
    (f"{LOOP}.gain_interval.elbow", [0.2, 0.1], "must be two numbers"),
]


@pytest.mark.parametrize(("key", "value", "message"), WRONG)
def test_wrong_content_has_its_key(
    tmp_path: Path, key: str, value: object, message: str
) -> None:
    error = problem(tmp_path / "p.json", edited(key, value))
    named = re.sub(r"\.(\d+)", r"[\1]", f"$.{key}")
    assert error.message.startswith(
        message if message.startswith("$") else f"{named}: {message}"
    )


def test_a_closed_loop_needs_no_more_than_the_contract(tmp_path: Path) -> None:
    rounds, rmse = (
        [{"effect": "stribeck", "joint": "elbow"}, {"effect": "payload"}],
        {"rmse": 0.5},
    )
    older = {"rounds": rounds, "before": {"elbow": rmse}, "after": {"elbow": rmse}}
    older |= {"noise_floor": {"elbow": 0.1}, "evaluated_on": ["v.parquet"]}
    path = tmp_path / "p.json"
    path.write_text(edited("closed_loop", older))
    loop = read_parameters(path).closed_loop
    assert [item.effect for item in loop.rounds if item.accepted] == [
        "stribeck",
        "payload",
    ]
    assert plain(loop.before) == older["before"]


def test_a_missing_file_a_folder_and_a_huge_file(tmp_path: Path) -> None:
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(2**30)
    for path, message in (
        (tmp_path / "no.json", "does not exist"),
        (tmp_path, "is not a file"),
        (Path("a\0b"), "cannot be read|does not exist"),
        (tmp_path / "huge", "the limit is"),
    ):
        with pytest.raises(ConfigError, match=message):
            read_parameters(path)


def test_older_files_are_migrated_in_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "p.json"
    path.write_text(edited("robot.joint_names", []))

    def second(document: dict[str, object]) -> dict[str, object]:
        del document["robot"]["joint_names"]
        return document

    steps = {
        1: second,
        2: lambda x: x | {"schema": "seqid/params@3", "created": "migrated"},
    }
    monkeypatch.setattr(io, "PARAMS_VERSION", 3)
    monkeypatch.setattr(io, "PARAMS_MIGRATIONS", steps)
    file = read_parameters(path)
    assert (file.schema, file.created) == ("seqid/params@3", "migrated")
    del steps[2]
    with pytest.raises(ConfigError, match="old version seqid/params@1"):
        read_parameters(path)


def test_two_branches_are_joined_unless_they_disagree() -> None:
    both = join([("g.json", gravity_file()), ("i.json", made.imu_file())])
    assert both.stages.gravity == gravity_file().stages.gravity
    assert both.stages.imu == made.imu_file().stages.imu
    assert [log.path for log in both.inputs] == ["a", "b", "c"]
    other = gravity_file()
    other.stages.friction.joints["elbow"].rmse = 0.7
    with pytest.raises(
        ConfigError, match=r"h.json: its friction stage differs from .*g\.json"
    ):
        join([("g.json", gravity_file()), ("h.json", other)])
