"""One log as the effects see it: its motion, its clock, and what the model says about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation

from seqid_cli.model.friction import SLIDES
from seqid_cli.model.torque import (
    REACH,
    TorqueModel,
    known_rotors,
    sampled_friction,
    sliding,
)
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.segmentation import TRAVEL_STEPS, noise_step
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

Joint = int | None  # index; None: of the whole arm, or of all joints alike

LONGEST_SESSION_S = 30 * 86400.0
DEFAULT_SIGN_SHARE = 0.004  # of a joint's top speed


@dataclass(frozen=True)
class Scene:
    """Everything that an effect's columns may be built from.

    `motion` is at the log's own rate or at least 24 samples per period of the cut-off;
    its q, dq, ddq (N, n) have been filtered once. The torques of `model`, the one so
    far, stand for what nobody measures (the load of a gear). `sign_width` (n,) is the
    speed [rad/s; m/s where prismatic] over which the sign of each joint's velocity
    changes.

    `log` is the number of the log, in the order in which they were given, `start` the
    time of the first sample [s]: on a clock that all logs share if `shared_clock`,
    which then tells how long after each other they were recorded; else 0. `period` is
    the sample period of the log itself [s].

    Absent where the log does not have them, (N, n): `temperature` degC as logged;
    `sensor` [N m], the load as a torque sensor behind the gear measures it, filtered
    like the motion; `encoder`, positions as it reports them, and `measured` torque [N
    m; N where prismatic], neither filtered. `full` is the same log at its own rate,
    where this one has been decimated.
    """

    robot: Robot
    motion: Motion
    model: TorqueModel
    sign_width: Array
    log: int = 0
    start: float = 0.0
    shared_clock: bool = False
    period: float = 0.0
    temperature: Array | None = None
    sensor: Array | None = None
    encoder: Array | None = None
    measured: Array | None = None
    full: Scene | None = None

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return self.motion.samples

    @cached_property
    def memo(self) -> dict[tuple[str, int], tuple[Array, ...]]:
        """What effects have computed of this scene and want to keep with it."""
        return {}

    @property
    def angle(self) -> Array:
        """Positions (N, n) for what is finer than the low-pass: the encoder's where there are."""
        return self.motion.q if self.encoder is None else self.encoder

    @cached_property
    def time(self) -> Array:
        """Time (N,) s on the shared clock."""
        return self.start + self.motion.t

    @cached_property
    def slides(self) -> Mask:
        """Samples (N, n) at which a joint certainly slides."""
        return sliding(self.motion, SLIDES * self.sign_width)

    @cached_property
    def stops(self) -> Mask:
        """Samples (N, n) that the low-pass mixes with some where a sliding joint stops or turns.

        A controller that hunts, or a joint that shakes, may stop many times where the
        low-passed motion goes on; friction then has less than its usual mean.
        """
        motion, rate = self.motion, self.motion.rate_hz
        gone = np.diff(self.angle, axis=0, prepend=self.angle[:1]) * np.sign(motion.dq)
        back, step = np.zeros_like(self.slides), noise_step(self.angle)
        for j, least in enumerate(step):
            expected, way = (
                np.cumsum(np.abs(motion.dq[:, j])) / rate,
                np.cumsum(gone[:, j]),
            )
            later = np.interp(expected + 2.0 * TRAVEL_STEPS * least, expected, way)
            back[:, j] = later - way < least
        reach = max(1, int(REACH * rate / motion.lowpass.cutoff_hz))
        within = np.ones((2 * reach + 1, 1), dtype=bool)
        return np.asarray(binary_dilation(back & self.slides, within))

    @cached_property
    def sign(self) -> Array:
        """Direction of motion (N, n), between -1 and 1."""
        return np.tanh(self.motion.dq / self.sign_width)

    @cached_property
    def gear(self) -> Array:
        """Gear ratios (n,), 1 where the robot file gives none."""
        return gear_ratios(self.robot)

    @cached_property
    def rigid(self) -> Array:
        """Modelled rigid-body torque (N, n), rotors included."""
        motion = self.motion
        return self.model.rigid(motion.q, motion.dq, motion.ddq)

    @cached_property
    def load(self) -> Array:
        """Torque (N, n) that the gear passes to the link: measured, else modelled without rotor."""
        return self.modelled_load if self.sensor is None else self.sensor

    @cached_property
    def rotor(self) -> Array:
        """Inertias (n,) kg m^2 of the rotors as the joints feel them."""
        rotor = (
            known_rotors(self.robot) if self.model.rotor is None else self.model.rotor
        )
        return np.asarray(self.gear**2 * rotor)

    @cached_property
    def modelled_load(self) -> Array:
        """The same (N, n) N m as the model has it, rotors left out."""
        return self.rigid - self.rotor * self.motion.ddq

    @cached_property
    def carried(self) -> Array:
        """Torque (N, n) N m of links and rotors: modelled, but for a load that is measured."""
        return (
            self.rigid
            if self.sensor is None
            else self.rigid - self.modelled_load + self.sensor
        )

    @cached_property
    def friction(self) -> Array:
        """Modelled friction torque (N, n)."""
        return sampled_friction(self.model.surfaces, self.motion)

    def friction_slope(self, joint: int, lead: Array) -> Array:
        """Secant slope (N,) of a joint's friction, from its speed to `lead` (N,) rad/s more.

        Over as much as a sample resolves at the least: of the step at a reversal the
        area counts.
        """
        motion = self.motion
        q, v = motion.q[:, joint], motion.dq[:, joint] + 0.5 * lead
        per_sample = 2.0 * np.abs(motion.ddq[:, joint]) / motion.rate_hz
        half = np.maximum(
            np.maximum(self.sign_width[joint], per_sample), 0.5 * np.abs(lead)
        )
        ahead, behind = (
            self.model.friction_of(joint, q, v + side * half) for side in (1, -1)
        )
        return np.asarray((ahead - behind) / (2.0 * half))

    @cached_property
    def modelled(self) -> Array:
        """Modelled torque (N, n): rigid body, rotors and friction."""
        return self.rigid + self.friction

    @cached_property
    def modelled_filtered(self) -> Array:
        """Modelled torque (N, n), low-passed like the measured one."""
        motion = self.motion
        return motion.filtered(self.rigid) + motion.filtered(self.friction, times=2)


Scenes = Sequence[Scene]


def sign_widths(model: TorqueModel, top_speed: Array) -> Array:
    """Speeds (n,) over which friction changes its sign: the file's, or a share of the top speed."""
    usual = zip(
        model.surfaces, np.maximum(DEFAULT_SIGN_SHARE * top_speed, 1e-6), strict=True
    )
    return np.array([width if own is None else own.sign_width for own, width in usual])


def moves(scenes: Scenes, joint: int) -> bool:
    """Return whether the joint moves in any log."""
    return any(bool(scene.motion.moving[:, joint].any()) for scene in scenes)


def top_speed(scenes: Scenes, joint: int) -> float:
    """Return a joint's highest speed [rad/s; m/s where prismatic] once settled, at least 1e-6."""
    speeds = [np.abs(scene.motion.dq[scene.motion.usable, joint]) for scene in scenes]
    return max(float(np.max(np.concatenate(speeds), initial=0.0)), 1e-6)


def travel(scenes: Scenes, joint: int) -> float:
    """Return the range of the joint's positions [rad; m where prismatic], at least 1e-6."""
    positions = np.concatenate([s.motion.q[s.motion.usable, joint] for s in scenes])
    return max(float(np.ptp(positions)) if len(positions) else 0.0, 1e-6)


def session(scenes: Scenes) -> float:
    """Return the time [s] on the clock at which the last log ends."""
    return max(float(scene.time[-1]) for scene in scenes)
