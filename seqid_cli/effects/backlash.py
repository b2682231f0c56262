"""A dead zone in the gear: where the load changes its sign, the link flies free.

    x = q_motor - q_link in [-b/2, b/2]
    M x'' = tau_L in flight,    x = +-b/2 in contact
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
from typing import NamedTuple

import numpy as np

from seqid_cli.effects.declared import Play
from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
    knows_load,
)
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.sensitivity import link_deviation, link_inertia
from seqid_cli.motion.filters.differentiation import differentiate, runs
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Bounds of the gap, rad.
SMALLEST = 2e-4
LARGEST = 2e-2
GAPS = tuple(float(gap) for gap in np.geomspace(SMALLEST, LARGEST, 7))
AGREEMENT = 4.0  # of gap and trial gap, as a ratio


class Backlash(Effect):
    """Free flight at every sign change of the transmitted torque."""

    name = "backlash"
    family = "transmission"
    settings = (
        Setting(
            "trial_gap",
            "rad",
            low=SMALLEST,
            high=LARGEST,
            continuous=False,
            agreement=AGREEMENT,
        ),
    )
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
        """Return False: the gap stands where it was left when it was last crossed."""
        return False

    def available(self, scenes: Scenes, joint: int) -> bool:
        """Return whether the model knows the load, and the load changes its sign."""
        changes_sign = any(
            np.ptp(np.sign(scene.load[:, joint])) > 1.0 for scene in scenes
        )
        return changes_sign and knows_load(scenes)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield the gap whose flights fit the joint's own residual best."""
        y = np.concatenate([r[:, joint] for r in residual])
        flights = [self._flight_torques(scene, joint) for scene in scenes]

        best_gap = SMALLEST
        largest_gain = -1.0
        for gap, *torques in zip(GAPS, *flights, strict=True):
            x = np.where(y != 0.0, np.concatenate(torques), 0.0)
            # Squares that a regression on x explains; a negative gap is none.
            gain = 0.0
            if x @ y > 0.0:
                gain = float(x @ y) ** 2 / max(float(x @ x), 1e-300)
            if gain > largest_gain:
                best_gap = gap
                largest_gain = gain
        yield {"trial_gap": best_gap}

    def _flight_torques(self, scene: Scene, joint: int) -> tuple[Array, ...]:
        """Compute the torque (N,) of each gap's flights at the joint, low-passed.

        It is asked for often, and kept with the scene.
        """
        key = (self.name, joint)
        if key not in scene.memo:
            motion = scene.motion
            load = scene.load[:, joint]
            inertia = link_inertia(scene, joint)[:, joint]
            torques = []
            for gap in GAPS:
                lead = play(load, inertia, motion, gap)
                _, acceleration = differentiate(lead, motion.rate_hz, motion.valid)
                torque = -inertia * acceleration
                torques.append(motion.filtered(torque, times=self.passes))
            scene.memo[key] = tuple(torques)
        return scene.memo[key]

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Play:
        """Return the flight between the flanks of the trial gap."""
        return Play(settings["trial_gap"])

    def link_angle(self, scene: Scene, joint: int, settings: Settings) -> Array:
        """Return minus the lead of the motor per unit gap."""
        gap = settings["trial_gap"]
        inertia = link_inertia(scene, joint)[:, joint]
        lead = play(scene.load[:, joint], inertia, scene.motion, gap)
        return lead[:, None] / -gap

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Compute the torque per unit gap, on all joints."""
        angle = self.link_angle(scene, joint, settings)
        return link_deviation(scene, joint, angle[:, 0])


def play(load: Array, inertia: Array, motion: Motion, gap: float) -> Array:
    """Compute by how much the motor leads the link under a load.

    Parameters
    ----------
    load, inertia : Array
        tau_L (N,) [N m] and M (N,) [kg m^2] of the module's text.
    motion : Motion
        Its valid runs are followed one by one.
    gap : float
        b [rad].

    Returns
    -------
    Array
        x (N,) [rad], within half the gap to either side.
    """
    acceleration = load / np.maximum(inertia, 1e-9)
    x = 0.5 * gap * np.where(load < 0.0, -1.0, 1.0)
    for start, stop in runs(motion.valid, len(load)):
        run = slice(start, stop)
        _fly(x[run], acceleration[run], 0.5 * gap, 1.0 / motion.rate_hz)
    return x


def _fly(x: Array, acceleration: Array, half_gap: float, dt: float) -> None:
    """Fill in x (N,), of which the flank is right except during and after flights."""
    pull = np.where(acceleration < 0.0, -1.0, 1.0)
    sign_changes = np.flatnonzero(pull[1:] != pull[:-1])

    k = 0
    flank = float(pull[0])
    while k < len(x) - 1:
        if pull[k] == flank:
            # In contact up to the next sign change of the load.
            ahead = np.searchsorted(sign_changes, k)
            if ahead == len(sign_changes):
                x[k:] = flank * half_gap
                return
            x[k : sign_changes[ahead] + 1] = flank * half_gap
            k = int(sign_changes[ahead])
        landing = _flight(x, acceleration, flank, half_gap, dt, k)
        k = landing.sample
        flank = landing.flank


class _Landing(NamedTuple):
    """The sample at which a flight ends, and the flank (-1 or 1) that it ends on."""

    sample: int
    flank: float


def _flight(
    x: Array, acceleration: Array, flank: float, half_gap: float, dt: float, k: int
) -> _Landing:
    """Follow one flight from a flank on, from sample k; fill in its positions.

    Accelerations are joined by straight lines, along which position and speed are
    exact.
    """
    before = float(acceleration[k])
    after = float(acceleration[k + 1])
    step = dt
    if before * flank > 0.0:
        # The load changes its sign between two samples: there the flight begins.
        step = after / (after - before) * dt
        before = 0.0

    position = flank * half_gap
    speed = 0.0
    while True:
        position += speed * step + (2.0 * before + after) * step**2 / 6.0
        speed += 0.5 * (before + after) * step
        k += 1
        if abs(position) >= half_gap:
            flank = 1.0 if position > 0.0 else -1.0
            x[k] = flank * half_gap
            return _Landing(k, flank)

        x[k] = position
        if k + 1 >= len(x):
            return _Landing(k, flank)
        step = dt
        before = after
        after = float(acceleration[k + 1])
