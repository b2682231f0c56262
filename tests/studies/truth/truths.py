"""What is true of an arm: standard parameters in Pinocchio's order, and friction."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.robot.base_parameters import STANDARD
from tests import Array
from tests.studies.outside.arms import Link
from tests.studies.truth.follow import heat_of, shares_up
from tests.studies.truth.plan import Case


@dataclass(frozen=True)
class Body:
    """Mass kg, first moment (3,) kg m and inertia (3, 3) kg m^2 about the frame's
    origin.
    """

    mass: float
    moment: Array
    inertia: Array

    def seen_from(self, rotation: Array, place: Array) -> "Body":
        """Return the body in a frame in which its own one stands so: (3,
        3) and (3,) m.
        """
        moment, centre_part = rotation @ self.moment, self.mass * place
        inertia = rotation @ self.inertia @ rotation.T
        # About the other origin: J = J_0 - [p][h] - [h][p] - m [p][p].
        p, h = _cross(place), _cross(moment)
        inertia = inertia - p @ h - h @ p - self.mass * (p @ p)
        return Body(self.mass, moment + centre_part, inertia)

    def __add__(self, other: "Body") -> "Body":
        return Body(
            self.mass + other.mass,
            self.moment + other.moment,
            self.inertia + other.inertia,
        )

    @property
    def standard(self) -> list[float]:
        """Values of `STANDARD`."""
        xx, xy, yy, xz, yz, zz = self.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        return [float(x) for x in (self.mass, *self.moment, xx, xy, yy, xz, yz, zz)]


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def body_of(link: Link) -> Body:
    c = _cross(link.centre)
    inertia = link.inertia - link.mass * (c @ c)
    return Body(link.mass, link.mass * link.centre, inertia)


def true_standard(case: Case) -> dict[str, float]:
    """Return standard parameters by name, of the links that the robot file's joints
    move.

    A joint that the robot file lacks counts as locked where it stood (at zero where it
    moves), as links beyond the drives do; its rotor belongs to no parameter.
    """
    arm, joints = case.arm, case.joints
    bodies = [body_of(link) for link in arm.links]
    out = case.sizes("left_out")
    angle = float(out["radians"]) if out else 0.0
    for k in reversed(range(1, len(bodies))):
        if k not in joints:
            link = arm.links[k]
            rotation = _placed(link, angle if k == case.left_out else 0.0)
            bodies[k - 1] = bodies[k - 1] + bodies[k].seen_from(rotation, link.place)
    found = {}
    for number, j in enumerate(joints, start=1):
        for name, value in zip(STANDARD, bodies[j].standard, strict=True):
            found[f"{name}_{number}"] = value
        found[f"Ia_{number}"] = arm.drives[j].rotor / arm.drives[j].ratio ** 2
    return found


def _placed(link: Link, angle: float) -> Array:
    turned = Rotation.from_euler("xyz", link.turn)
    return np.asarray((turned * Rotation.from_rotvec(angle * link.axis)).as_matrix())


def true_friction(case: Case, joint: int, q: Array, v: Array, warmth: float) -> Array:
    """Return the friction (N,) N m of a joint that slides at v (N,), at a temperature
    above cold.

    `q` (N,) are the encoder's angles.
    """
    drive = case.arm.drives[joint]
    zero = case.sizes("zero")
    if zero and zero["joint"] == joint:
        q = q - zero["radians"]
    factor = heat_of(case, np.full((1, case.arm.n), warmth))[0, joint]
    dry = drive.coulomb * (1.0 + drive.waviness * np.sin(q + drive.phase))
    larger = np.where(v > 0.0, 1.0 + shares_up(case)[joint], 1.0)
    return np.asarray(factor * larger * (dry * np.sign(v) + drive.viscous * v))


def true_offset(case: Case, joint: int) -> float:
    """Return the offset N m of a joint's logged torque."""
    sizes = case.sizes("offset")
    return (
        float(sizes["shares"][joint] * case.arm.drives[joint].coulomb) if sizes else 0.0
    )


def true_nuisances(case: Case, joint: int) -> dict[str, float]:
    """Return what a joint's drive adds to its torque, by the names of the parameter
    file.

    `delay` s: a filter counts as the delay of what is slow. `offset` N m. `asymmetry`
    and `viscous_asymmetry`: shares of the mean of both directions that are added on the
    way up. `thermal` 1/K: share by which friction changes.
    """
    seconds = case.sizes("delay")
    delay = float(seconds["seconds"][joint]) if seconds else 0.0
    if lowpass := case.sizes("filter"):
        delay += [1.0, 2.0**0.5][lowpass["order"] - 1] / (
            2.0 * np.pi * lowpass["hertz"]
        )
    larger = shares_up(case)[joint]
    share = larger / (2.0 + larger)
    heat = case.sizes("warmth")
    return {
        "delay": delay,
        "offset": true_offset(case, joint),
        "asymmetry": share,
        "viscous_asymmetry": share,
        "thermal": float(heat["per_kelvin"][joint]) if heat else 0.0,
    }
