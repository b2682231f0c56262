"""Thresholds of discovery, inspection and plans: each beside a case that it decides."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from seqid_cli.discover import diagnosis
from seqid_cli.discover.select import selection
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.selection import Selection
from seqid_cli.discover.settings import (
    DiscoverSettings,
    EventSettings,
    EvidenceSettings,
)
from seqid_cli.discover.survey import events
from seqid_cli.discover.survey.events import Interval
from seqid_cli.inspect.channels import positions
from seqid_cli.inspect.channels.torques import _spikes
from seqid_cli.inspect.channels.values import missing
from seqid_cli.inspect.dynamics import equations
from seqid_cli.inspect.imu import readings
from seqid_cli.inspect.settings import (
    ChannelSettings,
    DynamicsSettings,
    ImuSettings,
    InspectSettings,
)
from seqid_cli.plan import make
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.moves.floor import floor_of
from seqid_cli.plan.moves.strokes import postures_of
from seqid_cli.plan.settings import (
    DiscriminationSettings,
    MarginSettings,
    PlanSettings,
)
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.urdf import UrdfJoint
from seqid_cli.settings_in_force import in_force, put_in_force
from tests import ROOT
from tests.plants.robots.sample import sample_robot
from tests.unit.thresholds.test_stages import WITNESSES as OF_STAGES
from tests.unit.thresholds.witness import Witness

# --- discovery


def unsure_effect(settings: EvidenceSettings, probability: float) -> bool:
    """Whether an effect that is there with this probability is not told."""
    asked: list[float] = []

    def all_taken(least: float) -> tuple[()]:
        asked.append(least)
        return ()

    found: Any = SimpleNamespace(
        model=SimpleNamespace(linear=None),
        keys=set(),
        _tried=[],
        _search=SimpleNamespace(visible={}),
        _all_taken=all_taken,
        _with_value_changes=lambda told, least: told,
    )
    with (
        put_in_force(DiscoverSettings(evidence=settings)),
        patch.object(selection, "_ranked", lambda *_: []),
    ):
        Selection.told(found)
    return probability < asked[0]


def passes(settings: EvidenceSettings, evidence: float, share: float) -> bool:
    with put_in_force(DiscoverSettings(evidence=settings)):
        chosen: Any = SimpleNamespace(options=Options())
    term: Any = SimpleNamespace(
        gained=SimpleNamespace(evidence=evidence),
        predicted=SimpleNamespace(doubt=0.0, share=share),
    )
    return Selection._passes(chosen, term)


def noise(settings: EvidenceSettings, evidence: float) -> bool:
    return not passes(settings, evidence, share=0.9)


def negligible(settings: EvidenceSettings, share: float) -> bool:
    return not passes(settings, 1e6, share)


def invisible(settings: EvidenceSettings, share: float) -> bool:
    found: Any = SimpleNamespace(
        found=SimpleNamespace(visible={("stribeck", 0): share})
    )
    robot = load_robot(ROOT / "sample_logs" / "one_joint" / "robot.toml")
    with put_in_force(DiscoverSettings(evidence=settings)):
        return bool(diagnosis._hidden(found, robot))


def stands_out(settings: EventSettings, sigma: float) -> bool:
    """A window of this height among quiet ones; its certainty counts alike."""
    z = np.full((100, 1), 1.0)
    z[50] = sigma
    event = Interval(scene=0, start=0.0, end=1.0, joints=(0,), score=sigma)
    with put_in_force(DiscoverSettings(events=settings)):
        found = events._joined(0, 0.3, z, 0.1 * np.arange(100.0))
        assert bool(found) == (event.certainty > 0.5)
    return bool(found)


def lasts_too_long(settings: EventSettings, seconds: float) -> bool:
    """A stretch of this length that stands out, most in its middle."""
    centre = 0.05 * np.arange(400.0)
    z = np.full((400, 1), 1.0)
    z[np.abs(centre - 10.0) <= seconds / 2.0] = 20.0
    z[200] = 21.0
    with put_in_force(DiscoverSettings(events=settings)):
        return not events._joined(0, 0.2, z, centre)


def fills_a_log(settings: EventSettings, share: float) -> bool:
    """One stretch that fills a share of a log of 100 s."""
    windows = SimpleNamespace(length_s=1.0, scene=np.zeros(100 * events.OVERLAP))
    stretch = Interval(
        scene=0, start=10.0, end=10.0 + 100.0 * share, joints=(0,), score=9.0
    )
    rows: Any = SimpleNamespace(scenes=[None])
    with (
        put_in_force(DiscoverSettings(events=settings)),
        patch.multiple(
            events,
            tracks_of=lambda *_: None,
            windows_of=lambda *_: windows,
            scores=lambda *_: None,
            places=lambda *_: [stretch],
        ),
    ):
        return not events.find_events(rows, [])


# --- inspection


def inspected(**groups: Any) -> Any:
    return put_in_force(InspectSettings(**groups))


def spike_over_noise(settings: ChannelSettings, times: float) -> bool:
    """One sample beside twenty that stand out by 1 N m."""
    values = np.zeros(400)
    values[10:210:10] = 1.0
    values[300] = times
    with inspected(channels=settings):
        return len(_spikes(values)) > 0


def spike_over_span(settings: ChannelSettings, share: float) -> bool:
    """One sample that stands out of torque that rises from 0 to 100 N m."""
    values = np.linspace(0.0, 100.0, 1001)
    values[500] += 98.0 * share  # 98 % of the samples span 98 N m
    with inspected(channels=settings):
        return len(_spikes(values)) > 0


def holes(settings: ChannelSettings, share: float) -> bool:
    values = np.arange(10_000.0)
    rng = np.random.default_rng(0)
    values[rng.choice(np.arange(1, 9_999), round(1e4 * share), replace=False)] = np.nan
    with inspected(channels=settings):
        return bool([*missing(values, "elbow", "position")])


def too_fast(settings: ChannelSettings, times: float) -> bool:
    joint = SimpleNamespace(name="elbow", velocity_limit=2.0, encoder_resolution=None)
    data: Any = SimpleNamespace(
        robot=SimpleNamespace(joints=[joint]),
        joints=SimpleNamespace(
            channels={"position": np.sin(np.linspace(0.0, 3.0, 500))[:, None]}
        ),
        moves=lambda j: True,
    )
    with (
        inspected(channels=settings),
        patch.object(positions, "top_speed", lambda *_: 2.0 * times),
    ):
        found = [*positions.position_quality(data, ())]
    return any(finding.code == "speed_limit" for finding in found)


def cause_is_sought(settings: DynamicsSettings, left: float) -> bool:
    """Whether equations that leave a share of the torque are compared with others."""
    sample: Any = SimpleNamespace(
        thinned=lambda: None, rms_speeds=np.ones(1), moving=[0]
    )
    data: Any = SimpleNamespace(step=np.zeros(1))
    nearly_right: Any = lambda *_: iter(["nearly right"])  # noqa: E731
    with (
        inspected(dynamics=settings),
        patch.multiple(
            equations,
            _structural_error=lambda *_: left,
            _nearly_right=nearly_right,
            _mending=lambda *_: None,
            causes_of=lambda *_, **__: [],
        ),
    ):
        return "nearly right" not in [*equations._structural(data, sample)]


def wrong_gravity(settings: ImuSettings, error: float) -> bool:
    """An accelerometer whose three channels read too much at rest."""
    data: Any = SimpleNamespace(
        recording=SimpleNamespace(valid=np.ones(9, dtype=bool)),
        robot=SimpleNamespace(gravity=np.array([0.0, 0.0, -9.81])),
    )
    values = np.tile([0.0, 0.0, 9.81 * (1.0 + error)], (9, 1))
    imu: Any = SimpleNamespace(name="imu", axes=np.eye(3))
    with (
        inspected(imus=settings),
        patch.object(readings, "rest_rows", lambda *_: values),
    ):
        return bool([*readings._force(data, imu, values, at_rest=True)])


# --- plans


def torque_has_room(settings: MarginSettings, sigma: float) -> bool:
    """Whether a move keeps more than so many standard errors of its torque."""
    belief: Any = SimpleNamespace(
        robot=sample_robot("one_joint"),
        theta=np.zeros(1),
        surfaces=[None],
        root=np.eye(1),
    )
    with put_in_force(PlanSettings(margins=settings)):
        return planned_torque(belief) > sigma


def planned_torque(belief: Any) -> float:
    """Torque [N m] of a belief that knows nothing but a standard error of 1 N m."""
    moves: Any = SimpleNamespace(
        q=np.zeros((1, 1, 1)), dq=np.zeros((1, 1, 1)), ddq=np.zeros((1, 1, 1))
    )
    return float(Belief.torque(belief, moves, np.ones((1, 1, 1, 1))).max())


def kept_above(settings: MarginSettings, height: float) -> bool:
    """Whether a plan keeps the arm this high above the base plane."""
    robot = sample_robot("six_joint")
    limits = limits_of(robot, ramp_s=0.5)
    drawn = postures_of(limits, 50, np.random.default_rng(0))
    with put_in_force(PlanSettings(margins=settings)):
        floor = floor_of(robot, limits, drawn)
    assert floor is not None
    return floor.clearance_m >= height


def too_weak(settings: DiscriminationSettings, power: float) -> bool:
    separation = SimpleNamespace(
        between=("a", "b"), powers=[power, power], imitations=[0.1, 0.1], power=power
    )
    planned: Any = SimpleNamespace(stage=SimpleNamespace(separation=separation))
    with put_in_force(PlanSettings(discrimination=settings)):
        (verdict,) = make._verdicts("discriminate", planned)
    return not verdict.good


WITNESSES = [
    Witness(
        command=command,
        setting=setting,
        beyond=beyond,
        within=within,
        is_flagged=is_flagged,
    )
    for command, setting, beyond, within, is_flagged in [
        ("diagnose", "evidence.min_confidence", 0.6, 0.8, unsure_effect),
        ("diagnose", "evidence.min_log_evidence", 4.8, 7.2, noise),
        ("diagnose", "evidence.negligible_share", 0.032, 0.048, negligible),
        ("diagnose", "evidence.min_visible", 0.16, 0.24, invisible),
        ("diagnose", "events.min_sigma", 6.2, 4.2, stands_out),
        ("diagnose", "events.longest", 2.4, 1.6, lasts_too_long),
        ("diagnose", "events.max_time", 0.06, 0.04, fills_a_log),
        ("inspect", "channels.min_spike_ratio", 12.0, 8.0, spike_over_noise),
        ("inspect", "channels.min_spike_share", 1.2, 0.8, spike_over_span),
        ("inspect", "channels.max_missing", 0.012, 0.008, holes),
        ("inspect", "channels.max_speed", 2.4, 1.6, too_fast),
        ("inspect", "dynamics.max_left", 0.12, 0.08, cause_is_sought),
        ("inspect", "imus.max_gravity_error", 0.06, 0.04, wrong_gravity),
        ("plan", "margins.torque_sigma", 2.4, 3.6, torque_has_room),
        ("plan", "margins.floor_clearance", 0.016, 0.024, kept_above),
        ("plan", "discrimination.min_power", 0.85, 0.95, too_weak),
    ]
]


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda one: one.setting)
def test_a_threshold_lies_where_it_should(witness: Witness) -> None:
    witness.check()


def test_every_setting_has_its_case() -> None:
    """A new setting needs a case that fails when it is loosened by half."""
    held = [witness.key for witness in (*OF_STAGES, *WITNESSES)]
    assert len(held) == len(set(held))
    of_commands = {
        (type(getattr(settings, group)), name)
        for settings in SETTINGS_OF_COMMANDS.values()
        for group in settings.__dataclass_fields__
        for name in getattr(settings, group).__dataclass_fields__
    }
    assert set(held) == of_commands


def test_a_plan_uses_less_than_the_limits_of_robot_file_and_urdf() -> None:
    """A twentieth is left for what a controller overshoots."""
    robot = sample_robot("two_joint")
    first, *others = robot.joints
    limited = replace(
        first,
        position_limits=(-1.0, 1.0),
        velocity_limit=2.0,
        urdf=UrdfJoint(
            name=first.name,
            kind="revolute",
            parent="base",
            child="link",
            follows="",
            axis=(0.0, 0.0, 1.0),
            lower=-9.0,
            upper=9.0,
            velocity=9.0,
            effort=40.0,
        ),
    )
    limits = limits_of(replace(robot, joints=(limited, *others)), ramp_s=0.5)
    assert 0.9 * 40.0 <= limits.torque[0] <= 0.96 * 40.0
    assert 0.9 * 2.0 <= limits.speed[0] <= 0.96 * 2.0
    assert 0.9 <= limits.upper[0] <= 0.96
    assert limits.acceleration[0] <= 0.96 * 2.0 / 0.5


def test_settings_are_in_force_inside_the_block_alone() -> None:
    loose = PlanSettings(margins=MarginSettings(torque_sigma=1.0))
    with put_in_force(loose), put_in_force(InspectSettings()):
        assert in_force(PlanSettings) is loose
        with put_in_force(PlanSettings()):
            assert in_force(PlanSettings) == PlanSettings()
        assert in_force(PlanSettings) is loose
    assert in_force(PlanSettings) == PlanSettings()
