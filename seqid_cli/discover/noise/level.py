"""Torque noise of one joint as white and 1/f^a noise, and what of it a low-pass leaves.

A spectrum is fitted by Whittle's likelihood: P. Whittle, "Estimation and information in stationary
time series", Arkiv foer Matematik 2(5), 1953. What it leaves open is drawn: the densities w and c
of every exponent from the normal distribution of their estimates, none below zero, exponents by
their likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from seqid_cli.discover.noise.spectra import power_gain
from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array

Slid = Sequence[tuple[Motion, float]]  # motion of a log, and for how many seconds the joint slides

GRID = 400  # frequencies, over which a band is integrated
ROUNDS = 30
DRAWS = 2000
LEVEL = 0.95  # of the interval


@dataclass(frozen=True)
class Spectrum:
    """Two-sided densities (F,) N^2 m^2 / Hz of one joint's torque at frequencies (F,) Hz.

    `averaged` (F,) independent periodograms are behind each; `least` is the density that rounding
    the torque makes.
    """

    frequency: Array
    density: Array
    averaged: Array
    least: float = 0.0

    def beside(self, other: Spectrum) -> Spectrum:
        """Both logs' spectra of the same noise."""
        return Spectrum(
            np.concatenate([self.frequency, other.frequency]),
            np.concatenate([self.density, other.density]),
            np.concatenate([self.averaged, other.averaged]),
            max(self.least, other.least),
        )

    def within(self, low: float, high: float) -> Spectrum:
        """What lies between two frequencies, Hz."""
        kept = (self.frequency >= low) & (self.frequency <= high)
        parts = (self.frequency[kept], self.density[kept], self.averaged[kept])
        return Spectrum(*parts, self.least)

    @property
    def mean(self) -> tuple[float, float]:
        """Mean density, and its relative variance."""
        total = float(self.averaged.sum())
        return float(self.averaged @ self.density) / total, 1.0 / total


@dataclass(frozen=True)
class Shape:
    """Density w + c f^-a.

    `middle` (2,) are w and c as they are most likely without regard to their sign, `covariance`
    (2, 2) of these.
    """

    white: float  # N^2 m^2 / Hz
    flicker: float
    middle: Array
    covariance: Array
    exponent: float = 1.0

    def over(self, slid: Slid) -> tuple[Array, float]:
        """Mean squares (2,) per w and c, low-passed twice; relative variance in so short a time."""
        total = sum(seconds for _, seconds in slid)
        passed, scatter = np.zeros(2), 0.0
        for motion, seconds in slid:
            frequency, gain = _band(motion)
            colour = frequency**-self.exponent
            shapes = np.stack([gain, gain * colour])
            passed += seconds / total * np.trapezoid(shapes, frequency, axis=1)
            both = np.array([self.white, self.flicker]) @ shapes
            scatter += seconds / total**2 * float(np.trapezoid(both**2, frequency))
        mean = float(passed @ [self.white, self.flicker])
        return passed, scatter / mean**2 if mean > 0.0 else 0.0

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Values (K, 2) of w and c that may be, none below zero; K is `count` or somewhat less."""
        values = rng.multivariate_normal(self.middle, self.covariance, 8 * count, method="eigh")
        inside = values[np.all(values >= 0.0, axis=1)]
        return inside[:count] if len(inside) else np.array([[self.white, self.flicker]])


@dataclass(frozen=True)
class Level:
    """Shapes that the noise may have, the most likely first, and how likely each is (K,)."""

    shapes: tuple[Shape, ...]
    weights: Array

    @classmethod
    def known(cls, white: float) -> Level:
        """White noise of a known density, N^2 m^2 / Hz."""
        shape = Shape(white, 0.0, np.array([white, 0.0]), np.zeros((2, 2)))
        return cls((shape,), np.ones(1))

    def rms(self, slid: Slid, rng: np.random.Generator) -> tuple[float, float, float]:
        """RMS of the low-passed noise of some logs, and the ends of its 95 % interval, N m."""
        if not slid:
            return 0.0, 0.0, 0.0
        best, _ = self.shapes[0].over(slid)
        squares = []
        for shape, weight in zip(self.shapes, self.weights, strict=True):
            passed, scatter = shape.over(slid)
            mean = shape.drawn(max(1, round(DRAWS * weight)), rng) @ passed
            squares.append(mean * np.exp(np.sqrt(scatter) * rng.standard_normal(len(mean))))
        tail = 0.5 * (1.0 - LEVEL)
        low, high = np.sqrt(np.quantile(np.concatenate(squares), [tail, 1.0 - tail]))
        middle = float(np.sqrt(best @ [self.shapes[0].white, self.shapes[0].flicker]))
        return middle, min(float(low), middle), max(float(high), middle)


def level_of(
    spectrum: Spectrum, exponents: Sequence[float], *, clearly: float = 3.0, cost: float = 1.0
) -> Level:
    """White noise w and 1/f^a noise c f^-a by Whittle's likelihood.

    Parameters
    ----------
    spectrum : Spectrum
    exponents : sequence of float
        Values of a that may be.
    clearly : float
        Log-likelihood by which 1/f noise, or another exponent than the first, must be better to
        come first.
    cost : float
        Log-likelihood that a parameter more must gain (Akaike's criterion).
    """
    if not spectrum.density.any():
        return Level.known(spectrum.least)
    found = [_fitted(spectrum, a) for a in (None, *exponents)]
    lost = np.array([one for one, _ in found]) + cost * (np.arange(len(found)) > 0)
    best = 0
    for k in range(1, len(found)):
        best = k if found[best][0] - found[k][0] > clearly else best
    order = [best, *(k for k in range(len(found)) if k != best)]
    weights = np.exp(lost.min() - lost[order])
    return Level(tuple(found[k][1] for k in order), weights / weights.sum())


def _fitted(spectrum: Spectrum, exponent: float | None) -> tuple[float, Shape]:
    """Negative log-likelihood of white and 1/f^a noise, or of white noise alone; and the noise."""
    f, density, averaged = spectrum.frequency, spectrum.density, spectrum.averaged
    coloured = np.zeros_like(f) if exponent is None else f**-exponent
    columns = np.stack([np.ones_like(f), coloured], axis=1)
    c, fitted = _whittle(columns, density, averaged)
    scale = (np.sqrt(averaged) / fitted)[:, None]
    gram = (scale * columns).T @ (scale * columns)
    covariance = np.asarray(np.linalg.pinv(gram, hermitian=True), dtype=np.float64)
    middle = covariance @ ((scale * columns).T @ (scale[:, 0] * density))
    lost = float(averaged @ (np.log(fitted) + density / fitted))
    white = max(float(c[0]), spectrum.least)
    return lost, Shape(white, float(c[1]), middle, covariance, exponent or 0.0)


def _whittle(columns: Array, density: Array, averaged: Array) -> tuple[Array, Array]:
    """Coefficients (2,) >= 0 and the density (F,) that they give, by reweighted least squares."""
    tiny = 1e-9 * float(density.mean())
    shape = np.full_like(density, density.mean())
    for _ in range(ROUNDS):
        scale = np.sqrt(averaged) / shape
        c, _rest = nnls(columns * scale[:, None], density * scale)
        shape = np.maximum(columns @ c, tiny)
    return c, shape


def _band(motion: Motion) -> tuple[Array, Array]:
    """Frequencies (F,) Hz above zero, and the power of two passes there, both signs together."""
    top = min(0.5 * motion.rate_hz, 2.0 * motion.lowpass.cutoff_hz)
    frequency = np.geomspace(1.0 / motion.t[-1], top, GRID)
    return frequency, 2.0 * power_gain(motion.lowpass, frequency, 2)
