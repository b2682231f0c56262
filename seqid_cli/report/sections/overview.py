"""The head of the page: the verdict, its grounds, gaps, the joints at a glance."""

from markupsafe import Markup

from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import drawing
from seqid_cli.report.figures.svg import rect
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section, Table, badge, badge_text, table
from seqid_cli.report.words import number, percent, short_path


def overview(collection: Collection, judgement: Judgement) -> Section:
    """Return the section with the verdict."""
    glance = _glance(collection) if collection.predictions else None
    return Section("verdict", "Verdict", judgement=judgement, glance=glance)


def _glance(collection: Collection) -> Table:
    used = collection.predictions[0]
    made = ", ".join(short_path(item.path) for item in used.content.parameters)
    caption = f"Predicted torque, joint by joint ({short_path(used.path)}, made with {made})"
    errors, rows = used.content.joints, []
    largest = max([0.01, *(error.relative_rmse or 0.0 for error in errors.values())])
    for k, name in enumerate(collection.robot.joints, start=1):
        if name not in errors:
            continue
        error, entry = errors[name], collection.residual(used, name)
        share, unit = error.relative_rmse, collection.place(name).unit
        floor = None if entry is None else entry.noise_floor
        state = badge([verdict for verdict in used.content.verdicts if verdict.joint == name])
        bar: str = ""
        if share is not None:
            width = max(100.0 * min(share / largest, 1.0), 1.0)
            mark = rect(f"bar {state}", 0, 2, width, 8)
            bar = drawing(100, 12, f"Error of {name}", percent(share), [mark], style="glyph")
        rows.append(
            (
                Markup('<a href="#torque-{}">{}</a>').format(k, name),
                None if error.rmse is None else f"{number(error.rmse)} {unit}",
                share,
                bar,
                None if floor is None else f"{number(floor)} {unit}",
                badge_text(state, state or "not judged"),
            )
        )
    titles = "joint | RMS error | of RMS torque | drawn | noise floor | verdict"
    return table(caption, titles, "text number share text number text", rows, style="glance")
