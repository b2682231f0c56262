"""The head of the page with the joints at a glance; the files behind it."""

from collections.abc import Sequence

from markupsafe import Markup

from seqid_cli.params.document import COMMAND_OF, present
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.results.tables import values
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.report.chart import element
from seqid_cli.report.collection import WRITTEN_BY, Collection, kind_of, models_of
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section, Table, badge, table
from seqid_cli.report.words import file_name, number, percent, plural, short_path

_MOST_LOGS = 500


def overview(collection: Collection, judgement: Judgement) -> Section:
    """Return the section with the verdict, and the joints at a glance."""
    glance = _glance(collection) if collection.predictions else None
    return Section(id="verdict", title="Verdict", judgement=judgement, glance=glance)


def _glance(collection: Collection) -> Table:
    """Return a table of all joints with their errors by the best model."""
    prediction = collection.predictions[0]
    file = prediction.content
    shares = [error.relative_rmse or 0.0 for error in file.joints.values()]
    full_bar = max([0.01, *shares])

    rows = []
    for place, name in enumerate(collection.robot.joints, start=1):
        if name not in file.joints:
            continue
        error = file.joints[name]
        unit = collection.place(name).unit
        residual = collection.residual(prediction, name)
        noise_floor = None if residual is None else residual.noise_floor
        state = badge([verdict for verdict in file.verdicts if verdict.joint == name])
        verdict = Markup('<span class="badge {}">{}</span>').format(
            state or "none", state or "not judged"
        )
        row = (
            Markup('<a href="#torque-{}">{}</a>').format(place, name),
            _with_unit(error.rmse, unit),
            error.relative_rmse,
            _bar(name, error.relative_rmse, full_bar, state),
            _with_unit(noise_floor, unit),
            verdict,
        )
        rows.append(row)

    parameters = ", ".join(short_path(item.path) for item in file.parameters)
    caption = (
        f"Predicted torque, joint by joint ({short_path(prediction.path)}, made with"
        f" {parameters})"
    )
    titles = "joint | RMS error | of RMS torque | drawn | noise floor | verdict"
    kinds = "text number share text number text"
    return Table(caption=caption, values=values(titles, kinds, rows), style="glance")


def _with_unit(value: float | None, unit: str) -> str | None:
    return None if value is None else f"{number(value)} {unit}"


def _bar(name: str, share: float | None, full: float, state: str) -> Markup:
    """Return a bar as long as a joint's share of the `full` one."""
    width = 100.0 * min((share or 0.0) / full, 1.0)
    return element(
        "svg",
        element("title", f"Error of {name}"),
        element("desc", percent(share)),
        element("rect", class_=f"bar {state}", y=2, width=width, height=8),
        class_="glyph",
        viewBox="0 0 100 12",
        role="img",
    )


def pipeline(collection: Collection) -> Section:
    """Return the section on files and commands."""
    files = table(
        "The files of this report",
        "file | made by | from | holds | written | version | SHA-256",
        "text text text text text text text",
        [_file_row(source) for source in collection.sources],
    )
    return Section(
        id="pipeline",
        title="Pipeline and files",
        lead=(
            "Each step builds on the one before. Hashes are SHA-256; two files with the"
            " same hash are the same to the last bit."
        ),
        tables=[files, _logs_table(collection)],
    )


def _file_row(source: Source[Document]) -> Sequence[str]:
    """Return what a file is, as a row of the table of files."""
    content = source.content
    logs = _logs_of(content)
    reads = ""
    if logs:
        samples = _thousands(sum(log.samples for log in logs))
        reads = f"{plural(len(logs), 'log')}, {samples} samples"

    if isinstance(content, ParameterFile):
        stages = present(content.stages)
        command = _command_of(content)
        holds = ", ".join(stages)
    else:
        command = WRITTEN_BY[type(content)]
        used = [f"of {file_name(x.path)} {x.sha256[:12]}" for x in models_of(content)]
        holds = ", ".join(used)
    return (
        source.path,
        f"seqid {command}",
        reads,
        holds,
        content.created,
        f"{content.tool.name} {content.tool.version}",
        source.sha256,
    )


def _command_of(file: ParameterFile) -> str:
    """Return the command that wrote a parameter file."""
    kind = kind_of(file)
    if kind == "refined":
        return "refine"
    if kind == "simultaneous":
        return "simultaneous"
    last_stage = next(reversed(present(file.stages)), "friction")
    return COMMAND_OF[last_stage]


def _logs_of(content: Document) -> list[InputLog]:
    """Return the logs that a document was made of."""
    return [] if isinstance(content, PlanFile) else content.inputs


def _logs_table(collection: Collection) -> Table:
    """Return the logs behind all files, each once per command that read it."""
    log_of_row: dict[tuple[str, str, str], InputLog] = {}
    for source in collection.sources:
        content = source.content
        default = WRITTEN_BY.get(type(content), "refine")
        for log in _logs_of(content):
            command = COMMAND_OF.get(log.stage, log.stage) or default
            log_of_row.setdefault((command, log.sha256, log.path), log)
        if isinstance(content, ParameterFile) and content.closed_loop is not None:
            for log in content.closed_loop.held_out:
                log_of_row.setdefault(("refine, held out", log.sha256, log.path), log)

    rows = [
        (command, log.path, _thousands(log.samples), log.sha256)
        for (command, _, _), log in log_of_row.items()
    ]
    note = f"and {len(rows) - _MOST_LOGS} more" if len(rows) > _MOST_LOGS else ""
    first_rows = values(
        "read by | log | samples | SHA-256",
        "text text count text",
        rows[:_MOST_LOGS],
    )
    return Table(caption="The logs behind them", values=first_rows, note=note)


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")
