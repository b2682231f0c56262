"""One log as the effects see it: its motion, its clock, and the model's torques."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property

import numpy as np

from seqid_cli.effects.link_readings import LinkReadings
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
from seqid_cli.running import dilated
from seqid_cli.typing import Array, Mask

Joint = int | None  # index; None: of the whole arm, or of all joints alike

LONGEST_SESSION_S = 30 * 86400.0
DEFAULT_SIGN_SHARE = 0.004  # of a joint's top speed


@dataclass(frozen=True)
class Scene:
    """Everything that an effect's columns may be built from.

    Attributes
    ----------
    robot : Robot
    motion : Motion
        At the log's own rate or at least 24 samples per period of the cut-off; its q,
        dq, ddq (N, n) have been filtered once.
    model : TorqueModel
        The model so far. Its torques stand for what nobody measures (the load of a
        gear).
    sign_width : Array
        (n,) speed [rad/s; m/s where prismatic] over which the sign of each joint's
        velocity changes.
    log : int
        Number of the log, in the order in which they were given.
    start : float
        Time of the first sample [s], on the clock that all logs share if
        `shared_clock`; else 0.
    shared_clock : bool
        Whether the clock tells how long after each other the logs were recorded.
    period : float
        Sample period of the log itself [s].
    temperature : Array, optional
        (N, n) degC, as logged.
    sensor : Array, optional
        (N, n) N m, the load as a torque sensor behind the gear measures it, filtered
        like the motion.
    encoder : Array, optional
        (N, n) positions as the encoder reports them, not filtered.
    measured : Array, optional
        (N, n) torque [N m; N where prismatic], not filtered.
    links : tuple of LinkReadings
        What calibrated IMUs read beyond what the encoders say.
    last_link : Array, optional
        (10,) inertial parameters of the last link with all that the files say it
        carries, as in `payload`; None where none says any.
    full : Scene, optional
        The same log at its own rate, where this one has been decimated.
    """

    robot: Robot
    motion: Motion
    model: TorqueModel
    sign_width: Array
    _: KW_ONLY
    log: int = 0
    start: float = 0.0
    shared_clock: bool = False
    period: float = 0.0
    temperature: Array | None = None
    sensor: Array | None = None
    encoder: Array | None = None
    measured: Array | None = None
    links: tuple[LinkReadings, ...] = ()
    last_link: Array | None = None
    full: Scene | None = None

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return self.motion.samples

    @cached_property
    def memo(self) -> dict[tuple[str, int], tuple[Array, ...]]:
        """Results of effects that are kept with the scene."""
        return {}

    def forget(self, *, but_at: Collection[Joint] = ()) -> None:
        """Let go of results of effects, but of those at some joints.

        What is asked for again is worked out again.
        """
        for key in [*self.memo]:
            if key[1] not in but_at:
                del self.memo[key]
        if self.full is not None:
            self.full.forget(but_at=but_at)

    @property
    def angle(self) -> Array:
        """Positions (N, n) for what is finer than the low-pass: the encoder's."""
        return self.motion.q if self.encoder is None else self.encoder

    @cached_property
    def time(self) -> Array:
        """Time (N,) s on the shared clock."""
        return self.start + self.motion.t

    @cached_property
    def lowest(self) -> Array:
        """Lowest usable position (n,) of each joint; infinite if no sample is."""
        usable = self.motion.q[self.motion.usable]
        return np.asarray(np.min(usable, axis=0, initial=np.inf))

    @cached_property
    def highest(self) -> Array:
        """Highest usable position (n,) of each joint; -infinite if no sample is."""
        usable = self.motion.q[self.motion.usable]
        return np.asarray(np.max(usable, axis=0, initial=-np.inf))

    @cached_property
    def slides(self) -> Mask:
        """Samples (N, n) at which a joint certainly slides."""
        return sliding(self.motion, SLIDES * self.sign_width)

    @cached_property
    def stops(self) -> Mask:
        """Samples (N, n) that the low-pass mixes with a stop or a reversal.

        A controller that hunts, or a joint that shakes, may stop many times where the
        low-passed motion goes on; friction then has less than its usual mean.
        """
        motion = self.motion
        rate_hz = motion.rate_hz
        steps = np.diff(self.angle, axis=0, prepend=self.angle[:1]) * np.sign(motion.dq)

        # Where the low-passed speed promises a travel of several noise steps and the
        # encoder shows less than one, the joint has stopped or turned back.
        stopped = np.zeros_like(self.slides)
        for j, step in enumerate(noise_step(self.angle)):
            expected = np.cumsum(np.abs(motion.dq[:, j])) / rate_hz
            travelled = np.cumsum(steps[:, j])
            ahead = expected + 2.0 * TRAVEL_STEPS * step
            travelled_ahead = np.interp(ahead, expected, travelled)
            stopped[:, j] = travelled_ahead - travelled < step

        reach = max(1, int(REACH * rate_hz / motion.lowpass.cutoff_hz))
        return dilated(stopped & self.slides, reach)

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
        """Torque (N, n) N m that the gear passes to the link.

        It is measured, or else modelled without the rotor.
        """
        return self.modelled_load if self.sensor is None else self.sensor

    @cached_property
    def rotor(self) -> Array:
        """Inertias (n,) kg m^2 of the rotors as the joints feel them."""
        rotor = self.model.rotor
        if rotor is None:
            rotor = known_rotors(self.robot)
        return np.asarray(self.gear**2 * rotor)

    @cached_property
    def modelled_load(self) -> Array:
        """Modelled torque (N, n) N m that the gear passes to the link."""
        return self.rigid - self.rotor * self.motion.ddq

    @cached_property
    def carried(self) -> Array:
        """Torque (N, n) N m of links and rotors; the load is measured if possible."""
        if self.sensor is None:
            return self.rigid
        return self.rigid - self.modelled_load + self.sensor

    @cached_property
    def friction(self) -> Array:
        """Modelled friction torque (N, n)."""
        return sampled_friction(self.model.surfaces, self.motion)

    def friction_slope(self, joint: int, lead: Array) -> Array:
        """Compute the secant slope of a joint's friction over its speed.

        Parameters
        ----------
        joint : int
        lead : Array
            (N,) rad/s, how far the secant reaches beyond the joint's speed.

        Returns
        -------
        Array
            (N,) N m s/rad. The secant is at least as long as a sample resolves: the
            area under the step at a reversal counts.
        """
        motion = self.motion
        q = motion.q[:, joint]
        middle = motion.dq[:, joint] + 0.5 * lead
        per_sample = 2.0 * np.abs(motion.ddq[:, joint]) / motion.rate_hz
        shortest = np.maximum(self.sign_width[joint], per_sample)
        half = np.maximum(shortest, 0.5 * np.abs(lead))

        ahead = self.model.friction_of(joint, q, middle + half)
        behind = self.model.friction_of(joint, q, middle - half)
        return np.asarray((ahead - behind) / (2.0 * half))

    @cached_property
    def modelled(self) -> Array:
        """Modelled torque (N, n): rigid body, rotors and friction."""
        return self.rigid + self.friction

    @cached_property
    def modelled_filtered(self) -> Array:
        """Modelled torque (N, n), low-passed like the measured one."""
        rigid = self.motion.filtered(self.rigid)
        friction = self.motion.filtered(self.friction, times=2)
        return rigid + friction


Scenes = Sequence[Scene]


def sign_widths(model: TorqueModel, top_speed: Array) -> Array:
    """Return the speeds (n,) over which friction changes its sign.

    They are the file's, or else a share of the joints' top speeds (n,), rad/s.
    """
    usual = np.maximum(DEFAULT_SIGN_SHARE * top_speed, 1e-6)
    return np.array(
        [
            width if surface is None else surface.sign_width
            for surface, width in zip(model.surfaces, usual, strict=True)
        ]
    )


def moves(scenes: Scenes, joint: int) -> bool:
    """Return whether the joint moves in any log."""
    return any(bool(scene.motion.moving[:, joint].any()) for scene in scenes)


def top_speed(scenes: Scenes, joint: int) -> float:
    """Return a joint's highest speed once the filter has settled.

    In rad/s (m/s where prismatic); at least 1e-6.
    """
    speeds = [np.abs(scene.motion.dq[scene.motion.usable, joint]) for scene in scenes]
    return max(float(np.max(np.concatenate(speeds), initial=0.0)), 1e-6)


def positions(scenes: Scenes, joint: int) -> tuple[float, float]:
    """Return a joint's lowest and highest position, rad (m if prismatic)."""
    low = min(float(scene.lowest[joint]) for scene in scenes)
    high = max(float(scene.highest[joint]) for scene in scenes)
    return (low, high) if low <= high else (0.0, 0.0)


def travel(scenes: Scenes, joint: int) -> float:
    """Return the range of a joint's positions, rad (m if prismatic), at least 1e-6."""
    low, high = positions(scenes, joint)
    return max(high - low, 1e-6)


def session(scenes: Scenes) -> float:
    """Return the time [s] on the clock at which the last log ends."""
    return max(float(scene.time[-1]) for scene in scenes)
