"""One page about one robot, from the documents that the commands wrote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.params.io import Source
from seqid_cli.report.collection import Collection, collect
from seqid_cli.report.judgement import Judgement, judge
from seqid_cli.report.page import render
from seqid_cli.report.sections.diagnosis import diagnosis
from seqid_cli.report.sections.friction import friction
from seqid_cli.report.sections.imu import imu
from seqid_cli.report.sections.loop import closed_loop
from seqid_cli.report.sections.overview import overview
from seqid_cli.report.sections.parameters import parameters
from seqid_cli.report.sections.payload import payload
from seqid_cli.report.sections.pipeline import pipeline
from seqid_cli.report.sections.plan import plan
from seqid_cli.report.sections.torque import torque
from seqid_cli.report.torques import TorqueTable, find_torques, matches
from seqid_cli.report.words import plural


@dataclass(frozen=True)
class Report:
    """A finished page, its verdict and its sections.

    `sections` maps the id of each section to whether all its data were given; `torques` is the
    torque file that was used ("" for none).
    """

    html: str
    collection: Collection
    judgement: Judgement
    sections: dict[str, bool]
    torques: str


def make_report(
    documents: Sequence[Source], *, torques: Path | None = None, title: str = ""
) -> Report:
    """Make the report: one self-contained HTML text, its verdict and its sections.

    Parameters
    ----------
    documents : sequence of Source
        Parameter files and results about one robot, from `read_any`.
    torques : Path, optional
        What `seqid predict --torques` wrote; left out, the `torques.parquet` beside the
        prediction is taken if it holds exactly its logs.
    title : str
        Instead of the robot's name.

    Raises
    ------
    ConfigError
        The documents are about two robots or contradict each other.
    InputError
        The torque file is unreadable or belongs to another robot or other logs.
    """
    collection = collect(documents)
    path = torques or _beside(collection)
    table = TorqueTable.open(path, collection) if path is not None else None
    note = ""
    if table is not None and torques is None:
        note = f"The torques are those of {table.path}, which lies beside the prediction."
    judgement = judge(collection)
    used = table.path if table else ""
    made = [
        overview(collection, judgement),
        pipeline(collection, used),
        torque(collection, table, note),
        friction(collection),
        parameters(collection),
        imu(collection),
        diagnosis(collection),
        closed_loop(collection),
        payload(collection),
        plan(collection),
    ]
    sections = [section for section in made if section is not None]
    robot = collection.robot
    about = [plural(len(robot.joints), "joint"), f"robot file {robot.sha256[:12]}"]
    html = render(title or robot.name, about, judgement, sections)
    whole = {
        section.id: not section.absent and not any(group.absent for group in section.groups)
        for section in sections
    }
    return Report(html, collection, judgement, whole, used)


def _beside(collection: Collection) -> Path | None:
    for prediction in collection.predictions:
        path = find_torques(prediction.path)
        if path is not None and matches(path, prediction.file):
            return path
    return None
