"""A short catalogue, for tests of what is done with the effects that are found."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from seqid_cli.effects import registry


@contextmanager
def only_effects(names: Sequence[str]) -> Iterator[None]:
    """Let a refinement look for a few effects only."""
    few = {name: registry.CATALOGUE[name] for name in names}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "CATALOGUE", few)
        yield
