"""When two results count as different, and when not."""

import copy
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seqid_cli.compare.differences import compare
from seqid_cli.compare.rule import Rule
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.comparison import ComparisonFile, Difference
from seqid_cli.params.schema import EffectOfJoint, Parameter, ParameterFile, Verdict
from tests.unit.params.documents import diagnosis_file, full_file, inertia_file

DEFAULT = Rule.of(None, None)


def compared(a: Document, b: Document, rule: Rule = DEFAULT) -> ComparisonFile:
    return compare(Source("a.json", "0", a), Source("b.json", "1", b), rule=rule)


def changed(found: ComparisonFile) -> list[Difference]:
    return [item for item in found.differences if item.different]


def only(found: ComparisonFile) -> Difference:
    (change,) = changed(found)
    return change


def parameters(file: ParameterFile) -> list[Parameter]:
    return file.stages.gravity.parameters


def test_a_file_equals_itself() -> None:
    found = compared(full_file(), full_file())
    assert found.differences
    assert not found.changed
    assert all(item.relative == 0.0 for item in found.differences)


@pytest.mark.parametrize(
    ("moved", "error", "sigma", "rtol", "different"),
    [
        (0.10, 0.01, None, None, True),  # 7 standard errors and 8 %
        (0.05, 0.02, None, None, False),  # 4 %, but within 4 standard errors
        (0.005, 1e-5, None, None, False),  # far beyond its errors, but 0.4 %
        (0.05, 0.02, None, 0.01, True),  # rtol alone decides
        (0.005, 1e-5, None, 0.01, False),
        (0.005, 1e-5, 4.0, None, True),  # sigma alone decides
        (1e-9, 1e-12, 4.0, None, False),  # but never below rounding
        (0.05, 0.02, 1.0, 0.5, False),  # both must be exceeded
        (0.05, 0.02, 1.0, 0.01, True),
        (0.001, 0.0, None, None, False),  # no standard error: the size decides
        (0.1, 0.0, None, None, True),
    ],
)
def test_rule(
    moved: float, error: float, sigma: float | None, rtol: float | None, different: bool
) -> None:
    a, b = inertia_file(), inertia_file()
    parameters(a)[0].std_error = parameters(b)[0].std_error = error
    parameters(b)[0].value += moved
    found = compared(a, b, Rule.of(sigma, rtol))
    assert bool(found.changed) == different
    if different:
        change = only(found)
        assert (change.stage, change.name, change.joint) == ("gravity", "mx_1", "shoulder")
        if error:
            assert change.sigmas == pytest.approx(moved / (math.sqrt(2.0) * error))
        assert change.relative == pytest.approx(moved / (1.25 + moved))


def test_a_missing_parameter_is_a_change() -> None:
    a, b = inertia_file(), inertia_file()
    parameters(b).clear()
    assert only(compared(a, b)).remark == "only in the first"
    assert only(compared(b, a)).remark == "only in the second"


def test_a_missing_stage_is_a_change() -> None:
    a, b = inertia_file(), inertia_file()
    b.stages.imu = None
    change = only(compared(a, b))
    assert (change.stage, change.name) == ("imu", "stage")


def test_surfaces_of_different_coefficients_and_the_same_values_are_equal() -> None:
    """The same friction, over another range and of higher orders."""
    a, b = inertia_file(), inertia_file()
    joint = b.stages.friction.joints["elbow"]
    # 1 + x/3 with x = q / 2 becomes 1 + (2/3) x' over twice the range.
    joint.position_range = [-4.0, 4.0]
    joint.position_order, joint.velocity_order = 2, 1
    joint.positive = joint.negative = [[1.0, 0.0], [2.0 / 3.0, 0.0], [0.0, 0.0]]
    joint.covariance = (1e-8 * np.eye(6)).tolist()
    assert not compared(a, b).changed


def test_a_surface_that_moved_is_told_where_it_moved_most() -> None:
    a, b = inertia_file(), inertia_file()
    assert a.stages.friction is not None
    for file in (a, b):
        file.stages.friction.joints["elbow"].covariance = (1e-6 * np.eye(2)).tolist()
    joint = b.stages.friction.joints["elbow"]
    joint.positive = joint.negative = [[1.1], [1.0 / 3.0 + 0.1]]
    change = only(compared(a, b))
    assert (change.stage, change.joint) == ("friction", "elbow")
    assert change.remark.startswith("at 2,")
    assert change.a is not None
    assert change.b is not None
    assert abs(change.b) - abs(change.a) == pytest.approx(0.2)


@pytest.mark.parametrize(("degrees", "different"), [(0.5, False), (3.0, True)])
def test_mountings_are_compared_by_their_angle(degrees: float, different: bool) -> None:
    a, b = inertia_file(), inertia_file()
    imu = b.stages.imu.imus["imu_a"]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    imu.rotation = (np.array(imu.rotation) @ [[1, 0, 0], [0, c, -s], [0, s, c]]).tolist()
    found = compared(a, b)
    assert bool(found.changed) == different
    angle = next(item for item in found.differences if item.stage == "imu")
    assert angle.b == pytest.approx(degrees)


@pytest.mark.parametrize(("tilt", "different"), [(0.0, False), (3.0, True)])
def test_an_angle_that_is_not_determined_plays_no_part(tilt: float, different: bool) -> None:
    """About the axis of the only joint before an IMU: two installations choose any value."""
    a, b = inertia_file(), inertia_file()
    assert a.stages.imu is not None
    assert b.stages.imu is not None
    one, other = (file.stages.imu.imus["imu_a"] for file in (a, b) if file.stages.imu)
    one.std_errors_deg, other.std_errors_deg = [0.01, 0.01, 140.0], [0.01, 0.01, 140.0]
    turn = Rotation.from_euler("xz", (tilt, 143.0), degrees=True).as_matrix()
    other.rotation = (turn @ np.array(one.rotation)).tolist()
    found = compared(a, b)
    assert bool(found.changed) == different
    angle = next(item for item in found.differences if item.stage == "imu")
    assert angle.b == pytest.approx(tilt, abs=1e-6)


def test_effects_are_compared_by_name_joint_parameters_and_settings() -> None:
    a, b = full_file(), full_file()
    speed = Parameter(name="stribeck_torque", value=1.0, std_error=0.01, unit="N m", joint="elbow")
    a.stages.effects[0].parameters = [speed]
    b.stages.effects[0].parameters = [copy.copy(speed)]
    assert not compared(a, b).changed
    b.stages.effects[0].parameters[0].value = 1.2
    b.stages.effects[0].settings["stribeck_speed"] = 0.2
    names = {item.name for item in changed(compared(a, b))}
    assert names == {"stribeck: stribeck_torque", "stribeck: stribeck_speed"}
    b.stages.effects = [EffectOfJoint(effect="spring", joint="elbow")]
    changes = {(item.name, item.remark) for item in changed(compared(a, b))}
    assert changes == {("stribeck", "only in the first"), ("spring", "only in the second")}


def test_a_verdict_that_turned_is_a_note() -> None:
    a, b = inertia_file(), inertia_file()
    b.stages.friction.verdicts[1] = Verdict(joint="elbow", good=False, reason="too few speeds")
    found = compared(a, b)
    assert not found.changed
    assert found.notes == ["friction: the verdict on elbow is now poor: too few speeds"]


def test_of_several_verdicts_on_a_joint_all_must_be_good() -> None:
    a, b = inertia_file(), inertia_file()
    for each in (a, b):
        hole = Verdict(joint="elbow", good=False, reason="no values for a while")
        each.stages.friction.verdicts = [*each.stages.friction.verdicts, hole]
    assert compared(a, b).notes == []
    a.stages.friction.verdicts.pop()
    note = "friction: the verdict on elbow is now poor: no values for a while"
    assert compared(a, b).notes == [note]


def test_another_robot_file_is_a_note_and_another_robot_an_error() -> None:
    a, b = inertia_file(), inertia_file()
    b.robot.sha256 = "1" * 64
    assert "robot files differ" in compared(a, b).notes[0]
    b.robot.joints = ["shoulder", "wrist"]
    with pytest.raises(ConfigError, match="is about robot 'arm' \\(shoulder, wrist\\)"):
        compared(a, b)


def test_files_of_two_kinds_are_an_error() -> None:
    with pytest.raises(UsageError, match="is a diagnosis file"):
        compared(inertia_file(), diagnosis_file())


def test_diagnoses_are_compared_by_verdict_findings_and_errors() -> None:
    a, b = diagnosis_file(), diagnosis_file()
    assert not compared(a, b).changed
    b.verdict = "nothing_missing"
    b.findings = []
    b.joints["elbow"].rmse = 0.4
    names = {item.name for item in changed(compared(a, b))}
    assert names == {"verdict", "stribeck", "rmse"}


def test_false_alarms_are_as_rare_as_the_rule_says() -> None:
    """Two noisy estimates of the same hundred numbers: an alarm in about one of 160 comparisons."""
    rng = np.random.default_rng(0)
    alarms = 0
    for _ in range(150):
        a, b = inertia_file(), inertia_file()
        for file in (a, b):
            file.stages.friction = file.stages.imu = None
            parameters(file)[:] = [
                Parameter(name=f"m_{k}", value=1.0 + 0.1 * x, std_error=0.1, unit="kg", joint="")
                for k, x in enumerate(rng.normal(size=100))
            ]
        alarms += bool(compared(a, b).changed)
    assert alarms <= 5


def test_surfaces_without_a_common_range_differ() -> None:
    a, b = inertia_file(), inertia_file()
    b.stages.friction.joints["elbow"].speed_range = [2.0, 3.0]
    assert "range of both" in only(compared(a, b)).remark
