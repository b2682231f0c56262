"""Content and faults of logs, before anything is identified from them."""

from seqid_cli.inspect.functions import inspect

__all__ = ["inspect"]
