"""How well the model predicts: errors per joint, and the torque behind them."""

import math
from collections.abc import Mapping, Sequence

from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.tables import Head, Values, heads
from seqid_cli.report.collection import Collection, Place, Prediction
from seqid_cli.report.torque_figures.over_time import over_time
from seqid_cli.report.torque_figures.residual import over_quantity, spectrum
from seqid_cli.report.torques import Series, TorqueTable
from seqid_cli.report.views import Absent, Figure, Group, Section, Table, badge, table
from seqid_cli.report.words import number, percent, plural, short_path

_MOST_LOGS = 3  # with a figure each; the tables hold all
_COLUMNS = 250  # of a figure


def torque(
    collection: Collection,
    tables: Sequence[TorqueTable],
    notes_on_tables: Sequence[str] = (),
) -> Section:
    """Return the section on predicted torque.

    Parameters
    ----------
    collection : Collection
    tables : sequence of TorqueTable
        Those of the best model first.
    notes_on_tables : sequence of str
        Which of the tables were found beside their predictions.

    Returns
    -------
    Section
    """
    files = [item.content for item in collection.predictions]
    joints = {name for file in files for name in file.joints}
    for torques in tables:
        joints.update(torques.joints)

    groups = []
    if len(files) > 1:
        groups.append(_side_by_side(collection))
    for name in collection.robot.joints:
        if name in joints:
            groups.append(_joint_group(collection, tables, name))
    lead = (
        "Measured torque against what the model predicts, both low-passed alike. Errors"
        " are over samples in which the joint slides. At rest friction holds whatever"
        " balances, within an interval; there the residual that is drawn is the"
        " distance to it."
    )
    return Section(
        id="torque",
        title="Torque, joint by joint",
        lead=lead,
        groups=groups,
        absent=_absent(collection, files, tables),
        notes=[*_notes_of(files), *notes_on_tables],
    )


def _absent(
    collection: Collection,
    files: Sequence[PredictionFile],
    tables: Sequence[TorqueTable],
) -> list[Absent]:
    """Return what the section lacks, with the command that makes it."""
    # The logs that were predicted already, as far as they are easily read.
    logs = [log.path for log in files[0].logs] if files else []
    if len(logs) > 4:
        logs = []
    call = collection.call("predict", *logs, output="prediction.json")
    command = f"{call} --torques torques.parquet"

    absent = []
    if not files:
        text = "How large the errors are is not known without a prediction."
        absent.append(Absent(text, command))
    if not tables:
        text = "The torques over time are not in the files given."
        absent.append(Absent(text, command))
    return absent


def _notes_of(files: Sequence[PredictionFile]) -> list[str]:
    """Return the notes on single logs, then those on whole predictions."""
    notes = []
    for file in files:
        for log in file.logs:
            notes += [f"{short_path(log.path)}: {note}" for note in log.notes]
    for file in files:
        notes += file.notes
    return notes


def _side_by_side(collection: Collection) -> Group:
    """Return errors of the models on the logs that all of them predict."""
    # Errors compare on the same logs only.
    logs_of_predictions = [_hashes_of_logs(item) for item in collection.predictions]
    common_logs = frozenset.intersection(*logs_of_predictions)
    columns = heads("joint | unit", "text text")
    columns += [
        Head(collection.label(item), "number") for item in collection.predictions
    ]
    rows = []
    for name in collection.robot.joints:
        errors = [
            _error_on_logs(item, name, common_logs) for item in collection.predictions
        ]
        rows.append((name, collection.place(name).unit, *errors))

    errors_table = Table(
        caption="Error of each model",
        values=Values(columns, rows),
        note=(
            "RMS error, and its share of the RMS torque, on the"
            f" {plural(len(common_logs), 'log')} that all of them predict."
        ),
    )
    return Group(
        id="torque-models",
        title="Models side by side",
        tables=[errors_table],
        unfolded=True,
    )


def _hashes_of_logs(prediction: Prediction) -> frozenset[str]:
    """Return the hashes of the logs of a prediction."""
    return frozenset(log.sha256 for log in prediction.content.logs)


def _error_on_logs(
    prediction: Prediction, name: str, logs: frozenset[str]
) -> str | None:
    """Return a joint's RMS error and its share of the torque on some logs, as text."""
    samples = 0
    squared_error = 0.0
    squared_torque = 0.0
    for log in prediction.content.logs:
        if log.sha256 not in logs:
            continue
        error = log.joints[name]
        if error.rmse and error.relative_rmse:
            samples += error.samples
            squared_error += error.samples * error.rmse**2
            squared_torque += error.samples * (error.rmse / error.relative_rmse) ** 2
    if not samples:
        return None
    rms_error = math.sqrt(squared_error / samples)
    rms_torque = math.sqrt(squared_torque / samples)
    return f"{number(rms_error)} ({percent(rms_error / rms_torque)})"


def _joint_group(
    collection: Collection, tables: Sequence[TorqueTable], name: str
) -> Group:
    """Return the group on one joint."""
    place = collection.place(name)
    series, figures_over_time = over_logs(collection, tables, name, _COLUMNS)
    cutoffs_hz = [
        log.cutoff_hz for item in collection.predictions for log in item.content.logs
    ]

    verdicts = []
    for item in collection.judged:
        verdicts += [v for v in item.content.verdicts if v.joint == name]
    state = badge(verdicts)
    faults = [verdict.reason for verdict in verdicts if not verdict.good]
    notes = []
    if len(figures_over_time) < len(series):
        notes.append(
            f"Shown: the {len(figures_over_time)} of {len(series)} logs with the"
            " largest errors."
        )
    return Group(
        id=f"torque-{collection.robot.joints.index(name) + 1}",
        title=name,
        joint=name,
        badge=state,
        badge_text=f"{state}: {faults[0]}" if faults else state,
        figures=[
            *figures_over_time,
            over_quantity(series, place, "position", place.length),
            over_quantity(series, place, "velocity", f"{place.length}/s"),
            spectrum(series, place, max(cutoffs_hz, default=None), _COLUMNS),
        ],
        tables=[_errors_table(collection, place)],
        notes=notes,
    )


def over_logs(
    collection: Collection, tables: Sequence[TorqueTable], name: str, columns: int
) -> tuple[list[Series], list[Figure]]:
    """Return a joint's torques, and figures of the logs that are predicted worst.

    Parameters
    ----------
    collection : Collection
    tables : sequence of TorqueTable
        Those of the best model first.
    name : str
        The joint.
    columns : int
        A figure has at most two points to a line in each of so many parts of the time.

    Returns
    -------
    series : list of Series
        Torques by the best model, log by log.
    figures : list of Figure
    """
    models: dict[str, dict[str, Series]] = {}
    for torques in tables:
        if name not in torques.joints:
            continue
        label = short_path(torques.path)
        if torques.prediction:
            label = collection.label(torques.prediction)
        models[label] = {series.log: series for series in torques.series(name)}
    if not models:
        return [], []
    of_best_model = list(next(iter(models.values())).values())

    errors = _relative_errors(collection, name)
    worst_first = sorted(of_best_model, key=lambda item: -errors.get(item.log, 0.0))
    worst = {item.log for item in worst_first[:_MOST_LOGS]}
    place = collection.place(name)
    figures = []
    for series in of_best_model:
        if series.log in worst:
            of_log = _of_log(models, series.log)
            events = _events(collection, name, series.log)
            figures.append(over_time(of_log, place, events, columns))
    return of_best_model, figures


def _relative_errors(collection: Collection, name: str) -> dict[str, float]:
    """Return a joint's relative error on each log, by the best model that has it."""
    errors: dict[str, float] = {}
    for item in collection.predictions:
        for log in item.content.logs:
            error = log.joints.get(name)
            if error is not None:
                errors.setdefault(log.path, error.relative_rmse or 0.0)
    return errors


def _of_log(models: Mapping[str, Mapping[str, Series]], log: str) -> dict[str, Series]:
    """Return the torques of one log by the models that have it."""
    return {label: logs[log] for label, logs in models.items() if log in logs}


def _events(collection: Collection, name: str, log: str) -> list[tuple[float, float]]:
    """Return start and end [s] of pushes against a joint in a log."""
    events = []
    for item in collection.diagnoses:
        for event in item.content.events:
            if event.log == log and name in event.joints:
                events.append((event.start, event.end))
    return events


def _errors_table(collection: Collection, place: Place) -> Table:
    """Return a joint's errors in each log by each model."""
    rows = []
    for item in collection.predictions:
        for log in item.content.logs:
            error = log.joints.get(place.joint)
            if error is None:
                continue
            row = (
                short_path(log.path),
                collection.label(item),
                error.rmse,
                error.relative_rmse,
                error.max_abs,
                error.samples,
                error.share_sliding,
                error.rmse_all,
                log.cutoff_hz,
            )
            rows.append(row)

    titles = (
        "log | model | RMS error [{unit}] | of RMS torque | largest [{unit}] | samples"
        " | slides in | with rests [{unit}] | cut-off [Hz]"
    )
    kinds = "text text number share number count share number number"
    caption = f"Errors of {place.joint}, {plural(len(rows), 'log')}"
    return table(caption, titles, kinds, rows, unit=place.unit)
