"""URDF to chain: what other tools write, and what is refused."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.robot.base_parameters import base_parameters
from seqid_cli.robot.regressor import inverse_dynamics, torque_regressor
from seqid_cli.robot.urdf_model import frame_points, geometry_of
from tests.plants.robots import small
from tests.plants.robots.small import NAMES_6R, joint, link, urdf, urdf_6r
from tests.plants.robots.stages import save_robot

ARMS = [(urdf_6r(), NAMES_6R), (small.urdf_gantry(), small.NAMES_GANTRY)]


@pytest.mark.parametrize(("text", "names"), ARMS, ids=["6r", "gantry"])
def test_regressor_and_torque_are_pinocchios(
    tmp_path: Path, text: str, names: tuple[str, ...]
) -> None:
    robot = save_robot(tmp_path, text, names)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    q, dq, ddq = small.states(np.random.default_rng(0), 8, robot.n)
    Y = torque_regressor(robot.chain, robot.gravity, q, dq, ddq)
    tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
    for k in range(8):
        # (cos, sin) of endless turns
        wide = pin.integrate(model, pin.neutral(model), q[k])
        expected = pin.computeJointTorqueRegressor(model, data, wide, dq[k], ddq[k])
        np.testing.assert_allclose(Y[k], expected, rtol=0.0, atol=1e-10)
        rnea = pin.rnea(model, data, wide, dq[k], ddq[k])
        np.testing.assert_allclose(tau[k], rnea, rtol=0.0, atol=1e-10)


def test_joints_that_are_not_named_are_locked_at_zero_and_merged(
    tmp_path: Path,
) -> None:
    q, found = np.random.default_rng(3).normal(size=(3, 2)), []
    for names, at in ((NAMES_6R[1:3], q), (NAMES_6R, np.pad(q, ((0, 0), (1, 3))))):
        arm, still = save_robot(tmp_path, urdf_6r(), names), 0.0 * at
        found.append(
            inverse_dynamics(arm.chain, arm.gravity, arm.nominal, at, still, still)
        )
    some, every = found
    np.testing.assert_allclose(some, every[:, 1:3], atol=1e-10)


MIMIC = urdf(
    *(link(name, mass=1.0, x=0.1) for name in ("base", "l1", "finger_l", "finger_r")),
    joint("turn", "base", "l1", axis="0 1 0"),
    joint("left", "l1", "finger_l", kind="prismatic"),
    joint("right", "l1", "finger_r", kind="prismatic", extra='<mimic joint="left"/>'),
)
BRANCHES = urdf(
    *(link(name, mass=1.0) for name in ("base", "left_arm", "right_arm")),
    joint("left", "base", "left_arm"),
    joint("right", "base", "right_arm"),
)


def test_mimic_joints_and_other_branches_are_locked(tmp_path: Path) -> None:
    assert save_robot(tmp_path, MIMIC, ("turn",)).nominal[0, 0] == pytest.approx(3.0)
    assert save_robot(tmp_path, BRANCHES, ("right",)).n == 1


def test_a_mimic_joint_beside_the_arm_is_left_out_by_name(tmp_path: Path) -> None:
    arm = save_robot(tmp_path, MIMIC, ("turn", "right"))
    assert arm.joint_names == ("turn",)
    assert [joint.name for joint in arm.followers] == ["right"]
    without = save_robot(tmp_path, MIMIC, ("turn",))
    np.testing.assert_allclose(arm.nominal, without.nominal)
    assert not without.followers


CARRYING_MIMIC = urdf(
    *(link(name, mass=1.0) for name in ("base", "l1", "l2", "l3")),
    joint("first", "base", "l1"),
    joint("follower", "l1", "l2", extra='<mimic joint="first"/>'),
    joint("last", "l2", "l3"),
)
ORDER, KNOWN = "not in chain order: ", ", ".join(NAMES_6R)


@pytest.mark.parametrize(
    ("text", "names", "message", "hint"),
    [
        (
            CARRYING_MIMIC,
            "first follower last",
            r"joint\[1\].name 'follower' follows joint 'first'",
            "locked",
        ),
        (MIMIC, "right", r"joint\[0\].name 'right' follows joint 'left'", "locked"),
        (MIMIC, "left turn", f"{ORDER}left, turn", "turn, left"),
        (
            urdf_6r(),
            "elbow wrist_1 shoulder_lift",
            ORDER,
            "shoulder_lift, elbow, wrist_1",
        ),
        (
            BRANCHES,
            "left right",
            "'left' and 'right' are on different branches",
            "one serial",
        ),
        (
            urdf_6r(),
            "elbo",
            r"joint\[0\].name 'elbo' is no joint",
            "Did you mean 'elbow'?",
        ),
        (urdf_6r(), "elbo", "is no joint", KNOWN),
        (urdf_6r(), "tool_mount", "'tool_mount' is a fixed joint", "can be driven"),
    ],
)
def test_joints_that_are_no_chain_are_named(
    tmp_path: Path, text: str, names: str, message: str, hint: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        save_robot(tmp_path, text, tuple(names.split()))
    assert hint in caught.value.hint


def test_rounded_angles_are_tidied(tmp_path: Path) -> None:
    rough = urdf_6r().replace(repr(float(np.pi / 2)), "1.5708")
    assert "1.5708" in rough
    assert base_parameters(save_robot(tmp_path, rough, NAMES_6R), rotor=()).size == 36


def turning(*, mass: float | None = None, **options: str) -> str:
    return urdf(link("a"), link("b", mass=mass), joint("turn", "a", "b", **options))


TURN = joint("turn", "a", "b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot name='r'><link name='a'/>", "not well-formed XML"),
        ("<sdf/>", "outermost element is <sdf>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="r"/>', "declares XML entities"),
        (urdf('<xacro:include filename="a"/>'), "xacro file"),
        (
            urdf(link("a"), link("b"), joint("turn", "a", "c")),
            "child link 'c' is not in the URDF",
        ),
        (urdf(link("a"), link("b"), TURN, TURN), "two joints are named 'turn'"),
        (urdf(link("a"), link("b"), link("c"), TURN), "2 root links"),
        (urdf(link("a"), joint("turn", "a", "a")), "a loop, no root"),
        (
            urdf(link("a"), link("b"), link("c"), TURN, joint("own", "c", "c")),
            r"a loop of links beside its tree \(c\)",
        ),
        (
            urdf(
                *(link(name) for name in "abcd"),
                TURN,
                joint("there", "c", "d"),
                joint("back", "d", "c"),
            ),
            r"a loop of links beside its tree \(c, d\)",
        ),
        (turning(xyz="0 nan 0"), "finite"),
        (turning(axis="0 0 0"), "no direction"),
        (turning(xyz="0 x 0"), "xyz='0 x 0'"),
        (turning(xyz="0 0"), "'turn': <origin xyz"),
        (turning(rpy="0 0 1e300"), "rpy='0 0 1e300'"),
        (turning(mass=-3.7), "link 'b': .*value='-3.7'"),
        (turning(kind="planar"), "planar joint"),
    ],
)
def test_damaged_urdf_is_a_message(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        save_robot(tmp_path, text, ("turn",))


@pytest.mark.parametrize("attribute", ['iyz="x"', 'iyz="0.003" ixx="a\u202e"'])
def test_what_the_parser_of_the_library_prints_is_not_heard(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], attribute: str
) -> None:
    text = turning(mass=1.0).replace('iyz="0.003"', attribute)
    with pytest.raises(ConfigError) as caught:
        save_robot(tmp_path, text, ("turn",))
    assert caught.value.where == str(tmp_path / "arm.urdf")
    assert not capfd.readouterr().err


def test_nor_when_links_are_read_once_more(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The inertia of a link lacks a number: the library goes on without that link's."""
    text = urdf_6r()
    first = text.index(" ixx=")
    lacking = text[:first] + text[text.index(" ixy=", first) :]
    robot = save_robot(tmp_path, text, NAMES_6R)
    (tmp_path / "arm.urdf").write_text(lacking)
    assert robot.urdf == tmp_path / "arm.urdf"
    frame_points(robot)
    geometry_of(robot, np.zeros((1, robot.n)))
    assert not capfd.readouterr().err


ATTRIBUTES = " ".join(f'a{k}="1"' for k in range(101))


def _chain_of(count: int) -> str:
    links = [link(f"l{k}") for k in range(count + 1)]
    joints = [joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(count)]
    return urdf(*links, *joints)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot>" + "<a>" * 200_000 + "</a>" * 200_000 + "</robot>", "100 deep"),
        ("<robot>" + "<a/>" * 200_001 + "</robot>", "more than 200000 elements"),
        (
            f"<robot {ATTRIBUTES}/>",
            "<robot> has 101 attributes, more than 100",
        ),
        (_chain_of(1001), "it has 1001 joints, more than 1000"),
    ],
    ids=["deep", "wide", "attributes", "chain"],
)
def test_what_would_end_a_parser_is_refused_before_it(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as raised:
        save_robot(tmp_path, text, ("j0",))
    assert raised.value.where.endswith(".urdf")
