"""`seqid run`: from a folder of logs to a model and its report."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED
from seqid_cli.commands.options import JOBS, command, found_robot, option
from seqid_cli.commands.run_logs import NAMED_FOLDERS, STAGES, RunLogs, logs_of_run
from seqid_cli.commands.run_record import Record
from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.errors import UsageError
from seqid_cli.params.document import worst_level
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import LEVELS, Level, ParameterFile, Verdict


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command of a run: what it reads and writes, the result first, and its options.

    `words` are the options and arguments that decide the result, `neutral_words` those
    that do not, such as the number of processes.
    """

    command: str
    reads: Sequence[Path]
    writes: Sequence[Path]
    words: Sequence[object]
    neutral_words: Sequence[object] = ()

    @property
    def result(self) -> Path:
        """The file with the result."""
        return self.writes[0]

    @property
    def command_line(self) -> list[str]:
        """What decides the result, as it is typed."""
        return [self.command, *map(str, self.words)]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a step.

    `level` is the verdict, None where nothing is judged; `shown` is what a table says
    of it, and `reasons` why it is no better. `kept` and `partial` say that nothing had
    changed, and that logs were read in part.
    """

    step: Step
    level: Level | None
    shown: str
    reasons: Sequence[str]
    kept: bool
    partial: bool


@command(
    "folder robot urdf output refine jobs keep_going force strict",
    "seqid run sample_logs/two_joint -r sample_logs/two_joint/robot.toml -o"
    " out/two_joint",
    "seqid run sample_logs/one_joint -o out --no-refine --strict",
)
def run(
    context: typer.Context,
    folder: Path = typer.Argument(
        ...,
        metavar="FOLDER",
        help=f"Folder of logs: with {NAMED_FOLDERS} in it, or unsorted.",
    ),
    robot: Path | None = option(
        None,
        "-r --robot FILE",
        "Robot file; ./robot.toml or one in FOLDER when left out.",
    ),
    urdf: Path | None = option(
        None,
        "--urdf FILE",
        "URDF, of which a robot file is made in the folder of the results.",
    ),
    output: Path = option(..., "-o --output FOLDER", "Folder where all results go."),
    refine: bool = option(
        True,
        "--refine/--no-refine",
        "Add the effects that the model lacks, in the end.",
    ),
    jobs: int | None = JOBS,
    keep_going: bool = option(
        False, "--keep-going", "Go on after a stage whose verdict is poor."
    ),
    force: bool = option(
        False, "--force", "Do everything anew, also what has not changed."
    ),
    strict: bool = option(
        False, "--strict", "Exit with 1 when the worst verdict is not good."
    ),
) -> int:
    """Run every stage on a folder of logs, then predict, diagnose, refine and report.

    The files are those that the single commands write. What is there is kept as long as
    its logs, the options and the version are the same, so that a run goes on where it
    stopped. A folder that is not sorted is sorted by what inspect finds. The run stops
    at the first stage whose verdict is poor, with what to do. It ends with the worst
    verdict; the exit code is 1 where that is poor.
    """
    from seqid_cli.robot.file import load_robot

    screen = screen_of(context)
    robot_file = _robot_file(screen, context, folder, robot, urdf, output)
    arm = load_robot(robot_file)
    logs = logs_of_run(folder, output, arm, screen.note)
    steps = [*_steps(logs, robot_file, output, jobs, refine=refine)]
    _make_folder(output)

    record = Record(output)
    outcomes: list[Outcome] = []
    for step in steps:
        outcome = _outcome(step, record, screen, context, force=force)
        outcomes.append(outcome)
        if outcome.level == "poor" and step.command in STAGES and not keep_going:
            text = (
                f"stopped at {step.command}: its verdict is poor (--keep-going goes on)"
            )
            screen.note(text)
            break
    return _told(screen, outcomes, strict=strict)


def _make_folder(output: Path) -> None:
    """Make the folder of the results; raises UsageError if it cannot be made."""
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        message = f"the folder cannot be made: {problem.strerror}"
        raise UsageError(message, where=str(output), hint="Choose -o.") from None


def _robot_file(
    screen: Screen,
    context: typer.Context,
    folder: Path,
    robot: Path | None,
    urdf: Path | None,
    output: Path,
) -> Path:
    """Return the robot file that is given, made of a URDF, or found.

    One that an earlier run made stays: what nobody can read off logs has been written
    into it.
    """
    if robot is not None and urdf is not None:
        hint = "Name the URDF in the robot file, or leave out -r."
        raise UsageError("either -r or --urdf, not both", hint=hint)
    if robot is not None:
        return robot
    if urdf is None:
        return found_robot(screen, [str(folder)])
    made = output / "robot.toml"
    if made.is_file():
        screen.note(f"robot file: {made}, made by an earlier run, kept")
        return made
    _make_folder(output)
    screen.note("--- init")
    _code(["init", "--urdf", str(urdf), "-o", str(made), "--", str(folder)], context)
    return made


def _steps(
    logs: RunLogs,
    robot_file: Path,
    out: Path,
    jobs: int | None,
    *,
    refine: bool,
) -> Iterator[Step]:
    """Yield the commands for the logs that are there, each with the results before it."""
    processes = () if jobs is None else ("--jobs", jobs)
    of_robot = [robot_file, *_urdf_of(robot_file)]
    model: list[Path] = []

    def step(
        name: str,
        paths: Sequence[Path],
        writes: Sequence[Path],
        *options: object,
        neutral_words: Sequence[object] = (),
        also_reads: Sequence[Path] = (),
    ) -> Step:
        given = ["-p", model[-1]] if model else []
        words = ["-r", robot_file, *given, "-o", writes[0], *options, "--", *paths]
        return Step(
            command=name,
            reads=[*paths, *also_reads, *of_robot, *model[-1:]],
            writes=writes,
            words=words,
            neutral_words=neutral_words,
        )

    for name, stage in STAGES.items():
        if name in logs.of_command:
            result = out / f"{stage}.json"
            yield step(name, logs.of_command[name], [result], neutral_words=processes)
            model.append(result)

    files, tables = [*model], []
    if logs.held_out and "inertia" in logs.of_command:
        prediction, diagnosis = out / "prediction.json", out / "diagnosis.json"
        torques = out / "torques.parquet"
        tables = ["--torques", torques]
        results = [prediction, torques]
        yield step("predict", logs.held_out, results, *tables, neutral_words=processes)
        yield step("diagnose", logs.held_out, [diagnosis])
        files += [prediction, diagnosis]
        if refine:
            refined = out / "refined.json"
            held_out = [word for path in logs.held_out for word in ("--holdout", path)]
            training = logs.of_command["inertia"]
            yield step(
                "refine", training, [refined], *held_out, also_reads=logs.held_out
            )
            files.append(refined)
    page = out / "report.html"
    words = ["-o", page, *tables, "--", *files]
    shown = [*files, *map(Path, map(str, tables[1:]))]
    yield Step(command="report", reads=shown, writes=[page], words=words)


def _urdf_of(robot_file: Path) -> list[Path]:
    """Return the URDF that a robot file names, if it names one."""
    from seqid_cli.robot.toml import read_robot_file

    name = read_robot_file(robot_file)[0].urdf
    return [] if name is None else [robot_file.parent / name]


def _outcome(
    step: Step, record: Record, screen: Screen, context: typer.Context, *, force: bool
) -> Outcome:
    """Run a step, or keep its result where nothing of what it is made of has changed."""
    known = None if force else record.kept(step.command_line, step.reads, step.writes)
    if known is None:
        screen.note(f"--- {step.command}")
        line = [step.command, *map(str, step.neutral_words), *map(str, step.words)]
        partial = _code(line, context) == EXIT_PARTIAL
        record.add(step.command_line, step.reads, step.writes, partial=partial)
    else:
        partial = known.partial
        screen.note(
            f"{step.command}: {step.result} is of the same logs and options, kept"
        )
    level, shown, reasons = judged(step.result)
    if known is not None:
        for reason in reasons:
            screen.note(f"{step.command}: {level}: {reason}")
    return Outcome(
        step=step,
        level=level,
        shown=shown,
        reasons=reasons,
        kept=known is not None,
        partial=partial,
    )


def _code(line: Sequence[str], context: typer.Context) -> int:
    """Run a command line; with --json its own result is in its file alone."""
    from seqid_cli.commands.app import invoke

    names = [
        name
        for name in ("quiet", "verbose", "no_color", "json")
        if context.params[name]
    ]
    flags = [f"--{name.replace('_', '-')}" for name in names]
    if not context.params["json"]:
        return invoke([line[0], *flags, *line[1:]])
    with contextlib.redirect_stdout(io.StringIO()):
        return invoke([line[0], *flags, "--quiet", *line[1:]])


def judged(path: Path) -> tuple[Level | None, str, list[str]]:
    """Return the verdict of a result, what to show of it, and why it is no better than it is.

    Of a parameter file the newest part counts, after which it is named; what a
    diagnosis says is no verdict on the model's use.
    """
    if path.suffix != ".json":
        return None, "-", []
    from seqid_cli.params.io import read_any

    (source,) = read_any([path])
    document: Any = source.content
    if isinstance(document, DiagnosisFile):
        return None, document.verdict, []
    verdicts: list[Verdict] = []
    level: Level | None = None
    if isinstance(document, ParameterFile) and document.closed_loop is not None:
        verdicts, level = document.closed_loop.verdicts, document.closed_loop.verdict
    elif isinstance(document, ParameterFile):
        verdicts = getattr(document.stages, path.stem).verdicts
    else:
        verdicts = document.verdicts
    level = _worst([level, worst_level(verdicts)])
    reasons = [
        ": ".join(filter(None, (verdict.joint, verdict.reason)))
        for verdict in verdicts
        if verdict.level != "good"
    ]
    return level, level or "-", reasons


def _worst(levels: Sequence[Level | None]) -> Level | None:
    """Return the worst of some levels, None without any."""
    known = [level for level in levels if level is not None]
    return max(known, key=LEVELS.index, default=None)


def _told(screen: Screen, outcomes: Sequence[Outcome], *, strict: bool) -> int:
    """Print what came of each step and the worst verdict last; return the exit code."""
    worst = _worst([outcome.level for outcome in outcomes])
    rows = [
        (x.step.command, x.shown, str(x.step.result), "kept" if x.kept else "made")
        for x in outcomes
    ]
    screen.table(("step", "verdict", "file", ""), rows)
    steps = [
        {
            "command": outcome.step.command,
            "output": str(outcome.step.result),
            "verdict": outcome.shown,
            "good": outcome.level in (None, "good"),
            "kept": outcome.kept,
            "partial": outcome.partial,
        }
        for outcome in outcomes
    ]
    screen.document({"verdict": worst, "steps": steps})

    line = f"run: {worst or 'nothing was judged'}"
    if worst not in (None, "good"):
        line += f": {', '.join(x.step.command for x in outcomes if x.level == worst)}"
    screen.result(line)
    if worst == "poor" or (strict and worst != "good"):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(outcome.partial for outcome in outcomes) else EXIT_DONE
