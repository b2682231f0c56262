"""Whether a residual is no more than low-passed white noise.

Low-passing makes any noise coloured, so the residual is thinned to two samples per
period of the cut-off and freed of the correlation that the low-pass gives to white
noise, by the Cholesky factor of its covariance; gaps are no trouble for that. What is
left is uncorrelated under the hypothesis, and is tested by the squares of its
correlations at the first lags (Box and Pierce, Ljung and Box, "On a measure of lack of
fit in time series models", Biometrika 65(2), 1978), each from those pairs that are
there.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded
from scipy.stats import chi2

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.torque_noise import power_gain
from seqid_cli.typing import Array, Index, Mask

FALSE_ALARM = 0.01  # share of white residuals that are called coloured
LAGS = 20
SAMPLES_PER_LAG = 20  # with fewer, the statistic's tail is heavier than chi-square
SAMPLES_PER_CUTOFF = 2.0
MEMORY = 40  # samples beyond which the low-pass has no correlation left
NUGGET = 1e-6


def white(rows: Rows, residual: Sequence[Array]) -> Mask:
    """Test every joint's residual for being low-passed white noise.

    `residual` (N, n) N m per data set, low-passed twice; only samples that count are
    looked at. Returns (n,): False where the hypothesis is rejected, True where there
    are too few samples to.
    """
    return np.array([_p_value(rows, residual, j) for j in range(rows.n)]) >= FALSE_ALARM


def _p_value(rows: Rows, residual: Sequence[Array], joint: int) -> float:
    """Probability of correlations as large as these in a white residual."""
    product, pairs = np.zeros(LAGS), np.zeros(LAGS)
    for scene, at, used, values in zip(
        rows.scenes, rows.picked, rows.used, residual, strict=True
    ):
        time, z = _whitened(scene.motion, at, used[:, joint], values[:, joint])
        if len(z) > LAGS:
            more, count = _lagged(time, z / np.sqrt(max(float(np.mean(z**2)), 1e-300)))
            product, pairs = product + more, pairs + count
    if pairs.min() < 2 * SAMPLES_PER_LAG:
        return 1.0
    lags = int(min(LAGS, pairs[0] // SAMPLES_PER_LAG))
    product, pairs = product[:lags], pairs[:lags]
    return float(chi2.sf(float(np.sum(product**2 / pairs)), lags))


def _whitened(
    motion: Motion, at: Index, used: Mask, values: Array
) -> tuple[Index, Array]:
    """Steps in time (K,) of the thinned rows, and their values (K,) without the low-pass."""
    apart = int(np.min(np.diff(at), initial=motion.samples))
    wanted = motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)
    thin = max(1, int(wanted / apart)) if motion.lowpass.active else 1
    row = at // apart
    chosen = at[used & (row % thin == 0)]
    time = chosen // (apart * thin)
    if not len(time):
        return time, np.zeros(0)
    return time, _decorrelated(time, covariance(motion, apart * thin), values[chosen])


def covariance(motion: Motion, stride: int) -> Array:
    """Covariance (MEMORY,) of unit white noise after both passes, every `stride` samples apart."""
    length = 2 * MEMORY * stride + 2
    frequency = np.fft.rfftfreq(length, 1.0 / motion.rate_hz).astype(np.float64)
    whole = np.fft.irfft(power_gain(motion.lowpass, frequency, 2), length)
    result: Array = whole[: MEMORY * stride : stride] / whole[0]
    result[0] += NUGGET
    return result


def _decorrelated(time: Index, covariances: Array, values: Array) -> Array:
    """Innovations (K,) of values at times (K,), whose covariance depends on their distance."""
    reach = min(MEMORY, len(time))
    band = np.zeros((reach, len(time)))
    for k in range(reach):
        apart = time[k:] - time[: len(time) - k]
        known = apart < len(covariances)
        band[k, : len(apart)][known] = covariances[apart[known]]
    lower = cholesky_banded(band, lower=True)
    return np.asarray(solve_banded((reach - 1, 0), lower, values))


def _lagged(time: Index, z: Array) -> tuple[Array, Array]:
    """Sums (LAGS,) of products at each distance in time, and their numbers."""
    place = np.full(time[-1] - time[0] + 1, np.nan)
    place[time - time[0]] = z
    product, pairs = np.zeros(LAGS), np.zeros(LAGS)
    for lag in range(1, LAGS + 1):
        both = place[lag:] * place[:-lag]
        product[lag - 1] = np.nansum(both)
        pairs[lag - 1] = np.count_nonzero(~np.isnan(both))
    return product, pairs
