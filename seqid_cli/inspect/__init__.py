"""What is in a log and what is wrong with it, before anything is identified from it."""

from seqid_cli.inspect.functions import inspect

__all__ = ["inspect"]
