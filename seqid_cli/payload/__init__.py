"""The body that a robot carries, from logs with it and a model without it.

Data flow one way, in the order in which `functions` calls: `rows` makes equations of
the logs, `fit` solves them, `body` finds the body that is nearest to the solution,
`verdicts` judge it, and `result` makes the document, with the body in the words of
robot controllers (`controllers`).
"""

from seqid_cli.payload.functions import payload
from seqid_cli.payload.options import PayloadOptions

__all__ = ["PayloadOptions", "payload"]
