"""Settings that are refused, that are shown, and that decide in judging."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import pytest

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS as ALL
from seqid_cli.errors import UsageError
from seqid_cli.identify.friction_surface.checks import friction_verdicts
from seqid_cli.identify.prediction.verdicts import joint_verdicts
from seqid_cli.identify.rigid.cutoff_check import Difference, with_cutoff_check
from seqid_cli.identify.rigid.gravity_checks import gravity_verdicts
from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
from seqid_cli.identify.settings import (
    CutoffCheckSettings,
    FrictionSettings,
    InertiaSettings,
    JudgingSettings,
    PredictionErrorSettings,
)
from seqid_cli.model.torque import standard_parameters
from seqid_cli.params.document import used_settings
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import (
    BandCoverage,
    JointCoverage,
    JointError,
)
from seqid_cli.params.schema import Parameter, RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from seqid_cli.settings import Group, entries, overridden, setting, with_values
from tests import ROOT

ONE_JOINT = ROOT / "sample_logs" / "one_joint"


@pytest.mark.parametrize("name", sorted(ALL))
def test_every_setting_has_unit_reason_and_bounds_around_its_default(name: str) -> None:
    shown = list(entries(ALL[name]))
    assert shown
    for entry in shown:
        assert entry.unit
        assert entry.reason
        assert "\n" not in entry.reason
        assert entry.low <= entry.default <= entry.high
        assert not entry.changed
        # Both ends of its bounds are possible numbers.
        for end in (entry.low, entry.high):
            changed = overridden(ALL[name], [f"{entry.name}={end!r}"])
            values = {one.name: one.value for one in entries(changed)}
            assert values[entry.name] == end
            # A value below its default is changed as well as one above.
            told = [one.name for one in entries(changed) if one.changed]
            assert told == ([entry.name] if end != entry.default else [])


def test_settings_are_few() -> None:
    """As many as deserve it: they are read by people, in a table on the screen."""
    kinds = {
        (type(getattr(own, name)), name)
        for own in ALL.values()
        for name in own.__dataclass_fields__
    }
    assert sum(len(kind.__dataclass_fields__) for kind, _ in kinds) < 75


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("judging.max_factor=3", "Did you mean judging.max_gravity_factor"),
        ("max_gravity_factor=3", "Did you mean judging.max_gravity_factor"),
        ("some_group_of_numbers_with_a_long_name.clear_sigma=3", "judging.clear_sigma"),
        ("nothing.like=3", "--show-settings lists all of them"),
        ("judging=3", "Did you mean judging."),
        ("judging.max_gravity_factor", "Give a name and a number"),
        ("judging.max_gravity_factor=", "from 1.01 to 1e+06"),
        ("judging.max_gravity_factor=big", "the default is 2.5"),
        ("judging.max_gravity_factor=nan", "from 1.01 to 1e+06"),
        ("judging.max_gravity_factor=inf", "from 1.01 to 1e+06"),
        ("judging.max_gravity_factor=-3", "from 1.01 to 1e+06"),
    ],
)
def test_what_is_no_setting_is_refused_with_what_to_do(text: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        overridden(FrictionSettings(), [text])
    assert text in caught.value.message
    assert said in caught.value.hint
    assert caught.value.exit_code == 2


@dataclass(frozen=True, kw_only=True)
class Counted(Group):
    """Settings of a whole number and of another."""

    least_count: int = setting(2, unit="logs", reason="a few", low=1, high=9)
    largest_share: float = setting(0.5, unit="of all", reason="some", low=0.0, high=1.0)


def test_a_document_brings_its_numbers_back() -> None:
    """What is no setting any more is left out."""
    document = {"judging.max_gravity_factor": 3.0, "judging.gone": 1.0}
    settings = with_values(FrictionSettings(), document)
    assert settings.judging.max_gravity_factor == 3.0
    assert [one.name for one in entries(settings) if one.changed] == [
        "judging.max_gravity_factor"
    ]


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "3", None, True])
def test_no_bad_number_gets_into_a_group(value: Any) -> None:
    with pytest.raises(UsageError, match="max_gravity_factor"):
        JudgingSettings(max_gravity_factor=value)


def test_a_number_of_things_is_a_whole_one() -> None:
    """A group says which of both it takes."""
    with pytest.raises(UsageError, match=r"least_count is no whole number: 2\.5"):
        Counted(least_count=2.5)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="largest_share is no number: 'a'"):
        Counted(largest_share="a")  # type: ignore[arg-type]
    assert Counted(least_count=3, largest_share=1).least_count == 3


def test_the_result_says_what_was_changed_and_all_that_was_in_force() -> None:
    given = ["residual.poor_share=0.2", "judging.clear_sigma=4.0"]
    used = used_settings(overridden(InertiaSettings(), given))
    assert used.changed == {"residual.poor_share": 0.2}
    assert used.values["residual.poor_share"] == 0.2
    assert len(used.values) == len(list(entries(InertiaSettings())))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(ONE_JOINT / "robot.toml")


@pytest.fixture(scope="module")
def stages() -> Stages:
    return read_parameters(ONE_JOINT / "golden.json").stages


def scaled(stage: RigidStage, factor: float) -> RigidStage:
    values = {name: factor * x for name, x in stage.representative.items()}
    return msgspec.structs.replace(stage, representative=values)


def nominal(robot: Robot, stages: Stages, factor: float, turn: float = 0.0) -> Robot:
    """Return the robot with inertials of a gravity that is `factor` times, and turned
    [rad].
    """
    links = factor * standard_parameters(stages.gravity, robot.n)[0]
    c, s = np.cos(turn), np.sin(turn)
    links[:, 1:3] = links[:, 1:3] @ np.array([[c, s], [-s, c]])
    return replace(robot, nominal=links)


def poor(verdicts: Iterable[Verdict]) -> bool:
    return any(not verdict.good for verdict in verdicts)


def gravity_is_poor(robot: Robot, stages: Stages, **limits: float) -> bool:
    settings = JudgingSettings(**limits)
    return poor(gravity_verdicts(stages.gravity, stages.friction, robot, settings))


@pytest.mark.parametrize(
    ("factor", "turn", "setting", "value"),
    [
        (2.0, 0.0, "max_gravity_factor", 1.25),
        (1.0, 1.0, "min_gravity_correlation", 0.8),
    ],
)
def test_gravity_of_the_inertials_is_judged_by_settings(
    robot: Robot, stages: Stages, factor: float, turn: float, setting: str, value: float
) -> None:
    arm = nominal(robot, stages, factor, turn)
    assert not gravity_is_poor(arm, stages)
    assert gravity_is_poor(arm, stages, **{setting: value})


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("max_gravity_factor", 10.0),
        ("light_share", 1.0),
        ("min_gravity_torque", 1000.0),
    ],
)
def test_gravity_that_is_far_off_may_be_allowed(
    robot: Robot, stages: Stages, setting: str, value: float
) -> None:
    arm = nominal(robot, stages, 5.0)
    assert gravity_is_poor(arm, stages)
    assert not gravity_is_poor(arm, stages, **{setting: value})


def test_gravity_of_two_stages_is_judged_by_settings(
    robot: Robot, stages: Stages
) -> None:
    off = msgspec.structs.replace(stages, gravity=scaled(stages.gravity, 1.1))
    assert not gravity_is_poor(robot, off)
    assert gravity_is_poor(robot, off, max_gravity_difference=0.05)


@pytest.mark.parametrize("setting", ["driving_share", "driving_cells"])
def test_friction_that_drives_is_judged_by_settings(
    robot: Robot, stages: Stages, setting: str
) -> None:
    (name,) = stages.friction.joints
    joint = stages.friction.joints[name]
    D = np.array(joint.positive)
    D[0, 0] -= D[0, 0]
    driving = msgspec.structs.replace(
        joint, positive=D.tolist(), negative=D.tolist(), gravity=[]
    )
    stage = msgspec.structs.replace(stages.friction, joints={name: driving})
    most = {"driving_share": 10.0, "driving_cells": 0.999}
    loose = JudgingSettings(**{setting: most[setting]})
    assert poor([*friction_verdicts(stage, robot)])
    assert not poor([*friction_verdicts(stage, robot, loose)])


def test_a_negative_rotor_is_judged_by_settings(robot: Robot) -> None:
    rotor = Parameter(
        name="Ia_6",
        value=-0.0247,
        std_error=0.0052,
        unit="kg m^2",
        joint="six",
        terms={"Ia_6": 1.0},
    )
    stage = RigidStage(parameters=[rotor], condition=1.0, rank=1)
    assert poor([*inertia_verdicts(stage, None, robot)])
    assert not poor(
        [*inertia_verdicts(stage, None, robot, JudgingSettings(clear_sigma=6.0))]
    )


def test_a_parameter_that_depends_on_the_cutoff_is_judged_by_settings(
    robot: Robot,
) -> None:
    basis = free_basis(robot)
    one = Parameter(name=basis.names[0], value=1.0, std_error=0.1, unit="kg m^2")
    stage = RigidStage(parameters=[one], condition=1.0, rank=1)
    differences = [Difference(place=0, multiple=0.7, n_errors=3.5)]
    loose = CutoffCheckSettings(usable_sigma=4.5)
    assert poor(with_cutoff_check(stage, differences, basis).verdicts)
    assert not poor(with_cutoff_check(stage, differences, basis, loose).verdicts)


@pytest.mark.parametrize(
    ("level", "settings"),
    [
        ("poor", {"max_relative_rmse": 0.1}),
        ("usable", {"min_band_share": 0.89}),
        ("good", {}),
    ],
)
def test_a_prediction_is_judged_by_settings(
    robot: Robot, stages: Stages, level: str, settings: dict[str, float]
) -> None:
    band = BandCoverage(band_90=0.82, band_95=0.9, samples=10**6, blocks=10**5)
    error = JointError(
        rmse=0.1,
        relative_rmse=0.15,
        max_abs=0.4,
        samples=10**6,
        rmse_all=0.1,
        samples_all=10**6,
        share_sliding=1.0,
        coverage=JointCoverage(overall=band),
    )
    limits = PredictionErrorSettings(**settings)
    # That there is a calibration is all that counts here, not what it says.
    calibrated: Any = True
    inertia = msgspec.structs.replace(stages.inertia, bands=calibrated)
    stages = msgspec.structs.replace(stages, inertia=inertia)
    joints = dict.fromkeys(robot.joint_names, error)
    (verdict,) = joint_verdicts(joints, stages, robot, settings=limits)
    assert verdict.level == level, verdict.reason


def test_a_group_says_what_its_numbers_are() -> None:
    with pytest.raises(UsageError) as caught:
        JudgingSettings(clear_sigma=100.0)
    assert caught.value.message == "clear_sigma is out of bounds: 100"
    assert "from 0.5 to 20 (standard errors); the default is 4" in caught.value.hint
