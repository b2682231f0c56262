"""`seqid run`: from a folder of logs to a model and its report."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED
from seqid_cli.commands.options import JOBS, ROBOT, command, option
from seqid_cli.commands.screen.render import screen_of
from seqid_cli.errors import InputError, UsageError
from seqid_cli.params.schema import ParameterFile, Verdict

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

STAGES = {"friction": "friction", "gravity": "gravity", "imu-calib": "imu", "inertia": "inertia"}
FOLDERS = (*STAGES.values(), "validation")
_NAMED = ", ".join(f"{name}/" for name in FOLDERS)


class Step(NamedTuple):
    """One command, the files that it `reads`, and what it writes."""

    command: str
    reads: Sequence[Path]
    writes: Path
    words: Sequence[object]  # of its command line

    @property
    def current(self) -> bool:
        """Whether its result is newer than all that it is made of."""
        if not self.writes.is_file():
            return False
        files = [file for path in self.reads for file in (path, *path.rglob("*")) if file.is_file()]
        newest = max((file.stat().st_mtime_ns for file in files), default=0)
        return newest < self.writes.stat().st_mtime_ns


@command(
    "folder robot output jobs keep_going force",
    "seqid run sample_logs/two_joint -r sample_logs/two_joint/robot.toml -o out/two_joint",
    "seqid run sample_logs/one_joint -r sample_logs/one_joint/robot.toml -o out",
)
def run(
    context: typer.Context,
    folder: Path = typer.Argument(
        ...,
        metavar="FOLDER",
        help=f"Folder of logs with {_NAMED} in it; those that are there are used.",
    ),
    robot: Path = ROBOT,
    output: Path = option(..., "-o --output FOLDER", "Folder where all results go."),
    jobs: int | None = JOBS,
    keep_going: bool = option(False, "--keep-going", "Go on after a stage whose verdict is poor."),
    force: bool = option(False, "--force", "Do everything anew, also what is newer than its logs."),
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
    outcomes: list[dict[str, Any]] = []
    rows = []
    for step in steps:
        kept = step.current and not force
        if kept:
            screen.note(f"{step.command}: {step.writes} is newer than its logs, kept")
            poor = poor_of(step.writes)
            for verdict in poor:
                screen.note(f"{verdict.joint or step.command}: poor: {verdict.reason}")
            code = EXIT_UNTRUSTED if poor else EXIT_DONE
        else:
            screen.note(f"--- {step.command}")
            code, force = _code(step, context), True  # what rests on it is old
        path, good = str(step.writes), code != EXIT_UNTRUSTED
        made = {"command": step.command, "output": path, "good": good, "kept": kept}
        outcomes.append({**made, "partial": code == EXIT_PARTIAL})
        state, how = "good" if good else "poor", "kept" if kept else "made"
        rows.append((step.command, state, path, how))
        if code == EXIT_UNTRUSTED and not keep_going and step is not steps[-1]:
            screen.note(f"stopped at {step.command}: its verdict is poor (--keep-going goes on)")
            break
    screen.table(("step", "verdict", "file", ""), rows)
    screen.document({"steps": outcomes})
    if not all(outcome["good"] for outcome in outcomes):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(outcome["partial"] for outcome in outcomes) else EXIT_DONE


def _steps(folder: Path, path: Path, robot: "Robot", out: Path, jobs: int | None) -> Iterator[Step]:
    """Plan the commands for the logs that a folder has; slow friction trials serve gravity too."""
    there = {name: folder / name for name in FOLDERS if (folder / name).is_dir()}
    if "friction" not in there:
        wrong = "is no folder" if not folder.is_dir() else "has no folder friction/"
        message = f"{wrong}; a run starts with friction trials"
        hint = f"Sort the logs into {_NAMED}; without trials of single joints use seqid"
        raise InputError(message, where=str(folder), hint=f"{hint} simultaneous.")
    if not robot.imus:
        there.pop("imu", None)
    made: list[Path] = []
    trust = ["--strict", *(() if jobs is None else ("--jobs", jobs))]

    def step(command: str, logs: Sequence[Path], writes: Path, *own: object) -> Step:
        before = made[-1:]
        model = [word for path in before for word in ("-p", path)]
        words = ["-r", path, *model, "-o", writes, *own, "--", *logs]
        return Step(command, [*logs, path, *before], writes, words)

    for name, stage in STAGES.items():
        names = (stage, "friction") if stage == "gravity" else (stage,)
        logs = [there[own] for own in names if own in there]
        if logs:
            yield step(name, logs, out / f"{stage}.json", *trust)
            made.append(out / f"{stage}.json")
    files, page, tables = [*made], out / "report.html", []
    if {"validation", "inertia"} <= there.keys():
        tables = ["--torques", out / "torques.parquet"]
        files += [out / "prediction.json", out / "diagnosis.json"]
        yield step("predict", [there["validation"]], files[-2], *trust, *tables)
        yield step("diagnose", [there["validation"]], files[-1])
    yield Step("report", files, page, ["-o", page, *tables, "--", *files])


def _code(step: Step, context: typer.Context) -> int:
    """Run a step; with --json its own result is in its file alone."""
    from seqid_cli.commands.app import invoke

    names = [name for name in ("quiet", "verbose", "no_color", "json") if context.params[name]]
    flags = [f"--{name.replace('_', '-')}" for name in names]
    line = [step.command, *flags, *map(str, step.words)]
    if not context.params["json"]:
        return invoke(line)
    with contextlib.redirect_stdout(io.StringIO()):
        return invoke([*line[:1], "--quiet", *line[1:]])


def poor_of(path: Path) -> list[Verdict]:
    """Return what the newest part of a result calls poor."""
    if path.suffix != ".json":
        return []
    from seqid_cli.params.io import read_any

    (source,) = read_any([path])
    document: Any = source.content
    if isinstance(document, ParameterFile):
        document = getattr(document.stages, path.stem, None)
    return [verdict for verdict in getattr(document, "verdicts", []) if not verdict.good]
