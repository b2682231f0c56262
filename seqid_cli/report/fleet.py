"""One page about many robots: the verdict on each, its errors, and what is open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from seqid_cli.params.io import Source
from seqid_cli.params.results.report import TITLES
from seqid_cli.report.collection import Collection, collect
from seqid_cli.report.figures.row_chart import RowChart
from seqid_cli.report.judgement import Judgement, Level, judge
from seqid_cli.report.page import render
from seqid_cli.report.views import Figure, Group, Key, Section, Table, numbers, texts
from seqid_cli.report.words import DASH, listed, number, percent, plural, unit_text

_WORST: tuple[Level, ...] = ("poor", "not_judged", "reservations", "good")
_BADGES = {"good": "good", "reservations": "open", "poor": "poor", "not_judged": ""}
Judged = tuple[str, Collection, Judgement]


def fleet_page(
    robots: Mapping[str, Sequence[Source]], *, title: str = ""
) -> tuple[str, Judgement, list[Section]]:
    """Return the page, the verdict on the worst robot, and the sections.

    `robots`: the documents of each robot, by its name. `title`: instead of the number of robots.
    Raises ConfigError: the documents of a robot contradict each other.
    """
    collections = {name: collect(documents) for name, documents in robots.items()}
    judged = [(name, found, judge(found)) for name, found in collections.items()]
    judged.sort(key=lambda item: _WORST.index(item[2].level))
    whole = _judged(judged)
    groups = [_robot(place, *item) for place, item in enumerate(judged)]
    sections = [_overview(judged, whole), Section("robots", "Robot by robot", groups=groups)]
    about = [plural(sum(len(found.sources) for found in collections.values()), "file")]
    name = title or plural(len(robots), "robot")
    return render(name, about, whole, sections, subject="Fleet"), whole, sections


def _judged(robots: Sequence[Judged]) -> Judgement:
    said = []
    for level in _WORST:
        names = [name for name, _, judgement in robots if judgement.level == level]
        if names:
            said.append(f"{TITLES[level].lower()}: {listed(names)}")
    points = tuple(point for *_, one in robots for point in one.points if point.weight == "poor")
    sentence = f"{plural(len(robots), 'robot')}. {'; '.join(said).capitalize()}."
    return Judgement(robots[0][2].level, sentence, (), points)


def _errors(found: Collection) -> dict[str, tuple[float, float]]:
    """RMS error and its share of the RMS torque for each joint that was judged."""
    joints = found.predictions[0].file.joints if found.predictions else {}
    return {
        name: (error.rmse, error.relative_rmse)
        for name, error in joints.items()
        if error.rmse is not None and error.relative_rmse is not None
    }


def _overview(robots: Sequence[Judged], whole: Judgement) -> Section:
    columns = (
        *texts("robot", "verdict"),
        *numbers("largest error", unit="of RMS torque"),
        *texts("at"),
        *numbers("open points"),
    )
    rows = []
    for place, (name, found, judgement) in enumerate(robots):
        shares = {joint: share for joint, (_, share) in _errors(found).items()}
        worst = max(shares, key=lambda joint: shares[joint], default=None)
        error = percent(shares[worst]) if worst else DASH
        link = Markup('<a href="#robot-{}">{}</a>').format(place + 1, name)
        count = str(len(judgement.points))
        rows.append((link, judgement.title, error, worst or DASH, count))
    group = Group(
        "fleet",
        "The robots, the worst first",
        figures=_figures(robots),
        tables=[Table("Models and their errors", columns, rows)],
        unfolded=True,
    )
    title = f"The fleet: {TITLES[whole.level].lower()}"
    return Section("verdict", title, whole.sentence, [group])


def _figures(robots: Sequence[Judged]) -> list[Figure]:
    shown = {name: [share for _, share in _errors(found).values()] for name, found, _ in robots}
    shown = {name: shares for name, shares in shown.items() if shares}
    if not shown:
        return []
    far = 100.0 * max(map(max, shown.values()))
    chart = RowChart(list(shown), far, "RMS error of each joint, % of its RMS torque")
    for row, shares in enumerate(shown.values()):
        chart.link(row, 100.0 * min(shares), 100.0 * max(shares), "dumbbell")
        for share in shares:
            chart.dot(row, 100.0 * share, "after")
    title = "Errors of all robots"
    text = "; ".join(f"{name}: up to {percent(max(shares))}" for name, shares in shown.items())
    return [Figure(title, chart.render(title, f"{text}."), [Key("after", "a joint")], wide=True)]


def _robot(place: int, name: str, found: Collection, judgement: Judgement) -> Group:
    columns = (*texts("joint"), *numbers("RMS error"), *texts("unit"), *numbers("of RMS torque"))
    rows = [
        (joint, number(rmse), unit_text(found.units(joint)[0]), percent(share))
        for joint, (rmse, share) in _errors(found).items()
    ]
    return Group(
        f"robot-{place + 1}",
        name,
        lead=judgement.sentence,
        badge=_BADGES[judgement.level],
        badge_text=judgement.title,
        tables=[Table(f"Errors of {name}", columns, rows)],
        notes=[point.said for point in judgement.points],
    )
