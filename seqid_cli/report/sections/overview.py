"""The head of the page: the verdict, its grounds, gaps, the joints at a glance."""

from __future__ import annotations

from markupsafe import Markup

from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import drawing
from seqid_cli.report.figures.svg import rect
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section, Table, badge, badge_text, table
from seqid_cli.report.words import number, percent, short_path


def overview(collection: Collection, judgement: Judgement) -> Section:
    """Return the section with the verdict."""
    return Section("verdict", "Verdict", judgement=judgement, glance=_glance(collection))


def _glance(collection: Collection) -> Table | None:
    if not collection.predictions:
        return None
    used = collection.predictions[0]
    made = ", ".join(short_path(item.path) for item in used.content.parameters)
    caption = f"Predicted torque, joint by joint ({short_path(used.path)}, made with {made})"
    errors, rows = used.content.joints, []
    largest = max([0.01, *(error.relative_rmse or 0.0 for error in errors.values())])
    for k, name in enumerate(collection.robot.joints, start=1):
        if name not in errors:
            continue
        error, floor = errors[name], collection.noise_floor(used, name)
        share, unit = error.relative_rmse, collection.place(name).unit
        state = badge([verdict for verdict in used.content.verdicts if verdict.joint == name])
        rows.append(
            (
                Markup('<a href="#torque-{}">{}</a>').format(k, name),
                None if error.rmse is None else f"{number(error.rmse)} {unit}",
                share,
                "" if share is None else _bar(name, share, largest, state),
                None if floor is None else f"{number(floor)} {unit}",
                badge_text(state, state or "not judged"),
            )
        )
    titles = "joint | RMS error | of RMS torque | drawn | noise floor | verdict"
    return table(caption, titles, "text number share text number text", rows, style="glance")


def _bar(name: str, share: float, largest: float, state: str) -> Markup:
    width = max(100.0 * min(share / largest, 1.0), 1.0)
    bar = rect(f"bar {state}", 0, 2, width, 8)
    return drawing(100, 12, f"Error of {name}", percent(share), [bar], style="glyph")
