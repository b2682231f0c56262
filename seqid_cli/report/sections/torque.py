"""How well the model predicts: errors per joint, and the torque behind them."""

import math
from collections.abc import Sequence

from seqid_cli.params.results.tables import Head, Values, heads
from seqid_cli.report.collection import Collection, Place, Prediction
from seqid_cli.report.sections.torque_figures import over_quantity, over_time, spectrum
from seqid_cli.report.torques import Series, TorqueTable
from seqid_cli.report.views import Absent, Figure, Group, Section, Table, badge, table
from seqid_cli.report.words import number, percent, plural, short_path

_MOST_LOGS = 3  # with a figure each; the tables hold all
_COLUMNS = 250  # of a figure


def torque(
    collection: Collection, tables: Sequence[TorqueTable], found: Sequence[str] = ()
) -> Section:
    """Return the section on predicted torque; `found` says which torques were found."""
    files = [item.content for item in collection.predictions]
    lacking = []
    if not files:
        lacking.append("How large the errors are is not known without a prediction.")
    if not tables:
        lacking.append("The torques over time are not in the files given.")
    known = {name for file in files for name in file.joints}.union(*(x.joints for x in tables))
    groups = [_side_by_side(collection)] if len(files) > 1 else []
    groups += [_joint(collection, tables, x) for x in collection.robot.joints if x in known]
    lead = (
        "Measured torque against what the model predicts, both low-passed alike. Errors are over "
        "samples in which the joint slides. At rest friction holds whatever balances, within an "
        "interval; there the residual that is drawn is the distance to it."
    )
    logs = [log.path for file in files[:1] for log in file.logs]
    call = collection.call("predict", *(logs if len(logs) <= 4 else ()), output="prediction.json")
    return Section(
        "torque",
        "Torque, joint by joint",
        lead,
        groups,
        absent=[Absent(text, f"{call} --torques torques.parquet") for text in lacking],
        notes=[
            *(f"{short_path(x.path)}: {note}" for f in files for x in f.logs for note in x.notes),
            *(note for file in files for note in file.notes),
            *found,
        ],
    )


def _side_by_side(collection: Collection) -> Group:
    """Errors of the models on the logs that all of them predict."""
    logs = [frozenset(log.sha256 for log in p.content.logs) for p in collection.predictions]
    common = frozenset.intersection(*logs)
    columns = heads("joint | unit", "text text")
    columns += [Head(collection.label(p), "number") for p in collection.predictions]
    rows = [
        (
            name,
            collection.place(name).unit,
            *(_error_on(p, name, common) for p in collection.predictions),
        )
        for name in collection.robot.joints
    ]
    note = f"RMS error, and its share of the RMS torque, on the {plural(len(common), 'log')} that "
    shown = Table("Error of each model", Values(columns, rows), f"{note}all of them predict.")
    return Group("torque-models", "Models side by side", tables=[shown], unfolded=True)


def _error_on(item: Prediction, name: str, logs: frozenset[str]) -> str | None:
    errors = [log.joints[name] for log in item.content.logs if log.sha256 in logs]
    known = [(e.samples, e.rmse, e.relative_rmse) for e in errors if e.rmse and e.relative_rmse]
    if not known:
        return None
    error = math.sqrt(sum(n * rmse**2 for n, rmse, _ in known) / sum(n for n, *_ in known))
    size = math.sqrt(sum(n * (rmse / x) ** 2 for n, rmse, x in known) / sum(n for n, *_ in known))
    return f"{number(error)} ({percent(error / size)})"


def _joint(collection: Collection, tables: Sequence[TorqueTable], name: str) -> Group:
    place = collection.place(name)
    series, drawn = over_logs(collection, tables, name, _COLUMNS)
    cutoffs = [log.cutoff_hz for item in collection.predictions for log in item.content.logs]
    verdicts = [v for p in collection.judged for v in p.content.verdicts if v.joint == name]
    state, bad = badge(verdicts), [verdict.reason for verdict in verdicts if not verdict.good]
    notes = []
    if len(drawn) < len(series):
        notes.append(f"Shown: the {len(drawn)} of {len(series)} logs with the largest errors.")
    return Group(
        f"torque-{collection.robot.joints.index(name) + 1}",
        name,
        joint=name,
        badge=state,
        badge_text=f"{state}: {bad[0]}" if bad else state,
        figures=[
            *drawn,
            over_quantity(series, place, "position", place.length),
            over_quantity(series, place, "velocity", f"{place.length}/s"),
            spectrum(series, place, max(cutoffs, default=None), _COLUMNS),
        ],
        tables=[_errors(collection, place)],
        notes=notes,
    )


def over_logs(
    collection: Collection, tables: Sequence[TorqueTable], name: str, columns: int
) -> tuple[list[Series], list[Figure]]:
    """Return a joint's torques by the best model, and figures of the logs that it predicts worst.

    A figure has at most two points to a line in each of its `columns`.
    """
    models = {
        collection.label(table.prediction) if table.prediction else short_path(table.path): {
            series.log: series for series in table.series(name)
        }
        for table in tables
        if name in table.joints
    }
    series = list(next(iter(models.values()), {}).values())
    errors = {
        log.path: error.relative_rmse or 0.0
        for item in collection.predictions[::-1]  # the best model's errors last, which stay
        for log in item.content.logs
        if (error := log.joints.get(name)) is not None
    }
    worst = sorted(series, key=lambda item: -errors.get(item.log, 0.0))[:_MOST_LOGS]
    figures = []
    for log in [item.log for item in series if any(item is one for one in worst)]:
        own = {label: logs[log] for label, logs in models.items() if log in logs}
        events = [
            (event.start, event.end)
            for item in collection.diagnoses
            for event in item.content.events
            if event.log == log and name in event.joints
        ]
        figures.append(over_time(own, collection.place(name), events, columns))
    return series, figures


def _errors(collection: Collection, place: Place) -> Table:
    rows = [
        (
            short_path(log.path),
            collection.label(item),
            *(x.rmse, x.relative_rmse, x.max_abs, x.samples, x.share_sliding, x.rmse_all),
            log.cutoff_hz,
        )
        for item in collection.predictions
        for log in item.content.logs
        if (x := log.joints.get(place.joint)) is not None
    ]
    titles = "log | model | RMS error [{unit}] | of RMS torque | largest [{unit}] | samples"
    titles += " | slides in | with rests [{unit}] | cut-off [Hz]"
    kinds = "text text number share number count share number number"
    caption = f"Errors of {place.joint}, {plural(len(rows), 'log')}"
    return table(caption, titles, kinds, rows, unit=place.unit)
