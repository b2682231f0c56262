"""Torque that repeats with the angle: cogging, commutation, the strain wave, a gear's mesh.

    tau = m (c_s sin(p) + c_c cos(p)),        p = order N (q - lag dq)

`order` is in cycles per motor turn (N the gear ratio; per joint turn where the robot
file gives none, N = 1). On a slide N is the motor's angle per length [rad/m], 2 pi over
the screw's lead. The multiplier m is the law by which the ripple scales:

    law 0, constant:   m = 1            cogging, also without current [N m]
    law 1, torque:     m = tau_model    commutation, phase gains [-]
    law 2, direction:  m = s(v)         friction that varies round the turn [N m]
    law 3, load:       m = tau_load     mesh under what the gear passes to the link [-]

`lag` [s] is how late a fast ripple shows in the measured torque: the drive answers it
with a delay of its own, and what is left of it shakes the arm. Both ways and at many
speeds its waves then fall on different angles, and no sine of the angle alone sums them
up. It is looked for with law 0.

Candidate orders are the peaks of the residual's least-squares spectrum over position.
Cogging: Piccoli, Yim, "Anticogging: torque ripple suppression, modeling, and parameter
selection", IJRR 35(1-3), 2016; strain wave: Ghorbel, Gandhi, "On the kinematic error in
harmonic drive gears", J. Mech. Des. 123(1), 2001.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.optimize import minimize_scalar

from seqid_cli.model.effects.effect import Coefficient, Effect, Grid, Setting, Settings
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.scene import Scene, Scenes
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

BINS_PER_CYCLE = 4
MOST_BINS = 1 << 17
# of the Fourier transform, so that a line cannot fall between two of its values
PADDING = 4
TREND = 5  # terms of the smooth dependence on position that is taken out first
FLOOR_WINDOW = 64  # values of the spectrum over which its level is taken
XATOL = 5e-4  # of the half width of a line, to which its order is refined


@dataclass(frozen=True)
class Profile:
    """A residual r with its multiplier m, summed up over position in B bins.

    `x` (B,) is the mean position of each bin [turns], `rm` and `mm` (B,) the sums of r
    m and of m m in it, `span` the range of position [turns], `highest` the cycles per
    turn up to which the bins resolve lines.
    """

    x: Array
    rm: Array
    mm: Array
    span: float
    highest: float

    @classmethod
    def of(
        cls, x: Sequence[Array], r: Sequence[Array], m: Sequence[Array], highest: float
    ) -> Self | None:
        """Sum up samples x (N,) turns, r and m (N,) where r is not 0; None where they are few."""
        X, R, M = (np.concatenate(list(parts)) for parts in (x, r, m))
        counts = R != 0.0
        X, R, M = X[counts], R[counts], M[counts]
        if len(X) < 100 or np.ptp(X) <= 0.0:
            return None
        start, span = float(X.min()), float(np.ptp(X))
        bins = min(max(int(BINS_PER_CYCLE * highest * span), 16), MOST_BINS)
        at = np.minimum(((X - start) / span * bins).astype(np.intp), bins - 1)
        number = np.bincount(at, minlength=bins)
        centre = start + (np.arange(bins) + 0.5) * span / bins
        mean = np.bincount(at, weights=X, minlength=bins) / np.maximum(number, 1)
        mm = np.bincount(at, weights=M * M, minlength=bins).astype(np.float64)
        rm = np.bincount(at, weights=R * M, minlength=bins).astype(np.float64)
        position = np.where(number > 0, mean, centre)
        # A smooth dependence on position, scaled to [-1, 1], is taken out of r first.
        basis = chebvander(2 * (position - start) / span - 1, TREND - 1)
        weighted = basis * mm[:, None]
        rm = (
            rm
            - weighted
            @ np.linalg.lstsq(weighted.T @ basis, basis.T @ rm, rcond=1e-10)[0]
        )
        return cls(position, rm, mm, span, min(highest, bins / (BINS_PER_CYCLE * span)))

    def gain(self, order: float) -> float:
        """Squared residual that a sine of `order` cycles per turn explains, its phase free."""
        p = 2 * np.pi * order * self.x
        sin, cos = np.sin(p), np.cos(p)
        cross = float(self.mm @ (sin * cos))
        A = np.array([[self.mm @ (sin * sin), cross], [cross, self.mm @ (cos * cos)]])
        b = np.array([self.rm @ sin, self.rm @ cos])
        if np.linalg.det(A) < 1e-3 * float(np.trace(A)) ** 2:
            return 0.0
        return float(b @ np.linalg.solve(A, b))


def peaks(profile: Profile, lowest: float, count: int) -> list[float]:
    """At most `count` orders from `lowest` on: half the strongest lines, half the clearest ones."""
    orders, power, clear = _lines(profile, lowest)
    if len(power) < 3:
        return []
    top = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    chosen: list[int] = []
    for score in (clear, power):
        found = 0
        for k in top[np.argsort(-score[top], kind="stable")]:
            if found == (count + 1) // 2:
                break
            if all(abs(k - other) > 2 * PADDING for other in chosen):
                chosen.append(int(k))
                found += 1
    return [
        _refined(profile, float(orders[k]), 1.0 / profile.span / PADDING)
        for k in chosen
    ]


def clearest(profile: Profile, lowest: float) -> float:
    """How many times its surroundings' level the clearest line has; 0 where there are none."""
    return float(np.max(_lines(profile, lowest)[2], initial=0.0))


def clearness(profile: Profile, lowest: float, order: float) -> float:
    """How many times its surroundings' level the line nearest to an order has."""
    orders, _, clear = _lines(profile, lowest)
    return float(clear[np.argmin(np.abs(orders - order))]) if len(orders) else 0.0


def _lines(profile: Profile, lowest: float) -> tuple[Array, Array, Array]:
    """Orders from `lowest` on, their power, and how clear they stand above their surroundings."""
    lines = np.abs(np.fft.rfft(profile.rm, PADDING * len(profile.rm))) ** 2
    orders = np.arange(len(lines)) / (PADDING * profile.span)
    # The gain that a well spread range of positions would give.
    power = 2.0 * lines / max(float(profile.mm.sum()), 1e-300)
    inside = (orders >= lowest) & (orders <= profile.highest)
    orders, power = orders[inside], power[inside]
    if len(power) == 0:
        return orders, power, power
    # Their level: medians of windows, joined by lines.
    parts = np.array_split(
        np.arange(len(power)), len(power) // min(FLOOR_WINDOW, len(power))
    )
    at, level = zip(
        *((part.mean(), np.median(power[part])) for part in parts), strict=True
    )
    floor = np.interp(np.arange(len(power)), at, level)
    return orders, power, power / np.maximum(floor, 1e-300)


def _refined(profile: Profile, order: float, width: float) -> float:
    """Best order within `width` of a peak."""
    near = (order - width, order + width)
    found = minimize_scalar(
        lambda x: -profile.gain(x),
        bounds=near,
        method="bounded",
        options={"xatol": XATOL * width},
    )
    return float(found.x)


LAWS = ("constant", "torque", "direction", "load")
SCALES = ("", "tau * ", "sign(dq) * ", "load * ")  # of the ripple, by law
PEAKS = 4  # per law
# cycles per motor turn: eccentricity of the drive, a strain wave's two lobes
USUAL = (1.0, 2.0)
# cycles per joint turn: below it a smooth dependence on position does as well
LOWEST = 1.5
# cycles per joint turn, below which a ripple is whole per motor turn, or clear
FINE = 12.0
FINE_IN_RANGE = 8.0  # cycles in the range of a slide, likewise: it has no turn
HIGHEST = 4000.0
HIGHEST_OF_SLIDE = 40000.0  # cycles per 2 pi m: waves of 0.16 mm
CYCLES_IN_RANGE = 2.0
# of the best gain, from which a whole number is taken
WHOLE, WHOLE_IF_SPARSE = 0.98, 0.9
TURNED = 0.3  # rad, that a lag must turn a ripple by to be worth a name
LAGS_S = (0.005, 0.01, 0.015, 0.02)
# times the level around it, as the luckiest line of noise: of lag or few waves
CLEAR = 15.0
SPARSE = 3.0  # motor turns in the range: whole numbers then lie far apart


class TorqueRipple(Effect):
    """A sine of the angle, constant or scaled by torque or direction."""

    name = "torque_ripple"
    family = "transmission"
    drive = wide = True
    settings = (
        Setting("order", "cycles per motor turn", low=0.0, continuous=False),
        Setting("law", "1", low=0.0, high=len(LAWS) - 1.0, continuous=False),
        Setting("lag", "s", low=0.0, high=max(LAGS_S), continuous=False),
    )
    wave = "ripple"
    over = "wave"
    alike = ("encoder_eccentricity", "periodic_disturbance", "torque_constant")
    separate_by = (
        "slow passes at two constant speeds and two loads, both ways: ripple keeps its"
        " place in angle; what grows with load, direction or speed tells which kind"
        " it is"
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
        # which the spectrum over position does not reach where logs are fast
        for order in USUAL:
            if order * gear >= FINE:
                yield {"order": order, "law": 0.0, "lag": 0.0}
        for law, lag, profile in _profiles(scenes, joint, residual):
            lowest = max(LOWEST, CYCLES_IN_RANGE / profile.span)
            fine_from = (
                FINE_IN_RANGE / profile.span if _slides(scenes[0], joint) else FINE
            )
            orders = (
                self._named(profile, k / gear, gear)
                for k in peaks(profile, lowest, PEAKS)
            )
            for order in dict.fromkeys(orders):
                turned = order * gear * lag * speed
                fine = order == round(order) or order * gear >= fine_from
                few = not _slides(scenes[0], joint) and LAWS[law] != "direction"
                clear = fine or (
                    few and clearness(profile, lowest, order * gear) > CLEAR
                )
                if clear and (lag == 0.0 or turned > TURNED):
                    yield {"order": order, "law": float(law), "lag": lag}

    def _named(self, profile: Profile, order: float, gear: float) -> float:
        """A whole number of cycles per motor turn where it explains as much."""
        whole = float(round(order))
        enough = WHOLE_IF_SPARSE if gear * profile.span > SPARSE else WHOLE
        if whole >= 1.0 and profile.gain(whole * gear) >= enough * profile.gain(
            order * gear
        ):
            return whole
        return order

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Sine and cosine of the angle, times the law's multiplier."""
        parts = {"turn": "order * theta"}
        if settings["lag"]:
            parts["turn"] = "order * (theta - lag * gear * dq)"
        scale = SCALES[int(settings["law"])]
        terms = tuple(f"{scale}{wave}(turn)" for wave in ("sin", "cos"))
        numbers = {**settings, "gear": float(gear_ratios(robot)[joint])}
        return {joint: Law(terms=terms, parts=parts, numbers=numbers)}


def _profiles(
    scenes: Scenes, joint: int, residual: Sequence[Array]
) -> Iterator[tuple[int, float, Profile]]:
    """Residual over the angle for every law without lag, and for law 0 at the clearest one's."""
    highest = highest_order(scenes, joint)
    r = [values[:, joint] for values in residual]

    def profile_of(law: int, lag: float) -> Profile | None:
        turns = [_angle(scene, joint, lag) / (2 * np.pi) for scene in scenes]
        return Profile.of(
            turns, r, [multiplier(scene, joint, law) for scene in scenes], highest
        )

    prompt = [profile_of(law, 0.0) for law in range(len(LAWS))]
    yield from (
        (law, 0.0, profile) for law, profile in enumerate(prompt) if profile is not None
    )
    late = [(lag, profile_of(0, lag)) for lag in LAGS_S]
    there = [
        (clearest(profile, FINE), lag, profile) for lag, profile in late if profile
    ]
    clear, lag, profile = max(
        there, key=lambda found: found[0], default=(0.0, 0.0, None)
    )
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
