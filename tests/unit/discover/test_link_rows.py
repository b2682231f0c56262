"""Links against motors: what an IMU sees beyond an encoder is the twist of the gear."""

import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from seqid_cli.discover import diagnose
from seqid_cli.discover.candidates import Candidate, CandidateColumns
from seqid_cli.discover.link_rows import (
    KIND,
    LinkRows,
    _components,
    link_rows,
)
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.effect import Settings
from seqid_cli.effects.link_readings import link_readings
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.errors import SeqidWarning
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Imu
from tests import Array
from tests.plants.robots.made import made_recording
from tests.studies.outside.arms import drawn_arm
from tests.studies.outside.cases import prepared
from tests.studies.outside.effects import _geared
from tests.studies.outside.plan import Case, Outline
from tests.studies.outside.simulate import Effect, built
from tests.unit.effects.two_mass import LINK, LOG_HZ, Gear, Log, run, scene

CUTOFF_HZ = 10.0
LEVER = np.array([0.30, 0.05, 0.0])  # m
NOISE = 0.02  # m/s^2 a sample
BIAS = np.array([0.03, -0.02, 0.01])  # m/s^2, less than the calibration may be off
BELT = LINK * (2.0 * np.pi * 12.0) ** 2  # N m/rad
RINGS_S = 2.0
ELASTICITY = CATALOGUE["joint_elasticity"]
GAP = 4e-3  # rad


def damped(stiffness: float) -> Gear:
    """A gear with 5 % of the critical damping of link and motor against each other."""
    return Gear(stiffness, 0.1 * np.sqrt(stiffness * LINK))


def readings(log: Log) -> Array:
    """Specific force (N, 3) m/s^2 at the lever, from the link's place over time."""
    cos = np.cos(log.link)
    sin = np.sin(log.link)
    place = np.stack([LEVER[0] * cos - LEVER[1] * sin, LEVER[0] * sin + LEVER[1] * cos])
    rate = np.gradient(place, 1.0 / LOG_HZ, axis=1)
    x, y = np.gradient(rate, 1.0 / LOG_HZ, axis=1)
    felt_y = y + 9.81
    in_link = np.column_stack([x * cos + felt_y * sin, felt_y * cos - x * sin, 0.0 * x])
    hiss = np.random.default_rng(3).normal(size=in_link.shape)
    return in_link + BIAS + NOISE * hiss


def with_imu(log: Log) -> Scene:
    """Return the log's data set with what an IMU on the link reads."""
    plain = scene(log, cutoff_hz=CUTOFF_HZ)
    imu = Imu("imu", 0, np.zeros((3, 3)), np.eye(3))
    robot = replace(plain.robot, imus=(imu,))
    calibration = ImuCalibration(
        rotation=np.eye(3).tolist(),
        std_error_deg=0.1,
        std_errors_deg=[0.1] * 3,
        lever=LEVER.tolist(),
        lever_std_errors=[0.001] * 3,
        time_offset_std_error_s=1e-4,
        accelerometer_bias=[0.0] * 3,
        accelerometer_bias_std_errors=[0.02] * 3,
        accelerometer_scale=[1.0] * 3,
        accelerometer_scale_std_errors=[0.001] * 3,
        accelerometer_axes=np.eye(3).tolist(),
        accelerometer_tilt_std_errors_deg=[0.05] * 3,
        accelerometer_noise=[NOISE * np.sqrt(2.0 / LOG_HZ)] * 3,
    )
    recording = made_recording(
        np.round(log.motor / 1e-5)[:, None] * 1e-5,
        rate_hz=LOG_HZ,
        accelerometers={"imu": readings(log)},
    )
    read = link_readings(
        recording,
        robot,
        ImuStage(imus={"imu": calibration}),
        Lowpass(CUTOFF_HZ, LOG_HZ),
    )
    stride = round(LOG_HZ / plain.motion.rate_hz)
    links = tuple(of_imu.every(stride) for of_imu in read)
    # The log begins in motion: for a while the link rings as nothing tells.
    usable = plain.motion.usable & (plain.motion.t > RINGS_S)
    motion = replace(plain.motion, usable=usable)
    return replace(plain, robot=robot, motion=motion, links=links)


def settings(stiffness: float) -> Settings:
    return {"trial_stiffness": stiffness, "encoder_side": 0.0, "damping_ratio": 0.05}


def fit(links: LinkRows, scene: Scene, stiffness: float) -> tuple[float, float]:
    """Return the compliance, and the share of the squares that it explains."""
    angle = ELASTICITY.link_angle(scene, 0, settings(stiffness))
    assert angle is not None
    X = links.columns(0, [angle])[KIND][:, 0]
    y = links.y[0]
    compliance = float(X @ y) / float(X @ X)
    return compliance, 1.0 - float(np.mean((y - compliance * X) ** 2) / np.mean(y**2))


def test_the_twist_of_a_belt_is_measured() -> None:
    """By itself, without any torque."""
    of_log = with_imu(run(damped(BELT)))
    links = link_rows(rows_of([of_log]))
    compliance, explained = fit(links, of_log, BELT)
    assert 1.0 / compliance == pytest.approx(BELT, rel=0.03)
    assert explained > 0.85


def test_the_play_of_a_gear_is_measured() -> None:
    """Where the link lands its acceleration jumps: rows and columns are low-passed."""
    of_log = with_imu(run(Gear(5e4, 20.0, GAP)))
    stage = CandidateColumns(rows_of([replace(of_log, measured=of_log.motion.tau)]))
    play = Candidate(CATALOGUE["backlash"], 0, {"trial_gap": GAP})
    (columns,) = stage.columns([play])
    X = columns[KIND][:, 0]
    y = stage.links.y[0]
    gap = float(X @ y) / float(X @ X)
    explained = 1.0 - float(np.mean((y - gap * X) ** 2) / np.mean(y**2))
    assert gap == pytest.approx(GAP, rel=0.1)
    assert explained > 0.8


def test_a_stiff_gear_has_no_rows() -> None:
    """Biases that the calibration may have wrong are no twist."""
    of_log = with_imu(run(damped(400.0 * BELT)))
    assert not link_rows(rows_of([of_log])).of(0)


def test_effects_that_turn_a_link_have_columns_there() -> None:
    """And none of torque where the file has absorbed it."""
    of_log = with_imu(run(damped(BELT)))
    stage = CandidateColumns(rows_of([replace(of_log, measured=of_log.motion.tau)]))
    twisting = Candidate(ELASTICITY, 0, dict(settings(BELT)))
    absorbed = replace(twisting, absorbed="torque")
    offset = Candidate(CATALOGUE["torque_bias"], 0, {})
    channels = [set(columns) for columns in stage.columns([twisting, absorbed, offset])]
    assert channels == [{0, KIND}, {KIND}, {0}]


@pytest.mark.parametrize(("channels", "joints"), [(12, 2), (3, 6)])
def test_components_hold_all_that_joints_do(channels: int, joints: int) -> None:
    """As far as there are channels; what a joint behind the IMU does, none shows."""
    slopes = np.random.default_rng(0).normal(size=(5, channels, joints))
    slopes[:, :, -1] = 0.0
    Q = _components(slopes)
    assert Q.shape == (5, joints, channels)
    assert not Q[:, -1].any()
    seen = min(channels, joints - 1)
    products = Q @ Q.swapaxes(1, 2)
    unit = np.broadcast_to(np.eye(seen), (5, seen, seen))
    np.testing.assert_allclose(products[:, :seen, :seen], unit, atol=1e-9)
    again = Q.swapaxes(1, 2) @ (Q @ slopes)
    np.testing.assert_allclose(again[:, :, :seen], slopes[:, :, :seen], atol=1e-9)


def test_without_imus_there_are_no_rows() -> None:
    plain = scene(run(damped(BELT)), cutoff_hz=CUTOFF_HZ)
    assert not link_rows(rows_of([plain])).of(0)


@pytest.mark.slow
def test_a_belt_that_the_file_has_absorbed_is_named(tmp_path: Path) -> None:
    """Its torque is in the inertia of the file: only the IMUs tell.

    The whole way of a user, on a simulated arm of two joints whose first one has a belt
    of 20 Hz from the first log on.
    """
    case = belted(seed=2, hertz=20.0)
    ready = prepared(case, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        found = diagnose(ready.logs, ready.recorder.robot, ready.file)
    assert found.verdict == "effect_found"
    named = {(finding.effect, finding.joint) for finding in found.findings}
    assert named == {("joint_elasticity", "j1")}


def belted(*, seed: int, hertz: float) -> Case:
    """Return an arm of the second simulator with a belt at its first joint."""
    drawn = drawn_arm(np.random.default_rng([seed, 78]), "drawn", 2, True)
    fine = tuple(replace(x, count=min(x.count, 5e-5)) for x in drawn.drives)
    slow = min(drawn.bandwidth, 0.35 * 2.0 * np.pi * hertz)
    arm = replace(drawn, drives=fine, bandwidth=slow)

    # Against its motor, which is held, the link rings at that frequency.
    model = built(arm)
    data = mujoco.MjData(model)
    data.qpos[:] = [link.middle for link in arm.links[: arm.n]]
    mujoco.mj_forward(model, data)
    mass = np.zeros((arm.n, arm.n))
    mujoco.mj_fullM(model, data, mass)
    inertia = float(mass[0, 0]) - arm.drives[0].rotor
    stiffness = inertia * (2.0 * np.pi * hertz) ** 2
    damping = 0.1 * np.sqrt(stiffness * inertia)

    def xml(scale: float, root: ET.Element) -> None:
        tendon = _geared(root, arm, 0, stiffness)
        tendon.attrib.update(damping=repr(float(damping)), springlength="0 0")

    belt = Effect(0, xml=xml, name="joint_elasticity")
    outline = Outline(
        seed, ("joint_elasticity",), "early", "drawn", 2, True, False, True
    )
    return Case(outline, arm, (belt,), (0.1,))
