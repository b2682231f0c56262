"""Identified models in the forms that other tools read."""

from seqid_cli.export.functions import export

__all__ = ["export"]
