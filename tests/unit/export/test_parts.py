"""Pieces of the export: pseudo-inertias, the conic problem, friction, effects, the
URDF's XML.
"""

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.linalg import null_space

from seqid_cli.effects.fitted import FittedEffect, as_stage
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.errors import ConfigError
from seqid_cli.export.formats import export
from seqid_cli.export.model import simple_friction
from seqid_cli.export.text import plain, real
from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.nearest import expected_links
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import inverse_dynamics
from tests.plants.robots.made import friction_joint
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import NAMES_6R, joint, link, urdf, urdf_6r
from tests.plants.robots.stages import random_bodies, save_robot, stages_of
from tests.unit.export.arms import agree, rigid, sample, states, with_effect
from tests.unit.logs.samples import make_robot


@pytest.mark.parametrize("rotor", [True, False])
def test_inertia_that_may_be_a_rotors_makes_no_link_heavy(rotor: bool) -> None:
    """A first link shows in one number alone, which holds the rotor of its drive as
    well.
    """
    E = np.zeros((2, 20))
    E[0, 9] = E[1, 19] = 1.0  # Izz of both
    G = np.array([[1.0], [0.0]]) if rotor else np.zeros((2, 0))
    robot = make_robot(["first", "second"])
    J = expected_links(robot, np.zeros((2, 10)), E, np.array([0.7, 0.01]), G)[0]
    first, second = J[:, 3, 3]
    assert (first == pytest.approx(second)) == rotor


def test_the_solution_is_the_minimum_of_the_divergence() -> None:
    """Feasible steps in any direction along the equations make the divergence
    larger.
    """
    rng = np.random.default_rng(3)
    phi = random_bodies(rng, 2)
    J = pseudo_inertia(phi)
    E = rng.normal(size=(6, 20))
    values = E @ random_bodies(rng, 2).ravel()
    phi, _, exact = consistent_links(
        J, np.zeros(0), E, np.zeros((6, 0)), values, np.eye(6)
    )
    assert exact
    np.testing.assert_allclose(E @ phi.ravel(), values, atol=1e-9)

    def divergence(x: np.ndarray) -> float:
        S = np.linalg.solve(J, pseudo_inertia(x.reshape(2, 10)))
        return float(np.sum(np.trace(S, axis1=1, axis2=2) - np.linalg.slogdet(S)[1]))

    best = divergence(phi)
    for direction in null_space(E).T:
        for step in (-5e-4, 5e-4):
            assert not divergence(phi.ravel() + step * direction) < best - 1e-6


@pytest.mark.parametrize(
    ("forward", "backward", "viscous", "rel"),
    [
        ([3.1, 1.0], [3.1, 1.0], 1.0, 1e-6),  # 3.1 + (v - 1.1): 2 + v
        ([2.0, -0.5], [2.0, -0.5], 0.0, 1e-3),  # no negative damping
        ([2.5], [1.5], 0.0, 1e-6),  # the offset does not flip with the direction
    ],
)
def test_friction_becomes_coulomb_viscous_and_an_offset(
    forward: list[float], backward: list[float], viscous: float, rel: float
) -> None:
    offset = 0.5 * (forward[0] - backward[0])
    ways = forward != backward
    own = {"speed_range": [0.1, 2.1], "sign_width": 0.001, "directional": ways}
    joint = friction_joint([forward], [backward], **own)
    fit = simple_friction(FrictionSurface.from_stage(joint))
    assert fit.coulomb == pytest.approx(2.0, rel=rel)
    assert (fit.viscous, fit.offset) == pytest.approx((viscous, offset), abs=1e-12)
    assert (fit.rms_misfit < 1e-12) == (viscous > 0.0)


def test_urdf_keeps_all_but_inertials_dynamics_and_drives_of_the_arm(
    tmp_path: Path,
) -> None:
    """Of two joints with a fixed flange, a finger, and a second arm from the base."""
    text = urdf(
        link("base", mass=5.0, mesh="package://nowhere/base.dae"),
        link("upper", mass=3.0, x=0.1, mesh="upper.stl"),
        *(
            link(name, mass=0.5, x=0.02)
            for name in ("lower", "flange", "palm", "finger")
        ),
        *(link(name, mass=1.0) for name in ("camera", "other")),
        joint(
            "shoulder", "base", "upper", axis="0 1 0", extra='<dynamics damping="9"/>'
        ),
        joint("elbow", "upper", "lower", axis="0 1 0", xyz="0.4 0 0"),
        joint("mount", "lower", "flange", kind="fixed", xyz="0.3 0 0", rpy="0 0.5 0.2"),
        joint("grip", "flange", "palm", kind="fixed", xyz="0 0 0.1", rpy="0 0 1"),
        joint("slide", "palm", "finger", kind="prismatic", axis="1 0 0", rpy="0.4 0 0"),
        joint("eye", "base", "camera", kind="fixed"),
        joint("second", "camera", "other"),
        '<ros2_control name="driver" type="system"/>',
    )
    text = text.replace("<robot", "<!-- by hand -->\n<robot", 1)
    robot = save_robot(tmp_path, text, ("shoulder", "elbow"))
    assert robot.nominal is not None
    done = export(robot, stages_of(robot, robot.nominal), kind="URDF")
    before, after = ElementTree.fromstring(text), ElementTree.fromstring(done.text)
    assert "<!-- by hand -->" in done.text
    assert [system.get("name") for system in after.findall("ros2_control")] == [
        "driver"
    ]
    inertials = {
        e.get("name"): e.find("inertial") is not None for e in after.findall("link")
    }
    assert {name for name, there in inertials.items() if not there} == {
        "flange",
        "palm",
    }
    assert len(inertials) == 8
    dynamics, fit = (
        after.find("joint[@name='shoulder']/dynamics"),
        done.model.friction[0],
    )
    assert float(dynamics.get("damping", "")) == pytest.approx(fit.viscous)
    assert float(dynamics.get("friction", "")) == pytest.approx(fit.coulomb)
    written = {"flange", "palm", "upper", "lower"}
    for tree in (before, after):
        for parent in list(tree.iter()):
            own = {"dynamics", "transmission", "ros2_control"}
            own |= {"inertial"} if parent.get("name") in written else set()
            for child in [child for child in parent if child.tag in own]:
                parent.remove(child)
    flat = (
        [(e.tag, sorted(e.attrib.items())) for e in tree.iter()]
        for tree in (before, after)
    )
    assert len({str(elements) for elements in flat}) == 1


def test_rotor_inertia_goes_into_the_transmission_that_is_there(tmp_path: Path) -> None:
    extra = "gear_ratio = 101.0\nrotor_inertia = 2e-4\n"
    robot = save_robot(tmp_path, urdf_6r(), NAMES_6R, joint_extra=extra)
    assert robot.nominal is not None
    done = export(robot, stages_of(robot, robot.nominal), kind="URDF")
    root = ElementTree.fromstring(done.text)
    assert len(root.findall("transmission")) == len(NAMES_6R)
    values = [
        float(e.get("value", ""))
        for e in root.iter("{http://drake.mit.edu}rotor_inertia")
    ]
    assert values == pytest.approx([2e-4] * 6)
    assert f"armature {real(101.0**2 * 2e-4)}" in done.text


def test_a_payload_is_part_of_the_last_link() -> None:
    robot, rng = sample_robot("two_joint"), np.random.default_rng(6)
    phi, load = random_bodies(rng, 2), random_bodies(rng, 1)[0]
    stages = stages_of(robot, phi)
    item = FittedEffect(
        effect=CATALOGUE["payload"],
        joint=None,
        settings={"from_log": 0.0},
        coefficients=load,
        covariance=np.eye(10),
    )
    stages.effects = [as_stage(item, robot)]
    model = export(robot, stages, kind="MJCF").model
    assert any(
        "added to the inertial parameters: payload" in note for note in model.notes
    )
    phi[1] += load
    q, dq, ddq = states(2)
    found = inverse_dynamics(robot.chain, robot.gravity, model.bodies, q, dq, ddq)
    agree(found, inverse_dynamics(robot.chain, robot.gravity, phi, q, dq, ddq), 1e-8)


def test_a_rotor_inertia_that_was_wrong_is_corrected() -> None:
    robot, stages = with_effect("rotor_inertia", 3, {"coupling": 0.0}, [1.5e-5])
    model = export(robot, stages, kind="MJCF").model
    expected = np.array([j.rotor_inertia or 0.0 for j in robot.joints])
    expected[3] += 1.5e-5
    np.testing.assert_allclose(model.nearest.rotor, expected, rtol=1e-6)


def test_effects_without_a_place_are_named() -> None:
    settings = {"stribeck_speed": 0.1, "exponent": 2.0}
    done = export(*with_effect("stribeck", 1, settings, [0.5]), kind="URDF")
    note = "is left out: stribeck (shoulder_lift)"
    assert any(note in text for text in done.model.notes)
    assert note in done.text


def test_parameters_that_the_logs_did_not_show_come_from_the_prior() -> None:
    robot, stages = sample("two_joint")
    gone = stages.inertia.parameters.pop()
    stages.inertia.covariance = [row[:-1] for row in stages.inertia.covariance[:-1]]
    model = export(robot, stages, kind="URDF").model
    assert gone.name not in {d.name for d in model.deviations}
    note = f"not determined by the logs, so as in the prior: {gone.name}"
    assert any(note in text for text in model.notes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        # nor a URDF with masses
        (lambda x: setattr(x, "inertia", None), "no inertia stage"),
        (
            lambda x: setattr(x.inertia.parameters[0], "name", "mz_1"),
            "'mz_1' is no base parameter",
        ),
        (lambda x: x.inertia.representative.update(Izz_2=1e200), "1e\\+200"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    change: Callable[[Stages], None], message: str
) -> None:
    robot, stages = sample("two_joint")
    change(stages)
    with pytest.raises(ConfigError, match=message):
        export(robot, stages, kind="URDF")


@pytest.mark.parametrize("error", [1e-6, 1e-3, 1.0])
def test_noise_of_any_size_gives_bodies_that_exist(
    tmp_path: Path, error: float
) -> None:
    robot = save_robot(
        tmp_path, urdf_6r(), NAMES_6R, joint_extra="gear_ratio = 100.0\n"
    )
    rng = np.random.default_rng(13)
    phi, rotor = random_bodies(rng, 6), np.full(6, 1e-4)
    size = len(stages_of(robot, phi, rotor).inertia.parameters)
    stages = stages_of(robot, phi, rotor, error=error, shift=rng.normal(size=size))
    model = export(robot, stages, kind="URDF").model
    assert all(
        np.linalg.eigvalsh(pseudo_inertia(row))[0] > 0.0 for row in model.nearest.links
    )
    assert model.largest_deviation < 5.0


def test_torque_scale_of_any_size_is_solved() -> None:
    """Arms of grams and of tons are the same problem."""
    robot = sample_robot("two_joint")
    phi = random_bodies(np.random.default_rng(11), 2)
    for scale in (1e-6, 1e6):
        stages = stages_of(robot, scale * phi)
        model = export(robot, stages, kind="MJCF").model
        assert model.nearest.exact
        found = inverse_dynamics(robot.chain, robot.gravity, model.bodies, *states(2))
        agree(found + model.armature * states(2)[2], rigid((robot, stages)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a -- b", "a - - b"),
        ("*/ int x; /*", "* / int x; / *"),
        ("l\nm\\", "l.m."),
        ("a-", "a"),
    ],
)
def test_names_cannot_leave_a_comment(text: str, expected: str) -> None:
    assert plain(text) == expected
