"""Thresholds of the stages that identify: each beside a case that it decides."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from msgspec.structs import replace as with_fields

from seqid_cli import identify
from seqid_cli.identify.friction_surface import hunting, stage, summary
from seqid_cli.identify.friction_surface.checks import friction_verdicts
from seqid_cli.identify.friction_surface.gravity_separation import configurations
from seqid_cli.identify.imu_calibration import verdict_of
from seqid_cli.identify.prediction.verdicts import joint_verdicts
from seqid_cli.identify.regression.least_squares import Accumulator, spread_of
from seqid_cli.identify.regression.noise_level import NoiseLevel
from seqid_cli.identify.rigid import gravity, inertia, parameters, rotor_coupling
from seqid_cli.identify.rigid.cutoff_check import (
    Difference,
    cutoff_check,
    with_cutoff_check,
)
from seqid_cli.identify.rigid.cutoff_choice import (
    Candidate,
    CutoffChoice,
    choose_cutoff,
)
from seqid_cli.identify.rigid.friction_of_logs import FrictionShares
from seqid_cli.identify.rigid.gravity_rows import _settled
from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
from seqid_cli.identify.rigid.log_agreement import agreement_verdicts, log_equations
from seqid_cli.identify.rigid.rotor_coupling import FreeShare
from seqid_cli.identify.rigid.simultaneous import OneStepResult
from seqid_cli.identify.settings import (
    AgreementSettings,
    CutoffCheckSettings,
    CutoffSettings,
    GravityFitSettings,
    GravitySettings,
    HuntingSettings,
    InertiaSettings,
    JudgingSettings,
    MountingSettings,
    OneStepSettings,
    PredictionErrorSettings,
    ResidualSettings,
    ReversalSettings,
    RotorSettings,
    SimultaneousSettings,
    SurfaceSettings,
    TrialSettings,
)
from seqid_cli.imu.calibration.segments import calibration_cutoff
from seqid_cli.model.torque import sliding
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import (
    BandCoverage,
    JointCoverage,
    JointError,
)
from seqid_cli.params.schema import (
    FrictionJoint,
    FrictionStage,
    Parameter,
    RigidStage,
    SpeedLevel,
    Stages,
    Verdict,
)
from seqid_cli.payload import verdicts as of_payload
from seqid_cli.payload.settings import PayloadFitSettings
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.small import planar_2r
from tests.unit.test_settings import gravity_is_poor, nominal, scaled
from tests.unit.thresholds.witness import Witness

# Of the arm with one joint, by its own gravity parameters: a position in which gravity
# is zero, and its RMS over the positions of the friction trials.
ZERO = 1.568  # rad
USUAL_GRAVITY = 0.0288  # N m
ONE_JOINT = ROOT / "sample_logs" / "one_joint"
TWO_JOINT = ROOT / "sample_logs" / "two_joint"


@cache
def robot() -> Robot:
    return load_robot(ONE_JOINT / "robot.toml")


@cache
def stages() -> Stages:
    return read_parameters(ONE_JOINT / "golden.json").stages


def any_poor(verdicts: Iterator[Verdict] | list[Verdict]) -> bool:
    return any(not verdict.good for verdict in verdicts)


# --- judging


def negative_rotor(settings: JudgingSettings, sigma: float) -> bool:
    rotor = Parameter(
        name="Ia_1",
        value=-0.01 * sigma,
        std_error=0.01,
        unit="kg m^2",
        joint="joint_1",
        terms={"Ia_1": 1.0},
    )
    stage = RigidStage(parameters=[rotor], condition=1.0, rank=1)
    return any_poor(inertia_verdicts(stage, None, robot(), settings))


def level(speed: float) -> SpeedLevel:
    return SpeedLevel(
        speed=speed,
        forward=1,
        backward=1,
        rmse=0.01,
        friction=1.0,
        std_error=0.0,
        left_out=None,
    )


def friction_of(entries: list[list[float]], speeds: list[float]) -> FrictionStage:
    levels = [level(v) for v in speeds]
    joint = friction_joint(
        entries,
        speed_range=[1.0, 3.0],
        speed_scale="linear",
        sign_width=0.01,
        covariance=(1e-12 * np.eye(np.size(entries))).tolist(),
        speeds=levels,
    )
    return FrictionStage(joints={"joint_1": joint})


def driving_by(settings: JudgingSettings, share: float) -> bool:
    """Friction of -d at the slowest speed and 2 + d at the fastest."""
    size = 0.0
    for _ in range(50):  # the usual friction depends on d as well
        size = share * float(np.sqrt((size**2 + (2.0 + size) ** 2) / 2.0))
    stage = friction_of([[1.0, 1.0 + size]], [1.0, 3.0])
    return any_poor(friction_verdicts(stage, robot(), settings))


def driving_at(settings: JudgingSettings, share: float) -> bool:
    """Friction that is negative in a share of the cells, of 9 speeds and 33 positions.

    It falls steeply over the position, so that at the last position alone it is
    negative, and there at the slowest speeds.
    """
    speeds = np.linspace(1.0, 3.0, 9)
    cells = round(share * 33 * len(speeds))
    edge = 0.5 * (speeds[cells - 1] + speeds[cells]) - 2.0  # from -1 to 1
    slope = 100.0
    entries = [[slope - edge, 1.0], [-slope, 0.0]]
    stage = friction_of(entries, speeds.tolist())
    # Beside such a slope the corner is too small to mean anything.
    settings = replace(settings, driving_share=0.0)
    return any_poor(friction_verdicts(stage, robot(), settings))


def gravity_between_stages(settings: JudgingSettings, share: float) -> bool:
    off = with_fields(stages(), gravity=scaled(stages().gravity, 1.0 / (1.0 + share)))
    return gravity_is_poor(robot(), off, **limits(settings))


def limits(settings: JudgingSettings) -> dict[str, float]:
    return {name: getattr(settings, name) for name in settings.__dataclass_fields__}


def gravity_factor(settings: JudgingSettings, factor: float) -> bool:
    arm = nominal(robot(), stages(), factor)
    return gravity_is_poor(arm, stages(), **limits(settings))


def gravity_turned(settings: JudgingSettings, turn: float) -> bool:
    arm = nominal(robot(), stages(), 1.0, turn)
    return gravity_is_poor(arm, stages(), **limits(settings))


def light_joint(settings: JudgingSettings, share: float) -> bool:
    """Trials about the position in which gravity is zero; five times what it is."""
    arm = nominal(robot(), stages(), 5.0)
    friction = stages().friction
    (name,) = friction.joints
    half = np.sqrt(3.0) * share  # of a sine about its zero the RMS is this over sqrt 3
    narrow = with_fields(
        friction.joints[name], position_range=[ZERO - half, ZERO + half]
    )
    stage = with_fields(friction, joints={name: narrow})
    return any_poor(friction_verdicts(stage, arm, settings))


def weak_gravity(settings: JudgingSettings, torque: float) -> bool:
    """Gravity of the URDF's inertials that has this RMS in the trials."""
    arm = nominal(robot(), stages(), torque / USUAL_GRAVITY)
    return any_poor(friction_verdicts(stages().friction, arm, settings))


# --- friction


def rough_surface(settings: SurfaceSettings, error: float) -> bool:
    """A speed left out is missed by a share of the friction, which is 1 N m."""
    levels = [level(v) for v in (1.0, 2.0, 3.0)]
    joint: FrictionJoint = with_fields(
        friction_of([[1.0]], []).joints["joint_1"], speeds=levels, held_out_rmse=error
    )
    unseen: Any = SimpleNamespace(
        at=lambda u: SimpleNamespace(missed=np.full(4, error if u > 0.0 else 0.01))
    )
    scaling: Any = SimpleNamespace(u=lambda speeds: speeds - 2.0)
    verdict = summary._verdict("elbow", joint, unseen, scaling, settings.max_error)
    return not verdict.good


@cache
def friction_fit() -> tuple[tuple[Any, ...], dict[str, Any]]:
    """What a friction surface is fitted to, for the arm with one joint."""
    seen: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
    work = stage._fit

    def watched(*given: Any, **named: Any) -> Any:
        seen.append((given, named))
        return work(*given, **named)

    options = identify.FrictionOptions(position_order=0, velocity_order=1)
    with patch.object(stage, "_fit", watched):
        identify.friction(ONE_JOINT / "friction", robot(), options)
    return seen[-1]


@cache
def sign_width(settings: SurfaceSettings) -> float:
    """Width over which friction changes its sign, as a share of the slowest speed."""
    (*others, _), named = friction_fit()
    surface = stage._fit(*others, settings, **named).surface
    return surface.sign_width / surface.scaling.speed[0]


def narrow_sign(settings: SurfaceSettings, narrowness: float) -> bool:
    return sign_width(settings) < 1.0 / narrowness


def apart(settings: TrialSettings, angle: float) -> bool:
    """Trials with another joint locked at angles that differ."""
    trials: Any = [
        SimpleNamespace(joint=0, configuration=np.array([k, k * angle])) for k in (0, 1)
    ]
    return len(configurations(trials, settings)) == 2


def hunting_joint(settings: HuntingSettings, swing: float) -> bool:
    """A trial at 2 rad/s of a joint with 3 kg m^2; swings are times the speed."""
    trial: Any = SimpleNamespace(stopped=False, speed=2.0, swing=swing * 3.0 * 2.0)
    group = SimpleNamespace(trials=[trial])
    first: Any = SimpleNamespace(gravity=SimpleNamespace(groups=[group]), surface=None)
    steady = [SimpleNamespace(inertia=3.0, std_error=0.01)]
    with (
        patch.object(hunting, "without_acceleration", lambda *_: steady),
        patch.object(hunting, "_accelerated_share", lambda *_: 1.0),
    ):
        return not hunting.sliding_trials(robot(), [trial], first, settings)


# --- gravity


def unsettled(settings: GravityFitSettings, distance: float, length: float) -> bool:
    """Whether a slice at this distance [s] from the end of a trial is left out."""
    trial: Any = SimpleNamespace(
        t=np.array([0.0, distance, length]),
        seconds=1e-9,
        q=np.zeros(3),
        velocity=1.0,
    )
    surface: Any = SimpleNamespace(outside=lambda q, v: np.zeros(len(q), dtype=bool))
    return not _settled(trial, surface, settings)[1]


@cache
def gravity_fit() -> tuple[Any, ...]:
    """What the gravity stage's result is made of, for the arm with one joint."""
    seen: list[tuple[Any, ...]] = []
    work = gravity._result

    def watched(*given: Any) -> Any:
        seen.append(given)
        return work(*given)

    friction_alone = stages().friction
    file = with_fields(
        read_parameters(ONE_JOINT / "golden.json"),
        stages=Stages(friction=friction_alone),
    )
    with patch.object(gravity, "_result", watched):
        identify.gravity(ONE_JOINT / "gravity", robot(), file)
    return seen[0]


def with_settings(settings: GravityFitSettings) -> tuple[Any, ...]:
    solution, rows, *others = gravity_fit()
    rows.settings = GravitySettings(fit=settings)
    return solution, rows, *others


def bad_postures(settings: GravityFitSettings, condition: float) -> bool:
    solution, *others = with_settings(settings)
    result = gravity._result(replace(solution, condition=condition), *others)
    return not result.gravity.verdicts[-1].good


def two_gravities(settings: GravityFitSettings, times: float) -> bool:
    """Gravity of all postures leaves this many times what friction's surface leaves."""
    solution, rows, _, friction, _ = with_settings(settings)
    ((j, joint_rows),) = rows.joints.items()
    left = joint_rows.rms(joint_rows.residual(solution.theta))
    name = robot().joint_names[j]
    entry = with_fields(friction.joints[name], rmse=left / times)
    alone = with_fields(friction, joints={name: entry})
    loose = replace(settings, min_friction_change=10.0)
    rows.settings = GravitySettings(fit=loose)
    return bool(gravity._judged(solution, rows, alone, ["log"]).gravity)


def shown_gravity(settings: GravityFitSettings, sigma: float) -> bool:
    given = with_settings(settings)
    work = gravity.rigid_stage

    def weak(*arguments: Any) -> RigidStage:
        stage = work(*arguments)
        each = [
            with_fields(p, value=sigma * p.std_error, std_error=p.std_error)
            for p in stage.parameters
        ]
        return with_fields(stage, parameters=each)

    with patch.object(gravity, "rigid_stage", weak):
        return gravity.NO_GRAVITY not in gravity._result(*given).gravity.notes


def warmed_up(settings: GravityFitSettings, change: float) -> bool:
    shares = FrictionShares(
        logs=np.arange(2),
        shares=np.array([0.0, change]),
        std_errors=np.full(2, 1e-6),
        surface_std=0.0,
        unexplained=np.zeros(0),
    )
    return shares.has_changed(settings)


# --- IMUs


def mounting(settings: MountingSettings, **values: float) -> bool:
    arm = load_robot(TWO_JOINT / "robot.toml")
    usual = {"std_error_deg": 0.01, "holdout": 1.0, "configurations": 6}
    calibration: Any = SimpleNamespace(
        **(usual | values), not_determined=[], deflections=[], gyro_axes=True
    )
    verdict = verdict_of(
        arm, arm.imus[0], calibration, converged=True, settings=settings
    )
    return not verdict.good


def cut_off(settings: MountingSettings, hz: float) -> bool:
    """Whether a calibration leaves out what is at a frequency."""
    motion: Any = SimpleNamespace(rate_hz=1e5)
    return calibration_cutoff(motion, None, settings.max_cutoff) < hz


# --- inertia


def residual_level(
    left: float, noise: float, poor_share: float, max_of_noise: float
) -> str:
    """The verdict on a joint with 1 N m RMS of torque."""
    solution: Any = SimpleNamespace(sigma=np.array([left]))
    rows: Any = [SimpleNamespace(samples=100)]
    high = np.array([noise])
    (verdict,) = parameters.joint_verdicts(
        robot(),
        solution,
        rows,
        np.array([100.0]),
        NoiseLevel(high, high, high),
        poor_share=poor_share,
        max_of_noise=max_of_noise,
        idle="",
    )
    return verdict.level


Residual = ResidualSettings | OneStepSettings


def much_left(settings: Residual, share: float) -> bool:
    given = settings.poor_share, settings.max_of_noise
    return residual_level(share, 0.0, *given) == "poor"


def more_than_noise(settings: Residual, times: float) -> bool:
    given = settings.poor_share, settings.max_of_noise
    return residual_level(0.01 * times, 0.01, *given) == "usable"


@cache
def inertia_fit() -> tuple[Any, ...]:
    """What the inertia stage's result is made of, for the arm with one joint."""
    seen: list[tuple[Any, ...]] = []
    work = inertia._described

    def watched(*given: Any) -> Any:
        seen.append(given)
        return work(*given)

    options = identify.RigidOptions(cutoff_hz=5.0, source="encoder")
    file = read_parameters(ONE_JOINT / "golden.json")
    file = with_fields(file, stages=with_fields(file.stages, inertia=None))
    with patch.object(inertia, "_described", watched):
        identify.inertia(ONE_JOINT / "inertia", robot(), file, options)
    return seen[0]


def bad_moves(settings: ResidualSettings, condition: float) -> bool:
    equations, rows, solution, posterior = inertia_fit()
    own = replace(equations.options, settings=InertiaSettings(residual=settings))
    with patch.object(equations, "options", own):
        told = replace(solution, condition=condition)
        stage = inertia._described(equations, rows, told, posterior)
    return not stage.verdicts[-1].good


def beside_a_reversal(settings: ReversalSettings, periods: float) -> bool:
    """Whether a sample at this distance from a reversal does not count as sliding."""
    cutoff_hz, rate_hz, reversal = 10.0, 1000.0, 500
    sign = np.sign(np.arange(1000) - reversal)
    motion: Any = SimpleNamespace(
        moving=np.ones((1000, 1), dtype=bool),
        dq=sign[:, None],
        usable=np.ones(1000, dtype=bool),
        lowpass=SimpleNamespace(cutoff_hz=cutoff_hz),
        rate_hz=rate_hz,
    )
    slides = sliding(motion, np.array([0.5]), reach_periods=settings.settled_periods)
    return not slides[reversal + round(periods * rate_hz / cutoff_hz), 0]


START_HZ = 8.0
Noise = Any


def tried(
    settings: CutoffSettings,
    errors: dict[float, float],
    *,
    noise: float = 0.0,
    independent: float = 1e6,
    bias: float = 0.0,
    moves: Array | None = None,
) -> CutoffChoice:
    """The choice among cut-offs [Hz] with these errors;
    all else of those beside 8 Hz.
    """

    def trial(hz: float) -> Candidate | None:
        if hz not in errors:
            return None
        beside = hz != START_HZ
        return Candidate(
            cutoff_hz=hz,
            theta=np.array([1.0 + bias * beside, 2.0]),
            determined=np.ones(2, dtype=bool),
            covariance=errors[hz] / 2.0 * np.eye(2),
            moves=np.zeros((10, 2)) if moves is None or beside else moves,
            information=np.eye(2),
            torque_square=1.0,
            rank=2,
            independent=independent,
        )

    return choose_cutoff(
        trial,
        START_HZ,
        lowest_hz=1.0,
        highest_hz=64.0,
        acceleration_noise=lambda hz: noise if hz > START_HZ else 0.0,
        limits=settings,
    )


BETTER = {8.0: 2e-4, 16.0: 1e-4}  # the higher one has half of the error


def noisy_acceleration(settings: CutoffSettings, share: float) -> bool:
    return tried(settings, BETTER, noise=share).cutoff_hz == START_HZ


def few_samples(settings: CutoffSettings, per_rank: float) -> bool:
    errors = {8.0: 2e-4, 4.0: 1e-4}
    return tried(settings, errors, independent=2.0 * per_rank).cutoff_hz == START_HZ


def disagreeing(settings: CutoffSettings, share: float) -> bool:
    """Three cut-offs, of which the two at the start agree and the best with none."""
    errors = {8.0: 4e-4, 4.0: 3e-4, 2.0: 1e-4}

    def trial(hz: float) -> Candidate | None:
        if hz not in errors:
            return None
        return Candidate(
            cutoff_hz=hz,
            theta=np.array([1.0 + share * (hz == 2.0), 2.0]),
            determined=np.ones(2, dtype=bool),
            covariance=errors[hz] / 2.0 * np.eye(2),
            moves=np.zeros((10, 2)),
            information=np.eye(2),
            torque_square=1.0,
            rank=2,
            independent=1e6,
        )

    found = choose_cutoff(
        trial,
        START_HZ,
        lowest_hz=1.0,
        highest_hz=64.0,
        acceleration_noise=lambda hz: 0.0,
        limits=settings,
    )
    return found.cutoff_hz != 2.0


def worth_leaving(settings: CutoffSettings, times: float) -> bool:
    return tried(settings, {8.0: times * 1e-4, 16.0: 1e-4}).cutoff_hz != START_HZ


def clear_gain(settings: CutoffSettings, sigma: float) -> bool:
    """Whether a start is left whose error is larger by so many standard errors."""
    moves = np.zeros((10, 2))
    moves[:, 0] = np.sqrt(np.linspace(0.0, 1e-3, 10))
    parts = moves[:, 0] ** 2
    chance = float(np.sqrt(len(parts)) * parts.std(ddof=1))
    errors = {8.0: 1e-5 + sigma * chance, 16.0: 1e-5}
    return tried(settings, errors, moves=moves).cutoff_hz != START_HZ


def hopeless(settings: CutoffSettings, times: float) -> bool:
    errors = {8.0: 1e-4, 16.0: times * 1e-4, 32.0: 1e-4}
    cutoffs = [one.cutoff_hz for one in tried(settings, errors).tried]
    return 32.0 not in cutoffs


def depends_on_the_cutoff(settings: CutoffCheckSettings, sigma: float) -> bool:
    rng = np.random.default_rng(0)
    moves = rng.standard_normal((40, 2))
    error = float(np.sqrt(spread_of(moves)[0, 0]))

    def result(theta: float, moves: Array) -> Any:
        known = np.ones(2, dtype=bool)
        solution = SimpleNamespace(
            theta=np.array([theta, 0.0]), moves=moves, determined=known
        )
        return solution, SimpleNamespace(covariance=np.eye(2), friction={})

    near = {0.7: result(sigma * error, moves)}
    still = result(0.0, np.zeros((40, 2)))
    return bool(cutoff_check(still, near, [None], settings).differences)


def depends_by_much(settings: CutoffCheckSettings, sigma: float) -> bool:
    basis = free_basis(robot())
    one = Parameter(name=basis.names[0], value=1.0, std_error=0.1, unit="kg m^2")
    stage = RigidStage(parameters=[one], condition=1.0, rank=1)
    differences = [Difference(place=0, multiple=0.7, n_errors=sigma)]
    found = with_cutoff_check(stage, differences, basis, settings)
    return any_poor(found.verdicts)


def coupling(settings: RotorSettings, share: FreeShare) -> rotor_coupling.Coupling:
    solution = SimpleNamespace(theta=np.zeros(2))
    equations: Any = SimpleNamespace(
        rotors=np.ones(1), coupling_place=2, solved=lambda *_: (solution, None)
    )
    rows: Any = [None]
    with patch.object(rotor_coupling, "_free_shares", lambda *_: [share]):
        return rotor_coupling.decide(equations, rows, settings)


def contradicted_coupling(settings: RotorSettings, sigma: float) -> bool:
    share = FreeShare(value=-0.01 * sigma, std_error=0.01)
    return bool(coupling(settings, share).contradicted)


def decided_coupling(settings: RotorSettings, log_odds: float) -> bool:
    share = FreeShare(value=1.0, std_error=float(np.sqrt(0.5 / log_odds)))
    return coupling(settings, share).used


def odd_log(
    settings: AgreementSettings,
    difference: float,
    *,
    torque: float = 3.0,
    independent: float = 1.0,
) -> str:
    """The verdict on four logs, one of which has another body; "" without any.

    Two joints, of one parameter of the body; torque is 0.1 N m of noise beside it.
    """
    rng = np.random.default_rng(0)
    logs = []
    for body in (0.0, 0.0, 0.0, difference):
        joints = []
        for _ in range(2):
            joint = Accumulator(1)
            H = rng.standard_normal((400, 1))
            joint.add(H, body * H[:, 0] + 0.1 * rng.standard_normal(400))
            joints.append(joint)
        logs.append(joints)
    names = [f"{k}.csv" for k in range(4)]
    found = agreement_verdicts(
        log_equations(names, logs),
        planar_2r(),
        np.full(2, 0.1),
        np.full(2, 1600.0 * torque**2),
        1,
        settings,
        independent=independent,
    )
    return found[0].level if found else ""


def left_by_two_bodies(settings: AgreementSettings, share: float) -> bool:
    """One log of four differs by d: one body leaves 0.1 N m and 3/16 d^2 more."""
    added = 0.1 * np.sqrt(1.0 / share**2 - 1.0)
    return bool(odd_log(settings, added * np.sqrt(16.0 / 3.0)))


def differing_share(settings: AgreementSettings, share: float, level: str) -> bool:
    added = 1.0 * np.sqrt(3.0 / 16.0)
    found = odd_log(settings, 1.0, torque=added / share)
    return found == level or (level == "usable" and found == "poor")


def barely_odd(settings: AgreementSettings, independent: float) -> bool:
    """Whether a log stands out that differs by a third of the noise,
    if it is certain.
    """
    all_else = replace(settings, max_left=1.0, usable_share=0.0)
    return bool(odd_log(all_else, 0.03, independent=independent))


@cache
def full_certainty() -> float:
    """The F value of that log where all rows count."""
    low, high = 1.0, 1e4
    while high > 1.001 * low:
        middle = np.sqrt(low * high)
        if barely_odd(AgreementSettings(min_certainty=middle), 1.0):
            low = middle
        else:
            high = middle
    return low


def certain_difference(settings: AgreementSettings, certainty: float) -> bool:
    """Rows count for less, until the fall of the residual has this F value."""
    return barely_odd(settings, certainty / full_certainty())


# --- one step, prediction, payload


def one_step_level(
    settings: OneStepSettings, *, coulomb: float, wave: float, wave_error: float
) -> str:
    """The verdict on a joint with 1 N m RMS of torque.

    Coulomb friction is known to 0.01 N m.
    """
    solution: Any = SimpleNamespace(
        theta=np.array([coulomb, wave]),
        covariance=np.diag([0.01**2, wave_error**2]),
        sigma=np.array([0.01]),
        condition=1.0,
    )
    rows: Any = SimpleNamespace(
        robot=robot(),
        basis=SimpleNamespace(size=1),
        joints=[SimpleNamespace(samples=100)],
        torque_squares=np.array([100.0]),
        friction=[slice(0, 1)],
        waves=[slice(1, 2)],
    )
    nothing: Any = None
    result = OneStepResult(
        rows=rows,
        solution=solution,
        waving=solution,
        posterior=nothing,
        uses=[],
        noise=[],
        options=nothing,
        settings=SimultaneousSettings(residual=settings),
    )
    floor = NoiseLevel(np.zeros(1), np.zeros(1), np.zeros(1))
    verdict, _ = result._joint_verdicts(floor, n_missing=0)
    return verdict.level


def negative_friction(settings: OneStepSettings, sigma: float) -> bool:
    level = one_step_level(settings, coulomb=-0.01 * sigma, wave=0.0, wave_error=1.0)
    return level == "poor"


def certain_wave(settings: OneStepSettings, sigma: float) -> bool:
    level = one_step_level(settings, coulomb=1.0, wave=0.2, wave_error=0.2 / sigma)
    return level == "usable"


def large_wave(settings: OneStepSettings, share: float) -> bool:
    level = one_step_level(settings, coulomb=1.0, wave=share, wave_error=1e-4)
    return level == "usable"


def prediction_level(
    settings: PredictionErrorSettings, *, relative: float, band: float
) -> str:
    coverage = BandCoverage(band_90=band, band_95=0.95, samples=10**6, blocks=10**6)
    error = JointError(
        rmse=0.1,
        relative_rmse=relative,
        max_abs=0.4,
        samples=10**6,
        rmse_all=0.1,
        samples_all=10**6,
        share_sliding=1.0,
        coverage=JointCoverage(overall=coverage),
    )
    calibrated: Any = True  # that there is a calibration is all that counts here
    model = with_fields(
        stages(), inertia=with_fields(stages().inertia, bands=calibrated)
    )
    joints = dict.fromkeys(robot().joint_names, error)
    (verdict,) = joint_verdicts(joints, model, robot(), settings=settings)
    return verdict.level


def bad_prediction(settings: PredictionErrorSettings, relative: float) -> bool:
    return prediction_level(settings, relative=relative, band=0.9) == "poor"


def narrow_band(settings: PredictionErrorSettings, share: float) -> bool:
    return prediction_level(settings, relative=0.01, band=share) == "usable"


def bad_payload(
    settings: PayloadFitSettings,
    *,
    mass_sigma: float = 1000.0,
    distance: float = 0.0,
    left: float = 0.0,
) -> str:
    """What is said of a payload of 2 kg, or of less in standard errors of 0.001 kg."""
    entry: Any = SimpleNamespace(
        mass=SimpleNamespace(value=1e-3 * mass_sigma, std_error=1e-3), distance=distance
    )
    verdicts = [
        of_payload.mass_verdict(entry, 10.0, settings),
        *of_payload.joint_verdicts(entry, {"elbow": left}, settings),
    ]
    return " ".join(verdict.reason for verdict in verdicts)


WITNESSES = [
    Witness(
        command=command,
        setting=setting,
        beyond=beyond,
        within=within,
        is_flagged=is_flagged,
    )
    for command, setting, beyond, within, is_flagged in [
        ("inertia", "judging.clear_sigma", 5.0, 3.0, negative_rotor),
        ("friction", "judging.driving_share", 0.036, 0.024, driving_by),
        ("friction", "judging.driving_cells", 0.0236, 0.0168, driving_at),
        ("gravity", "judging.max_gravity_difference", 0.3, 0.2, gravity_between_stages),
        ("gravity", "judging.max_gravity_factor", 3.0, 2.0, gravity_factor),
        ("gravity", "judging.min_gravity_correlation", 1.3, 1.1, gravity_turned),
        ("friction", "judging.light_share", 0.06, 0.04, light_joint),
        ("friction", "judging.min_gravity_torque", 1.2e-3, 0.8e-3, weak_gravity),
        ("friction", "surface.max_error", 0.18, 0.12, rough_surface),
        ("friction", "surface.sign_narrowness", 20.0, 30.0, narrow_sign),
        ("friction", "trials.same_configuration", 0.036, 0.024, apart),
        ("friction", "hunting.max_speed_swing", 1.7, 1.1, hunting_joint),
        ("gravity", "fit.settling", 0.024, 0.036, lambda s, x: unsettled(s, x, 10.0)),
        (
            "gravity",
            "fit.settling_share",
            0.1,
            0.15,
            lambda s, x: unsettled(s, 0.1 * x, 0.1),
        ),
        ("gravity", "fit.max_condition", 360.0, 240.0, bad_postures),
        ("gravity", "fit.max_left", 3.0, 2.0, two_gravities),
        ("gravity", "fit.shown_sigma", 5.0, 3.0, shown_gravity),
        ("gravity", "fit.min_friction_change", 0.012, 0.008, warmed_up),
        (
            "imu-calib",
            "mounting.max_error",
            0.6,
            0.4,
            lambda s, x: mounting(s, std_error_deg=x),
        ),
        (
            "imu-calib",
            "mounting.max_left_out",
            1.8,
            1.2,
            lambda s, x: mounting(s, holdout=x),
        ),
        ("imu-calib", "mounting.max_cutoff", 24.0, 16.0, cut_off),
        ("inertia", "residual.poor_share", 0.18, 0.12, much_left),
        ("inertia", "residual.max_of_noise", 1.4, 1.0, more_than_noise),
        ("inertia", "residual.max_condition", 1200.0, 800.0, bad_moves),
        ("inertia", "reversals.settled_periods", 0.8, 1.3, beside_a_reversal),
        ("inertia", "cutoff.max_acceleration_noise", 6e-3, 4e-3, noisy_acceleration),
        ("inertia", "cutoff.min_samples_per_rank", 2.4, 3.6, few_samples),
        ("inertia", "cutoff.max_disagreement", 0.024, 0.016, disagreeing),
        ("inertia", "cutoff.nearly_best", 1.2, 1.05, worth_leaving),
        ("inertia", "cutoff.clear_sigma", 1.2, 0.8, clear_gain),
        ("inertia", "cutoff.hopeless", 1.4, 1.1, hopeless),
        ("inertia", "cutoff_check.noted_sigma", 5.0, 3.0, depends_on_the_cutoff),
        ("inertia", "cutoff_check.usable_sigma", 3.6, 2.4, depends_by_much),
        ("inertia", "rotors.max_sigma", 3.6, 2.4, contradicted_coupling),
        ("inertia", "rotors.min_log_odds", 6.0, 4.0, decided_coupling),
        ("inertia", "agreement.max_left", 0.6, 0.8, left_by_two_bodies),
        ("inertia", "agreement.min_certainty", 6.0, 4.0, certain_difference),
        (
            "inertia",
            "agreement.usable_share",
            0.012,
            0.008,
            lambda s, x: differing_share(s, x, "usable"),
        ),
        (
            "inertia",
            "agreement.poor_share",
            0.06,
            0.04,
            lambda s, x: differing_share(s, x, "poor"),
        ),
        ("simultaneous", "residual.poor_share", 0.3, 0.2, much_left),
        ("simultaneous", "residual.max_of_noise", 1.4, 1.0, more_than_noise),
        ("simultaneous", "residual.negative_sigma", 3.6, 2.4, negative_friction),
        ("simultaneous", "residual.wave_sigma", 3.6, 2.4, certain_wave),
        ("simultaneous", "residual.wave_share", 0.036, 0.024, large_wave),
        ("predict", "errors.max_relative_rmse", 0.36, 0.24, bad_prediction),
        ("predict", "errors.min_band_share", 0.78, 0.82, narrow_band),
        (
            "payload",
            "fit.max_left",
            0.36,
            0.24,
            lambda s, x: "is left" in bad_payload(s, left=x),
        ),
        (
            "payload",
            "fit.negative_sigma",
            3.6,
            2.4,
            lambda s, x: "swap the two" in bad_payload(s, mass_sigma=-x),
        ),
        (
            "payload",
            "fit.max_distance",
            3.6,
            2.4,
            lambda s, x: "from any body" in bad_payload(s, distance=x),
        ),
    ]
]


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda one: one.setting)
def test_a_threshold_lies_where_it_should(witness: Witness) -> None:
    witness.check()
