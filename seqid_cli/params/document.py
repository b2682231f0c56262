"""Build, extend and join parameter files, which grow by a stage at a time."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypedDict

from seqid_cli import __version__
from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.params import schema
from seqid_cli.params.dates import created_from, now
from seqid_cli.params.schema import (
    ClosedLoop,
    FrictionStage,
    InputLog,
    ParameterFile,
    RigidStage,
    RobotId,
    Stages,
)
from seqid_cli.settings import Settings, entries

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

Logs = Sequence[InputLog]
COMMAND_OF = {  # each stage, in their order
    "friction": "friction",
    "gravity": "gravity",
    "imu": "imu-calib",
    "inertia": "inertia",
    "effects": "refine",
}
# Stages that were identified with the help of each stage, and are stale once that stage
# is done again.
_DEPENDENTS: Mapping[str, tuple[str, ...]] = {
    "friction": ("gravity", "inertia", "effects"),
    "gravity": ("inertia", "effects"),
    "imu": ("inertia", "effects"),
    "inertia": ("effects",),
}


class Head(TypedDict):
    """The fields that every document begins with."""

    schema: str
    created: str
    tool: schema.Tool


def head(name: str, created: str) -> Head:
    """Return the head of a document that this program writes; `name` is its schema."""
    return {
        "schema": name,
        "created": created,
        "tool": schema.Tool(version=__version__),
    }


def robot_id(robot: "Robot") -> RobotId:
    """Return the identity of a robot in the form of documents."""
    return RobotId(
        name=robot.name,
        joints=list(robot.joint_names),
        sha256=robot.sha256,
        prismatic=[joint.name for joint in robot.joints if joint.prismatic],
    )


def used_settings(settings: Settings) -> schema.UsedSettings:
    """Return settings in the form of documents."""
    all_entries = list(entries(settings))
    return schema.UsedSettings(
        changed={entry.name: entry.value for entry in all_entries if entry.changed},
        values={entry.name: entry.value for entry in all_entries},
    )


def present(stages: Stages) -> dict[str, object]:
    """Return the stages that are there, by name, in their order."""
    by_name = {name: getattr(stages, name) for name in COMMAND_OF}
    return {name: stage for name, stage in by_name.items() if stage is not None}


def friction_of(file: schema.ParameterFile, joint: str) -> schema.FrictionJoint:
    """Return the identified friction of a joint.

    Raises
    ------
    UsageError
        No friction of this joint is in the file.
    """
    stage = file.stages.friction
    joints = stage.joints if stage else {}
    if joint not in joints:
        names = ", ".join(joints) or "none"
        raise UsageError(
            f"no friction of {joint!r} is in this file", hint=f"It has: {names}."
        )
    return joints[joint]


def worst_level(verdicts: Iterable[schema.Verdict]) -> schema.Level | None:
    """Return the worst level among some verdicts, None without any."""
    levels = [verdict.level for verdict in verdicts]
    return max(levels, key=schema.LEVELS.index, default=None)


def poor_because(verdicts: Iterable[schema.Verdict], joint: str) -> str:
    """Return why a joint is not good, or a whole stage (""); empty where it is."""
    return "; ".join(v.reason for v in verdicts if v.joint == joint and not v.good)


def stale_stages(
    previous: ParameterFile | None, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the earlier stages that are void once the stages `names` are redone."""
    if previous is None:
        return ()
    earlier = present(previous.stages)
    dependents: set[str] = set()
    for name in names:
        if name in earlier:
            dependents.update(_DEPENDENTS.get(name, ()))
    stale = dependents & earlier.keys() - set(names)
    return tuple(name for name in COMMAND_OF if name in stale)


def with_stage(
    previous: ParameterFile | None,
    robot: RobotId,
    inputs: Logs,
    improved: Mapping[str, object] | None = None,
    *,
    created: str | None = None,
    **stages: object,
) -> ParameterFile:
    """Return a new document: an earlier one with more stages.

    Earlier stages and their inputs stay; a stage that is given again replaces the old
    one, and what had been identified from the old one (`stale_stages`) is dropped.

    Parameters
    ----------
    previous : ParameterFile, optional
        The earlier document.
    robot : RobotId
        The robot that both are about.
    inputs : sequence of InputLog
        Logs that the stages were identified from.
    improved : mapping of str to stage, optional
        Earlier stages with what the new logs show of them: nothing is dropped for
        these.
    created : str, optional
        Date of the newest input (`dates.created_from`); by default the present.
    **stages
        New stages, by their names in `Stages`.
    """
    dropped = {*stages, *stale_stages(previous, tuple(stages))}
    earlier_stages: dict[str, object] = {}
    earlier_inputs: list[InputLog] = []
    if previous is not None:
        for name, stage in present(previous.stages).items():
            if name not in dropped:
                earlier_stages[name] = stage
        earlier_inputs = [log for log in previous.inputs if log.stage not in dropped]
    content = {**earlier_stages, **(improved or {}), **stages}
    return _file(robot, [*earlier_inputs, *inputs], content, created=created)


def refined(
    previous: ParameterFile,
    robot: RobotId,
    inputs: Logs,
    stages: Stages,
    loop: ClosedLoop,
    *,
    created: str | None = None,
) -> ParameterFile:
    """Return a new document: an earlier one after refinement.

    Parameters
    ----------
    previous : ParameterFile
        The earlier document. All its inputs stay, because what was identified from them
        went into the refined stages.
    robot : RobotId
        The robot that both are about.
    inputs : sequence of InputLog
        Logs that refinement read in addition.
    stages : Stages
        Stages that replace the earlier ones.
    loop : ClosedLoop
        What refinement did.
    created : str, optional
        As of `with_stage`.
    """
    # Effects are there even where nothing was added.
    content = {"effects": [], **present(previous.stages), **present(stages)}
    return _file(robot, [*previous.inputs, *inputs], content, loop, created=created)


def stages_before(previous: ParameterFile, refined_stages: Stages) -> Stages | None:
    """Return the model as it came into the first refinement.

    None where refinement has identified none of it anew.

    Parameters
    ----------
    previous : ParameterFile
        The document as it comes into this refinement.
    refined_stages : Stages
        Those that replace its stages.
    """
    loop = previous.closed_loop
    earliest = previous.stages
    if loop is not None and loop.incoming is not None:
        earliest = loop.incoming
    came_in = _model_of(earliest)
    written = {**_model_of(previous.stages), **_model_of(refined_stages)}
    return None if came_in == written else Stages(**came_in)


class _Model(TypedDict, total=False):
    """The stages that say an arm's torque without effects."""

    friction: FrictionStage
    gravity: RigidStage
    inertia: RigidStage


def _model_of(stages: Stages) -> _Model:
    """Return those that are there."""
    model = _Model()
    if stages.friction is not None:
        model["friction"] = stages.friction
    if stages.gravity is not None:
        model["gravity"] = stages.gravity
    if stages.inertia is not None:
        model["inertia"] = stages.inertia
    return model


def _file(
    robot: RobotId,
    inputs: Logs,
    stages: Mapping[str, object],
    loop: ClosedLoop | None = None,
    *,
    created: str | None = None,
) -> ParameterFile:
    """Return a document in which each input stands once."""
    unique_inputs = {(log.stage, log.sha256, log.path): log for log in inputs}
    return ParameterFile(
        **head(schema.SCHEMA, created or now()),
        robot=robot,
        inputs=list(unique_inputs.values()),
        stages=Stages(**stages),  # type: ignore[arg-type]
        closed_loop=loop,
    )


def check_same_robot(
    first: tuple[str, RobotId], other: tuple[str, RobotId], hint: str
) -> None:
    """Raise ConfigError for a document about another robot than the first.

    Parameters
    ----------
    first, other : (path, RobotId)
        Path and robot of the two documents.
    hint : str
        What to do about it.
    """
    first_path, robot = first
    other_path, other_robot = other
    if (other_robot.name, other_robot.joints) != (robot.name, robot.joints):
        message = (
            f"is about robot {other_robot.name!r} ({', '.join(other_robot.joints)}), "
            f"but {first_path} about {robot.name!r} ({', '.join(robot.joints)})"
        )
        raise ConfigError(message, where=other_path, hint=hint)


def join(files: Sequence[tuple[str, ParameterFile]]) -> ParameterFile:
    """Join parameter files of one robot.

    Parameters
    ----------
    files : sequence of (str, ParameterFile)
        Files with the names to use in messages.

    Raises
    ------
    ConfigError
        There are none, or they are of different robots or disagree on a stage.
    """
    if not files:
        raise ConfigError("no parameter file given", hint="Name one with -p.")
    first_path, first = files[0]
    stages: dict[str, object] = {}
    source_of: dict[str, str] = {}  # the file that each stage is from
    for path, file in files:
        check_same_robot(
            (first_path, first.robot),
            (path, file.robot),
            "Join files of one robot only.",
        )
        for name, stage in present(file.stages).items():
            source = source_of.setdefault(name, path)
            if stages.setdefault(name, stage) != stage:
                message = f"its {name} stage differs from that of {source}"
                hint = "Give files of one branch, or redo one from the other's result."
                raise ConfigError(message, where=path, hint=hint)

    inputs = [log for _, file in files for log in file.inputs]
    loop = next((file.closed_loop for _, file in files if file.closed_loop), None)
    created = created_from(file for _, file in files)
    joined = _file(first.robot, inputs, stages, loop, created=created)
    joined.tool = first.tool
    return joined
