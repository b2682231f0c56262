"""Friction of many laws: their coefficients and settings come back, and no others are
believed.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seqid_cli.effects.asymmetric_friction import AsymmetricFriction
from seqid_cli.effects.effect import Effect, GridAxes
from seqid_cli.effects.gear_efficiency import GearEfficiency
from seqid_cli.effects.gear_load import ROTOR as REFLECTED
from seqid_cli.effects.hysteresis import Hysteresis
from seqid_cli.effects.load_dependent_friction import LoadDependentFriction
from seqid_cli.effects.memory import deflection, wound
from seqid_cli.effects.nonlinear_viscous import NonlinearViscous
from seqid_cli.effects.presliding_hysteresis import PreslidingHysteresis
from seqid_cli.effects.quadratic_drag import QuadraticDrag
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scenes
from seqid_cli.effects.stribeck import Stribeck
from seqid_cli.robot.base_parameters import STANDARD
from tests import Array
from tests.plants.robots.two_joint import GEAR, ROTOR, torque_model, two_joint_robot
from tests.unit.effects.fitting import (
    FINE_HZ,
    Law,
    direction,
    fit,
    fitted,
    trials,
)
from tests.unit.effects.scenes import scene_of, wander

# N m, rad/s
HEIGHT = 2.0
SPEED = 0.12
DRAG = 0.25  # N m s^2/rad^2
# Coulomb N m, viscous N m s/rad
FORTH = (3.0, 1.1)
BACK = (2.2, 0.8)
SHARE = 0.08
DRIVING = 0.82
BACKDRIVING = 0.91
# N m, rad
TORQUE = 5.0
DISTANCE = 0.01
WAY = 0.22  # of a rope
SOFT = {"trial_stiffness": 900.0, "encoder_side": 0.0, "damping_ratio": 0.15}


def humped(exponent: float) -> Law:
    """Friction as Armstrong-Helouvry writes it: one curve of the speed."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        level = 3.0 + HEIGHT * np.exp(-((np.abs(dq) / SPEED) ** exponent))
        return level * direction(dq) + 0.7 * dq

    return law


def powered(size: float, exponent: float) -> Law:
    """Coulomb, viscous and one more power of the speed."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        speed = np.abs(dq)
        return direction(dq) * (2.0 + 0.5 * speed + size * speed**exponent)

    return law


def dragged(t: Array, q: Array, dq: Array) -> Array:
    """A body in a fluid: power lost grows with the cube of the speed."""
    lost = DRAG * np.abs(dq) ** 3
    return lost / np.where(dq == 0.0, 1.0, dq) + direction(dq) + 0.5 * dq


def one_sided(t: Array, q: Array, dq: Array) -> Array:
    """One law forth, another back, nothing at rest."""
    dry = np.where(dq > 0, FORTH[0], BACK[0])
    wet = np.where(dq > 0, FORTH[1], BACK[1])
    return dry * direction(dq) + wet * dq


def link_torque(q: Array, dq: Array) -> Array:
    """Torque (N, n) N m behind the gears."""
    ddq = np.gradient(dq, 1.0 / FINE_HZ, axis=0)
    return (
        torque_model(two_joint_robot()).rigid(q, dq, ddq)
        - np.square(GEAR) * ROTOR * ddq
    )


def loaded(t: Array, q: Array, dq: Array) -> Array:
    """Tooth friction on top of a seal's."""
    return (2.0 + SHARE * np.abs(link_torque(q, dq))) * direction(dq) + 0.3 * dq


def lossy(t: Array, q: Array, dq: Array) -> Array:
    """Return motor torque beyond the link's: a motor gives more, or is driven less."""
    load = link_torque(q, dq)
    motor = np.where(load * dq > 0, load / DRIVING, load * BACKDRIVING)
    return motor - load + 2.0 * direction(dq) + 0.3 * dq


def dahl(q: Array, distance: float, substeps: int = 20) -> Array:
    """Integrate z' = v - |v| z / z_max by the midpoint rule, the speed constant in each
    sample.
    """
    z = 0.0
    out = np.zeros(len(q))
    for k, way in enumerate(np.diff(q) / substeps):
        for _ in range(substeps):
            half = z + 0.5 * (way - abs(way) * z / distance)
            z += way - abs(way) * half / distance
        out[k + 1] = z / distance
    return out


def bouc_wen(q: Array, distance: float, n: int, substeps: int = 20) -> Array:
    """Integrate dz = (1 - |z|^n (1 + sign(z dq)) / 2) dq / x_0 by the midpoint rule."""
    z = 0.0
    out = np.zeros(len(q))
    for k, way in enumerate(np.diff(q) / distance / substeps):
        for _ in range(substeps):
            half = z + 0.5 * way * (1.0 - abs(z) ** n * (z * way > 0.0))
            z += way * (1.0 - abs(half) ** n * (half * way > 0.0))
        out[k + 1] = z
    return out


def roped(n: int) -> Law:
    """A rope that rubs on both joints, and viscous friction."""

    def law(t: Array, q: Array, dq: Array) -> Array:
        states = [bouc_wen(q[:, j], WAY, n, substeps=2) for j in range(q.shape[1])]
        return TORQUE * np.stack(states, axis=1) + 0.5 * dq

    return law


def bristled(t: Array, q: Array, dq: Array) -> Array:
    """Dahl friction and viscous friction on both joints."""
    bristles = [TORQUE * dahl(q[:, j], DISTANCE, substeps=2) for j in range(q.shape[1])]
    return np.stack(bristles, axis=1) + 0.5 * dq


# effect, joint, torque by the law, logs, noise N m, coefficient, how well, settings
LAWS = [
    *(
        (Stribeck(), 0, humped(a), 3, 0.2, HEIGHT, 0.06, (SPEED, a))
        for a in (0.5, 1.0, 2.0)
    ),
    *((QuadraticDrag(), j, dragged, 2, 0.05, DRAG, 0.03, ()) for j in (0, 1)),
    *(
        (NonlinearViscous(), 0, powered(size, a), 3, 0.05, size, 0.25, (a,))
        for size, a in ((2.0, 0.5), (1.5, 0.7), (0.4, 3.0), (-0.1, 3.0))
    ),
    *((LoadDependentFriction(), j, loaded, 2, 0.2, SHARE, 0.05, None) for j in (0, 1)),
    (PreslidingHysteresis(), 1, bristled, 3, 0.2, TORQUE, 0.03, (DISTANCE,)),
]


@pytest.mark.slow
@pytest.mark.parametrize("case", LAWS, ids=lambda case: f"{case[0].name} {case[5]}")
def test_the_law_comes_back(
    case: tuple[Effect, int, Law, int, float, float, float, Any],
) -> None:
    effect, joint, law, logs, noise, c, rel, settings = case
    fitted_settings, coefficients = fit(effect, trials(law, logs, noise=noise), joint)
    assert coefficients[0] == pytest.approx(c, rel=rel)
    if settings is not None:
        tolerance = 0.03 if effect.name == "presliding_hysteresis" else 0.1
        assert list(fitted_settings.values()) == pytest.approx(settings, rel=tolerance)
        assert effect.name != "stribeck" or fitted_settings["exponent"] == settings[1]


@pytest.mark.parametrize("offset", [False, True])
def test_half_differences_come_back(offset: bool) -> None:
    """Also beside a free offset, by the rests and reversals."""
    _, c = fit(
        AsymmetricFriction(), trials(one_sided, 3, noise=0.1), joint=0, offset=offset
    )
    assert c == pytest.approx(
        [0.5 * (a - b) for a, b in zip(FORTH, BACK, strict=True)], rel=0.1
    )


def test_drag_is_not_called_nonlinear_viscous() -> None:
    effect = NonlinearViscous()
    logs = trials(powered(0.3, 2.0))
    settings, c = fit(effect, logs, joint=0)
    assert settings["exponent"] == pytest.approx(2.0, abs=0.1)
    assert not effect.plausible(logs, 0, settings, c)


@pytest.mark.parametrize(
    ("name", "settings", "c", "believed"),
    [
        ("stribeck", {"stribeck_speed": 0.1, "exponent": 2.0}, 1.0, True),
        ("stribeck", {"stribeck_speed": 0.1, "exponent": 2.0}, -1.0, False),
        # than the motion
        ("stribeck", {"stribeck_speed": 50.0, "exponent": 2.0}, 1.0, False),
        ("presliding_hysteresis", {"presliding_distance": DISTANCE}, 1.0, True),
        ("presliding_hysteresis", {"presliding_distance": DISTANCE}, -1.0, False),
        # nor covered by it
        ("presliding_hysteresis", {"presliding_distance": 0.3}, 1.0, False),
        *(
            ("backlash", {"trial_gap": 1e-3}, c, c == 1.2e-3)
            for c in (1.2e-3, 1e-4, 1e-2)
        ),
        *(("joint_elasticity", SOFT, c / 900.0, c == 1.0) for c in (1.0, 0.1, -1.0)),
    ],
)
def test_what_motion_or_shape_contradicts_is_not_believed(
    name: str, settings: Mapping[str, float], c: float, believed: bool
) -> None:
    scenes = [
        scene_of(
            wander(10.0, amplitude=0.1 if name == "presliding_hysteresis" else 1.0)
        )
    ]
    assert CATALOGUE[name].plausible(scenes, 0, settings, np.array([c])) == believed


@pytest.mark.parametrize("joint", [0, 1])
def test_efficiencies_come_back(joint: int) -> None:
    effect = GearEfficiency()
    logs = trials(lossy, noise=0.2)
    _, c = fit(effect, logs, joint)
    values = {
        v.name: v for v in effect.values(logs[0].robot, joint, {}, c, 1e-6 * np.eye(2))
    }
    assert c == pytest.approx([1 / DRIVING - 1, 1 - BACKDRIVING], rel=0.05)
    assert values["driving_efficiency"].value == pytest.approx(DRIVING, rel=0.01)
    assert values["backdriving_efficiency"].value == pytest.approx(
        BACKDRIVING, rel=0.01
    )
    assert values["driving_efficiency"].std_error == pytest.approx(
        DRIVING**2 * 1e-3, rel=0.03
    )


def test_without_a_rigid_body_there_is_no_load() -> None:
    robot = two_joint_robot()
    unknown = replace(torque_model(robot), phi=None, rotor=None, coupling="diagonal")
    effect = LoadDependentFriction()
    q = wander(10.0)
    assert effect.available([scene_of(q)], 0)
    assert not effect.available([scene_of(q), scene_of(q, model=unknown)], 0)


def test_a_rotor_that_nobody_knows_does_not_load_the_gear() -> None:
    """The first joint's rotor stands in its link's inertia; what is lost tells them
    apart.
    """
    robot = two_joint_robot()
    reflected = GEAR[0] ** 2 * ROTOR[0]
    first = replace(robot.joints[0], rotor_inertia=None)
    model = torque_model(robot)
    robot = replace(robot, joints=(first, *robot.joints[1:]))
    lumped = model.phi.copy()
    lumped[0, STANDARD.index("Izz")] += reflected
    model = replace(
        model, robot=robot, phi=lumped, rotor=np.array([0.0, model.rotor[1]])
    )
    logs = trials(loaded, noise=0.2, top_hz=1.5)
    logs = [replace(scene, robot=robot, model=model) for scene in logs]
    settings, c = fit(LoadDependentFriction(), logs, 0)
    assert c[0] == pytest.approx(SHARE, rel=0.05)
    assert settings[REFLECTED] == pytest.approx(reflected, rel=0.15)


@pytest.mark.parametrize("distance", [0.003, 0.03, 0.3])
def test_the_closed_form_of_dahls_bristle_solves_its_equation(distance: float) -> None:
    q = wander(15.0, seed=4)[:, 0]
    np.testing.assert_allclose(deflection(q, distance), dahl(q, distance), atol=1e-3)


class RopeOfSharpness(Hysteresis):
    """A rope whose law is given."""

    def __init__(self, n: int) -> None:
        self.n = n

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        return {**super().axes(scenes, joint), "sharpness": [float(self.n)]}


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2])
def test_a_rope_comes_back(n: int) -> None:
    """Its torque, its way, and which of the laws it has."""
    logs = trials(roped(n), 3, noise=0.2)
    left = {}
    for tried in (0, 1, 2):
        settings, c = fit(RopeOfSharpness(tried), logs, joint=1)
        free = ("direction", "velocity", "offset")
        left[tried] = fitted(Hysteresis(), logs, 1, settings, free)[1]
        if tried == n:
            assert c[0] == pytest.approx(TORQUE, rel=0.01)
            assert settings["hysteresis_distance"] == pytest.approx(WAY, rel=0.01)
            assert Hysteresis().plausible(logs, 1, settings, c)
    others = [rms for tried, rms in left.items() if tried != n]
    assert min(others) > 3.0 * left[n]


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("distance", [0.03, 0.3])
def test_the_closed_form_of_a_rope_solves_its_equation(distance: float, n: int) -> None:
    q = wander(15.0, seed=4)[:, 0]
    np.testing.assert_allclose(
        wound(q, distance, n), bouc_wen(q, distance, n), atol=2e-3
    )


def test_a_rope_gives_the_same_loop_at_any_speed() -> None:
    """And keeps what it has at rest."""
    way = np.concatenate([np.linspace(0.0, 1.0, 401), np.linspace(1.0, -0.5, 601)])
    slow = np.repeat(way, 3)
    np.testing.assert_allclose(wound(slow, 0.2, 2)[::3], wound(way, 0.2, 2), atol=1e-12)
