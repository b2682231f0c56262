"""One page about one robot, from the documents that the commands wrote."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from seqid_cli.errors import InputError, UsageError
from seqid_cli.params.dates import created_from
from seqid_cli.params.io import Document, Source
from seqid_cli.report.collection import Collection, collect
from seqid_cli.report.judgement import judge
from seqid_cli.report.sections.diagnosis import closed_loop, diagnosis
from seqid_cli.report.sections.friction import friction
from seqid_cli.report.sections.imu import imu
from seqid_cli.report.sections.parameters import parameters
from seqid_cli.report.sections.pipeline import overview, pipeline
from seqid_cli.report.sections.results import payload, plan
from seqid_cli.report.sections.torque import torque
from seqid_cli.report.torques import TorqueTable
from seqid_cli.report.views import Page
from seqid_cli.report.words import plural


def make_report(
    documents: Sequence[Source[Document]],
    *,
    torques: Sequence[Path] = (),
    title: str = "",
) -> Page:
    """Make the page about one robot from the documents of `read_any`.

    `torques`: what `seqid predict --torques` wrote, a file for each prediction; for
    those without one the `torques.parquet` beside it is taken if it holds exactly its
    logs. `title`: instead of the robot's name. Raises ConfigError: the documents are
    about two robots or contradict each other. Raises InputError: a torque file is
    unreadable or of another robot, log or model.
    """
    collection = collect(documents)
    tables, notes = open_torques(torques, collection)
    judgement = judge(collection)
    sections = [overview(collection, judgement), pipeline(collection)]
    sections.append(torque(collection, tables, notes))
    sections += [
        make(collection) for make in (friction, parameters, imu, diagnosis, closed_loop)
    ]
    # None where no file of one is given
    results = (payload(collection), plan(collection))
    robot = collection.robot
    return Page(
        title or robot.name,
        [plural(len(robot.joints), "joint"), f"robot file {robot.sha256[:12]}"],
        judgement,
        [*sections, *filter(None, results)],
        robot.name,
        [item.path for item in collection.sources],
        created_from(item.content for item in documents),
        torques=[table.path for table in tables],
        warnings=collection.warnings,
    )


def open_torques(
    paths: Sequence[Path], collection: Collection
) -> tuple[list[TorqueTable], list[str]]:
    """Open a torque table for each prediction, in their order; say which ones were found."""
    tables = [TorqueTable.open(path, collection) for path in paths]
    whose = [table.prediction for table in tables]
    if doubled := [
        t.path for t in tables if t.prediction and whose.count(t.prediction) > 1
    ]:
        message = f"torque files of one prediction: {', '.join(doubled)}"
        raise UsageError(message, hint="Name the one that belongs to it.")
    notes = []
    for prediction in collection.predictions:
        if prediction not in whose:
            path, alone = (
                Path(prediction.path).with_name("torques.parquet"),
                (prediction,),
            )
            with suppress(InputError):  # it is not there, or of another prediction
                tables.append(
                    TorqueTable.open(path, replace(collection, predictions=alone))
                )
                notes.append(f"The torques are those of {path}, beside the prediction.")
    order = [*collection.predictions, None]
    return sorted(tables, key=lambda table: order.index(table.prediction)), notes
