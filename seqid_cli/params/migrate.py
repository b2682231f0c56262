"""Older documents become the newest version, one step at a time, before they are checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Document = dict[str, object]
Migration = Callable[[Document], Document]

PARAMS_VERSION = 1
# From each older version: the function that turns it into the next. Version 1 is the oldest.
PARAMS_MIGRATIONS: Mapping[int, Migration] = {}


def migrate(
    document: Document, version: int, *, target: int, steps: Mapping[int, Migration]
) -> Document:
    """Apply the steps from `version` up to `target`.

    Raises
    ------
    LookupError
        No step leads on from one of the versions.
    """
    for current in range(version, target):
        document = steps[current](document)
    return document
