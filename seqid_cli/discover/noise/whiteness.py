"""Whether a residual is no more than low-passed white noise.

Low-passing makes any noise coloured, so the residual is thinned to two samples per
period of the cut-off and freed of the correlation that the low-pass gives to white
noise, by the Cholesky factor of its covariance; gaps are no trouble for that. What is
left is uncorrelated under the hypothesis, and is tested by the squares of its
correlations at the first lags (Box and Pierce, Ljung and Box, "On a measure of lack of
fit in time series models", Biometrika 65(2), 1978), each from those pairs that are
there.

In shapes, K is the number of thinned rows of one joint in one log.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded
from scipy.special import chdtrc

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

    Parameters
    ----------
    rows : Rows
        The samples that are looked at.
    residual : sequence of (N, n) arrays
        What is left [N m; N where prismatic] per data set, low-passed twice.

    Returns
    -------
    (n,) mask
        False where the hypothesis is rejected, True where there are too few samples to.
    """
    p_values = [_p_value(rows, residual, joint) for joint in range(rows.n)]
    return np.array(p_values) >= FALSE_ALARM


def _p_value(rows: Rows, residual: Sequence[Array], joint: int) -> float:
    """Return the probability of correlations as large as these in a white residual."""
    products = np.zeros(LAGS)
    pairs = np.zeros(LAGS)
    for scene, samples, used, values in zip(
        rows.scenes, rows.samples, rows.used, residual, strict=True
    ):
        time, z = _whitened(scene.motion, samples, used[:, joint], values[:, joint])
        if len(z) <= LAGS:
            continue
        scaled = z / np.sqrt(max(float(np.mean(z**2)), 1e-300))
        of_log, pairs_of_log = _lagged_products(time, scaled)
        products = products + of_log
        pairs = pairs + pairs_of_log

    if pairs.min() < 2 * SAMPLES_PER_LAG:
        return 1.0
    n_lags = int(min(LAGS, pairs[0] // SAMPLES_PER_LAG))
    statistic = float(np.sum(products[:n_lags] ** 2 / pairs[:n_lags]))
    return float(chdtrc(n_lags, statistic))


def _whitened(
    motion: Motion, samples: Index, used: Mask, values: Array
) -> tuple[Index, Array]:
    """Thin a joint's rows, and free them of the correlation that the low-pass makes.

    Returns their times (K,) in steps of the thinned rows, and their values (K,).
    """
    spacing = int(np.min(np.diff(samples), initial=motion.samples))
    wanted = motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)
    thinning = max(1, int(wanted / spacing)) if motion.lowpass.active else 1

    row = samples // spacing
    chosen = samples[used & (row % thinning == 0)]
    stride = spacing * thinning
    time = chosen // stride
    if not len(time):
        return time, np.zeros(0)
    return time, _decorrelated(time, covariance(motion, stride), values[chosen])


def covariance(motion: Motion, stride: int) -> Array:
    """Return the covariance of unit white noise after both passes of the low-pass.

    It is that of samples (MEMORY,) that lie 0, 1, ... strides apart.
    """
    length = 2 * MEMORY * stride + 2
    frequency = np.fft.rfftfreq(length, 1.0 / motion.rate_hz).astype(np.float64)
    at_every_sample = np.fft.irfft(power_gain(motion.lowpass, frequency, 2), length)
    result: Array = at_every_sample[: MEMORY * stride : stride] / at_every_sample[0]
    # Where the low-pass leaves nothing, the matrix of covariances is nearly singular.
    result[0] += NUGGET
    return result


def _decorrelated(time: Index, covariances: Array, values: Array) -> Array:
    """Return innovations (K,) of values (K,) that their distance in time correlates."""
    bandwidth = min(MEMORY, len(time))
    band = np.zeros((bandwidth, len(time)))
    for offset in range(bandwidth):
        distance = time[offset:] - time[: len(time) - offset]
        is_correlated = distance < len(covariances)
        diagonal = band[offset, : len(distance)]
        diagonal[is_correlated] = covariances[distance[is_correlated]]
    lower = cholesky_banded(band, lower=True)
    return np.asarray(solve_banded((bandwidth - 1, 0), lower, values))


def _lagged_products(time: Index, z: Array) -> tuple[Array, Array]:
    """Return sums (LAGS,) of products at each distance in time, and their numbers."""
    in_time = np.full(time[-1] - time[0] + 1, np.nan)
    in_time[time - time[0]] = z
    products = np.zeros(LAGS)
    pairs = np.zeros(LAGS)
    for lag in range(1, LAGS + 1):
        of_pairs = in_time[lag:] * in_time[:-lag]
        products[lag - 1] = np.nansum(of_pairs)
        pairs[lag - 1] = np.count_nonzero(~np.isnan(of_pairs))
    return products, pairs
