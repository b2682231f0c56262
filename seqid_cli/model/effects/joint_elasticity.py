"""The gear twists under load: the link is not where the motor's encoder says, or the other way.

Encoder on the motor (encoder_side 0): with x = q_link - q_measured the joint's twist,

    M x'' + D x' + K x = -tau_L,        tau_effect = (d tau / d q, dq, ddq) . (x, x', x'')

Encoder on the link (encoder_side 1, where the robot file says so): rotor and motor
friction feel dq_m = dq + tau_L' / K,

    tau_effect = N^2 J tau_L'' / K + (d tau_friction / d dq) tau_L' / K

tau_L [N m] is what the gear passes on, M [kg m^2] the links' inertia about the joint
with the others held, K [N m/rad] the stiffness, D [N m s/rad] the damping. Well below
the resonance x = -tau_L / K, and only the compliance 1/K matters, which is the
coefficient; nearer to it the shape depends on K and D too, by the settings
`trial_stiffness`, which must agree with 1/K, and `damping_ratio`, of critical: looked
for first with more of it than a gear has, so that a coarse grid of resonances meets the
true one, then with less. In the band a finer grid with less damping meets those that
ring on. Spong, "Modeling and control of elastic joint robots", J. Dyn. Sys. Meas.
Control 109(4), 1987; Gautier, Jubien, Janot, "New iterative learning identification and
model based control of robots using only actual motor torque data", IROS 2013.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg.blas import dtbsv

from seqid_cli.model.effects.declared import Twist
from seqid_cli.model.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
)
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.memory import FrictionSlope, Rate
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.model.effects.sensitivity import link_deviation, link_inertia
from seqid_cli.model.effects.units import Value
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

BLUNT, RINGING = 0.15, 0.06  # damping, of critical
SHARPER = (RINGING, 0.03, 0.015)
# resonance of the grid's ends over the low-pass's cut-off
SOFTEST, STIFFEST = 0.25, 6.0
POINTS = 8
FINE = 8  # resonances in the band, where gears may ring on
AGREEMENT = 4.0  # of compliance and trial stiffness, as a ratio
# over the cut-off, of a joint whose shape is that of a stiff one
LOWEST_RESONANCE = 0.4


class JointElasticity(Effect):
    """Twist of a compliant joint."""

    name = "joint_elasticity"
    family = "transmission"
    settings = (
        Setting("trial_stiffness", "N m/rad", low=1e-2, high=1e8, logarithmic=True),
        Setting("encoder_side", "1", low=0.0, high=1.0, continuous=False),
        Setting(
            "damping_ratio", "1", low=0.0, high=1.0, continuous=False, then=SHARPER
        ),
    )
    needs = ("load",)
    passes = 1
    timing = apart = True
    linear = (Coefficient("compliance", "rad/(N m)", low=0.0),)
    alike = ("time_skew", "actuator_lag", "encoder_eccentricity")
    separate_by = (
        "steps of acceleration without a reversal, and a chirp towards the resonance; a"
        " sensor on the link shows the twist itself"
    )

    def local(self, settings: Settings) -> bool:
        """Only where the encoder is on the link: a twist rings on."""
        return settings["encoder_side"] > 0.5

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield resonances around the cut-off; the robot file tells where the encoder sits."""
        inertia = max(float(np.mean(link_inertia(scenes[0], joint)[:, joint])), 1e-9)
        cutoff = scenes[0].motion.lowpass.cutoff_hz
        # N m/rad, of a resonance at the cut-off
        unit = inertia * (2 * np.pi * cutoff) ** 2
        link = scenes[0].robot.joints[joint].encoder_side == "link"
        tried = [
            (share, BLUNT)
            for share in np.geomspace(SOFTEST, STIFFEST, POINTS)[:: 1 + link]
        ]
        if not link:
            tried += [
                (share, RINGING) for share in np.geomspace(LOWEST_RESONANCE, 1.0, FINE)
            ]
        for share, ratio in tried:
            settings = {
                "trial_stiffness": float(unit * share**2),
                "encoder_side": float(link),
            }
            yield {**settings, "damping_ratio": ratio}

    def laws(
        self, robot: Robot, joint: int, settings: Settings
    ) -> Mapping[int, Law] | None:
        """Rotor and friction on the motor's motion, where the encoder is on the link."""
        if settings["encoder_side"] <= 0.5:
            return None
        slope = FrictionSlope(lead="load_rate", per=1.0 / settings["trial_stiffness"])
        rates = {"load_rate": Rate("load"), "load_bend": Rate("load", 2)}
        term = "rotor * load_bend + slope * load_rate"
        return {joint: Law(terms=(term,), memories={**rates, "slope": slope})}

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Twist | None:
        """Twist of the gear, where the encoder is on the motor."""
        if settings["encoder_side"] > 0.5:
            return None
        return Twist(settings["trial_stiffness"], settings.get("damping_ratio", BLUNT))

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Torque per unit compliance, on all joints (link's side: on its own)."""
        twisted = self.deviation(scene.robot, joint, settings)
        if twisted is None:
            return super().columns(scene, joint, settings)
        bent = twist(scene, joint, twisted.stiffness, twisted.damping_ratio)
        return link_deviation(scene, joint, bent)

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return the stiffness 1 / c, its error by the delta method."""
        compliance = max(float(c[0]), 1e-12)
        error = float(np.sqrt(max(covariance[0, 0], 0.0))) / compliance**2
        return [
            Value(
                "stiffness",
                1.0 / compliance,
                error,
                robot.joints[joint].unit("N m/rad"),
            )
        ]

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """The compliance agrees with the stiffness that shaped it, where that shows in the band."""
        if c[0] <= 0.0 or settings["encoder_side"] > 0.5:
            return bool(c[0] > 0.0)
        inertia = max(float(np.mean(link_inertia(scenes[0], joint)[:, joint])), 1e-9)
        # N m/rad
        band = inertia * (2 * np.pi * scenes[0].motion.lowpass.cutoff_hz) ** 2
        if settings["trial_stiffness"] < band:
            return bool(
                1.0 / AGREEMENT < c[0] * settings["trial_stiffness"] < AGREEMENT
            )
        return bool(1.0 / c[0] > LOWEST_RESONANCE**2 * band)


def twist(scene: Scene, joint: int, stiffness: float, ratio: float = BLUNT) -> Array:
    """Twist K x (N,) N m of a joint of given stiffness and damping, driven by the measured motion.

    Trapezoidal (average acceleration) steps, stable however stiff the joint is; before
    the first sample of each stretch without a gap the twist is taken for quasi-static.
    """
    load = scene.load[:, joint]
    mass = np.maximum(link_inertia(scene, joint)[:, joint], 1e-9) / stiffness
    damping = 2.0 * ratio * np.sqrt(mass)
    result = -load
    for start, stop in runs(scene.motion.valid, scene.samples):
        if stop - start > 3:
            at = slice(start, stop)
            result[at] = _oscillator(
                load[at], mass[at], damping[at], scene.motion.rate_hz
            )
    return result


def _oscillator(load: Array, mass: Array, damping: Array, rate_hz: float) -> Array:
    """Solve mass z'' + damping z' + z = -load; the time steps form a triangular band."""
    a, d = mass[1:-1] * rate_hz**2, 0.5 * damping[1:-1] * rate_hz
    band = np.zeros((3, len(load)))
    band[0, :2] = 1.0
    band[0, 2:] = a + d + 0.25
    band[1, 1:-1] = 0.5 - 2.0 * a
    band[2, :-2] = a - d + 0.25
    right = -load
    right[2:] = -0.25 * (load[2:] + 2.0 * load[1:-1] + load[:-2])
    return np.asarray(dtbsv(2, band, right, lower=1))
