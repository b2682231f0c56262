"""Torque that repeats with the angle: cogging, commutation, the strain wave, a gear's mesh.

    tau = m (c_s sin(p) + c_c cos(p)),        p = order N (q - lag dq)

`order` is in cycles per motor turn (N the gear ratio; per joint turn where the robot file gives
none, N = 1). On a slide N is the motor's angle per length [rad/m], 2 pi over the screw's lead.
The multiplier m is the law by which the ripple scales:

    law 0, constant:   m = 1            cogging, also without current [N m]
    law 1, torque:     m = tau_model    commutation, phase gains [-]
    law 2, direction:  m = s(v)         friction that varies round the turn [N m]
    law 3, load:       m = tau_load     mesh under what the gear passes to the link [-]

`lag` [s] is how late a fast ripple shows in the measured torque: the drive answers it with a delay
of its own, and what is left of it shakes the arm. Both ways and at many speeds its waves then fall
on different angles, and no sine of the angle alone sums them up. It is looked for with law 0.

Candidate orders are the peaks of the residual's least-squares spectrum over position. Cogging:
Piccoli, Yim, "Anticogging: torque ripple suppression, modeling, and parameter selection", IJRR
35(1-3), 2016; strain wave: Ghorbel, Gandhi, "On the kinematic error in harmonic drive gears", J.
Mech. Des. 123(1), 2001.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Grid, Setting, Settings
from seqid_cli.model.effects.orders import Profile, clearest, clearness, peaks
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.typing import Array

LAWS = ("constant", "torque", "direction", "load")
PEAKS = 4  # per law
USUAL = (1.0, 2.0)  # cycles per motor turn: eccentricity of the drive, a strain wave's two lobes
LOWEST = 1.5  # cycles per joint turn: below it a smooth dependence on position does as well
FINE = 12.0  # cycles per joint turn, below which a ripple is whole per motor turn, or clear
FINE_IN_RANGE = 8.0  # cycles in the range of a slide, likewise: it has no turn
HIGHEST = 4000.0
HIGHEST_OF_SLIDE = 40000.0  # cycles per 2 pi m: waves of 0.16 mm
CYCLES_IN_RANGE = 2.0
WHOLE, WHOLE_IF_SPARSE = 0.98, 0.9  # of the best gain, from which a whole number is taken
TURNED = 0.3  # rad, that a lag must turn a ripple by to be worth a name
LAGS_S = (0.005, 0.01, 0.015, 0.02)
CLEAR = 15.0  # times the level around it, as the luckiest line of noise: of lag or few waves
SPARSE = 3.0  # motor turns in the range: whole numbers then lie far apart


class TorqueRipple(Effect):
    """A sine of the angle, constant or scaled by torque or direction."""

    name = "torque_ripple"
    family = "transmission"
    drive = True
    settings = (
        Setting("order", "cycles per motor turn", low=0.0, continuous=False),
        Setting("law", "1", low=0.0, high=len(LAWS) - 1.0, continuous=False),
        Setting("lag", "s", low=0.0, high=max(LAGS_S), continuous=False),
    )
    wide = True
    wave = "ripple"
    over = "wave"
    alike = ("encoder_eccentricity", "periodic_disturbance", "torque_constant")
    separate_by = (
        "slow passes at two constant speeds and two loads, both ways: ripple keeps its place in "
        "angle; what grows with load, direction or speed tells which kind it is"
    )

    def searched(self, settings: Settings) -> int:
        """Return 1 for an order that is read off the spectrum; whole ones are where motors rub."""
        return int(settings["order"] != round(settings["order"]))

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return sine and cosine parts."""
        unit = "1" if settings["law"] in (1.0, 3.0) else "N m"
        return Coefficient("ripple_sin", unit), Coefficient("ripple_cos", unit)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield the usual lines, the strongest and the clearest of every law and best lag."""
        gear = abs(float(scenes[0].gear[joint]))
        speed = max(usual_speed(scene, joint) for scene in scenes)
        for order in USUAL:  # which the spectrum over position does not reach where logs are fast
            if order * gear >= FINE:
                yield {"order": order, "law": 0.0, "lag": 0.0}
        for law, lag, profile in _profiles(scenes, joint, residual):
            lowest = max(LOWEST, CYCLES_IN_RANGE / profile.span)
            fine_from = FINE_IN_RANGE / profile.span if _slides(scenes[0], joint) else FINE
            orders = (self._named(profile, k / gear, gear) for k in peaks(profile, lowest, PEAKS))
            for order in dict.fromkeys(orders):
                turned = order * gear * lag * speed
                fine = order == round(order) or order * gear >= fine_from
                few = not _slides(scenes[0], joint) and LAWS[law] != "direction"
                clear = fine or (few and clearness(profile, lowest, order * gear) > CLEAR)
                if clear and (lag == 0.0 or turned > TURNED):
                    yield {"order": order, "law": float(law), "lag": lag}

    def _named(self, profile: Profile, order: float, gear: float) -> float:
        """A whole number of cycles per motor turn where it explains as much."""
        whole = float(round(order))
        enough = WHOLE_IF_SPARSE if gear * profile.span > SPARSE else WHOLE
        if whole >= 1.0 and profile.gain(whole * gear) >= enough * profile.gain(order * gear):
            return whole
        return order

    def columns(self, scene: Scene, joint: int, settings: Settings) -> Columns:
        """Sine and cosine of the angle, times the law's multiplier."""
        p = settings["order"] * scene.gear[joint] * _angle(scene, joint, settings["lag"])
        m = multiplier(scene, joint, int(settings["law"]))
        return {joint: np.stack([m * np.sin(p), m * np.cos(p)], axis=1)}


def _profiles(
    scenes: Scenes, joint: int, residual: Sequence[Array]
) -> Iterator[tuple[int, float, Profile]]:
    """Residual over the angle for every law without lag, and for law 0 at the clearest one's."""
    highest = highest_order(scenes, joint)
    r = [values[:, joint] for values in residual]

    def profile_of(law: int, lag: float) -> Profile | None:
        turns = [_angle(scene, joint, lag) / (2 * np.pi) for scene in scenes]
        return Profile.of(turns, r, [multiplier(scene, joint, law) for scene in scenes], highest)

    prompt = [profile_of(law, 0.0) for law in range(len(LAWS))]
    yield from ((law, 0.0, profile) for law, profile in enumerate(prompt) if profile is not None)
    late = [(lag, profile_of(0, lag)) for lag in LAGS_S]
    there = [(clearest(profile, FINE), lag, profile) for lag, profile in late if profile]
    clear, lag, profile = max(there, key=lambda found: found[0], default=(0.0, 0.0, None))
    if profile is not None and clear > CLEAR:
        yield 0, lag, profile


def _angle(scene: Scene, joint: int, lag: float) -> Array:
    """Angle (N,) rad of a joint as it was `lag` seconds before."""
    return np.asarray(scene.angle[:, joint] - lag * scene.motion.dq[:, joint])


def multiplier(scene: Scene, joint: int, law: int) -> Array:
    """What the ripple scales with, (N,)."""
    if law == 0:
        return np.ones(scene.samples)
    every = {1: "modelled", 2: "sign", 3: "load"}
    return np.asarray(getattr(scene, every[law])[:, joint])


def highest_order(scenes: Scenes, joint: int) -> float:
    """Most cycles per joint turn that speed, sampling rate and encoder can tell apart."""
    limits = [HIGHEST_OF_SLIDE if _slides(scenes[0], joint) else HIGHEST]
    for scene in scenes:
        speed = usual_speed(scene, joint)
        step = float(scene.motion.cutoff.encoder_step[joint])
        if step > 0.0:
            limits.append(1.0 / step)
        if speed > 0.0:
            limits.append(0.4 * scene.motion.rate_hz * 2 * np.pi / max(speed, 1e-6))
    return min(limits)


def _slides(scene: Scene, joint: int) -> bool:
    return bool(scene.robot.chain.prismatic[joint])


def usual_speed(scene: Scene, joint: int) -> float:
    """Speed [rad/s] that a joint exceeds in a quarter of the time that it moves; 0 if never."""
    speed = np.abs(scene.motion.dq[:, joint])[scene.motion.moving[:, joint]]
    return float(np.quantile(speed, 0.75)) if len(speed) else 0.0
