"""The body that a robot carries, from logs with it and a model without it.

`functions` hands the logs to `fit`, which identifies the body by least squares, and the
fit to `result`, which makes the document of it. `body` says how the numbers of a body
follow from the least squares, `controllers` how robot controllers write them.
"""

from seqid_cli.payload.functions import payload
from seqid_cli.payload.options import PayloadOptions

__all__ = ["PayloadOptions", "payload"]
