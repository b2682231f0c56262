"""Logs whose torque says nothing about the model are left out, and said to be."""

from collections.abc import Iterable

from seqid_cli.errors import InputError
from seqid_cli.logs.checks.echo import REMEDY, WARNING, echoes
from seqid_cli.logs.pieces import by_log
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.types import Robot


def usable_logs(
    recordings: Iterable[Recording], robot: Robot
) -> tuple[list[Recording], tuple[str, ...]]:
    """Leave out logs whose torque is an echo of the command (see `logs.checks.echo`).

    A log that comes in pieces is one if half of these are. Returns what is left, and a note on
    every log that was left out. Raises InputError: nothing is left.
    """
    kept: list[Recording] = []
    left_out: list[tuple[str, str]] = []
    for pieces in by_log(recordings):
        every = [echoes(robot, x.t, x.q, x.tau, x.valid) for x in pieces if x.tau is not None]
        echoed = [", ".join(robot.joint_names[j] for j in found) for found in every if len(found)]
        if 2 * len(echoed) >= len(pieces) and echoed:
            left_out.append((str(pieces[0].path), echoed[0]))
        else:
            kept += pieces
    if left_out and not kept:
        path, first = left_out[0]
        others = f" (and {len(left_out) - 1} more logs)" if len(left_out) > 1 else ""
        raise InputError(f"joint {first}: {WARNING}{others}", where=path, hint=REMEDY)
    return kept, tuple(f"{p} is left out: joint {j}: {WARNING}; {REMEDY}" for p, j in left_out)
