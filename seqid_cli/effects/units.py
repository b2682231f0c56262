"""Parameters of effects as they are reported, and their units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sized

UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Value:
    """A parameter of an effect as it is reported: value, standard error, unit."""

    name: str
    value: float
    std_error: float
    unit: str


def smooth_in_words(
    coefficients: Sized, settings: Mapping[str, str | float | int | bool]
) -> str:
    """Say on what a smooth term that no effect explains depends.

    Its coefficients would tell a reader nothing.
    """
    quantities = ", ".join(str(settings.get("depends_on", "")).split())
    return (
        f"a smooth function of {quantities}, {len(coefficients)} coefficients without"
        " errors"
    )
