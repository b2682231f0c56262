"""Thresholds of inspection: each beside a case that it decides."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from seqid_cli.inspect.channels import positions
from seqid_cli.inspect.channels.torques import _spikes
from seqid_cli.inspect.channels.values import missing
from seqid_cli.inspect.dynamics import echo, equations
from seqid_cli.inspect.imu import readings
from seqid_cli.inspect.settings import (
    ChannelSettings,
    DynamicsSettings,
    EchoSettings,
    ImuSettings,
    InspectSettings,
)
from tests.unit.thresholds.witness import Witness, witnesses


def spike_over_noise(settings: ChannelSettings, times: float) -> bool:
    """One sample beside twenty that stand out by 1 N m."""
    values = np.zeros(400)
    values[10:210:10] = 1.0
    values[300] = times
    return len(_spikes(values, settings)) > 0


def spike_over_span(settings: ChannelSettings, share: float) -> bool:
    """One sample that stands out of torque that rises from 0 to 100 N m."""
    values = np.linspace(0.0, 100.0, 1001)
    values[500] += 98.0 * share  # 98 % of the samples span 98 N m
    return len(_spikes(values, settings)) > 0


def holes(settings: ChannelSettings, share: float) -> bool:
    values = np.arange(10_000.0)
    rng = np.random.default_rng(0)
    values[rng.choice(np.arange(1, 9_999), round(1e4 * share), replace=False)] = np.nan
    stamps = np.arange(10_000.0)
    found = missing(values, stamps, "elbow", "position", settings.max_missing)
    return bool([*found])


def too_fast(settings: ChannelSettings, times: float) -> bool:
    joint = SimpleNamespace(name="elbow", velocity_limit=2.0, encoder_resolution=None)
    data: Any = SimpleNamespace(
        settings=InspectSettings(channels=settings),
        robot=SimpleNamespace(joints=[joint]),
        joints=SimpleNamespace(
            channels={"position": np.sin(np.linspace(0.0, 3.0, 500))[:, None]}
        ),
        t=np.linspace(0.0, 3.0, 500),
        moves=lambda j: True,
    )
    with patch.object(positions, "top_speed", lambda *_: 2.0 * times):
        found = [*positions.position_quality(data, ())]
    return any(finding.code == "speed_limit" for finding in found)


def of_equations(settings: DynamicsSettings, left: float) -> list[str]:
    """Codes of findings where the equations leave a share of the torque."""
    sample: Any = SimpleNamespace(
        thinned=lambda: None, rms_speeds=np.ones(1), moving=[0]
    )
    data: Any = SimpleNamespace(
        settings=InspectSettings(dynamics=settings), step=np.zeros(1)
    )
    nearly_right = SimpleNamespace(code="nearly right")
    with patch.multiple(
        equations,
        structural_error=lambda *_: left,
        angle_findings=lambda *_: iter([]),
        far_angle_finding=lambda *_: None,
        _nearly_right=lambda *_: iter([nearly_right]),
        _mending=lambda *_: None,
        causes_of=lambda *_, **__: [],
    ):
        return [finding.code for finding in equations._structural(data, sample)]


def cause_is_sought(settings: DynamicsSettings, left: float) -> bool:
    return "nearly right" not in of_equations(settings, left)


def no_match(settings: DynamicsSettings, left: float) -> bool:
    return "model_mismatch" in of_equations(settings, left)


def no_echo(settings: EchoSettings, friction: float) -> bool:
    """A torque that follows position, but for this share of friction in its RMS."""
    t = 0.02 * np.arange(3000)
    q = np.sin(t)
    direction = np.sign(np.cos(t))
    torque = np.sqrt(2.0) * (q + 0.08 * np.sin(40.0 * t))
    columns: Any = SimpleNamespace(
        of_position=q[:, None],
        direction=direction,
        speed=np.cos(t),
        accelerations=-q[:, None],
    )
    stretch = (2.0 * t).astype(np.intp)
    torque += friction * direction
    return not echo._follows_position(torque, columns, stretch, settings)


def at_rest(settings: ImuSettings) -> Any:
    return SimpleNamespace(
        settings=InspectSettings(imus=settings),
        recording=SimpleNamespace(valid=np.ones(9, dtype=bool)),
        robot=SimpleNamespace(gravity=np.array([0.0, 0.0, -9.81])),
    )


def wrong_gravity(settings: ImuSettings, error: float) -> bool:
    """An accelerometer whose three channels read too much at rest."""
    values = np.tile([0.0, 0.0, 9.81 * (1.0 + error)], (9, 1))
    imu: Any = SimpleNamespace(name="imu", axes=np.eye(3))
    with patch.object(readings, "rest_rows", lambda *_: values):
        return bool([*readings._force(at_rest(settings), imu, values, at_rest=True)])


def disagreement(settings: ImuSettings, error: float) -> bool:
    """Two triads of accelerometers, one channel of which reads too much or little."""
    axes = np.vstack([np.eye(3), np.eye(3)])
    rest = np.random.default_rng(0).standard_normal((20, 3))
    rest *= 9.81 / np.linalg.norm(rest, axis=1, keepdims=True)
    values = rest @ axes.T
    off = np.sqrt(2.0) * 9.81 * error  # half of its square is left beside its twin
    values[:, 5] += off * np.where(np.arange(20) % 2, 1.0, -1.0)
    imu: Any = SimpleNamespace(name="imu", axes=axes)
    max_error = settings.max_gravity_error
    return readings.odd_channel(imu, values, 9.81, max_error=max_error) is not None


def biased(settings: ImuSettings, bias: float) -> bool:
    gyro = np.tile([bias, 0.0, 0.0], (9, 1))
    imu: Any = SimpleNamespace(name="imu")
    with patch.object(readings, "rest_rows", lambda *_: gyro):
        return bool([*readings._bias(at_rest(settings), imu, gyro)])


WITNESSES = witnesses(
    "inspect",
    [
        ("channels.min_spike_ratio", 12.0, 8.0, spike_over_noise),
        ("channels.min_spike_share", 1.2, 0.8, spike_over_span),
        ("channels.max_missing", 0.012, 0.008, holes),
        ("channels.max_speed", 2.4, 1.6, too_fast),
        ("dynamics.max_left", 0.12, 0.08, cause_is_sought),
        ("dynamics.max_unexplained", 0.7, 0.5, no_match),
        ("echo.max_friction", 0.024, 0.018, no_echo),
        ("imus.max_gravity_error", 0.06, 0.04, wrong_gravity),
        ("imus.max_bias", 0.12, 0.08, biased),
    ],
)


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda one: one.setting)
def test_a_threshold_lies_where_it_should(witness: Witness) -> None:
    witness.check()


def test_accelerometers_that_disagree_on_gravity_are_held_to_the_same_limit() -> None:
    assert disagreement(ImuSettings(), 0.06)
    assert not disagreement(ImuSettings(), 0.04)
