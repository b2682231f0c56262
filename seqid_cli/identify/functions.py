"""Every stage as a function: logs and a robot file in, the document out.

Logs are paths, folders, globs, URLs of object storage, tables in memory or recordings;
parameters are files or documents. Nothing is printed: what may be wrong comes as
`SeqidWarning`, what cannot be done as a subclass of `SeqidError`. Cheap checks come
before anything heavy is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, Unpack

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
from seqid_cli.params.schema import (
    FrictionStage,
    ImuStage,
    ParameterFile,
    RigidStage,
    Stages,
    Verdict,
)
from seqid_cli.settings import Settings

if TYPE_CHECKING:
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.robot.types import Robot

Stage: TypeAlias = FrictionStage | RigidStage | ImuStage


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
    from seqid_cli.identify.friction_surface.checks import friction_verdicts
    from seqid_cli.identify.friction_surface.stage import identify_friction
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.recipe import friction_recipe

    arm = inputs.robot
    log_set = LogSet.of(inputs)
    stage = identify_friction(log_set, arm, options=options, settings=settings)
    stage = replace(stage, recipe=friction_recipe(options))
    checks = list(friction_verdicts(stage, arm, settings.judging))

    new_stage = NewStage(name="friction", stage=stage, checks=checks)
    return _with_new_stages(inputs, log_set, [new_stage], settings)


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
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.rigid.gravity import identify_gravity
    from seqid_cli.identify.rigid.gravity_checks import gravity_verdicts

    arm = inputs.robot
    log_set = LogSet.of(inputs)
    result = identify_gravity(log_set, arm, inputs.stages, settings)
    checks = list(
        gravity_verdicts(result.gravity, result.friction, arm, settings.judging)
    )

    new_stage = NewStage(name="gravity", stage=result.gravity, checks=checks)
    return _with_new_stages(
        inputs, log_set, [new_stage], settings, improved_friction=result.friction
    )


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
    from seqid_cli.identify.imu_calibration import calibrate_imus
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.imu.array import layout_statements
    from seqid_cli.motion.options import MotionOptions

    log_set = LogSet.of(inputs, imus=True)
    for imu in inputs.robot.imus:
        for text in layout_statements(imu):
            log_set.tell("note", text=f"{imu.name}: {text}")
    filtering = MotionOptions(cutoff_hz=options.cutoff_hz)
    stage = calibrate_imus(log_set, inputs.robot, options=filtering, settings=settings)

    new_stage = NewStage(name="imu", stage=stage)
    return _with_new_stages(inputs, log_set, [new_stage], settings)


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
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.identify.recipe import rigid_recipe
    from seqid_cli.identify.rigid.cutoff_choice import InertiaTrial
    from seqid_cli.identify.rigid.inertia import identify_inertia
    from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
    from seqid_cli.identify.rigid.parameters import made_consistent

    arm = inputs.robot
    earlier_stages = inputs.stages
    log_set = LogSet.of(inputs)
    motion = identification_options(
        inputs.logs,
        arm,
        options,
        earlier_stages.imu,
        InertiaTrial(arm, earlier_stages, options.source, settings),
        reading=inputs.reading,
        limits=settings.cutoff,
    )
    result = identify_inertia(
        log_set,
        arm,
        earlier_stages,
        options=InertiaOptions(motion=motion, source=options.source, settings=settings),
        compare=True,
    )
    stage = result.inertia
    if options.consistent:
        stage = made_consistent(stage, earlier_stages, arm)
    stage = replace(stage, recipe=rigid_recipe(options))
    checks = list(
        inertia_verdicts(stage, earlier_stages.gravity, arm, settings.judging)
    )

    new_stage = NewStage(name="inertia", stage=stage, checks=checks)
    return _with_new_stages(
        inputs, log_set, [new_stage], settings, improved_friction=result.friction
    )


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
    from seqid_cli.identify.friction_surface.checks import friction_verdicts
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.recipe import rigid_recipe
    from seqid_cli.identify.rigid.cutoff_choice import SimultaneousTrial
    from seqid_cli.identify.rigid.inertia_checks import inertia_verdicts
    from seqid_cli.identify.rigid.parameters import made_consistent
    from seqid_cli.identify.rigid.simultaneous import identify_simultaneous

    arm = inputs.robot
    imu = inputs.stages.imu
    log_set = LogSet.of(inputs)
    motion = identification_options(
        inputs.logs,
        arm,
        options,
        imu,
        SimultaneousTrial(arm, imu, options.source, offset=options.offset),
        reading=inputs.reading,
        limits=settings.cutoff,
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
    inertia = replace(inertia, recipe=rigid_recipe(options))
    gravity = inputs.stages.gravity
    limits = settings.judging

    new_stages = [
        NewStage(
            name="friction",
            stage=friction,
            checks=list(friction_verdicts(friction, arm, limits)),
        ),
        NewStage(
            name="inertia",
            stage=inertia,
            checks=list(inertia_verdicts(inertia, gravity, arm, limits)),
        ),
    ]
    return _with_new_stages(inputs, log_set, new_stages, settings)


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
        options=InertiaOptions(motion=motion, source=options.source),
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


@dataclass(frozen=True, kw_only=True)
class NewStage:
    """A stage as it was identified, and what physics and earlier stages say of it.

    `name` is that of a stage in a parameter file; `checks` are verdicts beside those of
    the fit.
    """

    name: str
    stage: Stage
    checks: Sequence[Verdict] = ()


def _with_new_stages(
    inputs: Inputs,
    log_set: LogSet,
    new_stages: Sequence[NewStage],
    settings: Settings,
    *,
    improved_friction: FrictionStage | None = None,
) -> ParameterFile:
    """Judge new stages as a whole, and add them to earlier ones.

    `improved_friction` is the earlier stage with what the logs of the new ones show of
    it.
    """
    from seqid_cli.identify.judging import as_a_whole, verdicts_by_earlier

    improved = {"friction": improved_friction} if improved_friction else {}
    identified = {new.name: new.stage for new in new_stages}
    # What a new stage rests on may be as new as it is.
    all_stages = replace(inputs.stages, **{**improved, **identified})
    of_logs = log_set.verdicts()

    judged: dict[str, Stage] = {}
    for new in new_stages:
        stage = new.stage
        verdicts = [
            *stage.verdicts,
            *new.checks,
            *of_logs,
            *verdicts_by_earlier(new.name, all_stages),
        ]
        judged[new.name] = replace(
            stage,
            verdicts=as_a_whole(verdicts),
            notes=[*stage.notes, *log_set.notes(stage.notes)],
            settings=used_settings(settings),
        )

    for name in stale_stages(inputs.previous, tuple(judged)):
        warn(f"the {name} stage rested on the old result and is left out: redo it")
    file = with_stage(
        inputs.previous,
        robot_id(inputs.robot),
        log_set.inputs(next(iter(judged))),
        improved,
        created=log_set.created(inputs.documents),
        **judged,
    )
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file
