"""`seqid run`: from a folder of logs to a model and its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from seqid_cli.commands.options import Jobs, RobotPath
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
DONE, POOR, PARTIAL = 0, 1, 3

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help=f"Folder of logs with {', '.join(f'{name}/' for name in FOLDERS)} in it; those that "
        "are there are used.",
    ),
]
Out = Annotated[
    Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder where all results go.")
]
KeepGoing = Annotated[
    bool, typer.Option("--keep-going", help="Go on after a stage whose verdict is poor.")
]
Force = Annotated[
    bool, typer.Option("--force", help="Do everything anew, also what is newer than its logs.")
]


@dataclass(frozen=True)
class Step:
    """One command: what it reads, beside the result of the stage before, and what it writes."""

    command: str
    reads: tuple[Path, ...]
    writes: Path
    arguments: Mapping[str, Any]

    @property
    def current(self) -> bool:
        """Whether its result is newer than all that it is made of."""
        if not self.writes.is_file():
            return False
        made = self.writes.stat().st_mtime_ns
        return all(newest(path) < made for path in self.reads)


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
    steps = steps_of(folder, robot, load_robot(robot), output, jobs)
    _made(output)
    outcomes: list[Outcome] = []
    for step in steps:
        redone = any(not outcome.kept for outcome in outcomes)  # then what rests on it is old
        outcome = _outcome(screen, step, force=force or redone)
        outcomes.append(outcome)
        if not outcome.good and not keep_going and step is not steps[-1]:
            screen.note(f"stopped at {step.command}: its verdict is poor (--keep-going goes on)")
            break
    _show(screen, outcomes)
    if not all(outcome.good for outcome in outcomes):
        return POOR
    return PARTIAL if any(outcome.partial for outcome in outcomes) else DONE


def steps_of(folder: Path, path: Path, robot: Robot, out: Path, jobs: int | None) -> list[Step]:
    """Plan the commands for the logs that a folder has.

    Raises InputError: it is no folder, or has no friction trials in it.
    """
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
    return [*_stages(there, path, out, jobs), *_judging(there, path, out, jobs)]


def _stages(there: Mapping[str, Path], robot: Path, out: Path, jobs: int | None) -> Iterator[Step]:
    """Stages in their order; slow trials of friction serve gravity as well."""
    before: tuple[Path, ...] = ()
    for command, name in STAGES.items():
        logs = [
            there[k] for k in ((name, "friction") if name == "gravity" else (name,)) if k in there
        ]
        if not logs or (name == "inertia" and "inertia" not in there):
            continue
        own = {"parameters": list(before)} if before else {}
        made = out / f"{name}.json"
        yield _step(command, logs, robot, made, before, {**own, "jobs": jobs, "strict": True})
        before = (made,)


def _judging(there: Mapping[str, Path], robot: Path, out: Path, jobs: int | None) -> Iterator[Step]:
    """Prediction, diagnosis and report, as far as there are logs for them."""
    stages = [name for name in STAGES.values() if name in there or name == "gravity"]
    files = [out / f"{name}.json" for name in stages]
    tables: dict[str, Any] = {}
    if {"validation", "inertia"} <= there.keys():
        logs, before = [there["validation"]], (out / "inertia.json",)
        torques = out / "torques.parquet"
        own = {"parameters": list(before)}
        more = {**own, "jobs": jobs, "torques": torques, "strict": True}
        files += [out / "prediction.json", out / "diagnosis.json"]
        yield _step("predict", logs, robot, files[-2], before, more)
        yield _step("diagnose", logs, robot, files[-1], before, own)
        tables = {"torques": torques}
    report = {"files": list(files), "output": out / "report.html", **tables}
    yield Step("report", tuple(files), out / "report.html", report)


def _step(
    command: str,
    logs: Sequence[Path],
    robot: Path,
    made: Path,
    before: tuple[Path, ...],
    own: Mapping[str, Any],
) -> Step:
    arguments = {"logs": [str(log) for log in logs], "robot": robot, "output": made, **own}
    return Step(command, (*logs, robot, *before), made, arguments)


def newest(path: Path) -> int:
    """When a file, or the newest file below a folder, was written last, ns."""
    files = path.rglob("*") if path.is_dir() else [path]
    return max((file.stat().st_mtime_ns for file in files if file.is_file()), default=0)


def _made(output: Path) -> None:
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UsageError(
            f"the folder cannot be made: {problem.strerror}", where=str(output), hint="Choose -o."
        ) from None


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

    own = (
        _Silent(step.command) if screen.json else replace(screen, command=step.command, said=set())
    )
    code = call(step.command, own, **step.arguments)
    good = code != POOR
    return Outcome(step.command, str(step.writes), good, kept=False, partial=code == PARTIAL)


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


def _show(screen: Screen, outcomes: Sequence[Outcome]) -> None:
    """One line per step."""
    rows = [
        (
            outcome.command,
            "good" if outcome.good else "poor",
            outcome.output,
            "kept" if outcome.kept else "made",
        )
        for outcome in outcomes
    ]
    screen.table(("step", "verdict", "file", ""), rows)
    screen.document({"steps": [asdict(outcome) for outcome in outcomes]})
