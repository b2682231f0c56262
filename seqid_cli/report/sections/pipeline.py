"""The head of the page with the joints at a glance; the files behind it and who made them."""

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
    if not collection.predictions:
        return Section("verdict", "Verdict", judgement=judgement)
    used = collection.predictions[0]
    made = ", ".join(short_path(item.path) for item in used.content.parameters)
    errors, rows = used.content.joints, []
    largest = max([0.01, *(error.relative_rmse or 0.0 for error in errors.values())])
    for k, name in enumerate(collection.robot.joints, start=1):
        if name not in errors:
            continue
        error, entry = errors[name], collection.residual(used, name)
        share, unit = error.relative_rmse, collection.place(name).unit
        floor = None if entry is None else entry.noise_floor
        state = badge(
            [verdict for verdict in used.content.verdicts if verdict.joint == name]
        )
        width = 100.0 * min((share or 0.0) / largest, 1.0)
        bar = element("rect", class_=f"bar {state}", y=2, width=width, height=8)
        named = (element("title", f"Error of {name}"), element("desc", percent(share)))
        link = Markup('<a href="#torque-{}">{}</a>').format(k, name)
        drawn = element(
            "svg", *named, bar, class_="glyph", viewBox="0 0 100 12", role="img"
        )
        rmse, noise = (
            None if x is None else f"{number(x)} {unit}" for x in (error.rmse, floor)
        )
        told = Markup('<span class="badge {}">{}</span>')
        verdict = told.format(state or "none", state or "not judged")
        rows.append((link, rmse, share, drawn, noise, verdict))
    caption = (
        f"Predicted torque, joint by joint ({short_path(used.path)}, made with {made})"
    )
    titles = "joint | RMS error | of RMS torque | drawn | noise floor | verdict"
    kinds = "text number share text number text"
    glance = Table(caption, values(titles, kinds, rows), style="glance")
    return Section("verdict", "Verdict", judgement=judgement, glance=glance)


def pipeline(collection: Collection) -> Section:
    """Return the section on files and commands."""
    titles = "file | made by | from | holds | written | version | SHA-256"
    rows, kinds = map(_file, collection.sources), "text text text text text text text"
    return Section(
        "pipeline",
        "Pipeline and files",
        lead=(
            "Each step builds on the one before. Hashes are SHA-256; two files with the"
            " same hash are the same to the last bit."
        ),
        tables=[
            table("The files of this report", titles, kinds, rows),
            _logs(collection),
        ],
    )


def _file(item: Source[Document]) -> Sequence[str]:
    content = item.content
    logs = [] if isinstance(content, PlanFile) else content.inputs
    samples = _thousands(sum(log.samples for log in logs))
    reads = f"{plural(len(logs), 'log')}, {samples} samples" if logs else ""
    if isinstance(content, ParameterFile):
        stages = present(content.stages)
        kind, holds = kind_of(content), ", ".join(stages)
        made = {"refined": "refine", "simultaneous": "simultaneous"}
        command = made.get(kind) or COMMAND_OF[next(reversed(stages), "friction")]
    else:
        used = [f"of {file_name(x.path)} {x.sha256[:12]}" for x in models_of(content)]
        command, holds = WRITTEN_BY[type(content)], ", ".join(used)
    tool = f"{content.tool.name} {content.tool.version}"
    return (
        item.path,
        f"seqid {command}",
        reads,
        holds,
        content.created,
        tool,
        item.sha256,
    )


def _logs(collection: Collection) -> Table:
    found: dict[tuple[str, str, str], InputLog] = {}
    for item in collection.sources:
        content = item.content
        default = WRITTEN_BY.get(type(content), "refine")
        for log in [] if isinstance(content, PlanFile) else content.inputs:
            by = COMMAND_OF.get(log.stage, log.stage) or default
            found.setdefault((by, log.sha256, log.path), log)
        if isinstance(content, ParameterFile) and content.closed_loop is not None:
            for log in content.closed_loop.held_out:
                found.setdefault(("refine, held out", log.sha256, log.path), log)
    rows = [
        (by, x.path, _thousands(x.samples), x.sha256) for (by, *_), x in found.items()
    ]
    note = f"and {len(rows) - _MOST_LOGS} more" if len(rows) > _MOST_LOGS else ""
    titles, kinds = "read by | log | samples | SHA-256", "text text count text"
    return Table("The logs behind them", values(titles, kinds, rows[:_MOST_LOGS]), note)


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")
