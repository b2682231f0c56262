"""How well the model predicts: errors per joint, and the torque behind them."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.schema import Verdict
from seqid_cli.report.collection import Collection, Prediction
from seqid_cli.report.figures.torque import Event, Place, over_quantity, over_time, spectrum
from seqid_cli.report.torques import Series, TorqueTable
from seqid_cli.report.views import Absent, Column, Figure, Group, Section, Table
from seqid_cli.report.words import command, limits, number, percent, plural, short_path, unit_text

_MOST_LOGS = 3  # with a figure each; the tables hold all
_BUDGET = 60_000  # points of all time series together
_COLUMNS = (60, 560)  # fewest and most across one figure


def torque(collection: Collection, torques: TorqueTable | None, found: str = "") -> Section:
    """Return the section on predicted torque; `found` is the source of unnamed torques."""
    absent = []
    if not collection.predictions:
        text = "How large the errors are is not known without a prediction."
        absent.append(Absent(text, _predict(collection)))
    if torques is None:
        text = "The torques over time are not in the files given."
        absent.append(Absent(text, _predict(collection)))
    joints = torques.joints if torques else ()
    figures = len(joints) * min(len(torques.rows), _MOST_LOGS) if torques else 0
    columns = max(_COLUMNS[0], min(_COLUMNS[1], _BUDGET // max(6 * figures, 1)))
    groups = [
        _joint(collection, torques, name, columns)
        for name in collection.robot.joints
        if name in joints or any(name in p.file.joints for p in collection.predictions)
    ]
    lead = (
        "Measured torque against what the model predicts, both low-passed alike. Errors are over "
        "samples in which the joint slides. At rest friction holds whatever balances, within an "
        "interval; there the residual that is drawn is the distance to it."
    )
    notes = [
        f"{short_path(log.path)}: {note}"
        for item in collection.predictions
        for log in item.file.logs
        for note in log.notes
    ]
    notes += [note for item in collection.predictions for note in item.file.notes]
    notes += [found] if found else []
    return Section("torque", "Torque, joint by joint", lead, groups, absent=absent, notes=notes)


def _predict(collection: Collection) -> str:
    model = collection.model
    logs = [log.path for item in collection.predictions[:1] for log in item.file.logs]
    if not 0 < len(logs) <= 4:
        logs = ["LOG..."]
    path = model.path if model else "inertia.json"
    return command(
        "seqid",
        "predict",
        *logs,
        "-r",
        "robot.toml",
        "-p",
        path,
        "-o",
        "prediction.json",
        "--torques",
        "torques.parquet",
    )


def _joint(collection: Collection, torques: TorqueTable | None, name: str, columns: int) -> Group:
    place = Place(name, *collection.units(name))
    series = torques.series(name) if torques and name in torques.joints else []
    figures: list[Figure] = []
    absent = []
    shown = _worst(series, collection.predictions, name)
    for log in shown:
        figures.append(over_time(log, place, _events(collection, log.log, name), columns))
    if series:
        small = [
            over_quantity(series, place, "position", place.position_unit),
            over_quantity(series, place, "velocity", f"{place.position_unit}/s"),
            spectrum(series, place, _cutoff(collection), columns),
        ]
        figures += [figure for figure in small if figure is not None]
        if series[0].position is None:
            text = "The torque file holds no position and velocity: write it anew."
            absent.append(Absent(text, _predict(collection)))
    badge, text = _badge(collection.predictions, name)
    notes = []
    if len(shown) < len(series):
        notes.append(f"Shown: the {len(shown)} of {len(series)} logs with the largest errors.")
    return Group(
        f"torque-{collection.robot.joints.index(name) + 1}",
        name,
        badge=badge,
        badge_text=text,
        facts=_facts(collection, name, place),
        figures=figures,
        tables=[table for table in (_errors(collection, name, place),) if table.rows],
        notes=notes,
        absent=absent,
    )


def _worst(series: Sequence[Series], predictions: Sequence[Prediction], name: str) -> list[Series]:
    errors = {
        log.path: error.relative_rmse or 0.0
        for item in predictions
        for log in item.file.logs
        if (error := log.joints.get(name)) is not None
    }
    if len(series) <= _MOST_LOGS:
        return list(series)
    worst = sorted(series, key=lambda item: -errors.get(item.log, 0.0))[:_MOST_LOGS]
    kept = {item.log for item in worst}
    return [item for item in series if item.log in kept]


def _events(collection: Collection, log: str, joint: str) -> list[Event]:
    return [
        (event.start, event.end)
        for item in collection.diagnoses
        for event in item.file.events
        if event.log == log and joint in event.joints
    ]


def _cutoff(collection: Collection) -> float | None:
    cutoffs = [log.cutoff_hz for item in collection.predictions for log in item.file.logs]
    return max(cutoffs, default=None)


def _badge(predictions: Sequence[Prediction], name: str) -> tuple[str, str]:
    mine: list[Verdict] = [v for p in predictions for v in p.file.verdicts if v.joint == name]
    if not mine:
        return "", ""
    bad = [verdict for verdict in mine if not verdict.good]
    return ("poor", "poor: " + bad[0].reason) if bad else ("good", "good")


def _facts(collection: Collection, name: str, place: Place) -> list[tuple[str, str]]:
    unit = unit_text(place.torque_unit)
    facts = []
    for item in collection.predictions[:1]:
        error = item.file.joints.get(name)
        if error is not None:
            facts += [
                ("RMS error", f"{number(error.rmse)} {unit}"),
                ("of the RMS torque", percent(error.relative_rmse)),
                ("largest error", f"{number(error.max_abs)} {unit}"),
                ("slides in", f"{percent(error.share_sliding)} of the samples"),
            ]
        entry = collection.residual(item, name)
        if entry is not None and entry.noise_floor is not None:
            facts.append(("noise floor", f"{number(entry.noise_floor)} {unit}"))
            facts.append(("its 95 % interval", f"{limits(entry.noise_floor_interval)} {unit}"))
    return facts


def _errors(collection: Collection, name: str, place: Place) -> Table:
    unit = unit_text(place.torque_unit)
    columns = (
        Column("log"),
        Column("RMS error", numeric=True, unit=unit),
        Column("relative", numeric=True, unit="of RMS torque"),
        Column("largest", numeric=True, unit=unit),
        Column("samples", numeric=True),
        Column("slides in", numeric=True, unit="of samples"),
        Column("with rests", numeric=True, unit=unit),
        Column("cut-off", numeric=True, unit="Hz"),
    )
    rows = [
        (
            short_path(log.path),
            number(error.rmse),
            percent(error.relative_rmse),
            number(error.max_abs),
            str(error.samples),
            percent(error.share_sliding),
            number(error.rmse_all),
            number(log.cutoff_hz),
        )
        for item in collection.predictions
        for log in item.file.logs
        if (error := log.joints.get(name)) is not None
    ]
    return Table(f"Errors of {name}, {plural(len(rows), 'log')}", columns, rows)
