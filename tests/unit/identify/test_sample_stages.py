"""Every stage on the sample logs, against the truth that the logs do not say."""

import numpy as np
import pytest

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.imu_calibration import calibrate_imus
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.parameters import missing_pairs
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from tests.plants.arms import rigs as plants
from tests.plants.robots.sample import Rig, sample_rig

SLOW_SIX = pytest.param("six_joint", marks=pytest.mark.slow)


@pytest.mark.parametrize("name", ["one_joint", "two_joint", SLOW_SIX])
def test_friction_surfaces_are_the_true_ones_where_the_trials_were(name: str) -> None:
    rig, acceleration = sample_rig(name), getattr(plants, name)().acceleration_limits
    for j, (name, joint) in enumerate(rig.friction.joints.items()):
        surface, table = FrictionSurface.from_stage(joint), rig.truth["friction"][name]
        grid = np.meshgrid(table["position"], table["velocity"], indexing="ij")
        q, v, torque = (np.ravel(x) for x in (*grid, table["torque"]))
        low, high = surface.scaling.position
        slow, fast = surface.scaling.speed
        ramp = 1.1 * v**2 / (2 * acceleration[j])  # of the range, to get to the speed
        own = np.abs(q - (low + high) / 2) <= (high - low) / 2 - ramp
        own &= (np.abs(v) >= slow) & (np.abs(v) <= 1.001 * fast)
        assert own.sum() > 200
        q, v, torque = q[own], v[own], torque[own]
        error = surface.torque(q, v) - torque
        F = surface.columns(q, v)
        z = error / np.sqrt(np.einsum("ni,ij,nj->n", F, surface.covariance, F))
        assert np.sqrt(np.mean(z**2)) < 1.5, name
        assert np.mean(np.abs(z) > 4) < 0.01, name
        assert np.sqrt(np.mean(error**2)) < 0.03 * np.sqrt(np.mean(torque**2)), name


def within(rig: Rig, stage: RigidStage, sigmas: float) -> list[bool]:
    return [
        abs(p.value - rig.true_value(p)) < sigmas * p.std_error
        for p in stage.parameters
    ]


@pytest.mark.parametrize(
    ("name", "count"),
    [("one_joint", 2), pytest.param("six_joint", 10, marks=pytest.mark.slow)],
)
def test_gravity_parameters_are_the_true_ones(name: str, count: int) -> None:
    rig = sample_rig(name)
    stage = rig.gravity
    assert stage.rank == stage.structural_rank == len(stage.parameters) == count
    assert stage.not_excited == []
    assert all(within(rig, stage, 4.0))
    errors = np.sqrt(np.diag(stage.covariance))
    assert errors.tolist() == pytest.approx([p.std_error for p in stage.parameters])
    largest = max(stage.parameters, key=lambda p: abs(rig.true_value(p)))
    assert largest.name.startswith("mx_")
    assert largest.value == pytest.approx(rig.true_value(largest), rel=0.01)
    assert {p.unit for p in stage.parameters} == {"kg m"}


def test_gravity_of_the_planar_arm_is_empty_and_says_so(two_joint: Rig) -> None:
    stage = two_joint.gravity
    assert (stage.parameters, stage.rank) == ([], 0)
    assert any("gravity loads no joint" in note for note in stage.notes)


@pytest.mark.parametrize(("name", "rank"), [("one_joint", 3), ("two_joint", 4)])
def test_inertia_of_the_papers_rigs_is_within_a_percent(name: str, rank: int) -> None:
    rig = sample_rig(name)
    stage = rig.inertia
    assert stage.rank == stage.structural_rank == rank
    for p in stage.parameters:
        true = rig.true_value(p)
        alike = [abs(rig.true_value(x)) for x in stage.parameters if x.unit == p.unit]
        assert abs(p.value - true) < 0.01 * (abs(true) or max(alike)), p.name
    assert all(within(rig, stage, 4.0))


@pytest.mark.slow
def test_six_joint_parameters_are_true_and_of_full_rank(six_joint: Rig) -> None:
    stage = six_joint.inertia
    assert stage.rank == stage.structural_rank == 36
    assert stage.not_excited == stage.missing_pairs == []
    # Its encoders are fine: of each log the source of the smaller error counts.
    assert len(stage.motion) == 15
    assert set(stage.motion.values()) <= {"encoder", "fused: imu_a, imu_b"}
    assert stage.rotor_coupling == "diagonal"
    names = {p.name for p in stage.parameters} | {
        p.name for p in six_joint.gravity.parameters
    }
    good = within(six_joint, six_joint.gravity, 3.0) + within(six_joint, stage, 3.0)
    assert len(names) == len(good) == 36
    assert np.mean(good) >= 0.95


@pytest.mark.slow
def test_imu_mountings_are_found_within_a_third_of_a_degree(six_joint: Rig) -> None:
    assert set(six_joint.imu.imus) == {"imu_a", "imu_b"}
    for name, found in six_joint.imu.imus.items():
        true = np.array(six_joint.truth["imus"][name]["R_link_from_imu"])
        turn = np.array(found.rotation) @ true.T
        assert np.degrees(np.arccos(min(1.0, (np.trace(turn) - 1) / 2))) < 0.3
        assert found.std_error_deg < 0.3
        assert found.not_determined == []


def test_a_mounting_about_parallel_axes_is_called_undetermined(two_joint: Rig) -> None:
    """All axes of the planar arm, and gravity, are parallel: the first link's angle
    stays open.
    """
    first, second = (two_joint.imu.imus[name] for name in ("imu_a", "imu_b"))
    assert first.not_determined[0].startswith("the angle about the link's axis")
    assert first.lever == [None] * 3
    # The distance between the axes shows the second link's.
    assert second.not_determined == ["the lever along the link's z is not determined"]
    for name, found in two_joint.imu.imus.items():
        true = np.array(two_joint.truth["imus"][name]["R_link_from_imu"])
        axis = np.array(found.rotation).T @ [0.0, 0.0, 1.0]
        assert np.degrees(np.arccos(axis @ true.T @ [0.0, 0.0, 1.0])) < 0.5
    # No joint before either IMU turns about another axis, so that it does no harm.
    assert all(verdict.good for verdict in two_joint.imu.verdicts)
    assert "does not matter" in two_joint.imu.verdicts[0].reason


def test_imus_do_better_than_the_coarse_encoder_alone(two_joint: Rig) -> None:
    """Table II of the paper: which motion the inertia is identified from matters."""
    encoder = two_joint.inertia_of(two_joint.logs("inertia"), source="encoder")
    for fused, alone in zip(
        two_joint.inertia.parameters, encoder.parameters, strict=True
    ):
        assert fused.std_error < alone.std_error
    assert set(encoder.motion.values()) == {"encoder"}


@pytest.mark.slow
def test_one_pair_alone_leaves_parameters_open_and_names_them(six_joint: Rig) -> None:
    logs = [
        log for log in six_joint.logs("inertia") if log.path.stem == "elbow__wrist_1"
    ]
    stage = six_joint.inertia_of(logs)
    assert stage.rank < stage.structural_rank == 36
    assert stage.missing_pairs
    open_names = {text.split()[0].lstrip("-") for text in stage.not_excited}
    named = {p.name for p in stage.parameters}
    assert open_names
    assert not open_names & named
    assert open_names | named == {p.name for p in six_joint.inertia.parameters}
    assert any(not verdict.good and not verdict.joint for verdict in stage.verdicts)
    assert "not excited" in "\n".join(stage.notes)


def test_pairs_for_an_arm_of_which_nothing_is_known(
    six_joint: Rig, one_joint: Rig
) -> None:
    """With gravity known before, random states of the pairs show every base
    parameter.
    """
    robot = six_joint.robot
    basis = base_parameters(robot, rotor=())
    pairs = missing_pairs(robot, basis, np.eye(basis.size))
    assert len({tuple(pair) for pair in pairs}) == len(pairs)
    rng, rows = np.random.default_rng(1), [np.eye(basis.size)[basis.gravity]]
    for pair in pairs:
        moving = [robot.joint_names.index(name) for name in pair]
        q = rng.uniform(-2.5, 2.5, (200, robot.n))
        dq, ddq = np.zeros((2, *q.shape))
        dq[:, moving], ddq[:, moving] = rng.normal(size=(2, 200, len(moving)))
        rows += [*base_regressor(robot, basis, q, dq, ddq)[:, moving]]
    W = np.vstack(rows)
    assert (
        np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0).clip(1e-12), tol=1e-6)
        == basis.size
    )
    basis = base_parameters(one_joint.robot, rotor=())
    assert missing_pairs(one_joint.robot, basis, np.eye(basis.size)) == [["joint_1"]]
    assert missing_pairs(one_joint.robot, basis, np.zeros((basis.size, 0))) == []


def test_logs_and_stages_that_lack_something_are_refused(
    one_joint: Rig, six_joint: Rig
) -> None:
    drills, robot = one_joint.logs("friction"), one_joint.robot
    for stage, options in (
        (identify_gravity, {}),
        (identify_inertia, {"options": InertiaOptions()}),
    ):
        with pytest.raises(UsageError, match="friction stage"):
            stage(drills, robot, Stages(), **options)
    with pytest.raises(
        QualityError, match="needs at least 13 speeds, these logs hold 12"
    ):
        identify_friction(drills, robot, options=FrictionOptions(velocity_order=12))
    robot, validation = six_joint.robot, six_joint.logs("validation")[:1]
    with pytest.raises(QualityError, match="moves by itself at constant velocity"):
        identify_friction(validation, robot, options=FrictionOptions())
    with pytest.raises(QualityError, match="no log moves a joint before this IMU"):
        calibrate_imus(six_joint.logs("friction")[:1], robot, options=MotionOptions())
