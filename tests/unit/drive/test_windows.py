"""Controllers by whole simulated windows: the simulation, its search, what is kept."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seqid_cli import drive as drives
from seqid_cli.drive.friction_table import POSITIONS, SPEEDS, FrictionTable
from seqid_cli.drive.nominal import nominal_stages
from seqid_cli.drive.rollouts.course import arm_motion, courses_of
from seqid_cli.drive.rollouts.errors import bias_of_steps, of_the_prior
from seqid_cli.drive.rollouts.joints import shared
from seqid_cli.drive.rollouts.loop import JointLoop
from seqid_cli.drive.rollouts.solver import (
    Solved,
    errors_of,
    freed,
    mean_squares,
    solved,
    start_slopes,
)
from seqid_cli.drive.rollouts.structures import Structure
from seqid_cli.drive.rollouts.terms import gains
from seqid_cli.drive.rollouts.unknowns import Unknown, Unknowns
from seqid_cli.drive.settings import DriveSettings, WindowSettings
from seqid_cli.drive.signals import signals_of
from seqid_cli.errors import ConfigError
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.driven import drawn_arm, multisine, simulate_drive
from tests.unit.drive.test_drive import arm, file_of, number, recorded, true_values


def urdf_robot() -> Robot:
    """The arm's robot with its true links as a URDF's: rotor and friction are left."""
    return replace(arm().robot, nominal=arm().phi)


@cache
def nominal_loops() -> list[JointLoop]:
    return loops_of(recorded(with_torque=False))


def loops_of(recording: Recording) -> list[JointLoop]:
    robot = urdf_robot()
    model = TorqueModel.from_stages(nominal_stages(robot), robot)
    log = signals_of(recording, model)
    courses = courses_of(
        [arm_motion(log, model)], 0, "interpolated", window_s=1.0, most=100
    )
    return [JointLoop(course=course, friction=None) for course in courses]


def true_numbers() -> dict[str, float]:
    """All that moves the joint, with friction and rotor beside the links.

    The viscous friction is a part of the damping.
    """
    drive = arm().drive
    return {
        "proportional": float(drive.proportional[0]),
        "derivative": float(drive.derivative[0] + arm().viscous[0]),
        "velocity_feedforward": float(drive.velocity_feedforward[0]),
        "gravity_compensation": 1.0,
        "command_delay": drive.command_delay,
        "armature": float(arm().armature[0]),
        "coulomb": float(arm().coulomb[0]),
    }


def rms(loops: list[JointLoop], unknowns: Unknowns, theta: Array) -> float:
    return float(np.sqrt(mean_squares(errors_of(loops, unknowns, theta)).mean()))


def test_the_true_numbers_follow_the_log() -> None:
    known = Unknowns(searched=[], fixed=true_numbers())
    assert rms(nominal_loops(), known, np.zeros((1, 0))) < 1e-4


def test_rough_steps_move_the_joint_alike() -> None:
    known = Unknowns(searched=[], fixed=true_numbers())
    rough = [replace(loop, course=loop.course.rough()) for loop in nominal_loops()]
    assert [loop.course.per_row for loop in rough] < [
        loop.course.per_row for loop in nominal_loops()
    ]
    assert rms(rough, known, np.zeros((1, 0))) < 5e-4


def test_numbers_that_are_off_are_found_again() -> None:
    true = true_numbers()
    names = ("proportional", "derivative", "armature", "coulomb")
    unknowns = Unknowns(
        searched=[
            Unknown(name=name, start=1.3 * true[name], std=1.0) for name in names
        ],
        fixed=true,
    )
    solution = solved(nominal_loops(), unknowns, unknowns.mean)
    found = unknowns.natural(solution.theta[None])[0]
    np.testing.assert_allclose(found, [true[name] for name in names], rtol=0.02)


def test_friction_holds_a_joint_that_stands_whatever_the_law_says() -> None:
    (loop,) = nominal_loops()
    course = loop.course.of(np.array([0]))
    still = np.zeros_like(course.rest)
    at_rest = replace(
        course,
        rest=still,
        slope=still,
        v0=np.zeros(1),
        along=still + course.q0,
        stands=np.ones(1, np.bool_),
    )
    pushed = Unknowns(searched=[], fixed={"coulomb": 0.1, "offset": 1.0})
    held = replace(loop, course=at_rest).run(pushed.values(np.zeros((1, 0))))
    np.testing.assert_allclose(held[0, :, 0], held[0, 0, 0], atol=1e-12)

    moving = replace(at_rest, stands=np.zeros(1, np.bool_))
    slides = replace(loop, course=moving).run(pushed.values(np.zeros((1, 0))))
    assert slides[0, -1, 0] > slides[0, 0, 0] + 0.1


def test_friction_along_known_positions_is_that_of_the_table() -> None:
    rng = np.random.default_rng(5)
    positions = np.linspace(-1.0, 1.0, POSITIONS)
    speeds = np.linspace(0.0, 2.0, SPEEDS)
    forward = 0.3 + 0.1 * np.add.outer(positions**2, speeds)
    table = FrictionTable(positions, speeds, forward, -0.8 * forward)
    q = rng.uniform(-1.0, 1.0, (3, 7))
    v = rng.uniform(-3.0, 3.0, (2, 7))
    for time in range(len(q)):
        found = table.along(q).limits(time, v)
        for side, limits in zip(found, table.limits(q[time], v), strict=True):
            np.testing.assert_allclose(side, limits, atol=1e-12)


def test_where_windows_begin_is_no_error_of_the_numbers() -> None:
    known = Unknowns(searched=[], fixed=true_numbers())
    none = np.zeros(0)
    starts = start_slopes(nominal_loops(), known, none)
    begun_elsewhere = [np.einsum("irb,i->rb", each, [1e-3, -2e-2]) for each in starts]
    for each in freed(begun_elsewhere, starts):
        np.testing.assert_allclose(each, 0.0, atol=1e-9)


def test_a_dead_band_is_no_command() -> None:
    (loop,) = nominal_loops()
    wide = Unknowns(searched=[], fixed=true_numbers() | {"dead_band": 100.0})
    none = Unknowns(searched=[], fixed=true_numbers() | {"proportional": 0.0})
    empty = np.zeros((1, 0))
    np.testing.assert_allclose(
        loop.run(wide.values(empty)), loop.run(none.values(empty))
    )


def test_what_gains_little_or_by_chance_is_not_kept() -> None:
    rng = np.random.default_rng(0)
    before = rng.uniform(1.0, 2.0, 60)
    assert gains(before, 0.9 * before)
    assert not gains(before, 0.99 * before)
    assert not gains(before, before + rng.uniform(-0.5, 0.5, 60))
    # One window that a touch has spoilt decides nothing.
    spoilt = before.copy()
    spoilt[0] = 1e4
    assert not gains(spoilt, before)


def test_few_windows_show_a_large_gain() -> None:
    before = np.array([1.0, 0.1, 0.1, 0.1])
    assert gains(before, 1e-4 * before)
    assert not gains(1e-4 * before, before)


def structure(*, integral: float, judged: float) -> Structure:
    """Parts of a controller with an integral, by the logarithm of the usual one."""
    unknowns = Unknowns(
        searched=[Unknown(name="integral", start=1.0, std=1.0)], fixed=true_numbers()
    )
    solution = solved(nominal_loops(), unknowns, np.zeros(1), rounds=1)
    return Structure(
        unknowns=unknowns,
        solution=replace(solution, theta=np.array([integral])),
        judged=np.full(8, judged),
    )


def test_an_integral_that_is_all_but_zero_is_none() -> None:
    plain = structure(integral=0.0, judged=1.0)
    other_offset = structure(integral=-6.0, judged=0.8)
    assert not other_offset.is_better(plain)
    assert structure(integral=1.0, judged=0.8).is_better(plain)


def without_scale() -> Unknowns:
    """All that moves the joint where gravity may be compensated to any share."""
    true = true_numbers()
    names = (
        "proportional",
        "derivative",
        "velocity_feedforward",
        "armature",
        "coulomb",
    )
    searched = [Unknown(name=name, start=true[name], std=1.0) for name in names]
    gravity = Unknown(name="gravity_compensation", start=0.8, std=0.5, positive=False)
    return Unknowns(searched=[*searched, gravity], fixed=true)


@cache
def plain_loops() -> list[JointLoop]:
    """The same arm where the controller does not compensate gravity."""
    plain = arm().with_drive(gravity_compensation=np.zeros(1))
    moves = multisine(4, 1, 12.0)
    return loops_of(simulate_drive(plain, moves, 12.0, seed=4, with_torque=False))


@cache
def solved_without_scale() -> Solved:
    return solved(plain_loops(), without_scale(), without_scale().mean)


def test_a_scale_that_nothing_shows_is_the_guess() -> None:
    assert of_the_prior(without_scale(), solved_without_scale()).all()


def test_what_steps_make_of_numbers_leaves_their_ratios() -> None:
    solution = solved_without_scale()
    bias = bias_of_steps(plain_loops(), without_scale(), solution)
    assert np.abs(bias).max() < 0.02


def assert_ratios_are_right(file: DriveFile) -> None:
    gain = number(file, "proportional")
    armature = number(file, "armature").value
    assert gain.state == "not_shown"
    assert "log a torque" in gain.reason
    assert gain.value is not None
    assert armature is not None
    links = float(nominal_loops()[0].course.inertia.mean())
    true = arm().drive.proportional[0] / (arm().armature[0] + links)
    assert gain.value / (armature + links) == pytest.approx(true, rel=0.05)


@pytest.mark.slow
def test_without_a_model_the_urdf_stands_for_it() -> None:
    # A controller that compensates gravity hides the only scale.
    plain = arm().with_drive(
        gravity_compensation=np.zeros(1), velocity_feedforward=np.zeros(1)
    )
    log, held_out = (
        simulate_drive(
            plain, multisine(seed, 1, 12.0), 12.0, seed=seed, with_torque=False
        )
        for seed in (4, 31)
    )
    file = drives.drive([log], urdf_robot())
    assert file.method == "motion"
    assert any("URDF" in note for note in file.notes)
    assert_ratios_are_right(file)
    joint = file.joints["joint_1"]
    assert joint.window_rms is not None
    assert joint.window_guess is not None
    assert joint.window_rms < 0.05 * joint.window_guess
    # The file alone moves the robot.
    replayed = drives.replay([held_out], urdf_robot(), file).joints["joint_1"]
    assert replayed.position.rms < 0.1 * replayed.start_plus_change.rms


@pytest.mark.slow
def test_an_integral_is_found_by_motion_and_links_alone() -> None:
    gain = arm().drive.proportional
    integrating = arm().with_drive(
        integral=1.5 * gain,
        gravity_compensation=np.zeros(1),
        velocity_feedforward=np.zeros(1),
    )
    log, held_out = (
        simulate_drive(
            integrating, multisine(seed, 1, 12.0), 12.0, seed=seed, with_torque=False
        )
        for seed in (4, 31)
    )
    file = drives.drive([log], urdf_robot())
    share = number(file, "integral").value / number(file, "proportional").value
    assert share == pytest.approx(1.5, rel=0.05)
    replayed = drives.replay([held_out], urdf_robot(), file).joints["joint_1"]
    assert replayed.position.rms < 0.05 * replayed.start_plus_change.rms


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1012, 1016])
def test_what_is_said_to_be_identified_holds_by_links_alone(seed: int) -> None:
    """Searches from drawn starts took one for a joint that is lifted, one for heavy."""
    of = drawn_arm(seed, 1)
    of = replace(of, robot=replace(of.robot, nominal=of.phi))
    log, held_out = (
        simulate_drive(of, multisine(s, 1, 20.0), 20.0, seed=s, with_torque=False)
        for s in (seed, seed + 1)
    )
    file = drives.drive([log], of.robot)
    true = true_values(of) | {"load_friction": 0.0, "stribeck_speed": 0.0}
    for each in file.joints["joint_1"].parameters:
        if each.state == "identified":
            assert each.low <= true[each.name] <= each.high, each
    replayed = drives.replay([held_out], of.robot, file).joints["joint_1"]
    assert replayed.position.rms < 1e-4


@pytest.mark.slow
def test_compensated_gravity_shows_no_scale() -> None:
    file = drives.drive([recorded(with_torque=False)], urdf_robot())
    assert file.verdicts[0].level == "usable"
    assert_ratios_are_right(file)


def test_a_robot_without_masses_needs_a_model() -> None:
    with pytest.raises(ConfigError, match="names no URDF with inertials"):
        drives.drive([recorded()], arm().robot)


@pytest.mark.slow
def test_a_measured_torque_tells_the_gains() -> None:
    by_rows = drives.drive(
        [recorded()],
        arm().robot,
        file_of(arm()),
        settings=DriveSettings(windows=WindowSettings(most=0.0)),
    )
    file = drives.drive([recorded()], arm().robot, file_of(arm()))
    assert number(file, "proportional") == number(by_rows, "proportional")
    assert by_rows.joints["joint_1"].windows == 0


def test_servos_of_one_type_tell_of_each_other() -> None:
    class Fit:
        def __init__(self, value: float, error: float) -> None:
            self.values = {"proportional": value}
            self.std_errors = {"proportional": error}

    value, std = shared([Fit(10.0, 0.5), Fit(12.0, 0.5), Fit(90.0, 80.0)])[
        "proportional"
    ]
    assert value == pytest.approx(11.0, rel=0.05)
    assert 0.1 < std < 0.3
    assert not shared([Fit(10.0, 0.5)])
