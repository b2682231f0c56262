"""What a robot carries: the body at its flange, from logs with it and a model without it."""

from seqid_cli.payload.functions import PayloadOptions, payload

__all__ = ["PayloadOptions", "payload"]
