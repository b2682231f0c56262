"""One page about many robots: the verdict on each, its errors, and what is open."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

from markupsafe import Markup

from seqid_cli.params.dates import created_from
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.report import TITLES
from seqid_cli.params.results.tables import of_joints
from seqid_cli.report.chart import dots
from seqid_cli.report.collection import Collection, collect
from seqid_cli.report.judgement import Judgement, judge
from seqid_cli.report.views import Group, Page, Section, Table, table
from seqid_cli.report.words import listed, plural

# worst first
_BADGES = {"poor": "poor", "not_judged": "", "reservations": "open", "good": "good"}


class _Robot(NamedTuple):
    """A robot, its documents and their verdict."""

    name: str
    found: Collection
    judgement: Judgement

    @property
    def errors(self) -> dict[str, tuple[float, float]]:
        """Of each joint RMS error and share of the torque."""
        return {
            joint: (error.rmse, error.relative_rmse)
            for prediction in self.found.predictions[:1]
            for joint, error in prediction.content.joints.items()
            if error.rmse is not None and error.relative_rmse is not None
        }


def fleet_page(
    robots: Mapping[str, Sequence[Source[Document]]], *, title: str = ""
) -> Page:
    """Return the page on `robots`, documents by name, with the verdict on the worst of them."""
    found = {name: collect(documents) for name, documents in robots.items()}
    judged = [_Robot(name, own, judge(own)) for name, own in found.items()]
    judged.sort(key=lambda robot: list(_BADGES).index(robot.judgement.level))
    by_level = groupby(judged, key=lambda robot: robot.judgement.level)
    said = [
        f"{TITLES[k].lower()}: {listed([own.name for own in of])}" for k, of in by_level
    ]
    points = [
        p for robot in judged for p in robot.judgement.points if p.weight == "poor"
    ]
    sentence = f"{plural(len(judged), 'robot')}. {'; '.join(said).capitalize()}."
    whole = Judgement(judged[0].judgement.level, sentence, (), tuple(points))
    groups = [_group(place, robot) for place, robot in enumerate(judged, start=1)]
    return Page(
        title or plural(len(robots), "robot"),
        [plural(sum(len(robot.found.sources) for robot in judged), "file")],
        whole,
        [_overview(judged, whole), Section("robots", "Robot by robot", groups=groups)],
        ", ".join(robots),
        [item.path for documents in robots.values() for item in documents],
        created_from(
            item.content for documents in robots.values() for item in documents
        ),
        subject="Fleet",
    )


def _overview(robots: Sequence[_Robot], whole: Judgement) -> Section:
    rows, shares = [], {}
    for place, robot in enumerate(robots, start=1):
        name, judgement, errors = robot.name, robot.judgement, robot.errors
        worst = max(errors, key=lambda joint: errors[joint][1], default=None)
        share = errors[worst][1] if worst else None
        link = Markup('<a href="#robot-{}">{}</a>').format(place, name)
        rows.append((link, judgement.title, share, worst, len(judgement.points)))
        if errors:
            shares[name] = [("after", 100.0 * share) for _, share in errors.values()]
    titles = "robot | verdict | largest error, of RMS torque | at | open points"
    x_title, legend = (
        "RMS error of each joint, % of its RMS torque",
        {"after": "a joint"},
    )
    group = Group(
        "fleet",
        "The robots, the worst first",
        figures=[dots("Errors of all robots", shares, x_title, legend)],
        tables=[
            table("Models and their errors", titles, "text text share text count", rows)
        ],
        unfolded=True,
    )
    return Section(
        "verdict", f"The fleet: {whole.title.lower()}", whole.sentence, [group]
    )


def _group(place: int, robot: _Robot) -> Group:
    rows = [(name, *error) for name, error in robot.errors.items()]
    titles, kinds = "joint | RMS error [{unit}] | of RMS torque", "text number share"
    errors = of_joints(titles, kinds, rows, robot.found.robot)
    return Group(
        f"robot-{place}",
        robot.name,
        lead=robot.judgement.sentence,
        badge=_BADGES[robot.judgement.level],
        badge_text=robot.judgement.title,
        tables=[Table(f"Errors of {robot.name}", errors)],
        notes=[point.said for point in robot.judgement.points],
    )
