"""A short catalogue for tests of what a refinement does with given effects."""

import pytest

from seqid_cli.effects import registry

# Friction over load, over speed and at reversals: each looks a little like the others.
ALIKE = (
    "load_dependent_friction",
    "presliding_hysteresis",
    "quadratic_drag",
    "stribeck",
)


@pytest.fixture
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for a few effects only: tests of the diagnosis tell each from all others."""
    few = {name: registry.CATALOGUE[name] for name in ALIKE}
    monkeypatch.setattr(registry, "CATALOGUE", few)
