"""Results that no arm can have are poor, and a stage is good only if all of it is."""

import numpy as np
import pytest
from msgspec.structs import replace

from seqid_cli.identify.friction_surface.checks import friction_verdicts
from seqid_cli.identify.judging import as_a_whole, verdicts_by_earlier
from seqid_cli.identify.log_set import LogSet, _as_warning
from seqid_cli.identify.rigid.gravity_checks import gravity_verdicts
from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
from seqid_cli.inspect.findings import finding_of
from seqid_cli.params.schema import Parameter, RigidStage, Stages, Verdict
from tests.plants.robots.sample import Rig


def poor(verdicts: list[Verdict]) -> list[str]:
    return [verdict.joint for verdict in verdicts if not verdict.good]


@pytest.mark.parametrize("share", [1.0, 2.0])
def test_friction_that_drives_is_poor(one_joint: Rig, share: float) -> None:
    """Friction less a share of its mean level drives where it was small."""
    joint = one_joint.friction.joints["joint_1"]
    D = np.array(joint.positive)
    D[0, 0] -= share * D[0, 0]
    driving = replace(joint, positive=D.tolist(), negative=D.tolist())
    stage = replace(one_joint.friction, joints={"joint_1": driving})
    (verdict,) = friction_verdicts(stage, one_joint.robot)
    assert verdict.joint == "joint_1"
    assert (
        "it would drive the joint. The sign of torque or current is wrong"
        in verdict.reason
    )


@pytest.mark.parametrize("factor", [-1.0, 7.2, 0.1])
def test_gravity_of_another_size_or_sign_is_poor(one_joint: Rig, factor: float) -> None:
    off = {
        name: factor * value for name, value in one_joint.gravity.representative.items()
    }
    wrong = replace(one_joint.gravity, representative=off)
    checks = gravity_verdicts(wrong, one_joint.friction, one_joint.robot)
    verdicts = as_a_whole([*wrong.verdicts, *checks])
    assert poor(verdicts) == ["joint_1", ""]
    assert "gravity in the friction trials" in verdicts[-2].reason
    assert verdicts[-1].reason.endswith("not good: joint_1")


def test_a_stage_is_no_better_than_one_that_it_rests_on(one_joint: Rig) -> None:
    poor_friction = replace(
        one_joint.friction, verdicts=[Verdict(joint="joint_1", good=False, reason="x")]
    )
    stages = Stages(friction=poor_friction, gravity=one_joint.gravity)
    (verdict,) = verdicts_by_earlier("gravity", stages)
    assert verdict.level == "usable"
    assert verdict.reason == "rests on the friction stage, which is poor"
    assert not list(verdicts_by_earlier("friction", stages))
    sound = Stages(friction=one_joint.friction)
    assert one_joint.friction.verdicts
    assert not list(verdicts_by_earlier("inertia", sound))
    assert not list(verdicts_by_earlier("inertia", Stages()))

    # A good stage does not hide another that is not.
    poor_gravity = replace(one_joint.gravity, verdicts=poor_friction.verdicts)
    mixed = Stages(friction=one_joint.friction, gravity=poor_gravity)
    (verdict,) = verdicts_by_earlier("inertia", mixed)
    assert verdict.reason == "rests on the gravity stage, which is poor"


def test_a_whole_is_as_good_as_its_joints() -> None:
    good = Verdict(joint="a", good=True)
    bad = Verdict(joint="b", good=False, level="usable", reason="x")
    assert as_a_whole([]) == []
    assert as_a_whole([good]) == [good]
    *joints, whole = as_a_whole([good, bad])
    assert joints == [good, bad]
    assert (whole.joint, whole.level, whole.reason) == ("", "usable", "not good: b")
    # What is said of the whole already is not said again.
    said = [good, Verdict(good=False, level="usable", reason="rests on another")]
    assert as_a_whole(said) == said


@pytest.mark.parametrize(
    ("value", "error", "expected"), [(-0.0247, 0.0052, ["six"]), (-0.02, 0.01, [])]
)
def test_a_rotor_of_negative_inertia_is_poor(
    one_joint: Rig, value: float, error: float, expected: list[str]
) -> None:
    named = {"name": "Ia_6", "unit": "kg m^2", "joint": "six", "terms": {"Ia_6": 1.0}}
    rotor = Parameter(value=value, std_error=error, **named)
    stage = RigidStage(parameters=[rotor], condition=1.0, rank=1)
    assert poor([*inertia_verdicts(stage, None, one_joint.robot)]) == expected


def test_errors_of_logs_are_verdicts_and_warnings_are_notes(one_joint: Rig) -> None:
    error = finding_of(
        "joints_swapped", "the torque of a is b's", joint="a, b", channel="torque"
    )
    warning = finding_of(
        "torque_saturated", "is at 5 in 3 %", joint="a", channel="current"
    )
    seen = [
        replace(finding, log=name)
        for finding in (error, warning)
        for name in ("x", "y", "z")
    ]
    logs = LogSet(logs=[], robot=one_joint.robot, findings=seen)
    verdicts = logs.verdicts()
    assert poor(verdicts) == ["a", "b"]
    assert verdicts[0].reason.startswith(
        "[joints_swapped] x and 2 more logs: torque the torque"
    )
    assert verdicts[0].reason.endswith(error.remedy)
    assert logs.notes() == [
        "a: [torque_saturated] x and 2 more logs: current is at 5 in 3 %"
    ]


def test_a_warning_of_many_logs_and_joints_is_one_line() -> None:
    jumps = [
        replace(finding_of("position_jump", "jumps by 1", joint, "position"), log=log)
        for log in ("a", "b", "c")
        for joint in ("one", "two")
    ]
    assert _as_warning(jumps) == (
        "a and 2 more logs: [position_jump] one, two position: jumps by 1"
    )
    told = [replace(finding_of("reader", "is odd"), log=log) for log in ("a", "b")]
    assert _as_warning(told) == "a and 1 more log: is odd"
