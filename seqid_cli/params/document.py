"""Build, extend and join parameter files, which grow by a stage at a time."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypedDict

from seqid_cli import __version__
from seqid_cli.errors import ConfigError
from seqid_cli.params import schema
from seqid_cli.params.dates import created_from, now
from seqid_cli.params.schema import ClosedLoop, InputLog, ParameterFile, RobotId, Stages
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
# What was identified with the help of each stage, and is stale once that stage is done
# again.
_DEPENDENTS: Mapping[str, tuple[str, ...]] = {
    "friction": ("gravity", "inertia", "effects"),
    "gravity": ("inertia", "effects"),
    "imu": ("inertia", "effects"),
    "inertia": ("effects",),
}


class Head(TypedDict):
    """What every document begins with."""

    schema: str
    created: str
    tool: schema.Tool


def head(name: str, created: str) -> Head:
    """Return the head of a document of this schema and date, written by this program."""
    return {
        "schema": name,
        "created": created,
        "tool": schema.Tool(version=__version__),
    }


def robot_id(robot: "Robot") -> RobotId:
    """Return the identity of a robot in the form of documents."""
    names, slides = (
        list(robot.joint_names),
        [j.name for j in robot.joints if j.prismatic],
    )
    return RobotId(name=robot.name, joints=names, sha256=robot.sha256, prismatic=slides)


def used_settings(settings: Settings) -> schema.UsedSettings:
    """Return settings in the form of documents."""
    shown = list(entries(settings))
    return schema.UsedSettings(
        changed={entry.name: entry.value for entry in shown if entry.changed},
        values={entry.name: entry.value for entry in shown},
    )


def present(stages: Stages) -> dict[str, object]:
    """Return the stages that are there, by name, in their order."""
    found = {name: getattr(stages, name) for name in COMMAND_OF}
    return {name: stage for name, stage in found.items() if stage is not None}


def worst_level(verdicts: Iterable[schema.Verdict]) -> schema.Level | None:
    """Return the worst level among some verdicts, None without any."""
    levels = [verdict.level for verdict in verdicts]
    return max(levels, key=schema.LEVELS.index, default=None)


def poor_because(verdicts: Iterable[schema.Verdict], joint: str) -> str:
    """Return why a joint (a whole stage where it is empty) is not good; nothing where it is."""
    return "; ".join(v.reason for v in verdicts if v.joint == joint and not v.good)


def stale_stages(
    previous: ParameterFile | None, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the earlier results that are void when the stages `names` are identified again."""
    if previous is None:
        return ()
    there = present(previous.stages)
    lost = {
        late for name in names if name in there for late in _DEPENDENTS.get(name, ())
    }
    return tuple(
        name for name in COMMAND_OF if name in lost & there.keys() - set(names)
    )


def with_stage(
    previous: ParameterFile | None,
    robot: RobotId,
    inputs: Logs,
    improved: Mapping[str, object] | None = None,
    *,
    created: str | None = None,
    **stages: object,
) -> ParameterFile:
    """Return a new document: `previous` and the given stages, by their names in `Stages`.

    Earlier stages and their inputs stay; a stage that is given again replaces the old
    one, and what had been identified from the old one (`stale_stages`) is dropped.
    `improved` are earlier stages with what the new logs show of them: nothing is
    dropped for these. `created` is the date of the newest input (`dates.created_from`);
    the present where it is left out.
    """
    gone = {*stages, *stale_stages(previous, tuple(stages))}
    old = present(previous.stages) if previous else {}
    kept = {name: stage for name, stage in old.items() if name not in gone}
    earlier = (
        [log for log in previous.inputs if log.stage not in gone] if previous else []
    )
    content = {**kept, **(improved or {}), **stages}
    return _file(robot, [*earlier, *inputs], content, created=created)


def refined(
    previous: ParameterFile,
    robot: RobotId,
    inputs: Logs,
    stages: Stages,
    loop: ClosedLoop,
    *,
    created: str | None = None,
) -> ParameterFile:
    """Return a new document: `previous` after refinement.

    `stages` replace those of `previous`. All its inputs stay, because what was
    identified from them went into the refined stages; `inputs` are the logs that
    refinement read in addition. `created` is as of `with_stage`.
    """
    # Effects are there even where nothing was added.
    content = {"effects": [], **present(previous.stages), **present(stages)}
    return _file(robot, [*previous.inputs, *inputs], content, loop, created=created)


def _file(
    robot: RobotId,
    inputs: Logs,
    stages: Mapping[str, object],
    loop: ClosedLoop | None = None,
    *,
    created: str | None = None,
) -> ParameterFile:
    return ParameterFile(
        **head(schema.SCHEMA, created or now()),
        robot=robot,
        inputs=list(
            {(log.stage, log.sha256, log.path): log for log in inputs}.values()
        ),
        stages=Stages(**stages),  # type: ignore[arg-type]
        closed_loop=loop,
    )


def check_same_robot(
    first: tuple[str, RobotId], other: tuple[str, RobotId], hint: str
) -> None:
    """Refuse a document about another robot than the first; each is given with its path."""
    (path, mine), (where, theirs) = first, other
    if (theirs.name, theirs.joints) != (mine.name, mine.joints):
        message = (
            f"is about robot {theirs.name!r} ({', '.join(theirs.joints)}), "
            f"but {path} about {mine.name!r} ({', '.join(mine.joints)})"
        )
        raise ConfigError(message, where=where, hint=hint)


def join(files: Sequence[tuple[str, ParameterFile]]) -> ParameterFile:
    """Join parameter files of one robot, given with the names to use in messages.

    Raises ConfigError: there are none, of different robots, or that disagree on a
    stage.
    """
    if not files:
        raise ConfigError("no parameter file given", hint="Name one with -p.")
    path, first = files[0]
    found: dict[str, tuple[object, str]] = {}
    for name, file in files:
        check_same_robot(
            (path, first.robot), (name, file.robot), "Join files of one robot only."
        )
        for stage, content in present(file.stages).items():
            known, source = found.setdefault(stage, (content, name))
            if known != content:
                message = f"its {stage} stage differs from that of {source}"
                hint = "Give files of one branch, or redo one from the other's result."
                raise ConfigError(message, where=name, hint=hint)
    inputs = [log for _, file in files for log in file.inputs]
    stages = {stage: content for stage, (content, _) in found.items()}
    loop = next((file.closed_loop for _, file in files if file.closed_loop), None)
    created = created_from(file for _, file in files)
    joined = _file(first.robot, inputs, stages, loop, created=created)
    joined.tool = first.tool
    return joined
