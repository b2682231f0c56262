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


class _JointError(NamedTuple):
    """RMS error of a joint [N m], and its share of the RMS torque."""

    rmse: float
    share: float


class _Robot(NamedTuple):
    """A robot, its documents and their verdict."""

    name: str
    collection: Collection
    judgement: Judgement

    @property
    def errors(self) -> dict[str, _JointError]:
        """Errors of each joint by the best model."""
        if not self.collection.predictions:
            return {}
        prediction = self.collection.predictions[0].content
        return {
            joint: _JointError(error.rmse, error.relative_rmse)
            for joint, error in prediction.joints.items()
            if error.rmse is not None and error.relative_rmse is not None
        }


def fleet_page(
    robots: Mapping[str, Sequence[Source[Document]]], *, title: str = ""
) -> Page:
    """Return the page on many robots, with the verdict on the worst of them.

    Parameters
    ----------
    robots : mapping of str to sequence of Source
        Documents by the name of the robot.
    title : str
        Instead of the number of robots.

    Returns
    -------
    Page
    """
    # All documents are collected before any is judged: faults of files come first.
    collections = {name: collect(documents) for name, documents in robots.items()}
    judged = [
        _Robot(name, collection, judge(collection))
        for name, collection in collections.items()
    ]
    worst_first = list(_BADGES)
    judged.sort(key=lambda robot: worst_first.index(robot.judgement.level))

    judgement = _judgement(judged)
    groups = [_group(place, robot) for place, robot in enumerate(judged, start=1)]
    n_files = sum(len(robot.collection.sources) for robot in judged)
    sources = [source for documents in robots.values() for source in documents]
    return Page(
        title=title or plural(len(robots), "robot"),
        about=[plural(n_files, "file")],
        judgement=judgement,
        sections=[
            _overview(judged, judgement),
            Section(id="robots", title="Robot by robot", groups=groups),
        ],
        robot=", ".join(robots),
        files=[source.path for source in sources],
        created=created_from(source.content for source in sources),
        subject="Fleet",
    )


def _judgement(robots: Sequence[_Robot]) -> Judgement:
    """Return the verdict on the worst of the robots, which come worst first."""
    verdicts = []
    for level, group in groupby(robots, key=lambda robot: robot.judgement.level):
        names = [robot.name for robot in group]
        verdicts.append(f"{TITLES[level].lower()}: {listed(names)}")
    sentence = f"{plural(len(robots), 'robot')}. {'; '.join(verdicts).capitalize()}."
    points = []
    for robot in robots:
        points += [p for p in robot.judgement.points if p.weight == "poor"]
    return Judgement(robots[0].judgement.level, sentence, (), tuple(points))


def _overview(robots: Sequence[_Robot], judgement: Judgement) -> Section:
    """Return the section with the verdict, and all robots at a glance."""
    rows = []
    dots_of_robot = {}
    for place, robot in enumerate(robots, start=1):
        errors = robot.errors
        worst = max(errors, key=lambda joint: errors[joint].share, default=None)
        largest_share = errors[worst].share if worst else None
        link = Markup('<a href="#robot-{}">{}</a>').format(place, robot.name)
        n_points = len(robot.judgement.points)
        rows.append((link, robot.judgement.title, largest_share, worst, n_points))
        if errors:
            dots_of_robot[robot.name] = [
                ("after", 100.0 * error.share) for error in errors.values()
            ]

    errors_figure = dots(
        "Errors of all robots",
        dots_of_robot,
        "RMS error of each joint, % of its RMS torque",
        {"after": "a joint"},
    )
    models_table = table(
        "Models and their errors",
        "robot | verdict | largest error, of RMS torque | at | open points",
        "text text share text count",
        rows,
    )
    group = Group(
        id="fleet",
        title="The robots, the worst first",
        figures=[errors_figure],
        tables=[models_table],
        unfolded=True,
    )
    return Section(
        id="verdict",
        title=f"The fleet: {judgement.title.lower()}",
        lead=judgement.sentence,
        groups=[group],
    )


def _group(place: int, robot: _Robot) -> Group:
    """Return the group on one robot."""
    errors = of_joints(
        "joint | RMS error [{unit}] | of RMS torque",
        "text number share",
        [(joint, error.rmse, error.share) for joint, error in robot.errors.items()],
        robot.collection.robot,
    )
    return Group(
        id=f"robot-{place}",
        title=robot.name,
        lead=robot.judgement.sentence,
        badge=_BADGES[robot.judgement.level],
        badge_text=robot.judgement.title,
        tables=[Table(caption=f"Errors of {robot.name}", values=errors)],
        notes=[point.said for point in robot.judgement.points],
    )
