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
from seqid_cli.drive.search import Solution, solved_at
from seqid_cli.drive.slopes import slopes_over_delays
from seqid_cli.typing import Array

# A held command takes effect where the controller looks next [s]: half a step of a fast
# one. It bends the speed between two rows, which looks like a lag of a part of a row.
LATE_S = 1e-4
LATE_ROWS = 0.02
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
    if law.course == "held":
        variances += _of_steps(law, names, solution)
    return np.sqrt(variances)


def _of_steps(law: JointLaw, names: Sequence[str], solution: Solution) -> Array:
    """Return what steps between rows move gains and delays by, squared (p + 2,)."""
    late_s = float(np.hypot(LATE_S, LATE_ROWS / law.logs[0].rate_hz))
    squares = np.full(len(names) + 2, late_s**2)
    squares[: len(names)] = 0.0
    # The whole time is off, or the motion against the command alone.
    for move in ({"command": late_s}, {"torque": late_s, "command": -late_s}):
        moved = solved_at(law, names, solution.delays.moved(**move))
        if moved is not None:
            squares[: len(names)] += (moved.theta - solution.theta) ** 2
    return squares


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
