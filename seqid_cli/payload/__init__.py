"""What a robot carries: the body at its flange, from logs with it and a model without it."""

from seqid_cli.payload.functions import payload
from seqid_cli.payload.options import PayloadOptions

__all__ = ["PayloadOptions", "payload"]
