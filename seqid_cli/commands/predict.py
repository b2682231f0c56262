"""`seqid predict`: how well a model explains the torque of some logs."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import Account, Job, exit_code, prepare
from seqid_cli.commands.options import (
    Clock,
    Cutoff,
    Engine,
    Jobs,
    Logs,
    MotionSource,
    Output,
    Parameters,
    RobotPath,
    Scheduler,
    SkipFailed,
    Strict,
    imu_stage_for,
)
from seqid_cli.commands.render import Screen, number, percent, screen_of
from seqid_cli.commands.show import verdict_text
from seqid_cli.commands.show_motion import announced, show_motion
from seqid_cli.commands.stages import tell_output, tell_remedies
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params.document import now, present, robot_id, tool
from seqid_cli.params.io import file_sha256, write_json_atomic
from seqid_cli.params.prediction_schema import (
    PREDICTION_SCHEMA,
    FileId,
    JointError,
    LogPredictionError,
    PredictionFile,
)
from seqid_cli.params.schema import Verdict
from seqid_cli.scale.options import Workers

if TYPE_CHECKING:
    from seqid_cli.commands.prediction_errors import ErrorSums, TorqueWriter
    from seqid_cli.export.torques_mcap import McapTorqueWriter
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.identify.prediction import LogPrediction

EXAMPLES = (
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json -o prediction.json",
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --torques torques.parquet --json",
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --torques torques.mcap",
)
# Above this share of the measured torque's RMS, a user should not rely on the prediction.
MAX_RELATIVE_RMSE = 0.3

Torques = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where the torques go: as MCAP if it ends so, else Parquet."),
]
WithUnexplained = Annotated[
    bool,
    typer.Option("--with-unexplained", help="Add the smooth terms that no known effect explains."),
]


def run(
    context: typer.Context,
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    torques: Torques = None,
    motion: MotionSource = "auto",
    cutoff: Cutoff = None,
    time: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    strict: Strict = False,
    with_unexplained: WithUnexplained = False,
) -> int:
    """Predict the joint torques of any logs and compare them with the measured ones.

    The error is given per joint over the samples in which it slides, in N m and relative to the RMS
    of the measured torque there. At rest friction is an interval: the error over all samples counts
    the distance to it.
    """
    if output is not None and torques is not None and output.resolve() == torques.resolve():
        message = "-o and --torques name the same file"
        raise UsageError(message, where=str(output), hint="Give them different names.")
    job = prepare(
        screen_of(context),
        logs,
        robot,
        parameters,
        output=output,
        more_outputs=[torques] if torques else [],
        time_source=time,
        workers=Workers(jobs, engine, scheduler, skip_failed),
        needs=imu_stage_for(motion),
    )
    there = present(job.stages)
    if not there:
        hint = "Run seqid friction first."
        raise ConfigError("holds no stage at all", where=str(parameters[0]), hint=hint)

    from seqid_cli.identify.one_cutoff import inherited
    from seqid_cli.identify.options import InertiaOptions

    options = InertiaOptions(motion=inherited(job.stages, cutoff), source=motion)
    account = Account(job)
    file = _predict(job, account, torques, options, unexplained=with_unexplained)
    if output is not None:
        write_json_atomic(output, file, inputs=[*job.files, *job.parameters])
    job.screen.document(file)
    _show(job.screen, file)
    if torques is not None:
        job.screen.note(f"written: {torques}")
    tell_output(job, "")
    poor = any(not verdict.good for verdict in file.verdicts)
    if poor:
        tell_remedies(job.screen, account.findings)
    return exit_code(untrusted=strict and poor, partial=account.incomplete)


def _predict(
    job: Job,
    account: Account,
    torques: Path | None,
    options: InertiaOptions,
    *,
    unexplained: bool,
) -> PredictionFile:
    from seqid_cli.commands.prediction_errors import ErrorSums
    from seqid_cli.identify.judge import as_a_whole, physics_verdicts
    from seqid_cli.identify.predict_logs import predict
    from seqid_cli.identify.prediction import lacking
    from seqid_cli.model.effects.fitted import effect_notes

    names = job.robot.joint_names
    overall = sliding = none = ErrorSums.none(len(names))
    logs = []
    told = effect_notes(job.stages, job.robot, unexplained=unexplained)
    told_logs = announced(account, job.screen, job.stages.imu, options.source)
    predictions = predict(
        told_logs, job.robot, job.stages, options=options, unexplained=unexplained
    )
    with contextlib.ExitStack() as stack:
        writer = stack.enter_context(_torque_writer(torques, names)) if torques else None
        own = slid = none
        for log in predictions:
            own = own + ErrorSums.of(log, sliding=False)
            slid = slid + ErrorSums.of(log, sliding=True)
            if writer is not None:
                writer.write(log)
            if log.last:
                logs.append(_log_error(log, _joints(own, slid, names)))
                overall, sliding = overall + own, sliding + slid
                own = slid = none
    joints = _joints(overall, sliding, names)
    used = list(present(job.stages))
    lacks = lacking(job.stages, job.robot)
    return PredictionFile(
        schema=PREDICTION_SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot_id(job.robot),
        inputs=account.inputs(),
        parameters=[FileId(path=str(p), sha256=file_sha256(p)) for p in job.parameters],
        stages=used,
        joints=joints,
        logs=logs,
        cutoff_origin=options.motion.origin or "chosen per log",
        verdicts=as_a_whole(
            [
                *(
                    _verdict(name, error, lacks.get(name, ()))
                    for name, error in joints.items()
                    if error.samples
                ),
                *physics_verdicts(job.stages, job.robot),
                *account.verdicts(),
            ]
        ),
        notes=[*told, *_notes(joints), *account.notes()],
    )


def _torque_writer(
    path: Path, names: tuple[str, ...]
) -> contextlib.AbstractContextManager[TorqueWriter | McapTorqueWriter]:
    if path.suffix.lower() == ".mcap":
        from seqid_cli.export.torques_mcap import McapTorqueWriter

        return McapTorqueWriter.open(path, names)
    from seqid_cli.commands.prediction_errors import TorqueWriter

    return TorqueWriter.open(path, names)


def _log_error(log: LogPrediction, joints: dict[str, JointError]) -> LogPredictionError:
    return LogPredictionError(
        path=str(log.path),
        sha256=log.sha256,
        samples=log.samples,
        cutoff_hz=log.cutoff_hz,
        joints=joints,
        notes=list(log.notes),
        motion=log.motion,
    )


def _joints(sums: ErrorSums, sliding: ErrorSums, names: tuple[str, ...]) -> dict[str, JointError]:
    return {
        name: JointError(
            rmse=sliding.rmse(index),
            relative_rmse=sliding.relative_rmse(index),
            max_abs=sliding.largest(index),
            samples=sliding.samples(index),
            rmse_all=sums.rmse(index),
            samples_all=sums.samples(index),
            share_sliding=_share(sliding.samples(index), sums.samples(index)),
        )
        for index, name in enumerate(names)
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _notes(joints: dict[str, JointError]) -> list[str]:
    still = [name for name, error in joints.items() if not error.samples]
    return [f"never slides in these logs and is not judged: {', '.join(still)}"] if still else []


def _verdict(name: str, error: JointError, lacks: Sequence[str]) -> Verdict:
    """A joint is poor where the model lacks something of it, or its error is too large."""
    share, reasons = error.relative_rmse, list(lacks)
    if share is None or share > MAX_RELATIVE_RMSE:
        limit = percent(MAX_RELATIVE_RMSE)
        reasons.append(f"the error is {percent(share)} of the torque's RMS, above {limit}")
    return Verdict(joint=name, good=not reasons, reason="; ".join(reasons))


def _show(screen: Screen, file: PredictionFile) -> None:
    rows = [
        (
            name,
            number(error.rmse),
            percent(error.relative_rmse),
            number(error.max_abs),
            percent(error.share_sliding),
            number(error.rmse_all),
            verdict_text(file.verdicts, name) if error.samples else "not judged",
        )
        for name, error in file.joints.items()
    ]
    columns = ("joint", "RMSE N m", "relative", "largest N m", "slides in", "all N m", "verdict")
    screen.table(columns, rows)
    for name in dict.fromkeys(verdict.joint for verdict in file.verdicts):
        if name not in file.joints:
            screen.result(f"{name or 'prediction'}: {verdict_text(file.verdicts, name)}")
    notes = [*file.notes, *(f"{log.path}: {note}" for log in file.logs for note in log.notes)]
    for note in notes:
        screen.remark(note)
    show_motion(screen, [log.motion for log in file.logs if log.motion is not None])
    used = sorted({number(log.cutoff_hz) for log in file.logs})
    screen.note(f"cut-off: {', '.join(used)} Hz, {file.cutoff_origin} (--cutoff overrides)")
    for log in file.logs:
        screen.detail(f"{log.path}: cut-off {number(log.cutoff_hz)} Hz")
