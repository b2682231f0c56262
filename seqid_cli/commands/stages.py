"""What the stage commands have in common: identify, write, show, say what comes next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

from msgspec.structs import replace

from seqid_cli.commands.job import Account, Job, exit_code
from seqid_cli.commands.show import show_stages
from seqid_cli.params.document import present, robot_id, stale_stages, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import Stages, Verdict

if TYPE_CHECKING:
    from seqid_cli.commands.render import Screen
    from seqid_cli.inspect.report import Finding
    from seqid_cli.logs.recording import Recording

Identify = Callable[["Iterable[Recording]"], Stages]


def run_stage(
    job: Job, identify: Identify, *, strict: bool, following: str, imus: bool | None = None
) -> int:
    """Run a stage and deal with its result; returns the exit code.

    Parameters
    ----------
    job : Job
        The checked inputs.
    identify : callable
        From the recordings to the new stages alone.
    strict : bool
        Whether a poor verdict makes the exit code 1.
    following : str
        The command that comes next, with `{output}` and `{robot}` to fill in; it is not proposed
        after a poor verdict.
    imus : bool, optional
        Whether the readings of IMUs are used; by default where they are calibrated.
    """
    from seqid_cli.identify.judge import judged

    account = Account(job, imus=imus)
    found = _with_notes(identify(account), account)
    found = judged(found, job.previous, job.robot, account.findings)
    names = tuple(present(found))
    for name in stale_stages(job.previous, names):
        job.screen.warn(f"the {name} stage rested on the old result and is left out: redo it")
    file = with_stage(
        job.previous,
        robot_id(job.robot),
        account.inputs(names[0]),
        friction=found.friction,
        gravity=found.gravity,
        imu=found.imu,
        inertia=found.inertia,
    )
    if job.output is not None:
        write_json_atomic(job.output, file, inputs=[*job.files, *job.parameters])
    job.screen.document(file)
    show_stages(job.screen, found)
    poor = any(not verdict.good for verdict in stage_verdicts(found))
    tell_output(job, "" if poor else following)
    if poor:
        tell_remedies(job.screen, account.findings)
    return exit_code(untrusted=strict and poor, partial=account.incomplete)


def _with_notes(found: Stages, account: Account) -> Stages:
    stages = {
        name: replace(stage, notes=[*stage.notes, *account.notes(stage.notes)])
        for name in ("friction", "gravity", "imu", "inertia")
        if (stage := getattr(found, name)) is not None
    }
    return replace(found, **stages)


def tell_output(job: Job, following: str) -> None:
    """Say where the result went and which command to type next."""
    if job.output is None:
        job.screen.note("Nothing was written: give -o FILE to keep the result.")
        return
    job.screen.note(f"written: {job.output}")
    if following:
        command = following.format(output=job.output, robot=job.robot.source)
        job.screen.note(f"next: {command}")


def tell_remedies(screen: Screen, findings: Sequence[Finding]) -> None:
    """Say what to do after a poor verdict."""
    from seqid_cli.identify.log_verdicts import remedies

    for remedy in remedies(findings):
        screen.note(f"do: {remedy}")
    screen.note(
        "do: look at the reasons above and mend the logs or the robot file before going on"
        + ("" if findings else " (seqid inspect LOG... -r ROBOT looks closer)")
    )


def stage_verdicts(stages: Stages) -> list[Verdict]:
    """Return the verdicts of all stages."""
    parts = (stages.friction, stages.gravity, stages.imu, stages.inertia)
    return [verdict for part in parts if part is not None for verdict in part.verdicts]
