"""The low-pass cut-off, chosen from the log itself.

Differentiating the position twice multiplies its spectrum by omega^4. With encoder
noise of one-sided density n (rad^2/Hz, white) the noise power of the acceleration
inside a cut-off f is

    N(f) = n (2 pi)^4 f^5 / 5,

while the power of the true acceleration S(f) stops growing where the motion's bandwidth
ends. Noise in the acceleration shrinks a least-squares inertia by about N / (S + N):
the errors-in-variables bias. The cut-off maximises

    J(f) = log S(f) - KAPPA N(f) / S(f),

which stops where a further percent of information would cost more than 1 / KAPPA
percent of bias. With a fine encoder that is higher than the model reaches (elasticity,
ripple), so the cut-off also stays below ten times the motion's own bandwidth, the
frequency below which 99 percent of the velocity's power lies. A slow motion of many
joints in a short log needs more: the cut-off may be as high as leaves twice as many
independent samples of each joint's torque as a chain of so many links has inertial
parameters.

With motion from the smoother, N is the power of its error instead (see
`smoothed_error`). That is so small that J rises as long as the motion has content; the
cut-off is the lowest one within a percent of the highest J, for what lies above is
noise of the torque and nothing to learn from. It is never below that of the encoders,
beside which the smoother has nowhere more noise.
"""

import math
from dataclasses import dataclass

import numpy as np

from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.spectra import welch
from seqid_cli.typing import Array, Mask

KAPPA = 30.0
# Bounds of the cut-off.
LOWEST_HZ = 1.0
HIGHEST_HZ = 80.0
BANDWIDTHS = 10.0
# Bandwidth of white noise after two passes of the low-pass, over the cut-off.
NOISE_BANDWIDTH = 0.807


@dataclass(frozen=True)
class Cutoff:
    """The cut-off and what it was chosen from.

    Attributes
    ----------
    hz : float
    encoder_step : Array
        (n,) rad, the smallest step of each encoder.
    noise_density : Array
        (n,) rad^2/Hz of the positions' noise.
    alone_hz : float, optional
        The encoders' own choice where `hz` is another's.
    """

    hz: float
    encoder_step: Array
    noise_density: Array
    alone_hz: float | None = None

    @property
    def acceleration_noise(self) -> Array:
        """Standard deviation (n,) rad/s^2 of differentiated positions."""
        return np.asarray(np.sqrt(differentiated_error(self.noise_density, self.hz)))

    @property
    def above_own(self) -> bool:
        """True if it is another's choice, and higher than the encoders' own."""
        return self.alone_hz is not None and self.alone_hz < self.hz


def differentiated_error(density: Array | float, hz: float | Array) -> Array:
    """Return N(f): power of twice differentiated white noise below a cut-off.

    `density` in rad^2/Hz gives (rad/s^2)^2.
    """
    return np.asarray(density * (2 * np.pi) ** 4 * hz**5 / 5)


def smoothed_error(variance: Array, density: Array, hz: float) -> Array:
    """Return the power of the smoother's acceleration error below a cut-off.

    Above some f_c the IMUs make the error of the acceleration white of density s, below
    it the encoder holds it down to s (f / f_c)^4. Velocity and position then have the
    variances 4 s / (3 (2 pi)^2 f_c) and 4 s / (3 (2 pi)^4 f_c^3), from which f_c and s
    follow. No more than the smoother's whole error lies below a cut-off, and no more
    than the encoder alone would have.

    Parameters
    ----------
    variance : Array
        (n, 3), typical variance of the smoother's q, dq, ddq; infinite where the
        encoder is used instead.
    density : Array
        (n,), noise of the encoders [rad^2/Hz].
    hz : float
        Cut-off.

    Returns
    -------
    Array
        (n,) (rad/s^2)^2.
    """
    is_smoothed = np.asarray(np.isfinite(variance).all(axis=1))
    finite = np.where(is_smoothed[:, None], np.maximum(variance, 1e-300), 1.0)
    position, velocity, acceleration = finite.T
    s = 0.75 * 2 * np.pi * velocity * np.sqrt(velocity / position)
    error: Array = np.where(is_smoothed, np.minimum(acceleration, s * hz), np.inf)
    return np.minimum(error, differentiated_error(density, hz))


def encoder_step(q: Array) -> Array:
    """Return the smallest steps (n,) of positions (N, n) rad; zero if not quantised."""
    return np.array([step_of(position) for position in q.T])


def step_of(position: Array) -> float:
    """Return the smallest step of a joint's position (N,); zero if not quantised."""
    if is_continuous(position):
        return 0.0
    return step_between(np.unique(np.round(position, 10)))


def is_continuous(
    position: Array, *, window: int = 8192, min_levels: int = 2048, min_steps: int = 16
) -> bool:
    """Return whether a position (N,) has no steps, by what is within a few windows.

    Those are windows of its value, of about so many samples each. All samples within
    one are there, so that its smallest steps show as they do in all of the position,
    which takes much longer to sort. False where a window does not tell.
    """
    if len(position) < 4 * window:
        return False
    some = np.sort(position[:: len(position) // 1024])
    reach = round(0.5 * window / len(position) * len(some))
    for middle in (len(some) // 3, 2 * len(some) // 3):
        low = some[middle - reach]
        high = some[middle + reach]
        inside = position[(position >= low) & (position <= high)]
        levels = np.unique(np.round(inside, 10))
        if len(levels) < min_levels:
            return False
        smallest = _Smallest.of(levels)
        if len(smallest.counts) < min_steps or smallest.are_multiples:
            return False
    return True


def step_between(levels: Array) -> float:
    """Return the smallest step of a position with some levels (L,), in their order.

    Zero where the steps between them are no multiples of one.
    """
    steps = np.diff(levels)
    steps = steps[steps > 1e-9]
    if len(steps) < 3:
        return float(steps.min()) if len(steps) else 0.0
    smallest = _Smallest.of(levels)
    are_many = len(smallest.counts) > 0.3 * len(steps)
    return smallest.step if smallest.are_multiples and are_many else 0.0


@dataclass(frozen=True, kw_only=True)
class _Smallest:
    """The smallest step between levels, and `counts` of it in the other small ones.

    Noise that is not quantised also has a smallest step, but its other steps are no
    multiples of that.
    """

    step: float
    counts: Array

    @classmethod
    def of(cls, levels: Array) -> "_Smallest":
        """Look at levels (L,), in their order, of which three are apart or more."""
        steps = np.diff(levels)
        steps = steps[steps > 1e-9]
        smallest = float(np.median(steps[steps < 1.5 * steps.min()]))
        return cls(step=smallest, counts=steps[steps < 20 * smallest] / smallest)

    @property
    def are_multiples(self) -> bool:
        """Whether nearly all small steps are whole numbers of the smallest."""
        off = np.abs(self.counts - np.round(self.counts))
        return bool(np.mean(off < 0.1) > 0.9)


@dataclass(frozen=True, kw_only=True)
class NoiseShares:
    """How much of each joint's acceleration is noise below some cut-offs.

    Energies of logs add up. They are zero of joints that do not move.

    Attributes
    ----------
    acceleration : Array, shape (n, C)
        Energy of the measured motion, noise included [(rad/s^2)^2 s].
    acceleration_noise : Array, shape (n, C)
        Energy of its error.
    """

    acceleration: Array
    acceleration_noise: Array

    def __add__(self, other: "NoiseShares") -> "NoiseShares":
        return NoiseShares(
            acceleration=self.acceleration + other.acceleration,
            acceleration_noise=self.acceleration_noise + other.acceleration_noise,
        )

    def of_joints(self, which: Mask) -> "NoiseShares":
        """Return shares of `which` (n,) joints as those of all n, zero for others."""

        def of_all(values: Array) -> Array:
            result = np.zeros((len(which), values.shape[1]))
            result[which] = values
            return result

        return NoiseShares(
            acceleration=of_all(self.acceleration),
            acceleration_noise=of_all(self.acceleration_noise),
        )

    def of_acceleration(self) -> Array:
        """Return noise over motion (C,) of the joint with the worst acceleration."""
        return _worst_share(self.acceleration, self.acceleration_noise)


def _worst_share(measured: Array, noise: Array) -> Array:
    """Return the largest ratio (C,) of noise to true motion of moving joints (n, C)."""
    moves = measured[:, -1] > 0.0
    motion = np.maximum(measured[moves] - noise[moves], 1e-12 * measured[moves, -1:])
    # Power beyond the first point where noise takes over is noise, whatever its level.
    motion = np.maximum.accumulate(motion, axis=1)
    return np.asarray(np.max(noise[moves] / motion, axis=0, initial=0.0))


def noise_shares(
    frequency: Array,
    acceleration: Array,
    error: Array,
    cutoffs: Array,
    seconds: float,
) -> NoiseShares:
    """Return the energies of a motion and of its error below some cut-offs.

    Parameters
    ----------
    frequency : Array, shape (F,)
        Frequencies of the spectra [Hz].
    acceleration : Array, shape (n, F)
        One-sided spectral density of the measured acceleration [(rad/s^2)^2/Hz].
    error : Array, shape (n, C)
        Power of the acceleration's error below each cut-off [(rad/s^2)^2].
    cutoffs : Array, shape (C,)
        Cut-offs [Hz].
    seconds : float
        Length of the log [s].
    """

    def power(densities: Array) -> Array:
        return np.array(
            [power_below(frequency, density, cutoffs) for density in densities]
        )

    return NoiseShares(
        acceleration=seconds * power(acceleration),
        acceleration_noise=seconds * error,
    )


@dataclass(frozen=True, kw_only=True)
class Score:
    """J of the module's text for each of some cut-offs, summed over joints.

    Attributes
    ----------
    values : Array
        (C,) of J; above the Nyquist rate like the last below it.
    bandwidth_hz : float
        Of the motion.
    joints : int
        Number of joints that move.
    seconds : float
        Length of the log.
    shares : NoiseShares, optional
        Of all joints of the robot, or of those that were given.
    """

    values: Array
    bandwidth_hz: float
    joints: int
    seconds: float = math.inf
    shares: NoiseShares | None = None


def highest_of(
    bandwidth_hz: float,
    joints: int = 0,
    seconds: float = math.inf,
    *,
    per_parameter: float = 2.0,
) -> float:
    """Return the highest cut-off [Hz] for a motion.

    Parameters
    ----------
    bandwidth_hz : float
        Of the motion.
    joints : int
        Number of joints that move.
    seconds : float
        Length of the log.
    per_parameter : float
        Independent samples of a joint's torque per inertial parameter of the moving
        links that must be left.
    """
    # Low-passed noise has 2 B independent samples a second, B its bandwidth.
    n_samples = per_parameter * PER_LINK * joints
    needed_hz = n_samples / (2.0 * NOISE_BANDWIDTH * max(seconds, 1e-9))
    return max(BANDWIDTHS * bandwidth_hz, 2 * LOWEST_HZ, needed_hz)


def smoothed_score(
    dq: Array, ddq: Array, error: Array, rate_hz: float, cutoffs: Array
) -> Score:
    """Score cut-offs by the smoothed motion of the joints that move.

    Parameters
    ----------
    dq, ddq : Array
        (N, m) rad/s, rad/s^2.
    error : Array
        (C, m), power of the acceleration's error below each cut-off, as
        `smoothed_error` returns it.
    rate_hz : float
    cutoffs : Array
        (C,) Hz.
    """

    def spectra(values: Array, segment_s: int) -> tuple[Array, Array]:
        length = min(len(values), max(256, int(segment_s * rate_hz)))
        frequency, density = welch(values, rate_hz, length, centred=False)
        return frequency, density.T

    # J of each joint: information about its acceleration, less its bias.
    frequency, densities = spectra(ddq, 8)
    below = np.minimum(cutoffs, rate_hz / 2)
    values = np.zeros(len(cutoffs))
    for density, noise in zip(densities, error.T, strict=True):
        power = power_below(frequency, density, below)
        signal = np.maximum(power - noise, 1e-12)
        values += np.log(signal) - KAPPA * noise / signal
    shares = noise_shares(frequency, densities, error.T, below, len(ddq) / rate_hz)

    frequency, densities = spectra(dq, 20)
    bandwidths = [bandwidth_of(frequency, density, rate_hz) for density in densities]
    return Score(
        values=values,
        bandwidth_hz=max(bandwidths, default=0.0),
        joints=len(densities),
        shares=shares,
    )


def lowest_as_good(score: Array, joints: int, *, worth: float = 0.01) -> int:
    """Return the index of the lowest cut-off whose score is nearly the best.

    For smoothed motion: a higher cut-off must be `worth` more per joint.
    """
    best = score[first_maximum(score)]
    as_good = score >= best - worth * joints
    return int(np.flatnonzero(as_good)[0])


def power_below(frequency: Array, density: Array, cutoffs: Array) -> Array:
    """Return the power of a signal below each cut-off (C,) by its spectrum (F,)."""
    total = np.concatenate(([0.0], np.cumsum(density[1:] * frequency[1])))
    return np.asarray(np.interp(cutoffs, frequency, total))


def first_maximum(score: Array, *, clear_fall: float = 0.05) -> int:
    """Return the index of the best value before the first clear fall."""
    # A slow joint's quantisation is tones, not white noise; above the motion's
    # bandwidth they would count as signal and raise the score again.
    fallen = np.flatnonzero(score < np.maximum.accumulate(score) - clear_fall)
    if len(fallen):
        score = score[: fallen[0]]
    return int(np.argmax(score))


def bandwidth_of(
    frequency: Array,
    density: Array,
    rate_hz: float,
    *,
    step: float = 0.0,
    min_signal_to_noise: float = 10.0,
) -> float:
    """Return the bandwidth of a motion by the spectrum of its measured velocity.

    A position's white noise has, differentiated, a spectrum that rises with f^2. Its
    level is read off the top of the spectrum. The noise of a coarse encoder is not
    white but tones at the rate at which counts pass; all of them together have no more
    than the power of quantisation. The motion ends where an octave to either side holds
    hardly more than such noise can make: what lies above the first such place is noise,
    whatever its level.

    Parameters
    ----------
    frequency : Array, shape (F,)
        Evenly spaced frequencies from zero on [Hz].
    density : Array, shape (F,)
        One-sided spectral density of the velocity [(rad/s)^2/Hz].
    rate_hz : float
        Rate of the samples that the spectrum is of [Hz].
    step : float
        Step of the encoder [rad]; zero where the position is not quantised.
    min_signal_to_noise : float
        Power of such a band over that of the floor, from which on it holds motion [-].

    Returns
    -------
    float
        Frequency below which 99 percent of the motion's power lies [Hz].
    """
    shape = frequency**2
    top = frequency > 0.25 * rate_hz
    level = float(np.median(density[top] / shape[top]))
    floor = level * shape

    # An octave to either side: a line spectrum is empty between two of its lines.
    low = np.searchsorted(frequency, frequency / 2.0, side="left")
    high = np.searchsorted(frequency, frequency * 2.0, side="right")
    power = np.concatenate(([0.0], np.cumsum(density)))
    noise = np.concatenate(([0.0], np.cumsum(floor)))
    tones = (2.0 * np.pi * frequency) ** 2 * step**2 / 12.0 / frequency[1]
    most_noise = np.maximum(min_signal_to_noise * (noise[high] - noise[low]), tones)
    shows_motion = power[high] - power[low] > most_noise

    # The motion ends at the first silent place above its peak.
    peak = int(np.argmax(np.where(shows_motion, density, -1.0)))
    silent = np.flatnonzero(~shows_motion[peak:])
    end = len(frequency)
    if len(silent):
        end = peak + int(silent[0])
    end = max(1, end)
    motion = np.cumsum(np.maximum(density[:end] - floor[:end], 0.0))
    return float(frequency[np.searchsorted(motion, 0.99 * motion[-1])])
