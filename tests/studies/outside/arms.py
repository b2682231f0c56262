"""Arms of the second simulator: drawn chains, and published ones with drawn drives."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests import Array

GRAVITY = 9.81
REACH = 1.4  # rad, at most, of a joint on either side of the middle of its range
PUBLISHED = Path(__file__).with_name("published.json")
SHAPE = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # of six numbers as an inertia matrix


@dataclass(frozen=True)
class Link:
    """One link: its joint's frame in the parent's, and its body (SI units)."""

    place: Array  # (3,) m
    turn: Array  # (3,) rad, roll pitch yaw
    axis: Array  # (3,)
    mass: float
    centre: Array  # (3,) m
    inertia: Array  # (3, 3) kg m^2, about the centre, along the frame's axes
    middle: float = 0.0  # rad, of the joint's range
    reach: float = REACH  # rad, on either side of it
    speed: float = 3.0  # rad/s, the joint's limit


@dataclass(frozen=True)
class Drive:
    """What moves a joint, seen at the joint, and how it is measured."""

    rotor: float  # kg m^2
    coulomb: float  # N m, mean over the positions
    waviness: float  # of the Coulomb friction, over the positions
    phase: float
    viscous: float  # N m s/rad
    ratio: float
    constant: float  # N m/A of the motor
    count: float  # rad
    rise: float  # K, of its temperature in the long run
    warm_s: float  # time constant of that


@dataclass(frozen=True)
class Imu:
    """A triad with a gyro, or four triads at the corners of a tetrahedron, on a moving
    link.
    """

    link: int
    place: Array  # (3,) m
    quaternion: Array  # (4,) w x y z
    gyro: bool
    noise: float  # m/s^2 per sample
    bias: Array  # (12,) m/s^2

    @property
    def corners(self) -> Array:
        return np.vstack([np.zeros(3), 0.05 * np.eye(3)])[: 1 if self.gyro else 4]


@dataclass(frozen=True)
class Arm:
    """A chain of links, and how it is logged; links beyond the drives are locked."""

    label: str
    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    rate_hz: float
    noise: float  # of the torque, as a share of each joint's Coulomb friction
    bandwidth: float  # rad/s of the position loop
    forward: float  # share of the rigid arm's torque that is fed forward
    currents: bool  # logged instead of torques
    temperatures: bool  # logged as well
    imus: tuple[Imu, ...] = ()

    @property
    def n(self) -> int:
        return len(self.drives)

    @property
    def names(self) -> list[str]:
        return [f"j{k + 1}" for k in range(self.n)]

    def of(self, quantity: str) -> Array:
        return np.array([getattr(drive, quantity) for drive in self.drives])


def published_links(name: str) -> tuple[Link, ...]:
    rows = json.loads(PUBLISHED.read_text(encoding="utf-8"))["arms"][name]
    return tuple(
        Link(
            place=np.array(row["place"]),
            turn=np.array(row["turn"]),
            axis=np.array(row["axis"]),
            mass=row["mass"],
            centre=np.array(row["centre"]),
            inertia=np.array(row["inertia"])[np.array(SHAPE)],
            middle=float(np.mean(row["limits"])),
            reach=min(REACH, 0.4 * float(np.ptp(row["limits"]))),
            speed=min(row["speed"], 3.0),
        )
        for row in rows
    )


def drawn_links(rng: np.random.Generator, n: int) -> tuple[Link, ...]:
    """A chain of a size between a desktop arm and a UR10e."""
    size, links = float(rng.uniform(0.3, 1.0)), []
    axes = np.eye(3)[[1, 1 if rng.random() < 0.7 else 0, 1, 2, 1, 2]]
    if rng.random() < 0.3 and n > 1:
        axes[0] = [0.0, 0.0, 1.0]  # a turntable first
    for k in range(n):
        length, mass = 0.6 * size * 0.8**k, 12.0 * size**2 * 0.55**k
        radius = 0.15 * length
        across = mass * (3.0 * radius**2 + length**2) / 12.0
        skew = 0.05 * across * rng.normal(size=3)
        off = np.array(
            [[0, skew[0], skew[1]], [skew[0], 0, skew[2]], [skew[1], skew[2], 0]]
        )
        links.append(
            Link(
                place=np.array(
                    [0.0, 0.0, 0.2 if k == 0 else 0.6 * size * 0.8 ** (k - 1)]
                ),
                turn=np.array([0.0, 0.0, rng.uniform(-0.5, 0.5) if k else 0.0]),
                axis=axes[k],
                mass=mass,
                centre=np.array(
                    [*rng.normal(0, 0.05 * length, 2), rng.uniform(0.4, 0.6) * length]
                ),
                inertia=np.diag([across, across, 0.5 * mass * radius**2]) + 0.3 * off,
                speed=float(rng.uniform(1.5, 4.0)),
            )
        )
    return tuple(links)


def _sizes(links: tuple[Link, ...], joint: int) -> tuple[float, float]:
    """Weight [N m] and inertia [kg m^2] at a joint of the arm stretched out,
    at most.
    """
    away, weight, inertia = 0.0, 0.0, 0.0
    for k, link in enumerate(links[joint:]):
        away += float(np.linalg.norm(link.place)) if k else 0.0
        at = away + float(np.linalg.norm(link.centre))
        weight, inertia = weight + GRAVITY * link.mass * at, inertia + link.mass * at**2
    return weight, inertia


def drawn_drives(
    rng: np.random.Generator, links: tuple[Link, ...], n: int
) -> tuple[Drive, ...]:
    """Motors and gears for the first n joints; friction varies over the positions."""
    drives = []
    for k in range(n):
        weight, inertia = _sizes(links, k)
        drives.append(
            Drive(
                rotor=float(rng.uniform(0.05, 0.3)) * inertia,
                coulomb=float(rng.uniform(0.03, 0.1)) * weight,
                waviness=float(rng.uniform(0.03, 0.15)),
                phase=float(rng.uniform(0.0, 6.0)),
                viscous=float(rng.uniform(0.02, 0.06)) * weight,
                ratio=float(round(rng.uniform(20.0, 120.0))),
                constant=float(rng.uniform(0.02, 0.15)),
                count=float(10.0 ** rng.uniform(-5.0, -3.7)),
                rise=float(rng.uniform(5.0, 20.0)),
                warm_s=float(rng.uniform(100.0, 400.0)),
            )
        )
    return tuple(drives)


def drawn_imus(rng: np.random.Generator, n: int) -> tuple[Imu, ...]:
    """One IMU on the last link that moves, sometimes one on the link before it."""
    gyro = bool(rng.random() < 0.5)
    links = [n - 1] if n == 1 or rng.random() < 0.6 else [n - 2, n - 1]
    imus = []
    for link in links:
        place, turn = rng.uniform(-0.1, 0.1, 3), rng.normal(size=4)
        noise, bias = float(rng.uniform(0.01, 0.05)), rng.normal(0.0, 0.05, 12)
        imus.append(Imu(link, place, turn / np.linalg.norm(turn), gyro, noise, bias))
    return tuple(imus)


def drawn_arm(rng: np.random.Generator, label: str, n: int, imus: bool) -> Arm:
    links = drawn_links(rng, n) if label == "drawn" else published_links(label)
    return Arm(
        label,
        links,
        drawn_drives(rng, links, n),
        rate_hz=float(rng.choice([125.0, 250.0, 500.0])),
        noise=float(rng.uniform(0.02, 0.08)),
        bandwidth=float(rng.uniform(40.0, 90.0)),
        forward=float(rng.uniform(0.7, 1.0)),
        currents=bool(rng.random() < 0.5),
        temperatures=bool(rng.random() < 0.4),
        imus=drawn_imus(rng, n) if imus else (),
    )
