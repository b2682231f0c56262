"""Standard errors of a fit by rows.

They are those of Gauss-Newton with the delays as unknowns beside the gains (J), and
what is left over (r) is no white noise: with its covariance R,

    cov = (J' J)^-1 J' R J (J' J)^-1.

R is read off what is left: its correlation over time, up to `ALIKE_S`. That takes all
rows together, and is much surer than the scatter of the few blocks that a log has. What
is left is not alike everywhere, though: where a joint turns round, rows miss how its
speed bends. So the scatter over short stretches is looked at as well, and the larger
one of both counts.
"""

from collections.abc import Sequence

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from seqid_cli.drive.equations import ALIKE_S, Equations, JointLaw
from seqid_cli.drive.search import Solution
from seqid_cli.drive.slopes import slopes_over_delays
from seqid_cli.typing import Array

# A controller acts in steps of its own: half a step of a fast one [s].
LATE_S = 1e-4
# Between two rows a step bends the speed, which looks like a lag of a part of a row.
LATE_ROWS = 0.01
# Stretches of time, longer than the filter's memory, in which a motion bends once [s].
BEND_S = 0.2
# Lags up to this share of the longest count in full, those beyond less and less.
IN_FULL = 0.5


def row_errors(law: JointLaw, names: Sequence[str], solution: Solution) -> Array:
    """Return standard errors (p + 2,) of gains and delays, the lag's last."""
    equations = law.equations(names, solution.delays)
    slopes = slopes_over_delays(law, names, solution.theta, solution.delays, equations)
    J = np.hstack([equations.X, slopes])
    left = equations.y - equations.X @ solution.theta

    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    J = J / scale
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-10)
    p = J.shape[1]
    of_scores = (_of_scores(J, left, equations), _of_bends(J, left, equations))
    each = [np.diag(inverse @ scores @ inverse) for scores in of_scores]
    variances = np.zeros(len(names) + 2)
    variances[:p] = np.maximum(*each) / scale**2
    variances += solution.spread
    variances[-2:] += _of_steps(law)
    return np.sqrt(variances)


def _of_steps(law: JointLaw) -> Array:
    """Return what steps of commands and of the controller do to both delays (2,) [s^2].

    Gains are right all the same: the lag takes all of it.
    """
    log = law.logs[0]
    if law.course != "held":
        return np.array([0.0 if log.measured else LATE_S**2, 0.0])
    lag_s = LATE_ROWS / log.rate_hz
    return np.array([LATE_S**2 + lag_s**2, lag_s**2])


def _of_bends(J: Array, left: Array, equations: Equations) -> Array:
    """Return the same (p, p) from the scatter over short stretches of time."""
    length = max(1, round(BEND_S * equations.rate_hz))
    scores = np.zeros((int(equations.at[-1]) // length + 1, J.shape[1]))
    np.add.at(scores, equations.at // length, J * left[:, None])
    n = max(J.shape[1] + 1, np.count_nonzero(scores.any(axis=1)))
    return np.asarray(scores.T @ scores * (n / (n - J.shape[1])))


def _of_scores(J: Array, left: Array, equations: Equations) -> Array:
    """Return J' R J (p, p), R the covariance of what is left over (M,)."""
    lags = max(2, round(ALIKE_S * equations.rate_hz))
    n = int(equations.at[-1]) + 1
    size = next_fast_len(n + lags, real=True)

    def on_grid(values: Array) -> Array:
        grid = np.zeros((n, *values.shape[1:]))
        grid[equations.at] = values
        return np.asarray(rfft(grid, size, axis=0))

    def correlation(values: Array) -> Array:
        spectrum = on_grid(values)
        return np.asarray(irfft((spectrum * spectrum.conj()).real, size)[:lags])

    pairs = np.maximum(correlation(np.ones(len(left))), 1.0)
    gamma = correlation(left) / pairs
    lag = np.arange(lags) / lags
    gamma *= np.clip((1.0 - lag) / (1.0 - IN_FULL), 0.0, 1.0)
    symmetric = np.zeros(size)
    symmetric[:lags] = gamma
    symmetric[size - lags + 1 :] = gamma[:0:-1]
    density = np.maximum(rfft(symmetric).real, 0.0)
    # A fit takes away of what is left: so many numbers of so many independent rows.
    independent = len(left) * gamma[0] ** 2 / max(float(symmetric @ symmetric), 1e-300)
    share = min(0.5, J.shape[1] / max(independent, 1.0))

    spectrum = on_grid(J)
    twice = np.full(len(density), 2.0)
    twice[0] = 1.0
    if size % 2 == 0:
        twice[-1] = 1.0
    weighted = spectrum.conj() * (twice * density / size)[:, None]
    return np.asarray((weighted.T @ spectrum).real / (1.0 - share))
