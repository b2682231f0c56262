"""What the stage commands have in common: call, show, say what comes next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from seqid_cli.commands.job import Told, any_poor, tell_output
from seqid_cli.commands.screen.show import show_stages
from seqid_cli.params.schema import ParameterFile, Stages


def show_stage(
    told: Told,
    file: ParameterFile,
    names: Sequence[str],
    *,
    output: Path | None,
    robot: Path,
    strict: bool,
    following: str,
) -> int:
    """Show new stages of a file; returns the exit code.

    Parameters
    ----------
    told : Told
        What listened to their identification.
    file : ParameterFile
    names : sequence of str
        The new stages.
    output : Path or None
        Where the file went.
    robot : Path
        The robot file.
    strict : bool
        Whether a poor verdict makes the exit code 1.
    following : str
        The command that comes next, with `{output}` and `{robot}` to fill in; it is not proposed
        after a poor verdict.
    """
    stages = Stages(**{name: getattr(file.stages, name) for name in names})
    told.screen.document(file)
    show_stages(told.screen, stages)
    verdicts = [v for name in names for v in getattr(stages, name).verdicts]
    tell_output(told.screen, output, robot, "" if any_poor(verdicts) else following)
    return told.ended(verdicts, strict=strict)
