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

    `told`: what listened to their identification. `names`: the new stages. `output`: where the file
    went. `robot`: the robot file. `strict`: whether a poor verdict makes the exit code 1.
    `following`: the command that comes next, with `{output}` and `{robot}` to fill in; it is not
    proposed after a poor verdict.
    """
    stages = Stages(**{name: getattr(file.stages, name) for name in names})
    told.screen.document(file)
    show_stages(told.screen, stages)
    verdicts = [v for name in names for v in getattr(stages, name).verdicts]
    tell_output(told.screen, output, robot, "" if any_poor(verdicts) else following)
    return told.ended(verdicts, strict=strict)
