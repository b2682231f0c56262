"""A short catalogue for tests of what a refinement does with given effects."""

from collections.abc import Iterator

import pytest

from tests.unit.effects.few import only_effects

# Friction over load, over speed and at reversals: each looks a little like the others.
ALIKE = (
    "load_dependent_friction",
    "presliding_hysteresis",
    "quadratic_drag",
    "stribeck",
)


@pytest.fixture
def few_effects() -> Iterator[None]:
    """Look for a few effects only: tests of the diagnosis tell each from all others."""
    with only_effects(ALIKE):
        yield
