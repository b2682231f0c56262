"""`seqid run`: from a folder of logs to a model and its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED
from seqid_cli.commands.options import Jobs, RobotPath, option
from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.errors import InputError, UsageError

if TYPE_CHECKING:
    from seqid_cli.params.schema import Verdict
    from seqid_cli.robot.types import Robot

EXAMPLES = (
    "seqid run sample_logs/two_joint -r sample_logs/two_joint/robot.toml -o out/two_joint",
    "seqid run sample_logs/one_joint -r sample_logs/one_joint/robot.toml -o out",
)
STAGES = {"friction": "friction", "gravity": "gravity", "imu-calib": "imu", "inertia": "inertia"}
FOLDERS = (*STAGES.values(), "validation")

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help=f"Folder of logs with {', '.join(f'{name}/' for name in FOLDERS)} in it; those that "
        "are there are used.",
    ),
]
Out = Annotated[Path, option("-o --output FOLDER", "Folder where all results go.")]
KeepGoing = Annotated[bool, option("--keep-going", "Go on after a stage whose verdict is poor.")]
Force = Annotated[bool, option("--force", "Do everything anew, also what is newer than its logs.")]


@dataclass(frozen=True)
class Step:
    """One command with its arguments, the files that it `reads`, and what it writes."""

    command: str
    reads: Sequence[Path]
    writes: Path
    arguments: Mapping[str, Any]

    @property
    def current(self) -> bool:
        """Whether its result is newer than all that it is made of."""
        if not self.writes.is_file():
            return False
        files = [file for path in self.reads for file in (path, *path.rglob("*")) if file.is_file()]
        newest = max((file.stat().st_mtime_ns for file in files), default=0)
        return newest < self.writes.stat().st_mtime_ns


@dataclass(frozen=True)
class Outcome:
    """What became of a step: its file, whether it is to be trusted, whether it was there before."""

    command: str
    output: str
    good: bool
    kept: bool
    partial: bool = False


def run(
    context: typer.Context,
    folder: Folder,
    robot: RobotPath,
    output: Out,
    jobs: Jobs = None,
    keep_going: KeepGoing = False,
    force: Force = False,
) -> int:
    """Run every stage on a folder of logs, then predict, diagnose and report.

    The files are those that the single commands write. What is newer than its logs is kept, so
    that a run goes on where it stopped. It stops at the first stage whose verdict is poor, with
    what to do; the exit code is 1 then.
    """
    from seqid_cli.robot.file import load_robot

    screen = screen_of(context)
    steps = [*_steps(folder, robot, load_robot(robot), output, jobs)]
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        message = f"the folder cannot be made: {problem.strerror}"
        raise UsageError(message, where=str(output), hint="Choose -o.") from None
    outcomes: list[Outcome] = []
    for step in steps:
        redone = any(not outcome.kept for outcome in outcomes)  # then what rests on it is old
        outcomes.append(_outcome(screen, step, force=force or redone))
        if not outcomes[-1].good and not keep_going and step is not steps[-1]:
            screen.note(f"stopped at {step.command}: its verdict is poor (--keep-going goes on)")
            break
    rows = [
        (x.command, "good" if x.good else "poor", x.output, "kept" if x.kept else "made")
        for x in outcomes
    ]
    screen.table(("step", "verdict", "file", ""), rows)
    screen.document({"steps": [asdict(outcome) for outcome in outcomes]})
    if not all(outcome.good for outcome in outcomes):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(outcome.partial for outcome in outcomes) else EXIT_DONE


def _steps(folder: Path, path: Path, robot: Robot, out: Path, jobs: int | None) -> Iterator[Step]:
    """Plan the commands for the logs that a folder has; slow friction trials serve gravity too."""
    there = {name: folder / name for name in FOLDERS if (folder / name).is_dir()}
    if "friction" not in there:
        wrong = "is no folder" if not folder.is_dir() else "has no folder friction/"
        raise InputError(
            f"{wrong}; a run starts with friction trials",
            where=str(folder),
            hint="Sort the logs into " + ", ".join(f"{name}/" for name in FOLDERS) + "; without "
            "trials of single joints use seqid simultaneous.",
        )
    if not robot.imus:
        there.pop("imu", None)
    made: list[Path] = []

    def step(command: str, logs: Sequence[Path], writes: Path, **own: Any) -> Step:
        before = made[-1:]
        own |= {"parameters": before} if before else {}
        arguments = {"logs": [*map(str, logs)], "robot": path, "output": writes, **own}
        return Step(command, [*logs, path, *before], writes, arguments)

    for command, name in STAGES.items():
        names = (name, "friction") if name == "gravity" else (name,)
        logs = [there[own] for own in names if own in there]
        if logs:
            yield step(command, logs, out / f"{name}.json", jobs=jobs, strict=True)
            made.append(out / f"{name}.json")
    files, torques, tables = [*made], out / "torques.parquet", {}
    if {"validation", "inertia"} <= there.keys():
        logs, files, tables = [there["validation"]], [*made], {"torques": torques}
        files += [out / "prediction.json", out / "diagnosis.json"]
        yield step("predict", logs, files[-2], jobs=jobs, torques=torques, strict=True)
        yield step("diagnose", logs, files[-1])
    page = out / "report.html"
    yield Step("report", files, page, {"files": files, "output": page, **tables})


def _outcome(screen: Screen, step: Step, *, force: bool) -> Outcome:
    """Run a step, or look up what it said before."""
    if step.current and not force:
        poor = poor_of(step.writes)
        screen.note(f"{step.command}: {step.writes} is newer than its logs, kept")
        for verdict in poor:
            screen.note(f"{verdict.joint or step.command}: poor: {verdict.reason}")
        return Outcome(step.command, str(step.writes), good=not poor, kept=True)
    screen.note(f"--- {step.command}")
    from seqid_cli.commands.app import call

    own = replace(screen, command=step.command, said=set())
    code = call(step.command, _Silent(step.command) if screen.json else own, **step.arguments)
    good, partial = code != EXIT_UNTRUSTED, code == EXIT_PARTIAL
    return Outcome(step.command, str(step.writes), good, kept=False, partial=partial)


@dataclass(frozen=True)
class _Silent(Screen):
    """For steps of a run whose own result is one JSON document."""

    json: bool = True
    quiet: bool = True

    def document(self, document: object) -> None:
        """Leave the step's out: it is in its file."""


def poor_of(path: Path) -> list[Verdict]:
    """Return what the newest part of a result calls poor."""
    if path.suffix != ".json":
        return []
    from seqid_cli.params.io import read_any
    from seqid_cli.params.schema import ParameterFile

    (source,) = read_any([path])
    document: Any = source.content
    if isinstance(document, ParameterFile):
        document = getattr(document.stages, path.stem, None)
    return [verdict for verdict in getattr(document, "verdicts", []) if not verdict.good]
