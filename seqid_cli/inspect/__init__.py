"""Content and faults of logs, before anything is identified from them."""

from seqid_cli.inspect.functions import inspect
from seqid_cli.inspect.settings import InspectSettings

__all__ = ["InspectSettings", "inspect"]
