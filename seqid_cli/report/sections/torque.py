"""How well the model predicts: errors per joint, and the torque behind them."""

import math
from collections.abc import Sequence

from seqid_cli.params.results.tables import Head, Values, heads
from seqid_cli.report.collection import Collection, Place, Prediction
from seqid_cli.report.figures.torque import over_quantity, over_time, spectrum
from seqid_cli.report.torques import Series, TorqueTable
from seqid_cli.report.views import Absent, Figure, Group, Section, Table, badge, table, table_of
from seqid_cli.report.words import limits, number, percent, plural, short_path

_MOST_LOGS = 3  # with a figure each; the tables hold all
_BUDGET = 60_000  # points of all time series together
_COLUMNS = (60, 560)  # fewest and most across one figure


def torque(
    collection: Collection, tables: Sequence[TorqueTable], found: Sequence[str] = ()
) -> Section:
    """Return the section on predicted torque; `found` says which torques were found."""
    lacking = []
    if not collection.predictions:
        lacking.append("How large the errors are is not known without a prediction.")
    if not tables:
        lacking.append("The torques over time are not in the files given.")
    joints = tables[0].joints if tables else ()
    figures = len(joints) * min(len(tables[0].rows), _MOST_LOGS) if tables else 0
    lines = max(figures * (4 + 2 * len(tables)), 1)
    columns = max(_COLUMNS[0], min(_COLUMNS[1], _BUDGET // lines))
    files = [item.content for item in collection.predictions]
    groups = [
        _joint(collection, tables, name, columns)
        for name in collection.robot.joints
        if name in joints or any(name in file.joints for file in files)
    ]
    lead = (
        "Measured torque against what the model predicts, both low-passed alike. Errors are over "
        "samples in which the joint slides. At rest friction holds whatever balances, within an "
        "interval; there the residual that is drawn is the distance to it."
    )
    logs = [log for file in files for log in file.logs]
    return Section(
        "torque",
        "Torque, joint by joint",
        lead,
        [*([_side_by_side(collection)] if len(files) > 1 else []), *groups],
        absent=[Absent(text, _predict(collection)) for text in lacking],
        notes=[
            *(f"{short_path(log.path)}: {note}" for log in logs for note in log.notes),
            *(note for file in files for note in file.notes),
            *found,
        ],
    )


def _predict(collection: Collection) -> str:
    logs = [log.path for item in collection.predictions[:1] for log in item.content.logs]
    call = collection.call("predict", *(logs if len(logs) <= 4 else ()), output="prediction.json")
    return f"{call} --torques torques.parquet"


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
    found = Values(columns, rows)
    shown = table_of("Error of each model", found, f"{note}all of them predict.")
    return Group("torque-models", "Models side by side", tables=[shown], unfolded=True)


def _error_on(item: Prediction, name: str, logs: frozenset[str]) -> str | None:
    errors = [log.joints[name] for log in item.content.logs if log.sha256 in logs]
    known = [(e.samples, e.rmse, e.relative_rmse) for e in errors if e.rmse and e.relative_rmse]
    if not known:
        return None
    count = sum(samples for samples, *_ in known)
    error = math.sqrt(sum(n * rmse**2 for n, rmse, _ in known) / count)
    size = math.sqrt(sum(n * (rmse / share) ** 2 for n, rmse, share in known) / count)
    return f"{number(error)} ({percent(error / size)})"


def _joint(collection: Collection, tables: Sequence[TorqueTable], name: str, columns: int) -> Group:
    place = collection.place(name)
    series, drawn = over_logs(collection, tables, name, columns)
    figures: list[Figure | None] = [*drawn]
    absent, notes = [], []
    cutoffs = [log.cutoff_hz for item in collection.predictions for log in item.content.logs]
    if series:
        figures += [
            over_quantity(series, place, "position", place.length),
            over_quantity(series, place, "velocity", f"{place.length}/s"),
            spectrum(series, place, max(cutoffs, default=None), columns),
        ]
        if series[0].position is None:
            text = "The torque file holds no position and velocity: write it anew."
            absent.append(Absent(text, _predict(collection)))
    verdicts = [v for p in collection.judged for v in p.content.verdicts if v.joint == name]
    state, bad = badge(verdicts), [verdict.reason for verdict in verdicts if not verdict.good]
    if len(drawn) < len(series):
        notes.append(f"Shown: the {len(drawn)} of {len(series)} logs with the largest errors.")
    return Group(
        f"torque-{collection.robot.joints.index(name) + 1}",
        name,
        joint=name,
        badge=state,
        badge_text=f"{state}: {bad[0]}" if bad else state,
        facts=_facts(collection, place),
        figures=figures,
        tables=[_errors(collection, place)],
        notes=notes,
        absent=absent,
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
    place = collection.place(name)
    figures = []
    for one in _worst(series, collection.predictions, name):
        own = {label: logs[one.log] for label, logs in models.items() if one.log in logs}
        events = [
            (event.start, event.end)
            for item in collection.diagnoses
            for event in item.content.events
            if event.log == one.log and name in event.joints
        ]
        figures.append(over_time(own, place, events, columns))
    return series, figures


def _worst(series: Sequence[Series], predictions: Sequence[Prediction], name: str) -> list[Series]:
    errors = {
        log.path: error.relative_rmse or 0.0
        for item in predictions[::-1]  # the best model's errors last, which stay
        for log in item.content.logs
        if (error := log.joints.get(name)) is not None
    }
    worst = sorted(series, key=lambda item: -errors.get(item.log, 0.0))[:_MOST_LOGS]
    kept = {item.log for item in worst}
    return [item for item in series if item.log in kept]


def _facts(collection: Collection, place: Place) -> list[tuple[str, str]]:
    unit, facts = place.unit, []
    for item in collection.predictions[:1]:
        error = item.content.joints.get(place.joint)
        if error is not None:
            facts += [
                ("RMS error", f"{number(error.rmse)} {unit}"),
                ("of the RMS torque", percent(error.relative_rmse)),
                ("largest error", f"{number(error.max_abs)} {unit}"),
                ("slides in", f"{percent(error.share_sliding)} of the samples"),
            ]
        entry = collection.residual(item, place.joint)
        if entry is not None and entry.noise_floor is not None:
            facts.append(("noise floor", f"{number(entry.noise_floor)} {unit}"))
            facts.append(("its 95 % interval", f"{limits(entry.noise_floor_interval)} {unit}"))
    return facts


def _errors(collection: Collection, place: Place) -> Table:
    several, rows = len(collection.predictions) > 1, []
    for item in collection.predictions:
        for log in item.content.logs:
            x = log.joints.get(place.joint)
            if x is not None:
                whose = (short_path(log.path), *([collection.label(item)] if several else []))
                errors = (x.rmse, x.relative_rmse, x.max_abs, x.samples, x.share_sliding)
                rows.append((*whose, *errors, x.rmse_all, log.cutoff_hz))
    titles = "log | model" if several else "log"
    titles += " | RMS error [{unit}] | of RMS torque | largest [{unit}] | samples | slides in"
    kinds = f"text {'text ' * several}number share number count share number number"
    caption = f"Errors of {place.joint}, {plural(len(rows), 'log')}"
    titles += " | with rests [{unit}] | cut-off [Hz]"
    return table(caption, titles, kinds, rows, unit=place.unit)
