"""Refinement of the one-joint sample arm: when an effect came, and what follows from it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm, excess_note
from seqid_cli.discover.refinement.held_out import (
    Gain,
    HeldOutError,
    gain,
    gain_of,
    likelier,
)
from seqid_cli.discover.refinement.loop import ALL_ALONG, LATE
from seqid_cli.discover.refinement.rounds import quiet, refine
from seqid_cli.discover.survey.events import Interval
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.gear_load import ROTOR
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.studies.loop.logs import Case, recorded
from tests.studies.undeclared.logs import sequential
from tests.studies.undeclared.refine import file_of

SAMPLES = ROOT / "sample_logs" / "one_joint"
STIFFNESS, REST = 0.0046265, 0.26  # N m/rad and rad, as truth.json has them
Earlier = dict[str, list[Recording]]


@cache
def robot() -> Robot:
    return load_robot(SAMPLES / "robot.toml")


@cache
def log(name: str) -> Recording:
    return read_recording(SAMPLES / name, robot())


def sprung(recording: Recording) -> Recording:
    """The log with a spring at the joint."""
    return replace(recording, tau=recording.tau + STIFFNESS * (recording.q - REST))


def identified(earlier: Earlier) -> ParameterFile:
    """The stages of an arm as its first logs show it."""
    friction = identify_friction(earlier["friction"], robot(), options=FrictionOptions())
    stages = Stages(friction=friction)
    stages.gravity = identify_gravity(earlier["gravity"], robot(), stages)
    inertia = identify_inertia(earlier["inertia"], robot(), stages, options=InertiaOptions())
    return with_stage(
        None, robot_id(robot()), [], friction=friction, gravity=stages.gravity, inertia=inertia
    )


def first_logs() -> Earlier:
    trial = log("friction/joint_1.parquet")
    return {
        "friction": [trial],
        "gravity": [log("gravity/joint_1.parquet"), trial],
        "inertia": [log("inertia/joint_1.parquet")],
    }


def changed(*names: str) -> list[Recording]:
    return [log(f"changed/{name}.parquet") for name in names]


@pytest.fixture(scope="module")
def before() -> ParameterFile:
    return identified(first_logs())


@pytest.mark.slow
def test_what_came_late_leaves_the_file_as_it_is(
    before: ParameterFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    training, held_out = changed("fourier", "trapezoids"), changed("held_out")
    found = refine(training, robot(), before, earlier=first_logs(), options=DiscoverOptions())
    stages, loop = found.stages, confirm(found, held_out)
    assert [(r.effect, r.accepted, r.reason) for r in loop.rounds] == [("spring", True, LATE)]
    assert stages.gravity == before.stages.gravity
    assert stages.inertia == before.stages.inertia
    assert stages.friction == before.stages.friction
    value = {p.name: p.value for p in stages.effects[0].parameters}
    assert value["stiffness"] == pytest.approx(STIFFNESS, rel=0.1)
    assert loop.gain_interval["joint_1"][0] > 0.5
    low, high = loop.noise_floor_interval["joint_1"]
    assert low < loop.noise_floor["joint_1"] < high
    assert low < loop.after["joint_1"].rmse
    assert [r.confirmed for r in loop.rounds] == [True]
    assert loop.verdict == "good"
    assert not any("doubtful" in note for note in loop.notes)
    left = np.array([loop.after["joint_1"].rmse])
    above = NoiseFloor(2.0 * left, 1.1 * left, 3.0 * left)
    monkeypatch.setattr("seqid_cli.discover.refinement.confirm.noise_floor", lambda *_, **__: above)
    doubtful = confirm(found, held_out)
    assert doubtful.noise_floor["joint_1"] == 2.0 * left[0] > doubtful.after["joint_1"].rmse
    assert any("doubtful" in note for note in doubtful.notes)


@pytest.mark.slow
def test_what_was_there_all_along_is_taken_out_of_every_stage() -> None:
    logs = {stage: [sprung(x) for x in logs] for stage, logs in first_logs().items()}
    file = identified(logs)
    training, held_out = changed("fourier", "trapezoids"), changed("held_out")
    found = refine(training, robot(), file, earlier=logs, options=DiscoverOptions())
    stages, loop = found.stages, confirm(found, held_out)
    assert [(r.effect, r.accepted, r.reason) for r in loop.rounds] == [("spring", True, ALL_ALONG)]
    assert stages.gravity != file.stages.gravity
    assert stages.inertia != file.stages.inertia
    assert loop.verdict == "good"
    assert loop.gain_interval["joint_1"][0] > 0.0


def test_events_are_not_fitted() -> None:
    logs = changed("fourier", "trapezoids")
    push = Interval(scene=1, start=2.0, end=3.0, joints=(0,), score=1.0)
    first, second = quiet(logs, [push])
    np.testing.assert_array_equal(first.valid, logs[0].valid)
    t = second.t - second.t[0]
    assert not second.valid[(t >= 2.0) & (t <= 3.0)].any()
    outside = (t < 2.0) | (t > 3.0)
    np.testing.assert_array_equal(second.valid[outside], logs[1].valid[outside])


def blocks(squares: Sequence[Sequence[float]]) -> HeldOutError:
    values, zero = np.array(squares, dtype=float), np.zeros(np.shape(squares))
    return HeldOutError(values, np.ones_like(values), zero, zero)


@pytest.mark.parametrize(("first", "second", "better"), [(9.0, 0.2, True), (2.0, 0.2, False)])
def test_what_one_joint_gains_counts_as_much_as_what_another_loses(
    first: float, second: float, better: bool
) -> None:
    samples, none = np.full((4, 2), 25.0), np.zeros((4, 2))
    one = HeldOutError(samples * [1.0, 1.0], samples, none, none)
    other = HeldOutError(samples * [first, second], samples, none, none)
    assert likelier(one, other) == better
    assert likelier(other, one) != better


def test_what_extrapolation_misses_hides_no_gain() -> None:
    """Half of the samples lie beyond the identified friction, with ten times the error there."""
    rng, samples = np.random.default_rng(0), np.full((16, 1), 200.0)
    beyond = 10.0 * rng.uniform(0.2, 1.8, (16, 1))
    old = HeldOutError(0.2 + beyond, samples, beyond, 0.5 * samples)
    moved = beyond * rng.uniform(0.9, 1.1, (16, 1))
    new = HeldOutError(0.1 + moved, samples, moved, 0.5 * samples)
    assert not gain_of(old.squares[:, 0], new.squares[:, 0]).certain
    found = gain(old, new, [0])
    assert found.certain
    assert found.value == pytest.approx(0.25, abs=0.05)


def test_a_certain_loss_at_one_joint_is_seen() -> None:
    old, new = blocks([[1.0, 1.0]] * 12), blocks([[0.1, 1.2]] * 12)
    assert gain(old, new, [0, 1]).certain
    assert gain(old, new, [1]).loses
    assert not gain(old, new, [0]).loses
    assert not Gain(-0.3, -0.8, 0.1).loses
    assert not Gain(-0.001, -0.002, -0.0005).loses


@pytest.mark.parametrize("memory", [1, 4])
def test_the_interval_of_a_gain_covers_it(memory: int) -> None:
    """Of errors that are independent from block to block, and of such that last for four blocks."""
    rng = np.random.default_rng(7)
    covered, draws, count = 0, 2000, 96
    for _ in range(draws):
        common = np.repeat(rng.gamma(2.0, 1.0, count // memory), memory)
        old = common * rng.gamma(8.0, 1.0, count)
        ratio = np.repeat(rng.normal(0.8, 0.2, count // memory), memory)
        found = gain_of(old, np.maximum(old * ratio, 0.0))
        covered += found.low <= 0.2 <= found.high
    assert 0.93 <= covered / draws <= 0.995


@pytest.mark.slow
def test_a_few_seconds_are_enough_for_a_large_effect(before: ParameterFile) -> None:
    log = changed("fourier")[0]
    short = log.t < log.t[0] + 6.0
    cut = replace(log, t=log.t[short], q=log.q[short], tau=log.tau[short], valid=log.valid[short])
    found = refine([cut], robot(), before, earlier={}, options=DiscoverOptions())
    loop = confirm(found, changed("held_out"))
    assert [(r.effect, r.accepted) for r in loop.rounds] == [("spring", True)]
    assert loop.after["joint_1"].rmse < 0.6 * loop.before["joint_1"].rmse


def test_smooth_terms_are_proposed_where_they_were_not_allowed_yet() -> None:
    assert excess_note({"elbow": 1.1}, smooth=False) == ()
    (asked,) = excess_note({"elbow": 5.0}, smooth=False)
    assert "elbow (5.0 times)" in asked
    assert "--with-unexplained" in asked
    (allowed,) = excess_note({"elbow": 5.0}, smooth=True)
    assert "--with-unexplained" not in allowed


LOSS = 0.1  # of the load, in all logs of the case


@pytest.mark.slow
def test_refine_finds_loss_and_rotor_of_a_joint_that_hides_it(tmp_path: Path) -> None:
    logs = recorded(Case("two", "load_dependent_friction", 0, 12), tmp_path)
    first, *rest = logs.robot.joints
    reflected = first.gear_ratio**2 * first.rotor_inertia
    robot = replace(logs.robot, joints=(replace(first, rotor_inertia=None), *rest))
    file = file_of(robot, sequential(logs.earlier, robot), logs.earlier)
    options = DiscoverOptions()
    found = refine(logs.training, robot, file, earlier=logs.earlier, options=options).stages.effects
    assert found is not None
    (loss,) = found
    assert (loss.effect, loss.joint) == ("load_dependent_friction", first.name)
    assert loss.parameters[0].value == pytest.approx(LOSS, rel=0.04)
    assert loss.settings[ROTOR] == pytest.approx(reflected, rel=0.15)
