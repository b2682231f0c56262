"""`seqid diagnose`: what a model lacks, with the evidence."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.evidence import evidence_entry, rival_entries
from seqid_cli.commands.job import Account, Job, exit_code, prepare
from seqid_cli.commands.options import (
    Clock,
    Cutoff,
    Logs,
    MotionSource,
    Output,
    Parameters,
    RobotPath,
    Strict,
    imu_stage_for,
    source_for_effects,
)
from seqid_cli.commands.render import screen_of
from seqid_cli.commands.show_diagnosis import show_diagnosis
from seqid_cli.commands.show_explained import show_explained
from seqid_cli.commands.show_motion import announced, show_motion
from seqid_cli.commands.stages import tell_output, tell_remedies
from seqid_cli.errors import UsageError
from seqid_cli.params.diagnosis_schema import (
    DIAGNOSIS_SCHEMA,
    ClosestEffect,
    DiagnosisFile,
    EffectParameter,
    EventEntry,
    FindingEntry,
    HiddenEntry,
    ResidualEntry,
    UnexplainedPart,
)
from seqid_cli.params.document import now, present, robot_id, tool
from seqid_cli.params.io import file_sha256, write_json_atomic
from seqid_cli.params.prediction_schema import FileId
from seqid_cli.params.schema import MotionUse

if TYPE_CHECKING:
    from seqid_cli.discover.results import (
        Diagnosis,
        Finding,
        JointResidual,
        Unexplained,
    )
    from seqid_cli.robot.types import Robot

Explain = Annotated[
    str | None,
    typer.Option(
        "--explain",
        metavar="JOINT",
        help="Tell of one joint what was tried there, what was taken and what was not, and why.",
    ),
]
EXAMPLES = (
    "seqid diagnose sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json -o diagnosis.json",
    "seqid diagnose sample_logs/six_joint/changed -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --strict --json",
)


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    motion: MotionSource = "auto",
    cutoff: Cutoff = None,
    time: Clock = "header",
    strict: Strict = False,
    explain: Explain = None,
) -> int:
    """Find out which physical effects a model lacks; any logs will do, nothing is changed.

    With --strict the exit code is 1 unless nothing is missing.
    """
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters,
        output=output,
        time_source=time,
        needs=("friction", "inertia", *imu_stage_for(motion)),
    )

    if explain is not None:
        _known(explain, job)

    from seqid_cli.discover.diagnosis import diagnose
    from seqid_cli.discover.gather import gather, one_each
    from seqid_cli.discover.options import DiscoverOptions
    from seqid_cli.identify.motion_use import motion_uses
    from seqid_cli.identify.one_cutoff import inherited
    from seqid_cli.identify.options import InertiaOptions

    options = DiscoverOptions(
        InertiaOptions(inherited(job.stages, cutoff), source=source_for_effects(motion))
    )
    account = Account(job)
    gathered = gather(
        announced(account, job.screen, job.stages.imu, motion),
        job.robot,
        job.stages,
        options=options.motion,
        paths=job.files,
        time_source=job.time_source,
    )
    found = diagnose(
        gathered.recordings, job.robot, job.stages, options=options, aside=gathered.aside
    )
    uses = motion_uses(one_each(gathered), job.robot, job.stages.imu, options=options.motion)
    said = (*gathered.notes(job.robot), *found.notes)
    found = replace(found, notes=(*said, *account.notes(said)))
    file = _document(job, account, found, uses)
    if job.output is not None:
        write_json_atomic(job.output, file, inputs=[*job.files, *job.parameters])
    job.screen.document(file)
    if explain is None:
        show_diagnosis(job.screen, file)
    else:
        show_explained(job.screen, file, explain)
    show_motion(job.screen, file.motion)
    tell_output(job, "")
    _tell_next(job, file)
    if file.verdicts:
        tell_remedies(job.screen, account.findings)
    missing = file.verdict != "nothing_missing" or bool(file.verdicts)
    return exit_code(untrusted=strict and missing, partial=account.partial)


def _known(joint: str, job: Job) -> None:
    names = job.robot.joint_names
    if joint not in names:
        raise UsageError(
            f"--explain names no joint of this robot: {joint!r}",
            where=str(job.robot.source),
            hint=f"Its joints are {', '.join(names)}.",
        )


def _tell_next(job: Job, file: DiagnosisFile) -> None:
    if file.verdict == "nothing_missing":
        return
    smooth = "" if file.findings else " --with-unexplained"
    given = " ".join(f"-p {path}" for path in job.parameters)
    job.screen.note(
        f"next: seqid refine LOG... --holdout LOG... -r {job.robot.source} {given}{smooth}"
        " -o refined.json"
    )


def _document(
    job: Job, account: Account, found: Diagnosis, motion: list[MotionUse]
) -> DiagnosisFile:
    from seqid_cli.identify.judge import physics_verdicts

    return DiagnosisFile(
        schema=DIAGNOSIS_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot_id(job.robot),
        inputs=account.inputs(),
        parameters=[FileId(path=str(p), sha256=file_sha256(p)) for p in job.parameters],
        stages=list(present(job.stages)),
        verdict=found.verdict,
        findings=[_finding(finding, job.robot) for finding in found.findings],
        unexplained=[_unexplained(part, job.robot) for part in found.unexplained],
        joints={name: _residual(joint) for name, joint in found.joints.items()},
        events=[
            EventEntry(log=event.log, start=event.start, end=event.end, joints=list(event.joints))
            for event in found.events
        ],
        hidden=[
            HiddenEntry(effect=item.effect, joint=item.joint, visible=item.visible)
            for item in found.hidden
        ],
        motion=motion,
        verdicts=[*physics_verdicts(job.stages, job.robot), *account.verdicts()],
        notes=list(found.notes),
    )


def _finding(finding: Finding, robot: Robot) -> FindingEntry:
    return FindingEntry(
        effect=finding.effect,
        joint=finding.joint,
        confidence=finding.confidence,
        name_confidence=finding.name_confidence,
        explains=finding.explains,
        confusable_with=list(finding.confusable_with),
        separate_by=finding.separate_by,
        gain=finding.gain,
        parameters=[
            EffectParameter(
                name=value.name, value=value.value, std_error=value.std_error, unit=value.unit
            )
            for value in finding.parameters
        ],
        settings=dict(finding.settings),
        note=finding.note,
        log_gain=finding.log_gain,
        evidence=evidence_entry(finding.evidence, robot),
        rivals=rival_entries(finding.rivals),
    )


def _unexplained(part: Unexplained, robot: Robot) -> UnexplainedPart:
    near = part.closest
    return UnexplainedPart(
        joint=part.joint,
        depends_on=list(part.depends_on),
        share=part.share,
        closest=ClosestEffect(effect=near.effect, share=near.share) if near else None,
        log_gain=part.log_gain,
        evidence=evidence_entry(part.evidence, robot),
        rivals=rival_entries(part.rivals),
    )


def _residual(joint: JointResidual) -> ResidualEntry:
    counted = joint.samples > 0  # else there is nothing to compute numbers from
    return ResidualEntry(
        rmse=joint.rmse if counted else None,
        noise_floor=joint.noise_floor if counted else None,
        noise_floor_interval=list(joint.noise_floor_interval) if counted else [],
        white=joint.white,
        rmse_explained=joint.rmse_explained if counted else None,
        samples=joint.samples,
        tried=rival_entries(joint.tried),
    )
