"""The head of the page: the verdict, its grounds, gaps, the joints at a glance."""

from __future__ import annotations

from markupsafe import Markup

from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import drawing
from seqid_cli.report.figures.svg import rect
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section, Table, badge_text, numbers, texts
from seqid_cli.report.words import number, percent, short_path, unit_text


def overview(collection: Collection, judgement: Judgement) -> Section:
    """Return the section with the verdict."""
    data: dict[str, object] = {"judgement": judgement, "table": _glance(collection)}
    return Section("verdict", "Verdict", template="verdict.html.j2", data=data)


def _glance(collection: Collection) -> Table | None:
    if not collection.predictions:
        return None
    used = collection.predictions[0]
    made = ", ".join(short_path(item.path) for item in used.file.parameters)
    caption = f"Predicted torque, joint by joint ({short_path(used.path)}, made with {made})"
    errors, verdicts = used.file.joints, {v.joint: v for v in used.file.verdicts}
    largest = max([0.01, *(error.relative_rmse or 0.0 for error in errors.values())])
    rows = []
    for place, name in enumerate(collection.robot.joints):
        if name not in errors:
            continue
        share, verdict = errors[name].relative_rmse, verdicts.get(name)
        state = "" if verdict is None else ("good" if verdict.good else "poor")
        rows.append(
            (
                Markup('<a href="#torque-{}">{}</a>').format(place + 1, name),
                _with_unit(errors[name].rmse, collection, name),
                percent(share),
                "" if share is None else _bar(name, share, largest, state),
                _with_unit(collection.noise_floor(used, name), collection, name),
                badge_text(state, state or "not judged"),
            )
        )
    columns = (
        *texts("joint"),
        *numbers("RMS error", "of RMS torque"),
        *texts("drawn"),
        *numbers("noise floor"),
        *texts("verdict"),
    )
    return Table(caption, columns, rows, style="glance")


def _with_unit(value: float | None, collection: Collection, joint: str) -> str:
    return (
        number(None)
        if value is None
        else f"{number(value)} {unit_text(collection.units(joint)[0])}"
    )


def _bar(name: str, share: float, largest: float, state: str) -> Markup:
    width = max(100.0 * min(share / largest, 1.0), 1.0)
    bar = rect(f"bar {state}", 0, 2, width, 8)
    return drawing(100, 12, f"Error of {name}", percent(share), [bar], style="glyph")
