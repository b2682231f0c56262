"""Whether what is left of a joint goes with its motion, or on as noise does whatever the arm does.

What a model lacks is strong in some states and weak in others: at speed, at reversals, far out. The
power of noise, coloured as it may be, knows nothing of them. The residual's power in short windows
is compared by rank with what the joint does there; how strong such a correlation is by chance,
between two series that both go on for a while, is told by surrogates: noise of the same spectrum
with random phases, with the same gaps (J. Theiler and others, "Testing for nonlinearity in time
series: the method of surrogate data", Physica D 58, 1992).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.stats import rankdata

from seqid_cli.discover.dependence import Dependence, dependence
from seqid_cli.discover.gates import quiet
from seqid_cli.discover.rows import SAMPLES_PER_CUTOFF, Rows
from seqid_cli.discover.search import Search
from seqid_cli.model.effects.scene import Scene

Array = NDArray[np.float64]
Index = NDArray[np.intp]

PERIODS = 2.0  # of the cut-off per window
FEWEST = 20  # windows
SURROGATES = 1000
CHANCE = 0.005  # of noise to be taken for what goes with the motion
MORE = 1.5  # times what they find in any surrogate, that they must find
LOOKS = 12  # surrogates that smooth functions look at, being slow
SEED = 1992


@dataclass(frozen=True)
class _Windows:
    """Windows of one scene: `sample` (K,) those that count, `of` (K,) the window of each."""

    sample: Index
    of: Index
    count: int

    def means(self, values: Array) -> Array:
        """Means (count,) of values (M,) over the samples that count."""
        return np.bincount(self.of, values[self.sample], self.count) / self._sizes

    @property
    def _sizes(self) -> Array:
        return np.bincount(self.of, minlength=self.count).astype(np.float64)


def goes_with_motion(rows: Rows, residual: Array, joint: int) -> bool:
    """Tell whether the power of a joint's residual depends on what the arm does.

    Parameters
    ----------
    rows : Rows
    residual : (M_j,) array
        Of the joint's rows, N m.
    joint : int

    Returns
    -------
    bool
        True as well where there is too little of it to tell.
    """
    own = rows.spread(joint, residual)
    windows = [_windows(r) for r in own]
    if sum(w.count for w in windows) < FEWEST:
        return True
    parts = zip(rows.scenes, rows.picked, own, windows, strict=True)
    states = np.concatenate([_states(s, at, r, w, joint) for s, at, r, w in parts if w.count])
    ranks = _standard(np.apply_along_axis(rankdata, 0, states))

    def strengths(series: Sequence[Array]) -> Array:
        power = [w.means(r**2) for r, w in zip(series, windows, strict=True) if w.count]
        return np.abs(_standard(rankdata(np.concatenate(power))) @ ranks)

    rng = np.random.default_rng(SEED)
    spectra = [np.abs(np.fft.rfft(r)) for r in own]
    noise = np.array([strengths(_drawn(own, spectra, rng)) for _ in range(SURROGATES)])
    middle, spread = noise.mean(axis=0), np.maximum(noise.std(axis=0), 1e-12)
    by_chance = np.max((noise - middle) / spread, axis=1)
    shown = float(np.max((strengths(own) - middle) / spread))
    return bool((1 + np.count_nonzero(by_chance >= shown)) / (1 + SURROGATES) <= CHANCE)


def beyond_chance(search: Search, found: Dependence) -> bool:
    """Tell whether a smooth function explains more than any does of noise of the same spectrum.

    Parameters
    ----------
    search : Search
        As it was when the dependence was found.
    found : Dependence
        With at least one rival.
    """
    system, joint = search.system(), found.joint
    own = [r[:, joint] for r in quiet(search.stage.rows, search.residual(system))]
    spectra = [np.abs(np.fft.rfft(r)) for r in own]
    rng = np.random.default_rng(SEED)
    for _ in range(LOOKS):
        noise = search.stage.rows.torque(joint, _drawn(own, spectra, rng))
        look = dependence(system.instead(joint, noise), joint, least_gain=0.0, most=1)
        if MORE * look.relative >= found.trials[0].relative:
            return False
    return True


def _windows(residual: Array) -> _Windows:
    """Windows of which at least half counts."""
    length = round(PERIODS * SAMPLES_PER_CUTOFF)
    sample = np.flatnonzero(residual)
    number, size = np.unique(sample // length, return_counts=True)
    full = number[2 * size >= length]
    kept = np.isin(sample // length, full)
    return _Windows(sample[kept], np.searchsorted(full, sample[kept] // length), len(full))


def _states(scene: Scene, at: Index, residual: Array, windows: _Windows, joint: int) -> Array:
    """What may go with the power (count, 7): of each window, how the arm moves there."""
    motion = scene.motion
    q, speed = motion.q[at, joint], np.abs(motion.dq[at])
    away = distance_transform_edt(residual != 0)
    values = (
        speed[:, joint],
        np.abs(motion.ddq[at, joint]),
        np.sum(speed / np.maximum(speed.max(axis=0), 1e-12), axis=1),
        np.abs(scene.rigid[at, joint]),
        q,
        np.abs(q - np.median(q)),
        np.minimum(away, float(SAMPLES_PER_CUTOFF)),
    )
    return np.stack([windows.means(x) for x in values], axis=1)


def _drawn(own: Sequence[Array], spectra: Sequence[Array], rng: np.random.Generator) -> list[Array]:
    """Noise of the same spectrum and gaps."""
    drawn = []
    for r, size in zip(own, spectra, strict=True):
        phase = np.exp(2j * np.pi * rng.random(len(size)))
        drawn.append(np.where(r != 0, np.fft.irfft(size * phase, n=len(r)), 0.0))
    return drawn


def _standard(values: Array) -> Array:
    """Columns of mean zero and unit length."""
    centred = values - values.mean(axis=0)
    return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=0), 1e-12))
