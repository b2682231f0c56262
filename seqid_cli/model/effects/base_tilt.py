"""The base does not stand as the robot file says: gravity comes from another direction.

    tau = G(q; R(t) g) - G(q; g)
        = sin(a) / a (t_1 G(q; e_1 x g) + t_2 G(q; e_2 x g)) - (1 - cos(a)) G(q; g),    a = |t|

g [m/s^2] is gravity in the base frame, G(q; .) the gravity torque of the model, linear
in it, and t [rad] a rotation of gravity about two axes e_1, e_2 square to it: x and y
of the base where it stands upright. The settings `around_1`, `around_2` make the
columns exact near that rotation: to first order a base that leans by 5 degrees looks
like an error of torque constants, too. A constant tilt hides in the first moments once
these are free, to which gravity torque is as linear: Gautier, Khalil, "Direct
calculation of minimum set of inertial parameters of serial robots", IEEE Trans.
Robotics and Automation 6(3), 1990.
"""

from collections.abc import Mapping

import numpy as np

from seqid_cli.model.effects.declared import BodyTerm
from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.base_parameters import STANDARD
from seqid_cli.robot.regressor import gravity_regressor, inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LARGEST_RAD = 0.35
PARALLEL = 1e-6
AROUND = ("around_1", "around_2")


class BaseTilt(Effect):
    """Gravity turned about two axes square to it."""

    name = "base_tilt"
    family = "body"
    arm = change = exact = True
    passes = 1
    settings = (
        Setting("upright", "1", low=0.0, high=1.0, continuous=False),
        *(
            Setting(name, "rad", -LARGEST_RAD, LARGEST_RAD, False, asked=False)
            for name in AROUND
        ),
    )
    alike = ("payload", "spring", "torque_bias")
    separate_by = (
        "an accelerometer on the base, or fast moves of the proximal joints: inertial"
        " torque does not turn with gravity"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the two rotations, and the first link's moments where they are new."""
        bounds = -LARGEST_RAD, LARGEST_RAD
        rotations = tuple(Coefficient(f"tilt_{k}", "rad", *bounds) for k in (1, 2))
        moments = tuple(Coefficient(f"moment_{k}", "N m") for k in (1, 2))
        return (*rotations, *moments) if settings["upright"] else rotations

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Gravity parameters are needed."""
        return scenes[0].model.phi is not None and bool(scenes[0].robot.gravity.any())

    def axes(self, scenes: Scenes, joint: Joint) -> GridAxes:
        """Whether the first joint turns about gravity; no rotation to begin with."""
        upright = float(first_joint_upright(scenes[0].robot))
        return {"upright": [upright], **{key: [0.0] for key in AROUND}}

    def sharpened(self, settings: Settings, c: Array) -> dict[str, float]:
        """The rotation that was found."""
        found = np.clip(c[:2], -LARGEST_RAD, LARGEST_RAD).tolist()
        return {**settings, **dict(zip(AROUND, found, strict=True))}

    def plausible(
        self,
        scenes: Scenes,
        joint: Joint,
        settings: Settings,
        c: Array,
        *,
        most_moment: float = 10.0,
    ) -> bool:
        """Ask that a tilt comes with the first link's moments, where other joints would show it.

        Moments alone are any function of the first joint's angle: `most_moment` of the
        largest torque that a gear passes on, per rad.
        """
        alone = not settings["upright"] or scenes[0].robot.n == 1
        tilt, moments = np.linalg.norm(c[:2]), np.linalg.norm(c[2:])
        largest = max(float(np.max(np.abs(scene.load))) for scene in scenes)
        tilted = alone or moments <= most_moment * largest * tilt
        return bool(tilted) and super().plausible(scenes, joint, settings, c)

    def body_terms(
        self, robot: Robot, joint: Joint, settings: Settings
    ) -> list[BodyTerm]:
        """Return two directions square to gravity, less what is lost along it."""
        gravity = robot.gravity
        across = [np.cross(axis, gravity) for axis in tilt_axes(gravity)]
        around = np.array([settings.get(name, 0.0) for name in AROUND])
        angle = float(np.linalg.norm(around))
        lost = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos(a)) / a^2
        turned = (
            np.sinc(angle / np.pi) * np.array(across) - lost * around[:, None] * gravity
        )
        moments = 2 * int(settings["upright"])
        return [*(BodyTerm(gravity=g) for g in turned), *[BodyTerm()] * moments]

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return the first link's moments, where they are new: a sine and cosine of its angle."""
        if not settings["upright"]:
            return {}
        across = np.cross(tilt_axes(robot.gravity)[0], robot.gravity)
        places = np.zeros((2, robot.n))
        places[1, 0] = 0.5 * np.pi
        (cos_1, cos_2), (sin_1, sin_2) = first_link_moments(
            robot, across, places
        ).tolist()
        numbers = {"cos_1": cos_1, "cos_2": cos_2, "sin_1": sin_1, "sin_2": sin_2}
        terms = "0.0", "0.0", *(f"cos_{k} * cos(q) + sin_{k} * sin(q)" for k in (1, 2))
        return {0: Law(terms=terms, numbers=numbers)}

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Gravity torque of the turned directions, and the moments."""
        q, phi, robot = scene.motion.q, scene.model.phi, scene.robot
        terms = self.body_terms(robot, joint, settings)
        result = {j: np.zeros((scene.samples, len(terms))) for j in range(robot.n)}
        if phi is None:
            return result
        still = np.zeros_like(q)
        for k, term in enumerate(terms):
            if term.gravity.any():
                torque = inverse_dynamics(
                    robot.chain, term.gravity, phi, q, still, still
                )
                for j, column in result.items():
                    column[:, k] = torque[:, j]
        for j, law in self.laws(robot, joint, settings).items():
            result[j] += law.columns(scene, j)
        return result


def first_joint_upright(robot: Robot) -> bool:
    """Whether the first joint turns about gravity, so that its link's weight never shows."""
    chain, gravity = robot.chain, robot.gravity
    across = np.linalg.norm(np.cross(chain.rotation[0] @ chain.axis[0], gravity))
    return not chain.prismatic[0] and bool(across < PARALLEL * np.linalg.norm(gravity))


def first_link_moments(robot: Robot, gravity: Array, q: Array) -> Array:
    """Torque (N, 2) at the first joint of two first moments square to its axis, of unit weight."""
    square = np.linalg.svd(robot.chain.axis[:1])[2][1:].T  # (3, 2)
    moments = slice(STANDARD.index("mx"), STANDARD.index("mz") + 1)
    Y = gravity_regressor(robot.chain, gravity, q)[:, 0, moments]
    return np.asarray(Y @ square / np.linalg.norm(gravity))


def tilt_axes(gravity: Array) -> tuple[Array, Array]:
    """Two unit axes (3,) square to gravity and to each other: x and y where gravity is along z."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    along = gravity / size
    start = np.eye(3)[0 if abs(along[0]) < 0.9 else 1]
    first = start - (start @ along) * along
    first /= np.linalg.norm(first)
    return first, np.cross(-along, first)
