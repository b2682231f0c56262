"""A dead zone in the gear: when the load changes its sign the link flies free from flank to flank.

    x = q_motor - q_link in [-b/2, b/2],    M x'' = tau_L in flight,    x = +-b/2 in contact
    tau_effect = -(d tau / d q, dq, ddq) . (x, x', x'')

b [rad] is the gap, tau_L [N m] the torque that would keep the link with the motor, M
[kg m^2] the links' inertia about the joint with the others held. In flight the motor
carries nothing of tau_L; where the link lands it gets all of it at once: a hole and a
blow of the same area, both at sign changes of the load, not of the velocity. Landing is
taken for inelastic, and the encoder for the motor's. The flight lasts about (6 M b /
tau_L')^(1/3), so the shape depends on b too, which is the setting `trial_gap`: both
must agree. Nordin, Gutman, "Controlling mechanical systems with backlash: a survey",
Automatica 38(10), 2002.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.model.effects.declared import Play
from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
)
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.model.effects.sensitivity import link_deviation, link_inertia
from seqid_cli.motion.filters.differentiation import differentiate, runs
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

SMALLEST, LARGEST = 2e-4, 2e-2  # rad
GAPS = tuple(float(gap) for gap in np.geomspace(SMALLEST, LARGEST, 7))
AGREEMENT = 4.0  # of gap and trial gap, as a ratio


class Backlash(Effect):
    """Free flight at every sign change of the transmitted torque."""

    name = "backlash"
    family = "transmission"
    settings = (
        Setting("trial_gap", "rad", SMALLEST, LARGEST, False, agreement=AGREEMENT),
    )
    needs = ("load",)
    apart = True
    linear = (Coefficient("gap", "rad", low=0.0, high=0.1),)
    alike = (
        "presliding_hysteresis",
        "joint_elasticity",
        "time_skew",
        "actuator_lag",
        "transmission_coupling",
    )
    separate_by = (
        "slow and fast moves in which the load of this joint changes its sign while it"
        " moves, and others in which it keeps it; an accelerometer on the link sees the"
        " landing"
    )

    def local(self, settings: Settings) -> bool:
        """No: where the gap stands was decided when it was last crossed."""
        return False

    def available(self, scenes: Scenes, joint: int) -> bool:
        """The model must know the load, and the load must change its sign."""
        changes = any(np.ptp(np.sign(scene.load[:, joint])) > 1.0 for scene in scenes)
        return changes and super().available(scenes, joint)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield the gap whose flights fit the joint's own residual best."""
        y = np.concatenate([r[:, joint] for r in residual])
        best, most = SMALLEST, -1.0
        flights = [self._flights(scene, joint) for scene in scenes]
        for gap, *parts in zip(GAPS, *flights, strict=True):
            x = np.concatenate(parts) * (y != 0.0)
            explained = (
                float(x @ y) ** 2 / max(float(x @ x), 1e-300) if x @ y > 0.0 else 0.0
            )
            if explained > most:
                best, most = gap, explained
        yield {"trial_gap": best}

    def _flights(self, scene: Scene, joint: int) -> tuple[Array, ...]:
        """Torque (N,) of each gap's flights at the joint, low-passed; it is asked for often."""
        key, motion, load = (self.name, joint), scene.motion, scene.load[:, joint]
        if key not in scene.memo:
            inertia = link_inertia(scene, joint)[:, joint]
            leads = (play(load, inertia, motion, gap) for gap in GAPS)
            flown = (
                -inertia * differentiate(x, motion.rate_hz, motion.valid)[1]
                for x in leads
            )
            scene.memo[key] = tuple(
                motion.filtered(x, times=self.passes) for x in flown
            )
        return scene.memo[key]

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Play:
        """Flight between the flanks of the trial gap."""
        return Play(settings["trial_gap"])

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Torque per unit gap, on all joints."""
        gap = settings["trial_gap"]
        inertia = link_inertia(scene, joint)[:, joint]
        deviation = play(scene.load[:, joint], inertia, scene.motion, gap) / -gap
        return link_deviation(scene, joint, deviation)


def play(load: Array, inertia: Array, motion: Motion, gap: float) -> Array:
    """By how much the motor leads the link (N,) rad under a load (N,) N m, at most half the gap."""
    acceleration = load / np.maximum(inertia, 1e-9)
    result = 0.5 * gap * np.where(load < 0.0, -1.0, 1.0)
    for start, stop in runs(motion.valid, len(load)):
        at = slice(start, stop)
        _fly(result[at], acceleration[at], 0.5 * gap, 1.0 / motion.rate_hz)
    return result


def _fly(x: Array, acceleration: Array, half: float, dt: float) -> None:
    """Fill in x (N,), of which the side of contact is right except during flights."""
    pulls = np.where(acceleration < 0.0, -1.0, 1.0)
    changes = np.flatnonzero(pulls[1:] != pulls[:-1])
    k, side = 0, float(pulls[0])
    while k < len(x) - 1:
        if pulls[k] == side:
            ahead = np.searchsorted(changes, k)
            if ahead == len(changes):
                x[k:] = side * half
                return
            x[k : changes[ahead] + 1] = side * half
            k = int(changes[ahead])
        k, side = _flight(x, acceleration, side, half, dt, k)


def _flight(
    x: Array, acceleration: Array, side: float, half: float, dt: float, k: int
) -> tuple[int, float]:
    """Follow one flight from flank `side`, from sample k on; return where and on which it ends.

    Accelerations are joined by straight lines, along which position and speed are
    exact.
    """
    before, after = float(acceleration[k]), float(acceleration[k + 1])
    share = after / (after - before) if before * side > 0.0 else 1.0
    step, before = share * dt, 0.0 if before * side > 0.0 else before
    position, speed = side * half, 0.0
    while True:
        position += speed * step + (2.0 * before + after) * step**2 / 6.0
        speed += 0.5 * (before + after) * step
        k += 1
        if abs(position) >= half:
            side = 1.0 if position > 0.0 else -1.0
            x[k] = side * half
            return k, side
        x[k] = position
        if k + 1 >= len(x):
            return k, side
        step, before, after = dt, after, float(acceleration[k + 1])
