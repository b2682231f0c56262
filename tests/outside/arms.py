"""Drawn arms: one description, written as MJCF for the simulator and as URDF for the user."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81
REACH = 1.6  # rad, of every joint on either side of zero


@dataclass(frozen=True)
class Link:
    """One moving link: its joint in the parent's frame, and its body (SI units)."""

    place: Array  # (3,) m
    axis: Array  # (3,)
    mass: float
    centre: Array  # (3,) m
    inertia: Array  # (3,) kg m^2, about the centre, along the frame's axes
    rotor: float  # kg m^2 at the joint
    coulomb: float  # N m, mean over the positions
    waviness: float  # of the Coulomb friction, over the positions
    phase: float
    viscous: float  # N m s/rad
    constant: float  # N m/A at the joint
    count: float  # rad

    def friction(self, q: float) -> float:
        """Coulomb friction at a position [N m]."""
        return self.coulomb * (1.0 + self.waviness * np.sin(q + self.phase))


@dataclass(frozen=True)
class Arm:
    """A chain of links, and how it is logged."""

    links: tuple[Link, ...]
    rate_hz: float
    noise: float  # of the torque, as a share of each joint's Coulomb friction

    @property
    def names(self) -> list[str]:
        """The joints."""
        return [f"j{k + 1}" for k in range(len(self.links))]


def drawn_arm(seed: int) -> Arm:
    """An arm of two or three joints, of a size between a desktop arm and a UR10e."""
    rng = np.random.default_rng([seed, 77])
    size = float(rng.uniform(0.4, 1.0))
    links = []
    for k in range(int(rng.integers(2, 4))):
        axis = np.array([0.0, 1.0, 0.0]) if k != 1 or rng.random() < 0.7 else np.array([1.0, 0, 0])
        length, mass = 0.6 * size * 0.8**k, 12.0 * size**2 * 0.5**k
        radius = 0.15 * length
        weight = 9.81 * mass * 0.5 * length
        across = mass * (3.0 * radius**2 + length**2) / 12.0
        links.append(
            Link(
                place=np.array([0.0, 0.0, 0.2 if k == 0 else 0.6 * size * 0.8 ** (k - 1)]),
                axis=axis,
                mass=mass,
                centre=np.array(
                    [*rng.normal(0.0, 0.03 * length, 2), rng.uniform(0.4, 0.6) * length]
                ),
                inertia=np.array([across, across, 0.5 * mass * radius**2]),
                rotor=float(rng.uniform(0.1, 0.5)) * mass * length**2 / 3.0,
                coulomb=float(rng.uniform(0.05, 0.12)) * weight,
                waviness=float(rng.uniform(0.03, 0.15)),
                phase=float(rng.uniform(0.0, 6.0)),
                viscous=float(rng.uniform(0.03, 0.08)) * weight,
                constant=float(rng.uniform(5.0, 12.0)),
                count=float(10.0 ** rng.uniform(-5.0, -4.0)),
            )
        )
    rate = float(rng.choice([250.0, 500.0]))
    return Arm(tuple(links), rate, float(rng.uniform(0.02, 0.08)))


def _row(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def mjcf(arm: Arm) -> str:
    """The arm for MuJoCo; dry friction is a constraint there, so that joints can stick."""
    inner = ""
    for k, link in reversed(list(enumerate(arm.links))):
        inner = (
            f'<body name="l{k}" pos="{_row(link.place)}">'
            f'<inertial pos="{_row(link.centre)}" mass="{link.mass!r}" '
            f'diaginertia="{_row(link.inertia)}"/>'
            f'<joint name="{arm.names[k]}" type="hinge" axis="{_row(link.axis)}" '
            f'armature="{link.rotor!r}" damping="{link.viscous!r}" frictionloss="{link.coulomb!r}" '
            'solreffriction="0.002 1" solimpfriction="0.99 0.999 0.001"/>'
            f"{inner}</body>"
        )
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast" '
        f'gravity="0 0 {-GRAVITY}"/><worldbody>{inner}</worldbody></mujoco>'
    )


def urdf(arm: Arm) -> str:
    """The arm as its maker publishes it."""
    parts = ['<robot name="outside"><link name="base"/>']
    for k, (name, link) in enumerate(zip(arm.names, arm.links, strict=True)):
        x, y, z = map(float, link.inertia)
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="{_row(link.centre)}"/>'
            f'<mass value="{link.mass!r}"/><inertia ixx="{x!r}" iyy="{y!r}" izz="{z!r}" '
            'ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent '
            f'link="{arm.names[k - 1] + "_link" if k else "base"}"/><child link="{name}_link"/>'
            f'<origin xyz="{_row(link.place)}"/><axis xyz="{_row(link.axis)}"/>'
            f'<limit lower="{-2 * REACH}" upper="{2 * REACH}" velocity="6" effort="1e4"/></joint>'
        )
    return "".join(parts) + "</robot>"


def robot_toml(arm: Arm) -> str:
    """The robot file that a user writes."""
    lines = [
        'schema = "seqid/robot@1"',
        'name = "outside"',
        'urdf = "arm.urdf"',
        f"gravity = [0.0, 0.0, {-GRAVITY}]",
    ]
    for name, link in zip(arm.names, arm.links, strict=True):
        lines += ["[[joint]]", f'name = "{name}"', f"torque_constant = {link.constant!r}"]
        lines += ["gear_ratio = 1.0", f"encoder_resolution = {link.count!r}"]
    return "\n".join(lines) + "\n"
