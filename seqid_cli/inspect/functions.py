"""Inspection as a function: logs in, the document out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from seqid_cli.errors import UsageError
from seqid_cli.inspect.progress import Progress
from seqid_cli.logs.given import Logs, PathLike, expanded, is_place, listed, optional
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.logs.raw import TimeSource
    from seqid_cli.robot.types import Robot


def inspect(
    logs: Logs,
    robot: PathLike | Robot | None = None,
    *,
    time_source: TimeSource = "header",
    plan: PathLike | None = None,
    output: PathLike | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> InspectionFile:
    """Inspect logs: their content, their faults, and the remedies.

    Parameters
    ----------
    logs : path or table, or a sequence of them
        Logs of any format that can be read.
    robot : path or Robot, optional
        Torque and IMUs are compared with its geometry; joints are guessed without it.
    time_source : {"header", "log"}
        Which stamps of an MCAP log count.
    plan : path, optional
        A plan file: which of its moves are recorded goes into `planned`.
    output : path, optional
        Where the inspection goes.
    on_progress : callable, optional
        Given a `Progress` before each log.

    Returns
    -------
    InspectionFile
        A log that cannot be read is in it with the finding `unreadable`.
    """
    found, target = expanded(listed(logs)), optional(output)
    files = [log for log in found if isinstance(log, Path)]
    if len(files) < len(found):
        raise UsageError(
            "a recording has been read already", hint="Give its path or its table."
        )
    if target is not None:
        check_output(target, [*files, *([Path(robot)] if is_place(robot) else [])])  # type: ignore[arg-type]
    if plan is not None and robot is None:
        raise UsageError("--plan needs the robot file", hint="Give it with -r.")
    arm = load_robot(Path(robot)) if is_place(robot) else robot  # type: ignore[arg-type]
    from seqid_cli.inspect.inspection import inspect_logs

    report = inspect_logs(files, arm, time_source=time_source, on_progress=on_progress)  # type: ignore[arg-type]
    if plan is not None:
        from seqid_cli.inspect.planned import recorded_parts

        parts = recorded_parts(Path(plan), arm, files, time_source)  # type: ignore[arg-type]
        report = structs.replace(report, planned=parts)
    if target is not None:
        write_json_atomic(target, report, inputs=files)
    return report
