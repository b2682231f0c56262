"""The base does not stand as the robot file says: gravity comes from another direction.

    tau = G(q; R(t) g) - G(q; g)
        = sin(a) / a (t_1 G(q; e_1 x g) + t_2 G(q; e_2 x g)) - (1 - cos(a)) G(q; g)
    a = |t|

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

from seqid_cli.effects.declared import BodyTerm
from seqid_cli.effects.effect import (
    SINCE_LOG,
    Coefficient,
    Columns,
    Effect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scene, Scenes
from seqid_cli.robot.base_parameters import STANDARD
from seqid_cli.robot.regressor import gravity_regressor, inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

LARGEST_RAD = 0.35
PARALLEL = 1e-6  # sine of the angle below which an axis counts as along gravity
AROUND = ("around_1", "around_2")


class BaseTilt(Effect):
    """Gravity turned about two axes square to it."""

    name = "base_tilt"
    family = "body"
    arm = True
    change = True
    exact = True
    passes = 1
    settings = (
        Setting("upright", "1", low=0.0, high=1.0, continuous=False),
        *(
            Setting(
                name,
                "rad",
                low=-LARGEST_RAD,
                high=LARGEST_RAD,
                continuous=False,
                asked=False,
            )
            for name in AROUND
        ),
        SINCE_LOG,
    )
    alike = ("payload", "spring", "torque_bias")
    separate_by = (
        "an accelerometer on the base, or fast moves of the proximal joints: inertial"
        " torque does not turn with gravity"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return the two rotations, and the first link's moments where they are new."""
        rotations = tuple(
            Coefficient(f"tilt_{k}", "rad", low=-LARGEST_RAD, high=LARGEST_RAD)
            for k in (1, 2)
        )
        if not settings["upright"]:
            return rotations
        moments = tuple(Coefficient(f"moment_{k}", "N m") for k in (1, 2))
        return (*rotations, *moments)

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Return whether gravity parameters and gravity itself are known."""
        return scenes[0].model.phi is not None and bool(scenes[0].robot.gravity.any())

    def axes(self, scenes: Scenes, joint: Joint) -> GridAxes:
        """Return whether the first joint turns about gravity, and no rotation yet."""
        upright = float(first_joint_upright(scenes[0].robot))
        return {"upright": [upright], **{key: [0.0] for key in AROUND}}

    def sharpened(self, settings: Settings, c: Array) -> dict[str, float]:
        """Return settings about the rotation that was estimated."""
        rotation = np.clip(c[:2], -LARGEST_RAD, LARGEST_RAD).tolist()
        return {**settings, **dict(zip(AROUND, rotation, strict=True))}

    def plausible(
        self,
        scenes: Scenes,
        joint: Joint,
        settings: Settings,
        c: Array,
        *,
        most_moment: float = 10.0,
    ) -> bool:
        """Ask that moments come with a tilt, where other joints would show it.

        Moments without a tilt are any function of the first joint's angle. They may be
        `most_moment` of the largest torque that a gear passes on, per rad of tilt.
        """
        other_joints_show_it = settings["upright"] and scenes[0].robot.n > 1
        tilted = True
        if other_joints_show_it:
            tilt = np.linalg.norm(c[:2])
            moments = np.linalg.norm(c[2:])
            largest_load = max(float(np.max(np.abs(scene.load))) for scene in scenes)
            tilted = bool(moments <= most_moment * largest_load * tilt)
        return tilted and super().plausible(scenes, joint, settings, c)

    def body_terms(
        self, robot: Robot, joint: Joint, settings: Settings
    ) -> list[BodyTerm]:
        """Return two directions square to gravity, less what is lost along it.

        With the rotation t_0 of the settings, a = |t_0|: sin(a) / a e_k x g minus (1 -
        cos(a)) / a^2 t_0k g.
        """
        gravity = robot.gravity
        across = np.array([np.cross(axis, gravity) for axis in tilt_axes(gravity)])
        rotation = np.array([settings.get(name, 0.0) for name in AROUND])
        angle = float(np.linalg.norm(rotation))

        # np.sinc(x) is sin(pi x) / (pi x): both factors stay finite where a is 0.
        kept_across = np.sinc(angle / np.pi)
        lost_along = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
        directions = kept_across * across - lost_along * rotation[:, None] * gravity

        terms = [BodyTerm(gravity=direction) for direction in directions]
        if settings["upright"]:
            terms += [BodyTerm(), BodyTerm()]  # the moments change no gravity
        return terms

    def laws(self, robot: Robot, joint: Joint, settings: Settings) -> Mapping[int, Law]:
        """Return sine and cosine of the first joint's angle for the moments, if any."""
        if not settings["upright"]:
            return {}

        # Their torque is a sine of q: its values at 0 and at a quarter turn tell it.
        across = np.cross(tilt_axes(robot.gravity)[0], robot.gravity)
        places = np.zeros((2, robot.n))
        places[1, 0] = 0.5 * np.pi
        at_zero, at_quarter_turn = first_link_moments(robot, across, places).tolist()
        numbers = {
            "cos_1": at_zero[0],
            "cos_2": at_zero[1],
            "sin_1": at_quarter_turn[0],
            "sin_2": at_quarter_turn[1],
        }
        terms = (
            "0.0",
            "0.0",
            "cos_1 * cos(q) + sin_1 * sin(q)",
            "cos_2 * cos(q) + sin_2 * sin(q)",
        )
        return {0: Law(terms=terms, numbers=numbers)}

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Compute the gravity torque of the turned directions, and the moments."""
        robot = scene.robot
        q = scene.motion.q
        phi = scene.model.phi
        terms = self.body_terms(robot, joint, settings)
        columns = {j: np.zeros((scene.samples, len(terms))) for j in range(robot.n)}
        if phi is None:
            return columns

        still = np.zeros_like(q)
        for k, term in enumerate(terms):
            if not term.gravity.any():
                continue
            torque = inverse_dynamics(robot.chain, term.gravity, phi, q, still, still)
            for j, column in columns.items():
                column[:, k] = torque[:, j]
        for j, law in self.laws(robot, joint, settings).items():
            columns[j] += law.columns(scene, j)
        return columns


def first_joint_upright(robot: Robot) -> bool:
    """Return whether the first joint turns about gravity.

    The weight of its link then never shows in a torque.
    """
    chain = robot.chain
    axis_in_base = chain.rotation[0] @ chain.axis[0]
    across = np.linalg.norm(np.cross(axis_in_base, robot.gravity))
    along = bool(across < PARALLEL * np.linalg.norm(robot.gravity))
    return not chain.prismatic[0] and along


def first_link_moments(robot: Robot, gravity: Array, q: Array) -> Array:
    """Compute the first joint's torque of two first moments square to its axis.

    Parameters
    ----------
    robot : Robot
    gravity : Array
        (3,) m/s^2, in the base frame.
    q : Array
        Positions (N, n) rad.

    Returns
    -------
    Array
        (N, 2), for moments of unit weight [N m].
    """
    square_to_axis = np.linalg.svd(robot.chain.axis[:1])[2][1:].T  # (3, 2)
    moments = slice(STANDARD.index("mx"), STANDARD.index("mz") + 1)
    Y = gravity_regressor(robot.chain, gravity, q)[:, 0, moments]
    return np.asarray(Y @ square_to_axis / np.linalg.norm(gravity))


def tilt_axes(gravity: Array) -> tuple[Array, Array]:
    """Return two unit axes (3,) square to gravity and to each other.

    They are x and y where gravity is along z.
    """
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])

    along = gravity / size
    start = np.eye(3)[0 if abs(along[0]) < 0.9 else 1]
    first = start - (start @ along) * along
    first /= np.linalg.norm(first)
    return first, np.cross(-along, first)
