"""The gear twists under load: motor and link do not stand at the same angle.

Encoder on the motor (encoder_side 0): with x = q_link - q_measured the joint's twist,

    M x'' + D x' + K x = -tau_L
    tau_effect = (d tau / d q, dq, ddq) . (x, x', x'')

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
ring on.

At the joints near the base no motion of the motor tells the rotor's inertia from the
link's. Where the robot file does not give it, the setting `reflected_rotor_inertia` is
the part of M and tau_L that is the motor's and does not twist the gear. An IMU on the
link shows the resonance then, but not which part is whose: no stiffness is told. Spong,
"Modeling and control of elastic joint robots", J. Dyn. Sys. Meas. Control 109(4), 1987;
Gautier, Jubien, Janot, "New iterative learning identification and model based control
of robots using only actual motor torque data", IROS 2013.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from seqid_cli.effects.declared import Twist
from seqid_cli.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    Grid,
    Setting,
    Settings,
    knows_load,
    rotor_hidden,
)
from seqid_cli.effects.gear_load import ROTOR, smallest_inertia
from seqid_cli.effects.law import Law
from seqid_cli.effects.memory import FrictionSlope, Rate
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.sensitivity import link_deviation, link_inertia
from seqid_cli.effects.units import Value
from seqid_cli.motion.filters.differentiation import differentiate, runs
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Damping, of critical.
BLUNT = 0.15
RINGING = 0.06
SHARPER = (RINGING, 0.03, 0.015)
# Resonances of the grid's ends over the low-pass's cut-off.
SOFTEST = 0.25
STIFFEST = 6.0
POINTS = 8
FINE = 8  # resonances in the band, where gears may ring on
AGREEMENT = 4.0  # of compliance and trial stiffness, as a ratio
# Rotors of the grid, of the smallest inertia about a joint that they may be part of.
ROTORS = (0.3, 0.6, 0.85)
HIGHEST_SEEN = 2.2  # over the cut-off, of a resonance that IMUs on the link show
# Resonance over the cut-off, of a joint whose shape is that of a stiff one.
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
        Setting(ROTOR, "kg m^2", low=1e-12, high=1e6, logarithmic=True, asked=False),
    )
    passes = 1
    timing = True
    apart = True
    linear = (Coefficient("compliance", "rad/(N m)", low=0.0),)
    alike = ("time_skew", "actuator_lag", "encoder_eccentricity")
    separate_by = (
        "steps of acceleration without a reversal, and a chirp towards the resonance; a"
        " sensor on the link shows the twist itself"
    )

    def local(self, settings: Settings) -> bool:
        """Return whether the encoder is on the link: a twist rings on."""
        return _encoder_on_link(settings)

    def available(self, scenes: Scenes, joint: int) -> bool:
        """Return whether the model knows the load of the gear."""
        return knows_load(scenes)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield resonances around the cut-off; the file says where the encoder is."""
        stiffness_at_cutoff = _stiffness_at_cutoff(scenes[0], joint)
        on_link = scenes[0].robot.joints[joint].encoder_side == "link"

        # On the link every second resonance is enough: its columns hardly change.
        shares = np.geomspace(SOFTEST, STIFFEST, POINTS)[:: 1 + on_link]
        tried = [(share, BLUNT) for share in shares]
        if not on_link:
            resonances = np.geomspace(LOWEST_RESONANCE, 1.0, FINE)
            if scenes[0].links:
                # An IMU on the link shows it ringing where the torque does not.
                above = np.geomspace(1.0, HIGHEST_SEEN, FINE)
                resonances = np.concatenate([resonances, above[1:]])
            tried += [(share, RINGING) for share in resonances]

        for share, damping_ratio in tried:
            yield {
                "trial_stiffness": float(stiffness_at_cutoff * share**2),
                "encoder_side": float(on_link),
                "damping_ratio": damping_ratio,
            }

        # Where a part of the inertia is the motor's, the gear resonates at a part of
        # the stiffness. The motor's torque hardly shows that, an IMU on the link does.
        inertia = smallest_inertia(scenes, joint)
        is_hidden = rotor_hidden(scenes[0].robot, joint)
        if on_link or not scenes[0].links or not is_hidden or inertia <= 0.0:
            return
        for (share, damping_ratio), of_rotor in product(tried, ROTORS):
            stiffness = stiffness_at_cutoff * share**2 * (1.0 - of_rotor)
            yield {
                "trial_stiffness": float(stiffness),
                "encoder_side": 0.0,
                "damping_ratio": damping_ratio,
                ROTOR: of_rotor * inertia,
            }

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """Return the stiffness, and the rotor's inertia where there is one."""
        stiffness, *_, rotor = self.settings
        return (stiffness, rotor) if ROTOR in settings else (stiffness,)

    def laws(
        self, robot: Robot, joint: int, settings: Settings
    ) -> Mapping[int, Law] | None:
        """Return rotor and friction on the motor's motion; encoder on the link."""
        if not _encoder_on_link(settings):
            return None
        compliance = 1.0 / settings["trial_stiffness"]
        law = Law(
            terms=("rotor * load_bend + slope * load_rate",),
            memories={
                "load_rate": Rate("load"),
                "load_bend": Rate("load", 2),
                "slope": FrictionSlope(lead="load_rate", per=compliance),
            },
        )
        return {joint: law}

    def deviation(self, robot: Robot, joint: int, settings: Settings) -> Twist | None:
        """Return the twist of the gear, if the encoder is on the motor."""
        if _encoder_on_link(settings):
            return None
        return Twist(
            stiffness=settings["trial_stiffness"],
            damping_ratio=settings.get("damping_ratio", BLUNT),
            rotor=settings.get(ROTOR, 0.0),
        )

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Compute the torque per unit compliance, on all joints.

        With the encoder on the link only the joint itself feels it.
        """
        deviation = self.deviation(scene.robot, joint, settings)
        if deviation is None:
            return super().columns(scene, joint, settings)
        angle = twist(scene, joint, deviation)
        columns = dict(link_deviation(scene, joint, angle))
        if deviation.rotor:
            # The motor's part of the inertia does not turn with the link.
            motion = scene.motion
            _, acceleration = differentiate(angle, motion.rate_hz, motion.valid)
            columns[joint] = columns[joint] - deviation.rotor * acceleration[:, None]
        return columns

    def size_in(self, settings: Settings) -> float | None:
        """Return the compliance of the trial stiffness, which says where it rings."""
        if _encoder_on_link(settings):
            return None
        return 1.0 / settings["trial_stiffness"]

    def with_size(self, settings: Settings, size: float) -> dict[str, float]:
        """Return the settings of another compliance."""
        return {**settings, "trial_stiffness": 1.0 / size}

    def link_angle(self, scene: Scene, joint: int, settings: Settings) -> Array | None:
        """Return the twist, if the encoder is on the motor."""
        deviation = self.deviation(scene.robot, joint, settings)
        if deviation is None:
            return None
        return twist(scene, joint, deviation)[:, None]

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return the stiffness 1 / c, its error by the delta method."""
        compliance = max(float(c[0]), 1e-12)
        error = float(np.sqrt(max(covariance[0, 0], 0.0))) / compliance**2
        unit = robot.joints[joint].unit("N m/rad")
        return [Value("stiffness", 1.0 / compliance, error, unit)]

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether the compliance agrees with the stiffness of its column.

        The shape shows where the resonance lies in the band of the motion. Elsewhere
        the compliance must not put the resonance into that band.
        """
        if c[0] <= 0.0:
            return False
        if _encoder_on_link(settings):
            return True
        rotor = settings.get(ROTOR, 0.0)
        if rotor > 0.0 and rotor > smallest_inertia(scenes, joint):
            return False  # no link is left

        stiffness_at_cutoff = _stiffness_at_cutoff(scenes[0], joint, rotor)
        if settings["trial_stiffness"] < stiffness_at_cutoff:
            ratio = c[0] * settings["trial_stiffness"]
            return bool(1.0 / AGREEMENT < ratio < AGREEMENT)
        return bool(1.0 / c[0] > LOWEST_RESONANCE**2 * stiffness_at_cutoff)


def _encoder_on_link(settings: Settings) -> bool:
    return settings["encoder_side"] > 0.5


def _stiffness_at_cutoff(scene: Scene, joint: int, rotor: float = 0.0) -> float:
    """Return the stiffness of a joint that resonates at the cut-off, N m/rad.

    Of its modelled inertia `rotor` kg m^2 are the motor's.
    """
    mean_inertia = float(np.mean(link_inertia(scene, joint)[:, joint]))
    inertia = max(mean_inertia - rotor, 1e-9)
    return float(inertia * (2 * np.pi * scene.motion.lowpass.cutoff_hz) ** 2)


def twist(scene: Scene, joint: int, gear: Twist) -> Array:
    """Compute the twist K x (N,) N m of a compliant joint under the measured motion.

    Parameters
    ----------
    scene : Scene
    joint : int
    gear : Twist
        K [N m/rad], damping, and the rotor that the model has in the link.

    Returns
    -------
    Array
        Trapezoidal (average acceleration) steps, stable however stiff the joint is.
        Before the first sample of each stretch without a gap the twist is taken for
        quasi-static.
    """
    load = scene.load[:, joint]
    if gear.rotor and scene.sensor is None:
        load = load - gear.rotor * scene.motion.ddq[:, joint]
    inertia = link_inertia(scene, joint)[:, joint] - gear.rotor
    mass = np.maximum(inertia, 1e-9) / gear.stiffness
    damping = 2.0 * gear.damping_ratio * np.sqrt(mass)

    torque = -load
    for start, stop in runs(scene.motion.valid, scene.samples):
        if stop - start <= 3:
            continue
        run = slice(start, stop)
        torque[run] = _oscillator(
            load[run], mass[run], damping[run], scene.motion.rate_hz
        )
    return torque


def _oscillator(load: Array, mass: Array, damping: Array, rate_hz: float) -> Array:
    """Solve mass z'' + damping z' + z = -load; time steps form a triangular band."""
    from scipy.linalg.blas import dtbsv

    inertial = mass[1:-1] * rate_hz**2
    viscous = 0.5 * damping[1:-1] * rate_hz

    band = np.zeros((3, len(load)))
    band[0, :2] = 1.0
    band[0, 2:] = inertial + viscous + 0.25
    band[1, 1:-1] = 0.5 - 2.0 * inertial
    band[2, :-2] = inertial - viscous + 0.25

    right = -load
    right[2:] = -0.25 * (load[2:] + 2.0 * load[1:-1] + load[:-2])
    return np.asarray(dtbsv(2, band, right, lower=1))
