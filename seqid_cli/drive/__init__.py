"""The controllers of the joints, from what they were asked for and what came of it.

Data flow one way, in the order in which `functions` calls: `signals` filters the
channels of a log alike, `equations` writes a controller's law as linear equations,
`fit` solves them with a search for delays, `rollouts` simulates each joint in windows
of its logs for what rows cannot tell, `result` makes the document. `replaying` takes it
back to logs: `simulation` steps arm, friction and controllers in closed loop, `windows`
compares it with the logs and with simpler guesses.
"""

from seqid_cli.drive.functions import drive
from seqid_cli.drive.options import DriveOptions, ReplayOptions
from seqid_cli.drive.replaying import replay

__all__ = ["DriveOptions", "ReplayOptions", "drive", "replay"]
