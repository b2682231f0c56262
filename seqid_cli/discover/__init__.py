"""What a model cannot explain: find it, trace it to an effect, add it, prove it."""

from seqid_cli.discover.functions import diagnose, refine
from seqid_cli.discover.options import DiagnoseOptions, RefineOptions
from seqid_cli.discover.settings import DiscoverSettings

__all__ = ["DiagnoseOptions", "DiscoverSettings", "RefineOptions", "diagnose", "refine"]
