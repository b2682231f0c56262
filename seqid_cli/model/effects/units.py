"""Parameters of effects as they are reported, and their units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sized

    from seqid_cli.typing import Array

UNEXPLAINED = "unexplained"
UNTOLD = 1e29  # standard error, from which on no sample shows a parameter; files hold no larger


@dataclass(frozen=True)
class Value:
    """A parameter of an effect as it is reported: value, standard error, unit."""

    name: str
    value: float
    std_error: float
    unit: str


def smooth_in_words(coefficients: Sized, settings: Mapping[str, str | float | int | bool]) -> str:
    """Say on what a smooth term that no effect explains depends; its numbers tell nobody more."""
    quantities = ", ".join(str(settings.get("depends_on", "")).split())
    return f"a smooth function of {quantities}, {len(coefficients)} coefficients without errors"


def amplitude_and_phase(c: Array, covariance: Array, unit: str, *, name: str) -> list[Value]:
    """Turn c_0 sin(p) + c_1 cos(p) into A sin(p + phase), errors by the delta method."""
    import numpy as np  # help of commands names units

    amplitude = float(np.hypot(c[0], c[1]))
    phase = float(np.arctan2(c[1], c[0]))
    scale = max(amplitude, 1e-300)
    slopes = np.array([[c[0], c[1]], [-c[1] / scale, c[0] / scale]]) / scale
    error = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    return [
        Value(f"{name}_amplitude", amplitude, float(error[0]), unit),
        Value(f"{name}_phase", phase, float(error[1]), "rad"),
    ]
