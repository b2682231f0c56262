"""`seqid run`: from a folder of logs to a model and its report."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from seqid_cli.commands.command_run import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED
from seqid_cli.commands.options import (
    DebugOption,
    ExcludeOption,
    FromOption,
    JobsOption,
    JsonOption,
    NoColorOption,
    QuietOption,
    SetOption,
    ShowSettingsOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
)
from seqid_cli.commands.robot_file import found_robot
from seqid_cli.commands.run_logs import NAMED_FOLDERS, STAGES, RunLogs, logs_of_run
from seqid_cli.commands.run_record import Record
from seqid_cli.commands.screen.render import Screen, screen_for
from seqid_cli.commands.settings import RunSettings, words_for_step
from seqid_cli.errors import UsageError
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.document import worst_level
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import LEVELS, Level, ParameterFile, Verdict
from seqid_cli.settings import overridden

app = command_app()


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command of a run, with the files that it reads and writes.

    The result is the first file that it writes. `words` are the options and arguments
    that decide the result, `neutral_words` those that do not, such as the number of
    processes.
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
    def deciding_line(self) -> list[str]:
        """The command line as far as it decides the result."""
        return [self.command, *map(str, self.words)]

    @property
    def command_line(self) -> list[str]:
        """The whole command line, as it is run."""
        return [self.command, *map(str, self.neutral_words), *map(str, self.words)]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a step.

    `level` is the verdict, None where nothing is judged; `summary` is what a table says
    of it, and `reasons` why it is no better. `is_kept` says that nothing had changed,
    so that an earlier run's result stays; `is_partial` that logs were read in part.
    """

    step: Step
    level: Level | None
    summary: str
    reasons: Sequence[str]
    is_kept: bool
    is_partial: bool


@dataclass(frozen=True, kw_only=True)
class StepRunner:
    """Runs the command lines of steps, which show themselves as the run does."""

    screen: Screen
    no_color: bool

    def run(self, command_line: Sequence[str]) -> int:
        """Run a command line and return its exit code.

        With --json the run prints one document of its own: that of a step is in its
        file alone.
        """
        from seqid_cli.commands.app import invoke

        flags = []
        if self.screen.quiet or self.screen.json:
            flags.append("--quiet")
        if self.screen.verbose:
            flags.append("--verbose")
        if self.no_color:
            flags.append("--no-color")
        if self.screen.json:
            flags.append("--json")

        command, *words = command_line
        if not self.screen.json:
            return invoke([command, *flags, *words])
        with contextlib.redirect_stdout(io.StringIO()):
            return invoke([command, *flags, *words])


@app.command(
    "run",
    epilog=examples(
        "seqid run sample_logs/two_joint -r sample_logs/two_joint/robot.toml -o"
        " out/two_joint",
        "seqid run sample_logs/one_joint -o out --no-refine --strict",
    ),
)
def run(
    *,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help=f"Folder of logs: with {NAMED_FOLDERS} in it, or unsorted.",
        ),
    ],
    robot: Annotated[
        Path | None,
        typer.Option(
            "-r",
            "--robot",
            metavar="FILE",
            help="Robot file; ./robot.toml or one in FOLDER when left out.",
        ),
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            metavar="FILE",
            help="URDF, of which a robot file is made in the folder of the results.",
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FOLDER", help="Folder where all results go."
        ),
    ],
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine",
            help="Add the effects that the model lacks, in the end.",
        ),
    ] = True,
    jobs: JobsOption = None,
    keep_going: Annotated[
        bool,
        typer.Option("--keep-going", help="Go on after a stage whose verdict is poor."),
    ] = False,
    force: Annotated[
        bool,
        typer.Option("--force", help="Do everything anew, also what has not changed."),
    ] = False,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Exit with 1 when the worst verdict is not good."
        ),
    ] = False,
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Run every stage on a folder of logs, then predict, diagnose, refine and report.

    The files are those that the single commands write. What is there is kept as long as
    its logs, the options and the version are the same, so that a run goes on where it
    stopped. A folder that is not sorted is sorted by what inspect finds. The run stops
    at the first stage whose verdict is poor, with what to do. It ends with the worst
    verdict; the exit code is 1 where that is poor. A setting goes to every stage that
    has it.
    """
    from seqid_cli.robot.file import load_robot

    screen = screen_for(
        "run", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    settings = list(set_values or ())
    overridden(RunSettings(), settings)  # refuses what no stage has, before any runs
    runner = StepRunner(screen=screen, no_color=no_color)
    part = LogPart.of(start, stop, exclude)  # refuses what is no time, likewise
    robot_file = _robot_file(runner, folder, robot, urdf, output)
    arm = load_robot(robot_file)
    logs = logs_of_run(folder, output, arm, screen.note)
    steps = list(_steps(logs, robot_file, output, jobs, settings, part, refine=refine))
    _make_folder(output)

    record = Record(output)
    outcomes: list[Outcome] = []
    for step in steps:
        outcome = _outcome(step, record, runner, force=force)
        outcomes.append(outcome)
        if outcome.level == "poor" and step.command in STAGES and not keep_going:
            screen.note(
                f"stopped at {step.command}: its verdict is poor (--keep-going goes on)"
            )
            break
    return _show_outcomes(screen, outcomes, strict=strict)


def _make_folder(output: Path) -> None:
    """Make the folder of the results; raises UsageError if it cannot be made."""
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        message = f"the folder cannot be made: {problem.strerror}"
        raise UsageError(message, where=str(output), hint="Choose -o.") from None


def _robot_file(
    runner: StepRunner,
    folder: Path,
    robot: Path | None,
    urdf: Path | None,
    output: Path,
) -> Path:
    """Return the robot file that is named, made of a URDF, or found.

    One that an earlier run made stays: what nobody can read off logs has been written
    into it.
    """
    if robot is not None and urdf is not None:
        hint = "Name the URDF in the robot file, or leave out -r."
        raise UsageError("either -r or --urdf, not both", hint=hint)
    if robot is not None:
        return robot
    if urdf is None:
        return found_robot(runner.screen, [str(folder)])

    robot_file = output / "robot.toml"
    if robot_file.is_file():
        note = f"robot file: {robot_file}, made by an earlier run, kept"
        runner.screen.note(note)
        return robot_file
    _make_folder(output)
    runner.screen.note("--- init")
    runner.run(["init", "--urdf", str(urdf), "-o", str(robot_file), "--", str(folder)])
    return robot_file


def _steps(
    logs: RunLogs,
    robot_file: Path,
    output: Path,
    jobs: int | None,
    settings: Sequence[str],
    part: LogPart,
    *,
    refine: bool,
) -> Iterator[Step]:
    """Yield the commands for the logs at hand, each with the results before it.

    `settings` are what --set was given; a command gets those that it has. `part` is
    the part of each log that is used.
    """
    processes = [] if jobs is None else ["--jobs", jobs]
    robot_files = [robot_file, *_urdf_of(robot_file)]
    # What has been identified so far; the last file holds it all.
    models: list[Path] = []

    def step(
        command: str,
        log_paths: Sequence[Path],
        writes: Sequence[Path],
        *options: object,
        neutral_words: Sequence[object] = (),
        held_out: Sequence[Path] = (),
    ) -> Step:
        model = models[-1:]
        model_words = ["-p", *model] if model else []
        return Step(
            command=command,
            reads=[*log_paths, *held_out, *robot_files, *model],
            writes=writes,
            words=[
                "-r",
                robot_file,
                *model_words,
                "-o",
                writes[0],
                *options,
                *words_for_step(command, settings),
                *part.words,
                "--",
                *log_paths,
            ],
            neutral_words=neutral_words,
        )

    for command, stage in STAGES.items():
        if command in logs.of_command:
            result = output / f"{stage}.json"
            yield step(
                command, logs.of_command[command], [result], neutral_words=processes
            )
            models.append(result)

    reported = list(models)
    torque_words: list[object] = []
    torques = output / "torques.parquet"
    if logs.held_out and "inertia" in logs.of_command:
        prediction = output / "prediction.json"
        diagnosis = output / "diagnosis.json"
        torque_words = ["--torques", torques]
        yield step(
            "predict",
            logs.held_out,
            [prediction, torques],
            *torque_words,
            neutral_words=processes,
        )
        yield step("diagnose", logs.held_out, [diagnosis])
        reported += [prediction, diagnosis]

        if refine:
            refined = output / "refined.json"
            held_out_words: list[object] = []
            for path in logs.held_out:
                held_out_words += ["--holdout", path]
            yield step(
                "refine",
                logs.of_command["inertia"],
                [refined],
                *held_out_words,
                held_out=logs.held_out,
            )
            reported.append(refined)

    page = output / "report.html"
    yield Step(
        command="report",
        reads=[*reported, torques] if torque_words else reported,
        writes=[page],
        words=["-o", page, *torque_words, "--", *reported],
    )


def _urdf_of(robot_file: Path) -> list[Path]:
    """Return the URDF that a robot file names, if it names one."""
    from seqid_cli.robot.toml import read_robot_file

    name = read_robot_file(robot_file)[0].urdf
    return [] if name is None else [robot_file.parent / name]


def _outcome(step: Step, record: Record, runner: StepRunner, *, force: bool) -> Outcome:
    """Run a step, or keep its result where no file and no option has changed."""
    screen = runner.screen
    earlier = None
    if not force:
        earlier = record.kept(step.deciding_line, step.reads, step.writes)

    if earlier is None:
        screen.note(f"--- {step.command}")
        is_partial = runner.run(step.command_line) == EXIT_PARTIAL
        record.add(step.deciding_line, step.reads, step.writes, partial=is_partial)
    else:
        is_partial = earlier.partial
        screen.note(
            f"{step.command}: {step.result} is of the same logs and options, kept"
        )

    judgement = judged(step.result)
    if earlier is not None:  # a step that runs says so itself
        for reason in judgement.reasons:
            screen.note(f"{step.command}: {judgement.level}: {reason}")
    return Outcome(
        step=step,
        level=judgement.level,
        summary=judgement.summary,
        reasons=judgement.reasons,
        is_kept=earlier is not None,
        is_partial=is_partial,
    )


@dataclass(frozen=True)
class Judgement:
    """The verdict of a result, what a table shows of it, and why it is no better."""

    level: Level | None
    summary: str
    reasons: Sequence[str] = ()


def judged(path: Path) -> Judgement:
    """Return the judgement of a result's file.

    Of a parameter file the newest part counts, after which it is named; what a
    diagnosis says is no verdict on the model's use.
    """
    if path.suffix != ".json":
        return Judgement(None, "-")
    from seqid_cli.params.io import read_any

    (source,) = read_any([path])
    document: Any = source.content
    if isinstance(document, DiagnosisFile):
        return Judgement(None, document.verdict)

    verdicts: list[Verdict]
    level: Level | None = None
    if isinstance(document, ParameterFile) and document.closed_loop is not None:
        verdicts = document.closed_loop.verdicts
        level = document.closed_loop.verdict
    elif isinstance(document, ParameterFile):
        verdicts = getattr(document.stages, path.stem).verdicts
    else:
        verdicts = document.verdicts
    level = _worst([level, worst_level(verdicts)])

    reasons = []
    for verdict in verdicts:
        if verdict.level != "good":
            place = f"{verdict.joint}: " if verdict.joint else ""
            reasons.append(f"{place}{verdict.reason}")
    return Judgement(level, level or "-", reasons)


def _worst(levels: Sequence[Level | None]) -> Level | None:
    """Return the worst of some levels, None without any."""
    of_judged = [level for level in levels if level is not None]
    return max(of_judged, key=LEVELS.index, default=None)


def _show_outcomes(screen: Screen, outcomes: Sequence[Outcome], *, strict: bool) -> int:
    """Print what came of each step, the worst verdict last; return the exit code."""
    worst = _worst([outcome.level for outcome in outcomes])
    rows = []
    steps = []
    for outcome in outcomes:
        command = outcome.step.command
        result = str(outcome.step.result)
        rows.append(
            (command, outcome.summary, result, "kept" if outcome.is_kept else "made")
        )
        steps.append(
            {
                "command": command,
                "output": result,
                "verdict": outcome.summary,
                "good": outcome.level in (None, "good"),
                "kept": outcome.is_kept,
                "partial": outcome.is_partial,
            }
        )
    screen.table(("step", "verdict", "file", ""), rows)
    screen.document({"verdict": worst, "steps": steps})

    line = f"run: {worst or 'nothing was judged'}"
    if worst not in (None, "good"):
        commands = [x.step.command for x in outcomes if x.level == worst]
        line += f": {', '.join(commands)}"
    screen.result(line)

    if worst == "poor" or (strict and worst != "good"):
        return EXIT_UNTRUSTED
    is_partial = any(outcome.is_partial for outcome in outcomes)
    return EXIT_PARTIAL if is_partial else EXIT_DONE
