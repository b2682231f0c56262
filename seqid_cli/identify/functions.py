"""Every stage as a function: logs and a robot file in, the document out.

Logs are paths, folders, globs, URLs of object storage, tables in memory or recordings;
parameters are files or documents. Nothing is printed: what may be wrong comes as
`SeqidWarning`, what cannot be done as a subclass of `SeqidError`. Cheap checks come
before anything heavy is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

from msgspec.structs import replace

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.identify.inputs import Inputs, Models, imu_stage_for, prepare
from seqid_cli.identify.options import (
    FrictionOptions,
    Keywords,
    LogOptions,
    ParallelKeywords,
    PredictOptions,
    RigidOptions,
    SimultaneousOptions,
    documented,
)
from seqid_cli.identify.settings import (
    FrictionSettings,
    GravitySettings,
    ImuCalibSettings,
    InertiaSettings,
    JudgingSettings,
    PredictSettings,
    SimultaneousSettings,
)
from seqid_cli.logs.given import Logs, PathLike, optional, warn
from seqid_cli.params.document import (
    present,
    robot_id,
    stale_stages,
    used_settings,
    with_stage,
)
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.settings import Settings

if TYPE_CHECKING:
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.robot.types import Robot


@documented(ParallelKeywords)
def friction(
    logs: Logs,
    robot: PathLike | Robot,
    options: FrictionOptions = FrictionOptions(),
    *,
    settings: FrictionSettings = FrictionSettings(),
    **keywords: Unpack[ParallelKeywords],
) -> ParameterFile:
    """Identify joint friction over position and velocity (Eq. 7-11).

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Moves of one joint at a time at constant velocity.
    """
    inputs = prepare(logs, robot, (), options, **keywords)
    from seqid_cli.identify.friction_surface.stage import (
        identify_friction as identified,
    )

    def find(log_set: LogSet) -> Identified:
        stage = identified(log_set, inputs.robot, options=options, settings=settings)
        return Identified(Stages(friction=stage))

    return _added(inputs, find, settings, settings.judging)


@documented(ParallelKeywords)
def gravity(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: LogOptions = LogOptions(),
    *,
    settings: GravitySettings = GravitySettings(),
    **keywords: Unpack[ParallelKeywords],
) -> ParameterFile:
    """Identify the gravity parameters, given the friction (Eq. 12-19).

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Moves of one joint at a time at constant velocity, others locked in several
        configurations.
    parameters : path or ParameterFile, or a sequence of them
        With the friction stage.
    """
    inputs = prepare(logs, robot, parameters, options, needs=("friction",), **keywords)
    from seqid_cli.identify.rigid.gravity import identify_gravity as identified

    def find(log_set: LogSet) -> Identified:
        result = identified(log_set, inputs.robot, inputs.stages, settings)
        return Identified(
            Stages(gravity=result.gravity), Stages(friction=result.friction)
        )

    return _added(inputs, find, settings, settings.judging)


@documented(ParallelKeywords)
def imu_calib(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models = (),
    options: LogOptions = LogOptions(),
    *,
    settings: ImuCalibSettings = ImuCalibSettings(),
    **keywords: Unpack[ParallelKeywords],
) -> ParameterFile:
    """Find how IMUs sit on their links and what they are like (Eq. 29-38).

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Rotations of the first joint with the others locked in several configurations.
    robot : path or Robot
        The robot file, which names the IMUs.
    """
    inputs = prepare(logs, robot, parameters, options, **keywords)
    if not inputs.robot.imus:
        raise ConfigError(
            "the robot file names no IMU",
            where=str(inputs.robot.source),
            hint="Add an [[imu]] table with its accelerometers.",
        )
    from seqid_cli.identify.imu_calibration.calibrate import calibrate_imus
    from seqid_cli.motion.imu.array import layout_statements
    from seqid_cli.motion.options import MotionOptions

    def find(log_set: LogSet) -> Identified:
        for imu in inputs.robot.imus:
            for text in layout_statements(imu):
                log_set.tell("note", text=f"{imu.name}: {text}")
        filtering = MotionOptions(cutoff_hz=options.cutoff_hz)
        stage = calibrate_imus(
            log_set, inputs.robot, options=filtering, settings=settings
        )
        return Identified(Stages(imu=stage))

    return _added(inputs, find, settings, imus=True)


@documented(ParallelKeywords)
def inertia(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: RigidOptions = RigidOptions(),
    *,
    settings: InertiaSettings = InertiaSettings(),
    **keywords: Unpack[ParallelKeywords],
) -> ParameterFile:
    """Identify the inertia parameters, given friction and gravity (Eq. 22-26).

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Moves of two joints (or more) at a time.
    parameters : path or ParameterFile, or a sequence of them
        With the stages friction and gravity; with imu to use IMUs.
    """
    needs = ("friction", "gravity", *imu_stage_for(options.source))
    inputs = prepare(logs, robot, parameters, options, needs=needs, **keywords)
    from seqid_cli.identify.common_cutoff import identification_options
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.identify.rigid.cutoff_choice import InertiaTrial
    from seqid_cli.identify.rigid.inertia import identify_inertia
    from seqid_cli.identify.rigid.parameters import made_consistent

    def find(log_set: LogSet) -> Identified:
        arm = inputs.robot
        earlier_stages = inputs.stages
        trial = InertiaTrial(arm, earlier_stages, options.source, settings)
        motion = identification_options(
            inputs.logs,
            arm,
            options,
            earlier_stages.imu,
            trial,
            limits=settings.cutoff,
        )
        rigid = InertiaOptions(motion, options.source, settings=settings)
        result = identify_inertia(
            log_set, arm, earlier_stages, options=rigid, compare=True
        )
        stage = result.inertia
        if options.consistent:
            stage = made_consistent(stage, earlier_stages, arm)
        return Identified(Stages(inertia=stage), Stages(friction=result.friction))

    return _added(inputs, find, settings, settings.judging)


@documented(Keywords)
def simultaneous(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models = (),
    options: SimultaneousOptions = SimultaneousOptions(),
    *,
    settings: SimultaneousSettings = SimultaneousSettings(),
    **keywords: Unpack[Keywords],
) -> ParameterFile:
    """Identify everything in one classical least squares (Eq. 5-6).

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Any; they are read one after the other.
    parameters : path or ParameterFile, or a sequence of them
        With the imu stage to use IMUs.
    """
    needs = imu_stage_for(options.source)
    inputs = prepare(logs, robot, parameters, options, needs=needs, **keywords)
    from seqid_cli.identify.common_cutoff import identification_options
    from seqid_cli.identify.rigid.cutoff_choice import SimultaneousTrial
    from seqid_cli.identify.rigid.parameters import made_consistent
    from seqid_cli.identify.rigid.simultaneous import identify_simultaneous

    def find(log_set: LogSet) -> Identified:
        arm = inputs.robot
        imu = inputs.stages.imu
        trial = SimultaneousTrial(arm, imu, options.source, offset=options.offset)
        motion = identification_options(
            inputs.logs, arm, options, imu, trial, limits=settings.cutoff
        )
        friction, inertia = identify_simultaneous(
            log_set,
            arm,
            options=motion,
            imu=imu,
            source=options.source,
            offset=options.offset,
            settings=settings,
        )
        if options.consistent:
            inertia = made_consistent(inertia, Stages(), arm)
        return Identified(Stages(friction=friction, inertia=inertia))

    return _added(inputs, find, settings, settings.judging)


@documented(ParallelKeywords)
def predict(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: PredictOptions = PredictOptions(),
    *,
    settings: PredictSettings = PredictSettings(),
    torques: PathLike | None = None,
    **keywords: Unpack[ParallelKeywords],
) -> PredictionFile:
    """Predict joint torques and compare them with the measured ones.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Any logs with torque or current.
    parameters : path or ParameterFile, or a sequence of them
        Whatever has been identified.
    torques : path, optional
        Where the torques themselves go: as MCAP if it ends so, else Parquet.
    """
    target = optional(keywords.get("output"))
    table = optional(torques)
    if target is not None and table is not None and target.resolve() == table.resolve():
        message = "-o and --torques name the same file"
        raise UsageError(message, where=str(target), hint="Give them different names.")
    inputs = prepare(
        logs,
        robot,
        parameters,
        options,
        more_outputs=[table] if table else [],
        needs=imu_stage_for(options.source),
        **keywords,
    )
    if not present(inputs.stages):
        where = inputs.models[0][0] if inputs.models else ""
        raise ConfigError(
            "holds no stage at all", where=where, hint="Run seqid friction first."
        )
    from seqid_cli.identify.common_cutoff import inherited
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.identify.prediction.document import prediction_file
    from seqid_cli.identify.prediction.predict import predict as predicted

    motion = inherited(inputs.stages, options.cutoff_hz)
    log_set = LogSet.of(inputs)
    predictions = predicted(
        log_set,
        inputs.robot,
        inputs.stages,
        options=InertiaOptions(motion, options.source),
        unexplained=options.with_unexplained,
    )
    file = prediction_file(
        inputs,
        log_set,
        predictions,
        table,
        motion.origin,
        unexplained=options.with_unexplained,
        settings=settings,
    )
    if target is not None:
        write_json_atomic(target, file, inputs=inputs.sources)
    return file


class Identified(NamedTuple):
    """New stages, and earlier ones with what the logs of the new ones show of them."""

    stages: Stages
    improved: Stages = Stages()


def _added(
    inputs: Inputs,
    find: Callable[[LogSet], Identified],
    settings: Settings,
    judging: JudgingSettings = JudgingSettings(),
    *,
    imus: bool | None = None,
) -> ParameterFile:
    """Find new stages, judge them, and add them to earlier ones.

    `imus` is as of `LogSet.of`.
    """
    from seqid_cli.identify.judging import judged
    from seqid_cli.identify.log_set import LogSet

    logs = LogSet.of(inputs, imus=imus)
    identified = find(logs)
    improved = present(identified.improved)
    earlier_stages = replace(inputs.stages, **improved)

    noted: dict[str, Any] = {}
    for name in present(identified.stages):
        stage = getattr(identified.stages, name)
        notes = [*stage.notes, *logs.notes(stage.notes)]
        noted[name] = replace(stage, notes=notes, settings=used_settings(settings))
    judged_stages = judged(
        Stages(**noted), earlier_stages, inputs.robot, logs.verdicts(), limits=judging
    )
    new = present(judged_stages)

    for name in stale_stages(inputs.previous, tuple(new)):
        warn(f"the {name} stage rested on the old result and is left out: redo it")
    file = with_stage(
        inputs.previous,
        robot_id(inputs.robot),
        logs.inputs(next(iter(new))),
        improved,
        created=logs.created(inputs.documents),
        **new,
    )
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file
