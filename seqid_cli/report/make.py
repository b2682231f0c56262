"""One page about one robot, from the documents that the commands wrote."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from seqid_cli.errors import InputError, UsageError
from seqid_cli.params.dates import created_from
from seqid_cli.params.io import Document, Source
from seqid_cli.report.collection import Collection, collect
from seqid_cli.report.judgement import judge, judge_results
from seqid_cli.report.sections.diagnosis import closed_loop, diagnosis
from seqid_cli.report.sections.drive import drive
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
    """Make the page about one robot.

    Parameters
    ----------
    documents : sequence of Source
        What `read_any` read.
    torques : sequence of Path
        What `seqid predict --torques` wrote, a file for each prediction. For those
        without one the `torques.parquet` beside it is taken if it holds exactly its
        logs.
    title : str
        Instead of the robot's name.

    Returns
    -------
    Page

    Raises
    ------
    ConfigError
        The documents are about two robots or contradict each other.
    InputError
        A torque file is unreadable or of another robot, log or model.
    """
    collection = collect(documents)
    tables, notes = open_torques(torques, collection)
    # None where no file of one is given
    results = (drive(collection), payload(collection), plan(collection))
    sections = [section for section in results if section is not None]
    if collection.is_about_a_model:
        judgement = judge(collection)
        of_model = [
            torque(collection, tables, notes),
            friction(collection),
            parameters(collection),
            imu(collection),
            diagnosis(collection),
            closed_loop(collection),
        ]
        sections = [*of_model, *sections]
        subject = "Dynamic model"
    else:
        judgement = judge_results(collection)
        subject = " and ".join(section.title for section in sections)
    sections = [overview(collection, judgement), pipeline(collection), *sections]

    robot = collection.robot
    facts = [plural(len(robot.joints), "joint"), f"robot file {robot.sha256[:12]}"]
    return Page(
        title=title or robot.name,
        subject=subject,
        about=facts,
        judgement=judgement,
        sections=sections,
        robot=robot.name,
        files=[source.path for source in collection.sources],
        created=created_from(source.content for source in documents),
        torques=[table.path for table in tables],
        warnings=collection.warnings,
    )


def open_torques(
    paths: Sequence[Path], collection: Collection
) -> tuple[list[TorqueTable], list[str]]:
    """Open a torque table for each prediction.

    Parameters
    ----------
    paths : sequence of Path
        Torque files that are named. Those beside predictions are found.
    collection : Collection

    Returns
    -------
    tables : list of TorqueTable
        In the order of their predictions.
    notes : list of str
        Which ones were found.

    Raises
    ------
    UsageError
        Two of the files are of one prediction.
    InputError
        A file that is named is unreadable or of another robot, log or model.
    """
    tables = [TorqueTable.open(path, collection) for path in paths]
    predictions = [table.prediction for table in tables]
    doubled = [
        table.path
        for table in tables
        if table.prediction and predictions.count(table.prediction) > 1
    ]
    if doubled:
        message = f"torque files of one prediction: {', '.join(doubled)}"
        raise UsageError(message, hint="Name the one that belongs to it.")

    notes = []
    for prediction in collection.predictions:
        if prediction in predictions:
            continue
        path = Path(prediction.path).with_name("torques.parquet")
        alone = replace(collection, predictions=(prediction,))
        # It need not be there, and may be of another prediction.
        with suppress(InputError):
            tables.append(TorqueTable.open(path, alone))
            notes.append(f"The torques are those of {path}, beside the prediction.")

    # A table of no prediction comes last.
    order = [*collection.predictions, None]
    tables.sort(key=lambda table: order.index(table.prediction))
    return tables, notes
