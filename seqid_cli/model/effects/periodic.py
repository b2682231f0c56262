"""Amplitude and phase of what was fitted as a sine and a cosine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Value

Array = NDArray[np.float64]


def amplitude_and_phase(
    c: Array, covariance: Array, unit: str, *, name: str = "ripple"
) -> list[Value]:
    """Turn c_0 sin(p) + c_1 cos(p) into A sin(p + phase), errors by the delta method.

    Parameters
    ----------
    c : (2,) array
    covariance : (2, 2) array
    unit : str
        Of c.
    name : str
        What the amplitude is of.
    """
    amplitude = float(np.hypot(c[0], c[1]))
    phase = float(np.arctan2(c[1], c[0]))
    scale = max(amplitude, 1e-300)
    slopes = np.array([[c[0], c[1]], [-c[1] / scale, c[0] / scale]]) / scale
    error = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    return [
        Value(f"{name}_amplitude", amplitude, float(error[0]), unit),
        Value(f"{name}_phase", phase, float(error[1]), "rad"),
    ]
