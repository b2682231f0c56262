"""The function `inspect`: logs in, the document out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from seqid_cli.errors import UsageError
from seqid_cli.inspect.progress import Progress
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.given import Logs, PathLike, expanded, is_place, listed, optional
from seqid_cli.logs.reading import ALL, LogPart, Reading
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.robot.file import load_robot

if TYPE_CHECKING:
    from seqid_cli.logs.reading import TimeSource
    from seqid_cli.robot.types import Robot


def inspect(
    logs: Logs,
    robot: PathLike | Robot | None = None,
    *,
    settings: InspectSettings = InspectSettings(),
    time_source: TimeSource = "header",
    part: LogPart = ALL,
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
    settings : InspectSettings
        Numbers that decide; `seqid inspect --show-settings` lists them.
    time_source : {"header", "log"}
        Which stamps of an MCAP log count.
    part : LogPart
        The part of each log that is looked at; all of it by default.
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

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    files = _files(logs)
    output_path = optional(output)
    robot_path = Path(robot) if is_place(robot) else None  # type: ignore[arg-type]
    if output_path is not None:
        sources = files if robot_path is None else [*files, robot_path]
        check_output(output_path, sources)
    if plan is not None and robot is None:
        raise UsageError("--plan needs the robot file", hint="Give it with -r.")
    arm = robot if robot_path is None else load_robot(robot_path)

    # Imported here because it imports numpy: a mistake in the arguments is told first.
    from seqid_cli.inspect.inspection import inspect_logs

    reading = Reading(time_source=time_source, part=part)
    report = inspect_logs(
        files,
        arm,  # type: ignore[arg-type]
        settings=settings,
        reading=reading,
        on_progress=on_progress,
    )
    if plan is not None:
        from seqid_cli.inspect.planned import recorded_parts

        parts = recorded_parts(
            Path(plan),
            arm,  # type: ignore[arg-type]
            files,
            reading,
            settings,
        )
        report = structs.replace(report, planned=parts)
    if output_path is not None:
        write_json_atomic(output_path, report, inputs=files)
    return report


def _files(logs: Logs) -> Sequence[Path]:
    """Return the files of logs; raise UsageError for a recording, which has none."""
    places = expanded(listed(logs))
    files = [log for log in places if isinstance(log, Path)]
    if len(files) < len(places):
        raise UsageError(
            "a recording has been read already", hint="Give its path or its table."
        )
    return files
