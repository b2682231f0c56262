"""The base of all structures of the result files."""

from __future__ import annotations

import msgspec


class FrozenStruct(
    msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=False, frozen=True
):
    """Base of structures that never change, and so can be in a set."""


class Struct(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=False):
    """Base of all file structures: an unknown key is an error that names its path."""
