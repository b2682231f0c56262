"""Effects and smooth terms of a parameter file: restored exactly, put on any log, taken
out.
"""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from seqid_cli.effects.apply import (
    added_torque,
    effect_torque,
    placed,
    session_of,
    without_effects,
)
from seqid_cli.effects.fitted import (
    FittedEffect,
    as_stage,
    effect_notes,
    fitted_effects,
)
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.smooth import Axis, SmoothTerm
from seqid_cli.errors import ConfigError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import EffectOfJoint, EffectSession, FrictionStage, Stages
from tests import Array
from tests.plants.robots.made import friction_joint, made_recording
from tests.plants.robots.two_joint import GEAR, SIGN_WIDTH, two_joint_robot
from tests.unit.effects.scenes import (
    CUTOFF_HZ,
    RATE_HZ,
    scene_of,
    scenes_of_logs,
    settings_of,
    wander,
)

ROBOT = two_joint_robot()
SESSION = EffectSession(logs=["a", "b", "c"], starts=[0.0, 100.0, 200.0], origin=1.7e9)


@pytest.fixture(scope="module")
def logs() -> list[Scene]:
    return scenes_of_logs()


def fitted(
    name: str, joint: int | None, c: list[float], **settings: float
) -> FittedEffect:
    return FittedEffect(
        effect=CATALOGUE[name],
        joint=joint,
        settings=settings,
        coefficients=np.array(c),
        covariance=1e-4 * np.eye(len(c)),
    )


def stribeck(level: float = 1.0) -> FittedEffect:
    return fitted("stribeck", 0, [level], stribeck_speed=0.1, exponent=2.0)


def recording_of(
    q: Array, tau: Array | None, sha256: str = "a", start: float = 0.0
) -> Recording:
    return made_recording(q, tau, rate_hz=RATE_HZ, sha256=sha256, start=start)


def through_a_file(*effects: EffectOfJoint) -> Stages:
    return msgspec.json.decode(
        msgspec.json.encode(Stages(effects=list(effects))), type=Stages
    )


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - {"external_contact"}))
def test_a_file_restores_the_torque_exactly(name: str, logs: list[Scene]) -> None:
    """Whatever `values` makes of the coefficients."""
    effect = CATALOGUE[name]
    joint = None if effect.arm else 0
    grid = settings_of(effect, logs, joint) or [
        {s.name: max(s.low, 0.5) for s in effect.settings}
    ]
    count = len(effect.coefficients(grid[-1]))
    c = 0.01 * np.random.default_rng(3).normal(size=count)
    written = FittedEffect(
        effect=effect,
        joint=joint,
        settings=grid[-1],
        coefficients=c,
        covariance=1e-6 * np.eye(count),
        session=SESSION,
    )
    (restored,) = fitted_effects(through_a_file(as_stage(written, ROBOT)), ROBOT)
    assert restored.session == written.session
    np.testing.assert_array_equal(restored.covariance, written.covariance)
    np.testing.assert_array_equal(
        effect_torque(logs[1], [restored]), effect_torque(logs[1], [written])
    )


def test_coefficients_that_came_later_are_zero_in_earlier_files(
    logs: list[Scene],
) -> None:
    """A cubic spring had no square."""
    with_square = fitted("spring", 0, [3.0, -0.5, 0.8, 0.0], cubic=1.0)
    earlier = as_stage(with_square, ROBOT)
    earlier.coefficients = earlier.coefficients[:3]
    earlier.covariance = [row[:3] for row in earlier.covariance[:3]]
    (restored,) = fitted_effects(through_a_file(earlier), ROBOT)
    assert restored.covariance.shape == (4, 4)
    assert not restored.covariance[3].any()
    np.testing.assert_array_equal(
        effect_torque(logs[1], [restored]), effect_torque(logs[1], [with_square])
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"effect": "phlogiston"},
            r"effects\[1\]\.effect: no effect named 'phlogiston'",
        ),
        ({"joint": None}, r"\.joint: stribeck is an effect of one joint"),
        (
            {"joint": "knee"},
            r"\.joint: 'knee' is none of the robot's joints: joint_1, joint_2",
        ),
        (
            {
                "effect": "payload",
                "settings": {"from_log": 0.0},
                "coefficients": [0.0] * 10,
            }
            | {"covariance": []},
            r"\.joint: payload is of the whole arm",
        ),
        ({"settings": {"exponent": 2.0}}, r"settings\.stribeck_speed: is missing"),
        (
            {"settings": {"stribeck_speed": 0.1, "exponent": 2.0, "colour": 1.0}},
            r"settings\.colour: stribeck takes stribeck_speed, exponent",
        ),
        (
            {"settings": {"stribeck_speed": -1.0, "exponent": 2.0}},
            "must lie within .*, is -1.0",
        ),
        (
            {"settings": {"stribeck_speed": "fast", "exponent": 2.0}},
            "must be a number, is 'fast'",
        ),
        (
            {"coefficients": [1.0, 2.0]},
            r"\.coefficients: stribeck takes 1 numbers, has 2",
        ),
        ({"coefficients": [], "parameters": []}, r"\.coefficients: stribeck lacks"),
        ({"covariance": [[1.0, 0.0]]}, r"\.covariance: must have 1 rows of 1"),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, object], message: str) -> None:
    right = as_stage(stribeck(), ROBOT)
    wrong = msgspec.structs.replace(right, **changes)
    with pytest.raises(ConfigError, match=message):
        fitted_effects(Stages(effects=[right, wrong]), ROBOT)


UNCLOCKED = EffectSession(logs=["a", "b", "c"])


@pytest.mark.parametrize(
    ("session", "sha256", "start", "expected"),
    [
        # known by its contents, whatever its clock
        (SESSION, "b", 5.0, (1, 100.0, True)),
        (SESSION, "x", 1.7e9 + 150.0, (1, 150.0, True)),
        (SESSION, "x", 1.7e9 - 50.0, (-1, -50.0, True)),
        (SESSION, "x", 1.7e9 + 900.0, (2, 900.0, True)),
        (SESSION, "x", 0.0, (3, 0.0, False)),
        (UNCLOCKED, "c", 1.7e9, (2, 0.0, False)),
        (UNCLOCKED, "x", 1.7e9, (3, 0.0, False)),
        (None, "x", 1.7e9, (0, 0.0, False)),
    ],
)
def test_logs_find_their_place_in_a_session(
    logs: list[Scene],
    session: EffectSession | None,
    sha256: str,
    start: float,
    expected: tuple[int, float, bool],
) -> None:
    alone = replace(logs[0], shared_clock=False)
    scene = placed(alone, recording_of(alone.motion.q, None, sha256, start), session)
    assert (scene.log, scene.start, scene.shared_clock) == expected


def test_a_session_is_described_by_its_logs(logs: list[Scene]) -> None:
    recordings = [
        recording_of(scene.motion.q, None, name, 1.7e9 + scene.start)
        for scene, name in zip(logs, "abc", strict=True)
    ]
    starts = [scene.start for scene in logs]
    expected = EffectSession(logs=["a", "b", "c"], starts=starts, origin=1.7e9)
    assert session_of(recordings, starts, True) == expected
    assert session_of(recordings, starts, False) == UNCLOCKED


def test_friction_effects_widen_what_holds_at_rest(logs: list[Scene]) -> None:
    """Stribeck friction at the slowest speed, either way; a spring or an offset does
    not.
    """
    scene = logs[0]
    log = recording_of(scene.motion.q, None)
    slowest = np.full(2, 0.02)
    added = added_torque(
        scene, log, [stribeck(), fitted("torque_bias", 1, [3.0])], slowest
    )
    held = np.exp(-0.04) * np.tanh(0.02 / SIGN_WIDTH)
    np.testing.assert_allclose(added.high[:, 0], held, rtol=1e-9)
    np.testing.assert_allclose(added.low, -added.high, atol=1e-12)
    assert not added.high[:, 1].any()
    np.testing.assert_allclose(added.value[:, 1], 3.0)


def test_a_recording_is_freed_of_its_effects() -> None:
    """A hump of friction and an offset on one joint, a wrong gain on the other."""
    scene = scene_of(wander(20.0, seed=4, rests=()))
    q = scene.motion.q
    dq = scene.motion.dq
    clean = scene.model.friction(q, dq)
    hump = np.exp(-((dq[:, 0] / 0.1) ** 2)) * np.tanh(dq[:, 0] / 0.01)
    dirty = clean + np.column_stack([hump + 0.3, 0.05 * clean[:, 1]])
    effects = [
        stribeck(),
        fitted("torque_bias", 0, [0.3]),
        fitted("torque_constant", 1, [0.05]),
    ]

    joints = {
        name: friction_joint(
            surface.positive,
            speed_range=[0.0, 4.0],
            sign_width=surface.sign_width,
            covariance=surface.covariance.tolist(),
        )
        for name, surface in zip(ROBOT.joint_names, scene.model.surfaces, strict=True)
    }
    stages = Stages(friction=FrictionStage(joints=joints))
    recording = recording_of(q, dirty)
    motion = MotionOptions(cutoff_hz=CUTOFF_HZ)
    freed = without_effects(recording, ROBOT, stages, effects, motion=motion)

    usable = scene.motion.usable
    np.testing.assert_allclose(freed.tau[usable, 1], clean[usable, 1], atol=1e-9)
    rms_left = np.sqrt(np.mean((freed.tau[usable, 0] - clean[usable, 0]) ** 2))
    rms_before = np.sqrt(np.mean((hump[usable] + 0.3) ** 2))
    assert rms_left < 0.05 * rms_before
    assert freed.q is q


def test_an_encoder_error_is_taken_off_the_angle() -> None:
    scene = scene_of(wander(8.0, seed=4, rests=()))
    q = scene.motion.q
    turns = GEAR[0] * q[:, 0]
    error = 1e-3 * np.sin(turns) - 2e-3 * np.cos(turns)
    item = fitted("encoder_eccentricity", 0, [1e-3, -2e-3], order=1.0)
    recording = recording_of(q, np.zeros_like(q))
    freed = without_effects(recording, ROBOT, Stages(), [item], motion=MotionOptions())
    np.testing.assert_allclose(freed.q[:, 0], q[:, 0] - error, atol=1e-12)
    np.testing.assert_array_equal(freed.q[:, 1], q[:, 1])
    assert freed.tau is recording.tau


KNOTS = (-1.0, -0.3, 0.1, 0.4, 1.2)


def a_term() -> SmoothTerm:
    axes = (
        Axis("position", 1, KNOTS),
        Axis("recent_speed", 0, (0.0, 0.5, 1.0), seconds=2.0),
    )
    c = np.random.default_rng(3).normal(size=axes[0].size * axes[1].size)
    return SmoothTerm(
        joint=1,
        quantities=("position", "other_joint:joint_1"),
        axes=axes,
        factor="direction",
        coefficients=c,
    )


def test_a_term_survives_the_file_and_counts_when_asked() -> None:
    scene = scene_of(wander(4.0, rests=()))
    term = a_term()
    entry = term.to_stage(ROBOT)
    assert {p.unit for p in entry.parameters} == {"N m"}
    stages = through_a_file(as_stage(stribeck(), ROBOT), entry)
    assert len(fitted_effects(stages, ROBOT)) == 1
    back = fitted_effects(stages, ROBOT, unexplained=True)[1]
    for name in ("joint", "quantities", "axes", "factor"):
        assert getattr(back, name) == getattr(term, name)
    np.testing.assert_array_equal(
        effect_torque(scene, [back])[:, 1], term.torques(scene)[1]
    )

    without = effect_notes(stages)
    with_it = effect_notes(stages, unexplained=True)
    assert without[0] == "effects in the prediction: stribeck (joint_1)"
    assert "--with-unexplained" in without[1]
    assert with_it == [
        "effects in the prediction: stribeck (joint_1), unexplained (joint_2)"
    ]


@pytest.mark.parametrize(
    ("settings", "lost", "message"),
    [
        ({"axis_1": "mood"}, 0, "axis_1"),
        ({"axis_1_joint": "wing"}, 0, "axis_1"),
        ({"axis_1_knot_0": 7.0}, 0, "axis_1"),
        ({"axis_1_knot_2": float("inf")}, 0, "axis_1"),
        ({"axis_1_knot_1": "x"}, 0, "axis_1"),
        ({"axis_2_seconds": 0.0}, 0, "axis_2_seconds"),
        ({"axis_2_seconds": "long"}, 0, "axis_2_seconds"),
        ({"factor": "luck"}, 0, "factor"),
        ({}, 1, "expected 35"),
    ],
)
def test_a_damaged_entry_is_named(
    settings: dict[str, str | float], lost: int, message: str
) -> None:
    entry = a_term().to_stage(ROBOT)
    entry.settings |= settings
    entry.parameters = entry.parameters[lost:]
    with pytest.raises(ConfigError, match=message):
        SmoothTerm.from_stage(entry, ROBOT)
