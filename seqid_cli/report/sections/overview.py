"""The head of the page: the verdict, its grounds, gaps, the joints at a glance."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import drawing
from seqid_cli.report.figures.svg import rect
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section
from seqid_cli.report.words import number, percent, short_path, unit_text


@dataclass(frozen=True)
class JointRow:
    """One joint at a glance."""

    name: str
    link: str
    error: str
    relative: str
    bar: Markup | None
    floor: str
    badge: str
    badge_text: str


def overview(collection: Collection, judgement: Judgement) -> Section:
    """Return the section with the verdict."""
    rows = _rows(collection)
    used = collection.predictions[0] if collection.predictions else None
    caption = ""
    if used is not None:
        made = ", ".join(short_path(item.path) for item in used.file.parameters)
        caption = f"Predicted torque, joint by joint ({short_path(used.path)}, made with {made})"
    data: dict[str, object] = {"judgement": judgement, "rows": rows, "caption": caption}
    return Section("verdict", "Verdict", template="verdict.html.j2", data=data)


def _rows(collection: Collection) -> list[JointRow]:
    if not collection.predictions:
        return []
    errors = collection.predictions[0].file.joints
    verdicts = {v.joint: v for v in collection.predictions[0].file.verdicts}
    shares = [error.relative_rmse or 0.0 for error in errors.values()]
    largest = max([*shares, 0.01])
    rows = []
    for name in collection.robot.joints:
        error = errors.get(name)
        if error is None:
            continue
        unit = unit_text(collection.units(name)[0])
        verdict, share = verdicts.get(name), error.relative_rmse
        state = "" if verdict is None else ("good" if verdict.good else "poor")
        floor = collection.noise_floor(collection.predictions[0], name)
        rows.append(
            JointRow(
                name=name,
                link=f"torque-{collection.robot.joints.index(name) + 1}",
                error=f"{number(error.rmse)} {unit}" if error.rmse is not None else number(None),
                relative=percent(share),
                bar=None if share is None else _bar(name, share, largest, state),
                floor=f"{number(floor)} {unit}" if floor is not None else number(None),
                badge=state,
                badge_text=state or "not judged",
            )
        )
    return rows


def _bar(name: str, share: float, largest: float, state: str) -> Markup:
    width = max(100.0 * min(share / largest, 1.0), 1.0)
    bar = rect(f"bar {state}", 0, 2, width, 8)
    return drawing(100, 12, f"Error of {name}", percent(share), [bar], style="glyph")
