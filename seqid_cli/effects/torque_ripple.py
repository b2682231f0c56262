"""Torque that repeats with the angle: cogging, commutation, strain wave, gear mesh.

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

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.fft import rfft
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.effects.effect import (
    Coefficient,
    Effect,
    Grid,
    Setting,
    Settings,
    amplitude_and_phase,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Scene, Scenes, travel
from seqid_cli.effects.units import Value
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

BINS_PER_CYCLE = 4
MOST_BINS = 1 << 17
# Of the Fourier transform, so that a line cannot fall between two of its values.
PADDING = 4
TREND = 5  # terms of the smooth dependence on position that is taken out first
FLOOR_WINDOW = 64  # values of the spectrum over which its level is taken
XATOL = 5e-4  # of the half width of a line, to which its order is refined
# Terms of a power series of exp(i x), and more for each rad that x may have: the first
# one that is left out is 1e-12 at pi / 2.
TERMS_FOR = (12, 5)


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A residual r with its multiplier m, summed up over position in B bins.

    Most bins are empty where a log is short and its lines may be fine: only the others
    are kept.

    Attributes
    ----------
    bins : int
        B.
    bin : Index
        (F,) numbers of the bins that are filled, ascending.
    x : Array
        (F,) mean position in each of these [turns].
    rm, mm : Array
        (F,) sums of r m and of m m in each of these.
    span : float
        Range of position [turns].
    highest : float
        Cycles per turn up to which the bins resolve lines.
    """

    bins: int
    bin: Index
    x: Array
    rm: Array
    mm: Array
    span: float
    highest: float

    @classmethod
    def of(
        cls, x: Sequence[Array], r: Sequence[Array], m: Sequence[Array], highest: float
    ) -> Self | None:
        """Sum up the samples of some logs at which r is not 0.

        Parameters
        ----------
        x, r, m : sequence of Array
            Positions (N,) [turns], residuals and multipliers (N,), log by log.
        highest : float
            Cycles per turn that are to be resolved.

        Returns
        -------
        Profile or None
            None where the samples are few.
        """
        X = np.concatenate(list(x))
        R = np.concatenate(list(r))
        M = np.concatenate(list(m))
        counts = R != 0.0
        X = X[counts]
        R = R[counts]
        M = M[counts]
        if len(X) < 100 or np.ptp(X) <= 0.0:
            return None

        start = float(X.min())
        span = float(np.ptp(X))
        bins = min(max(int(BINS_PER_CYCLE * highest * span), 16), MOST_BINS)
        bin_of = np.minimum(((X - start) / span * bins).astype(np.intp), bins - 1)

        number = np.bincount(bin_of, minlength=bins)
        filled = np.flatnonzero(number)
        position = np.bincount(bin_of, weights=X)[filled] / number[filled]
        mm = np.bincount(bin_of, weights=M * M)[filled].astype(np.float64)
        rm = np.bincount(bin_of, weights=R * M)[filled].astype(np.float64)

        # A smooth dependence on position, scaled to [-1, 1], is taken out of r first.
        basis = chebvander(2 * (position - start) / span - 1, TREND - 1)
        weighted = basis * mm[:, None]
        trend = np.linalg.lstsq(weighted.T @ basis, basis.T @ rm, rcond=1e-10)[0]
        resolved = bins / (BINS_PER_CYCLE * span)
        return cls(
            bins=bins,
            bin=filled,
            x=position,
            rm=rm - weighted @ trend,
            mm=mm,
            span=span,
            highest=min(highest, resolved),
        )

    @cached_property
    def power(self) -> tuple[Array, Array]:
        """Orders [cycles per turn] from 0 on, and the power of a line at each."""
        in_bins = np.zeros(self.bins)
        in_bins[self.bin] = self.rm
        lines = rfft(in_bins, PADDING * self.bins)
        squares = lines.real**2 + lines.imag**2
        orders = np.arange(len(lines)) / (PADDING * self.span)
        # The gain that a well spread range of positions would give.
        return orders, 2.0 * squares / max(self._sum_mm, 1e-300)

    @cached_property
    def _sum_mm(self) -> float:
        return float(self.mm.sum())

    def gain(self, order: float) -> float:
        """Return the squared residual that a sine of `order` cycles per turn explains.

        Its phase is free.
        """
        p = 2 * np.pi * order * self.x
        sin = np.sin(p)
        cos = np.cos(p)
        weighted = self.mm * sin
        return self._explained(
            of_sin=float(weighted @ sin),
            cross=float(weighted @ cos),
            b_sin=float(self.rm @ sin),
            b_cos=float(self.rm @ cos),
        )

    def _explained(
        self, *, of_sin: float, cross: float, b_sin: float, b_cos: float
    ) -> float:
        """Return the squared residual that sine and cosine explain, by their products.

        The squares of both are `_sum_mm` together.
        """
        of_cos = self._sum_mm - of_sin
        determinant = of_sin * of_cos - cross**2
        if determinant <= 1e-3 * self._sum_mm**2:
            return 0.0
        square = b_sin**2 * of_cos - 2.0 * b_sin * b_cos * cross + b_cos**2 * of_sin
        return square / determinant

    def gains_near(self, order: float, width: float) -> Callable[[float], float]:
        """Return `gain` of orders that are not further than `width` from one.

        Over the range of positions such a wave turns against that of `order` by a part
        of a turn. So it is its wave times a short power series of the position u, in
        halves of the range from its middle:

            exp(i p) = exp(i p0) sum_k (i a u)^k / k!,    a = pi span (order - order0),

        and the sums over all positions are taken once for all orders.
        """
        from scipy.special import factorial

        middle = 0.5 * (float(self.x[0]) + float(self.x[-1]))
        turns = order * (self.x - middle)
        wave = np.exp(2j * np.pi * (turns - np.round(turns)))
        reach = 2.0 * np.pi * self.span * width  # of the wave's square, rad
        powers = np.arange(TERMS_FOR[0] + math.ceil(TERMS_FOR[1] * reach))
        u = (self.x - middle) / (0.5 * self.span)
        of_u = np.empty((len(powers), len(u)))
        of_u[0] = 1.0
        for k in powers[1:]:
            np.multiply(of_u[k - 1], u, out=of_u[k])
        series = (1j**powers) / factorial(powers)
        rm_wave = of_u @ (self.rm * wave.real) + 1j * (of_u @ (self.rm * wave.imag))
        square = wave * wave
        mm_wave = of_u @ (self.mm * square.real) + 1j * (of_u @ (self.mm * square.imag))
        rm_series = series * rm_wave
        mm_series = series * mm_wave

        def gain(other: float) -> float:
            angle = np.pi * self.span * (other - order)
            of_r = complex(rm_series @ angle**powers)
            of_m = complex(mm_series @ (2.0 * angle) ** powers)
            # sin^2 p = (1 - cos 2 p) / 2, sin p cos p = sin 2 p / 2
            return self._explained(
                of_sin=0.5 * (self._sum_mm - of_m.real),
                cross=0.5 * of_m.imag,
                b_sin=of_r.imag,
                b_cos=of_r.real,
            )

        return gain


class _Spectrum(NamedTuple):
    """Orders (F,) of a profile, their power, and that over its surroundings' level."""

    orders: Array
    power: Array
    clearness: Array


def peaks(profile: Profile, lowest: float, count: int) -> list[float]:
    """Find at most `count` orders from `lowest` on that stand out.

    Half of them are the clearest lines, the other half the strongest ones.
    """
    spectrum = _spectrum(profile, lowest)
    power = spectrum.power
    if len(power) < 3:
        return []

    is_peak = (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
    tops = np.flatnonzero(is_peak) + 1
    chosen: list[int] = []
    for score in (spectrum.clearness, power):
        taken = 0
        for k in tops[np.argsort(-score[tops], kind="stable")]:
            if taken == (count + 1) // 2:
                break
            # Padding spreads a line over several values.
            if all(abs(k - other) > 2 * PADDING for other in chosen):
                chosen.append(int(k))
                taken += 1

    width = 1.0 / profile.span / PADDING
    return [_refined(profile, float(spectrum.orders[k]), width) for k in chosen]


def clearest(profile: Profile, lowest: float) -> float:
    """Return the power of the clearest line over its surroundings' level; 0 if none."""
    return float(np.max(_spectrum(profile, lowest).clearness, initial=0.0))


def clearness(profile: Profile, lowest: float, order: float) -> float:
    """Return the power of the line nearest to an order over its surroundings' level."""
    spectrum = _spectrum(profile, lowest)
    if not len(spectrum.orders):
        return 0.0
    nearest = np.argmin(np.abs(spectrum.orders - order))
    return float(spectrum.clearness[nearest])


def _spectrum(profile: Profile, lowest: float) -> _Spectrum:
    """Compute the spectrum of a profile over position, from the order `lowest` on."""
    orders, power = profile.power
    inside = (orders >= lowest) & (orders <= profile.highest)
    orders = orders[inside]
    power = power[inside]
    if len(power) == 0:
        return _Spectrum(orders, power, power)

    floor = _surroundings(power)
    return _Spectrum(orders, power, power / np.maximum(floor, 1e-300))


def _surroundings(power: Array) -> Array:
    """Return the level (F,) round each value of a spectrum (F,).

    Medians of windows, joined by lines. Windows of one length are taken together: one
    by one, their calls cost more than the Fourier transform.
    """
    count = len(power) // min(FLOOR_WINDOW, len(power))
    size, n_longer = divmod(len(power), count)
    in_longer = n_longer * (size + 1)
    longer = power[:in_longer].reshape(n_longer, size + 1)
    shorter = power[in_longer:].reshape(count - n_longer, size)
    levels = np.concatenate([np.median(longer, axis=1), np.median(shorter, axis=1)])

    ends = np.cumsum(np.repeat([size + 1, size], [n_longer, count - n_longer]))
    starts = np.concatenate([[0], ends[:-1]])
    middles = 0.5 * (starts + ends - 1)
    return np.asarray(np.interp(np.arange(len(power)), middles, levels))


def _refined(profile: Profile, order: float, width: float) -> float:
    """Return the order of most gain within `width` of a peak."""
    from scipy.optimize import minimize_scalar

    gain = profile.gains_near(order, width)
    best = minimize_scalar(
        lambda x: -gain(x),
        bounds=(order - width, order + width),
        method="bounded",
        options={"xatol": XATOL * width},
    )
    return float(best.x)


LAWS = ("constant", "torque", "direction", "load")
SCALES = ("", "tau * ", "sign(dq) * ", "load * ")  # of the ripple, by law
PEAKS = 4  # per law
# Cycles per motor turn: eccentricity of the drive, a strain wave's two lobes.
USUAL = (1.0, 2.0)
# Cycles per joint turn: below it a smooth dependence on position does as well.
LOWEST = 1.5
# Cycles per joint turn, below which a ripple is whole per motor turn, or clear.
FINE = 12.0
FINE_IN_RANGE = 8.0  # cycles in the range of a slide, likewise: it has no turn
HIGHEST = 4000.0
HIGHEST_OF_SLIDE = 40000.0  # cycles per 2 pi m: waves of 0.16 mm
CYCLES_IN_RANGE = 2.0
RESOLVED = 0.4  # of the sampling rate, up to which waves are told apart
# Of the best gain, from which a whole number is taken.
WHOLE = 0.98
WHOLE_IF_SPARSE = 0.9
# Fine waves that a joint must go through: lines are looked for by the hundred.
FEWEST_WAVES = 20.0
# Waves in its range, below which a ripple must be clear: a few of them follow many a
# function of the position.
FEWEST_IN_RANGE = 10.0
LEAST_TRAVEL = 0.1  # rad: with less a joint is only shaken
SPARSE = 3.0  # motor turns in the range: whole numbers then lie far apart
TURNED = 0.3  # rad, that a lag must turn a ripple by to be worth a name
LAGS_S = (0.005, 0.01, 0.015, 0.02)
# Times the level around it, as the luckiest line of noise: of lag or few waves.
CLEAR = 15.0


class TorqueRipple(Effect):
    """A sine of the angle, constant or scaled by torque or direction."""

    name = "torque_ripple"
    family = "transmission"
    drive = True
    wide = True
    settings = (
        Setting("order", "cycles per motor turn", low=0.0, continuous=False),
        Setting("law", "1", low=0.0, high=len(LAWS) - 1.0, continuous=False),
        Setting("lag", "s", low=0.0, high=max(LAGS_S), continuous=False),
    )
    over = "wave"
    alike = ("encoder_eccentricity", "periodic_disturbance", "torque_constant")
    separate_by = (
        "slow passes at two constant speeds and two loads, both ways: ripple keeps its"
        " place in angle; what grows with load, direction or speed tells which kind"
        " it is"
    )

    def searched(self, settings: Settings) -> int:
        """Return 1 for an order that is read off the spectrum.

        Whole orders are where motors have ripple: they are no search.
        """
        return int(settings["order"] != round(settings["order"]))

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return sine and cosine parts."""
        unit = "1" if settings["law"] in (1.0, 3.0) else "N m"
        return Coefficient("ripple_sin", unit), Coefficient("ripple_cos", unit)

    def waves(self, scenes: Scenes, joint: int, settings: Settings) -> float:
        """Return how many waves over a joint's travel a constant ripple has."""
        if settings["law"]:
            return np.inf
        gear = abs(float(scenes[0].gear[joint]))
        return settings["order"] * gear * travel(scenes, joint) / (2.0 * np.pi)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield the usual orders, then strong and clear lines of every law."""
        gear = abs(float(scenes[0].gear[joint]))
        speed = max(usual_speed(scene, joint) for scene in scenes)
        slides = _slides(scenes[0], joint)

        resolved_hz = RESOLVED * min(scene.motion.rate_hz for scene in scenes)

        def is_gone_through(cycles: float) -> bool:
            return goes_through(scenes, joint, cycles, resolved_hz)

        # The spectrum over position does not reach these where logs are fast.
        for order in USUAL:
            cycles = order * gear
            is_fine = cycles >= FINE and not has_few(scenes, joint, cycles)
            if is_fine and is_gone_through(cycles):
                yield {"order": order, "law": 0.0, "lag": 0.0}

        for law, lag, profile in _profiles(scenes, joint, residual):
            lowest = max(LOWEST, CYCLES_IN_RANGE / profile.span)
            fine_from = FINE_IN_RANGE / profile.span if slides else FINE
            few_waves_count = not slides and LAWS[law] != "direction"
            orders = [
                self._whole_if_as_good(profile, cycles / gear, gear)
                for cycles in peaks(profile, lowest, PEAKS)
            ]
            for order in dict.fromkeys(orders):
                cycles = order * gear
                is_clear = order == round(order) or cycles >= fine_from
                if cycles >= FINE and has_few(scenes, joint, cycles):
                    is_clear = False
                if not is_clear and few_waves_count:
                    is_clear = clearness(profile, lowest, cycles) > CLEAR
                is_turned = lag == 0.0 or cycles * lag * speed > TURNED
                if is_clear and is_turned and is_gone_through(cycles):
                    yield {"order": order, "law": float(law), "lag": lag}

    def shows(self, scenes: Scenes, joint: int, settings: Settings) -> bool:
        """Return whether the joint goes through enough waves below the cut-off."""
        cycles = settings["order"] * abs(float(scenes[0].gear[joint]))
        cutoff_hz = min(scene.motion.lowpass.cutoff_hz for scene in scenes)
        return goes_through(scenes, joint, cycles, cutoff_hz)

    def _whole_if_as_good(self, profile: Profile, order: float, gear: float) -> float:
        """Return a whole number of cycles per motor turn where it explains as much."""
        whole_order = float(round(order))
        if whole_order < 1.0:
            return order
        enough = WHOLE_IF_SPARSE if gear * profile.span > SPARSE else WHOLE
        is_as_good = profile.gain(whole_order * gear) >= enough * profile.gain(
            order * gear
        )
        return whole_order if is_as_good else order

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return sine and cosine of the angle, times the law's multiplier."""
        turn = "order * theta"
        if settings["lag"]:
            turn = "order * (theta - lag * gear * dq)"
        scale = SCALES[int(settings["law"])]
        law = Law(
            terms=(f"{scale}sin(turn)", f"{scale}cos(turn)"),
            parts={"turn": turn},
            numbers={**settings, "gear": float(gear_ratios(robot)[joint])},
        )
        return {joint: law}

    def values(
        self, robot: Robot, joint: int, settings: Settings, c: Array, covariance: Array
    ) -> list[Value]:
        """Return amplitude and phase of the ripple."""
        sine, _ = self.coefficients(settings)
        unit = robot.joints[joint].unit(sine.unit)
        return amplitude_and_phase("ripple", unit, c, covariance)


class _Candidate(NamedTuple):
    """The residual over the angle for one law and lag [s]."""

    law: int
    lag: float
    profile: Profile


def _profiles(
    scenes: Scenes, joint: int, residual: Sequence[Array]
) -> Iterator[_Candidate]:
    """Yield the residual over the angle for every law without lag.

    Law 0 follows at the lag that makes its lines clearest, if they are clear.
    """
    highest = highest_order(scenes, joint)
    r = [values[:, joint] for values in residual]

    def profile_of(law: int, lag: float) -> Profile | None:
        turns = [_angle(scene, joint, lag) / (2 * np.pi) for scene in scenes]
        multipliers = [multiplier(scene, joint, law) for scene in scenes]
        return Profile.of(turns, r, multipliers, highest)

    for law in range(len(LAWS)):
        profile = profile_of(law, 0.0)
        if profile is not None:
            yield _Candidate(law, 0.0, profile)

    best: _Candidate | None = None
    best_clearness = CLEAR
    for lag in LAGS_S:
        profile = profile_of(0, lag)
        if profile is None:
            continue
        clear = clearest(profile, FINE)
        if clear > best_clearness:
            best = _Candidate(0, lag, profile)
            best_clearness = clear
    if best is not None:
        yield best


def _angle(scene: Scene, joint: int, lag: float) -> Array:
    """Return the angle (N,) rad of a joint as it was `lag` seconds before."""
    return np.asarray(scene.angle[:, joint] - lag * scene.motion.dq[:, joint])


def multiplier(scene: Scene, joint: int, law: int) -> Array:
    """Return m (N,) of a law, by which the ripple scales."""
    match LAWS[law]:
        case "torque":
            return np.asarray(scene.modelled[:, joint])
        case "direction":
            return np.asarray(scene.sign[:, joint])
        case "load":
            return np.asarray(scene.load[:, joint])
    return np.ones(scene.samples)


def highest_order(scenes: Scenes, joint: int) -> float:
    """Return the most cycles per joint turn that can be told apart.

    Speed, sampling rate and encoder set the limit.
    """
    limits = [HIGHEST_OF_SLIDE if _slides(scenes[0], joint) else HIGHEST]
    for scene in scenes:
        speed = usual_speed(scene, joint)
        encoder_step = float(scene.motion.cutoff.encoder_step[joint])
        if encoder_step > 0.0:
            limits.append(1.0 / encoder_step)
        if speed > 0.0:
            resolved_hz = RESOLVED * scene.motion.rate_hz
            limits.append(resolved_hz * 2 * np.pi / max(speed, 1e-6))
    return min(limits)


def has_few(scenes: Scenes, joint: int, cycles: float) -> bool:
    """Return whether few waves, of so many per turn, are in the range of a joint.

    A slide has no turn: what is fine is counted in its range as it is.
    """
    if _slides(scenes[0], joint):
        return False
    return cycles * travel(scenes, joint) / (2 * np.pi) < FEWEST_IN_RANGE


def goes_through(scenes: Scenes, joint: int, cycles: float, highest_hz: float) -> bool:
    """Return whether a joint goes through enough fine waves at speeds that show them.

    A joint that is only shaken does not. Of few waves per turn it is their clearness
    that counts.

    Parameters
    ----------
    scenes : sequence of Scene
    joint : int
    cycles : float
        Waves per turn of the joint (per 2 pi m of a slide).
    highest_hz : float
        Waves per second from which on they do not show.
    """
    if cycles < FINE or _slides(scenes[0], joint):
        return True
    if travel(scenes, joint) < LEAST_TRAVEL:
        return False

    cycles_per_rad = cycles / (2 * np.pi)
    total = 0.0
    for scene in scenes:
        speed, way = _speeds(scene, joint)
        n_shown = np.searchsorted(speed, highest_hz / cycles_per_rad, side="right")
        total += cycles_per_rad * float(way[n_shown])
    return total >= FEWEST_WAVES


def _slides(scene: Scene, joint: int) -> bool:
    return bool(scene.robot.chain.prismatic[joint])


def usual_speed(scene: Scene, joint: int) -> float:
    """Return the speed that a joint exceeds in a quarter of the time that it moves.

    In rad/s; 0 if it never moves.
    """
    speed, _ = _speeds(scene, joint)
    return float(np.quantile(speed, 0.75)) if len(speed) else 0.0


def _speeds(scene: Scene, joint: int) -> tuple[Array, Array]:
    """Return speeds (K,) rad/s at which a joint moves, and ways (K + 1,) rad.

    Speeds ascend. The ways are those in the samples of the first few of them. They are
    kept with the scene: every line is asked for its waves.
    """
    key = ("speeds", joint)
    if key not in scene.memo:
        motion = scene.motion
        speed = np.sort(np.abs(motion.dq[motion.moving[:, joint], joint]))
        way = np.concatenate([[0.0], np.cumsum(speed)]) / motion.rate_hz
        scene.memo[key] = (speed, way)
    speed, way = scene.memo[key]
    return speed, way
