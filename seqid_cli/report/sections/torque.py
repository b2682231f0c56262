"""How well the model predicts: errors per joint, and the torque behind them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import welch

from seqid_cli.params.results.tables import Head, Values, heads
from seqid_cli.report.chart import Panel, figure, padded, small_panel, wide_box
from seqid_cli.report.collection import Collection, Place, Prediction
from seqid_cli.report.torques import Series, TorqueTable
from seqid_cli.report.views import Absent, Figure, Group, Section, Table, badge, table
from seqid_cli.report.words import number, percent, plural, short_path
from seqid_cli.typing import Array, Index, Mask

_ROWS = 20  # of the tables of time series and spectra
_BINS = 40
_MOST_SPANS = 200
_MOST_LOGS = 3  # with a figure each; the tables hold all
_COLUMNS = 250  # of a figure
_IN_BIN, _IN_RUN = 4, 64  # samples: fewer are not drawn
_ROOM = 0.06  # above and below what is drawn, of its range


def over_time(
    models: Mapping[str, Series],
    place: Place,
    events: Sequence[tuple[float, float]],
    columns: int,
) -> Figure:
    """Draw measured and predicted torque of one log above the residual, events shaded.

    `models` are the torques of the same log by the name of their model, the best first.
    """
    series, unit = next(iter(models.values())), place.unit
    t, good = series.t - series.t[0], _known(series)
    counted = good & series.used & series.sliding
    shown = counted if np.any(counted) else good
    torque, residual = _panels(models, shown, unit)
    for panel in (torque, residual):
        for start, stop in events:
            panel.span(start, stop, "event", f"pushed from {start:.2f} to {stop:.2f} s")
        for part in pieces(t, ~series.used, max_gap=np.inf)[:_MOST_SPANS]:
            panel.span(
                float(t[part.start]), float(t[min(part.stop, len(t) - 1)]), "unused"
            )
    rests = good & np.isfinite(series.low) & np.isfinite(series.high)
    for piece in pieces(t, rests):
        low, high = series.low[piece], series.high[piece]
        kept = np.union1d(
            *(extremes(t[piece], bound, columns) for bound in (low, high))
        )
        torque.band(t[piece][kept], low[kept], high[kept], "faint")
    banded = _draw_band(series, residual, good, columns)
    legend = _draw(models, torque, residual, unit, columns)
    legend |= {"band-residual": "95 % band"} if banded else {}
    legend |= {"faint": "held at rest"} if np.any(rests) else {}
    legend |= {"event": "pushed"} if events else {}
    legend |= {} if np.all(series.used) else {"unused": "not counted"}
    name, text = short_path(series.log), "No sample is known."
    if np.any(shown):
        rms = float(np.sqrt(np.mean(np.square(series.residual[shown]))))
        most = float(np.abs(series.residual[shown]).max())
        text = (
            f"The residual has an RMS of {number(rms)} {unit} and reaches"
            f" {number(most)} {unit}."
        )
    title = f"Torque of {place.joint}, {name}"
    rows = _time_table(series, good, unit, title)
    return figure(
        [torque, residual], f"{title} over time", text, legend, rows, name=name
    )


def _draw_band(series: Series, residual: Panel, good: Mask, columns: int) -> bool:
    """Draw the 95 % band of the residual where the joint slides; return whether there is any."""
    if series.std is None:
        return False
    t = series.t - series.t[0]
    banded = good & series.sliding & np.isfinite(series.std)
    for piece in pieces(t, banded):
        half_width = 1.96 * series.std[piece]
        kept = extremes(t[piece], half_width, columns)
        residual.band(t[piece][kept], -half_width[kept], half_width[kept], "residual")
    return bool(np.any(banded))


def _draw(
    models: Mapping[str, Series],
    torque: Panel,
    residual: Panel,
    unit: str,
    columns: int,
) -> dict[str, str]:
    """Draw the lines of all models, the best above the others; return their legend."""
    series, legend = next(iter(models.values())), {"measured": "measured"}
    curves = []
    for k, (name, own) in enumerate(models.items()):
        style = f"other{k - 1}" if k else "predicted"
        text = name if len(models) > 1 else "predicted"
        legend[style] = text
        left = (style, f"residual, {text}") if k else ("residual", "residual")
        curves += [
            (residual, own, own.residual, *left),
            (torque, own, own.predicted, style, text),
        ]
    curves.append((torque, series, series.torque, "measured", "measured"))
    for panel, own, values, style, text in reversed(curves):
        at = own.t - own.t[0]
        for piece in pieces(at, _known(own)):
            kept = extremes(at[piece], values[piece], columns)
            panel.line(
                at[piece][kept], values[piece][kept], style, name=text, unit=unit
            )
    return {**legend, "residual": "residual"}


def _panels(
    models: Mapping[str, Series], shown: Mask, unit: str
) -> tuple[Panel, Panel]:
    """Return the frames for the torque and, below, for the residual of the `shown` samples."""
    series = next(iter(models.values()))
    both, left = [series.low, series.high], [series.residual[shown]]
    for own in models.values():
        known = _known(own)
        both += [own.torque[known], own.predicted[known]]
        left.append(own.residual[known & own.used & own.sliding])
    drawn, span = np.concatenate(both), float(series.t[-1] - series.t[0])
    x, box, below = (0.0, span or 1.0), wide_box(26, 164), wide_box(220, 84)
    limits = padded(drawn[np.isfinite(drawn)], _ROOM)
    torque = Panel(box, x, limits, y_title=f"torque, {unit}", show_x=False, hover="t|s")
    limits, title = padded(np.concatenate([[0.0], *left]), _ROOM), f"residual, {unit}"
    return torque, Panel(below, x, limits, "time, s", title, y_ticks=3, hover="t|s")


def _known(series: Series) -> Mask:
    return (
        np.isfinite(series.torque)
        & np.isfinite(series.predicted)
        & np.isfinite(series.residual)
    )


def _time_table(series: Series, good: Mask, unit: str, title: str) -> Table:
    rows, t = [], series.t - series.t[0]
    edges = np.linspace(0.0, float(t[-1]), min(_ROWS, len(t)) + 1)[:-1]
    parts = np.split(np.arange(len(t)), np.searchsorted(t, edges[1:]))
    for at, part in zip(edges, parts, strict=True):
        keep = part[good[part]]
        if len(keep):
            ends = [
                f(x[keep])
                for x in (series.torque, series.predicted)
                for f in (np.min, np.max)
            ]
            left = series.residual[keep]
            sizes = (np.sqrt(np.mean(left**2)), np.abs(left).max())
            rows.append((f"{at:.2f}", *map(float, (*ends, *sizes))))
    heads = (
        "from [s] | measured, least [{u}] | most [{u}] | predicted, least [{u}] | most"
        " [{u}]"
    )
    heads += " | residual RMS [{u}] | largest [{u}]"
    return table(
        title, heads, "count number number number number number number", rows, u=unit
    )


def over_quantity(
    logs: Sequence[Series], place: Place, quantity: str, unit: str
) -> Figure | None:
    """Draw the spread of the residual over position or velocity; None where it is not known."""
    kept = [np.zeros((2, 0))]
    for one in logs:
        x = getattr(one, quantity)
        if x is not None:
            known = one.used & one.sliding & np.isfinite(x) & np.isfinite(one.residual)
            kept.append(np.array([x[known], one.residual[known]]))
    x, r = np.concatenate(kept, axis=1)
    if not len(x) or not x.max() > x.min():
        return None
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    order = np.argsort(x, kind="stable")
    parts = np.split(r[order], np.searchsorted(x[order], edges[1:-1]))
    bins = [
        (float(centre), *np.quantile(part, [0.0, 0.05, 0.5, 0.95, 1.0]).tolist())
        for centre, part in zip((edges[1:] + edges[:-1]) / 2, parts, strict=True)
        if len(part) >= _IN_BIN
    ]
    if not bins:
        return None
    x_range, y_range = padded(edges, 0.02), padded(np.append(r, 0.0), _ROOM)
    panel = small_panel((quantity, unit), x_range, f"residual, {place.unit}", y_range)
    centre, least, low, middle, high, most = zip(*bins, strict=True)
    panel.band(centre, least, most, "faint")
    panel.band(centre, low, high, "residual")
    panel.line(centre, middle, "residual", name="median", unit=place.unit)
    title = f"Residual of {place.joint} over {quantity}"
    text = (
        f"Median, 90 % range and extremes of the residual in {plural(len(bins), 'bin')}"
        f" of {quantity}. The median lies between {number(min(middle))} and"
        f" {number(max(middle))} {place.unit}."
    )
    legend = {"residual": "median", "band-residual": "90 %", "faint": "extremes"}
    heads = (
        "{over} [{x}] | least [{y}] | 5 % [{y}] | median [{y}] | 95 % [{y}] | most"
        " [{y}]"
    )
    own = {"over": quantity, "x": unit, "y": place.unit}
    values = table(
        title, heads, "number number number number number number", bins, **own
    )
    return figure(
        [panel], title, text, legend, values, name=f"Residual over {quantity}"
    )


def spectrum(
    logs: Sequence[Series], place: Place, cutoff_hz: float | None, columns: int
) -> Figure | None:
    """Draw the amplitude spectral density of the residual in the longest run without a gap."""
    runs = [
        (one, run)
        for one in logs
        for run in pieces(one.t, one.used & np.isfinite(one.residual))
        if run.stop - run.start >= _IN_RUN and one.t[run.stop - 1] > one.t[run.start]
    ]
    if not runs:
        return None
    one, run = max(runs, key=lambda found: found[1].stop - found[1].start)
    t, r = one.t[run], one.residual[run]
    even = np.interp(np.linspace(t[0], t[-1], len(t)), t, r)
    rate = (len(t) - 1) / float(t[-1] - t[0])
    length = min(len(r), max(256, len(r) // 4))
    f, power = welch(even, fs=rate, nperseg=length, detrend="constant")
    top = min(0.5 * rate, np.inf if cutoff_hz is None else 1.5 * cutoff_hz)
    inside = (f > 0.0) & (f <= top) & (power > 0.0)
    f, density = f[inside], np.sqrt(power[inside])
    if len(f) < 2:
        return None
    unit, title = f"{place.unit}/\u221aHz", f"Spectrum of the residual of {place.joint}"
    decades = (
        10 ** np.floor(np.log10(density.min())),
        10 ** np.ceil(np.log10(density.max())),
    )
    x, x_range = ("frequency", "Hz"), (0.0, float(top))
    panel = small_panel(x, x_range, f"residual, {unit}", decades, y_log=True)
    if cutoff_hz is not None and cutoff_hz < top:
        panel.upright(cutoff_hz, "line-mark")
    kept = extremes(f, np.log10(density), columns)
    panel.line(f[kept], density[kept], "residual", name="density", unit=unit)
    parts = np.array_split(np.arange(len(f)), min(_ROWS, len(f)))
    peaks = [part[np.argmax(density[part])] for part in parts]
    rows = [(float(f[k]), float(density[k])) for k in peaks]
    heads = "frequency [Hz] | density [{unit}]"
    values = table(f"{title}, its peaks", heads, "number4 number", rows, unit=unit)
    text = f"Strongest at {f[np.argmax(density)]:.2f} Hz."
    legend, name = (
        {"residual": "density", "line-mark": "cut-off"},
        "Spectrum of the residual",
    )
    return figure([panel], title, text, legend, values, name=name, note=text)


def extremes(x: Array, y: Array, columns: int) -> Index:
    """Return the indices of the smallest and largest y in each of `columns` equal parts of x.

    x (N,) does not fall, y (N,) is finite. The indices, 2 columns + 2 at most, rise;
    the first and the last sample are always among them.
    """
    if len(x) <= 2 * columns + 2:
        return np.arange(len(x))
    span = x[-1] - x[0]
    share = (x - x[0]) / span if span > 0.0 else np.zeros(len(x))
    column = np.minimum((share * columns).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    sizes, found = np.diff(np.append(starts, len(x))), [np.array([0, len(x) - 1])]
    for extreme in (np.minimum, np.maximum):  # the first sample that reaches it
        reached = y == np.repeat(extreme.reduceat(y, starts), sizes)
        found.append(
            np.minimum.reduceat(np.where(reached, np.arange(len(x)), len(x)), starts)
        )
    return np.unique(np.concatenate(found))


def pieces(t: Array, good: Mask, *, max_gap: float = 5.0) -> list[slice]:
    """Return the runs of good samples without a gap in time, as slices."""
    if not len(t):
        return []
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    cuts = np.flatnonzero((steps > max_gap * usual) | (good[1:] != good[:-1])) + 1
    ends = zip((0, *cuts.tolist()), (*cuts.tolist(), len(t)), strict=True)
    return [slice(start, stop) for start, stop in ends if good[start]]


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
    known = {name for file in files for name in file.joints}.union(
        *(x.joints for x in tables)
    )
    groups = [_side_by_side(collection)] if len(files) > 1 else []
    groups += [
        _joint(collection, tables, x) for x in collection.robot.joints if x in known
    ]
    lead = (
        "Measured torque against what the model predicts, both low-passed alike. Errors"
        " are over samples in which the joint slides. At rest friction holds whatever"
        " balances, within an interval; there the residual that is drawn is the"
        " distance to it."
    )
    logs = [log.path for file in files[:1] for log in file.logs]
    notes = [
        f"{short_path(x.path)}: {note}"
        for f in files
        for x in f.logs
        for note in x.notes
    ]
    notes += [note for file in files for note in file.notes]
    call = collection.call(
        "predict", *(logs if len(logs) <= 4 else ()), output="prediction.json"
    )
    return Section(
        "torque",
        "Torque, joint by joint",
        lead,
        groups,
        absent=[Absent(text, f"{call} --torques torques.parquet") for text in lacking],
        notes=[*notes, *found],
    )


def _side_by_side(collection: Collection) -> Group:
    """Errors of the models on the logs that all of them predict."""
    logs = [
        frozenset(log.sha256 for log in p.content.logs) for p in collection.predictions
    ]
    common = frozenset.intersection(*logs)
    columns = heads("joint | unit", "text text")
    columns += [Head(collection.label(p), "number") for p in collection.predictions]
    rows = []
    for name in collection.robot.joints:
        errors = (_error_on(item, name, common) for item in collection.predictions)
        rows.append((name, collection.place(name).unit, *errors))
    note = (
        "RMS error, and its share of the RMS torque, on the"
        f" {plural(len(common), 'log')} that "
    )
    shown = Table(
        "Error of each model", Values(columns, rows), f"{note}all of them predict."
    )
    return Group("torque-models", "Models side by side", tables=[shown], unfolded=True)


def _error_on(item: Prediction, name: str, logs: frozenset[str]) -> str | None:
    errors = [log.joints[name] for log in item.content.logs if log.sha256 in logs]
    known = [
        (e.samples, e.rmse, e.relative_rmse)
        for e in errors
        if e.rmse and e.relative_rmse
    ]
    if not known:
        return None
    error = math.sqrt(
        sum(n * rmse**2 for n, rmse, _ in known) / sum(n for n, *_ in known)
    )
    size = math.sqrt(
        sum(n * (rmse / x) ** 2 for n, rmse, x in known) / sum(n for n, *_ in known)
    )
    return f"{number(error)} ({percent(error / size)})"


def _joint(collection: Collection, tables: Sequence[TorqueTable], name: str) -> Group:
    place = collection.place(name)
    series, drawn = over_logs(collection, tables, name, _COLUMNS)
    cutoffs = [
        log.cutoff_hz for item in collection.predictions for log in item.content.logs
    ]
    verdicts = [
        v for p in collection.judged for v in p.content.verdicts if v.joint == name
    ]
    state, bad = (
        badge(verdicts),
        [verdict.reason for verdict in verdicts if not verdict.good],
    )
    few = f"Shown: the {len(drawn)} of {len(series)} logs with the largest errors."
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
        notes=[few] if len(drawn) < len(series) else [],
    )


def over_logs(
    collection: Collection, tables: Sequence[TorqueTable], name: str, columns: int
) -> tuple[list[Series], list[Figure]]:
    """Return a joint's torques by the best model, and figures of the logs that it predicts worst.

    A figure has at most two points to a line in each of its `columns`.
    """
    models = {}
    for own in [own for own in tables if name in own.joints]:
        label = (
            collection.label(own.prediction) if own.prediction else short_path(own.path)
        )
        models[label] = {series.log: series for series in own.series(name)}
    series = list(next(iter(models.values()), {}).values())
    errors = {
        log.path: error.relative_rmse or 0.0
        # the best model's errors last, which stay
        for item in collection.predictions[::-1]
        for log in item.content.logs
        if (error := log.joints.get(name)) is not None
    }
    worst = sorted(series, key=lambda item: -errors.get(item.log, 0.0))[:_MOST_LOGS]
    figures = []
    for log in [item.log for item in series if any(item is one for one in worst)]:
        shown = {label: logs[log] for label, logs in models.items() if log in logs}
        told = [event for item in collection.diagnoses for event in item.content.events]
        events = [(x.start, x.end) for x in told if x.log == log and name in x.joints]
        figures.append(over_time(shown, collection.place(name), events, columns))
    return series, figures


def _errors(collection: Collection, place: Place) -> Table:
    rows = []
    for item in collection.predictions:
        for log in item.content.logs:
            if (x := log.joints.get(place.joint)) is not None:
                errors = (
                    x.rmse,
                    x.relative_rmse,
                    x.max_abs,
                    x.samples,
                    x.share_sliding,
                )
                names = (short_path(log.path), collection.label(item))
                rows.append((*names, *errors, x.rmse_all, log.cutoff_hz))
    titles = (
        "log | model | RMS error [{unit}] | of RMS torque | largest [{unit}] | samples"
    )
    titles += " | slides in | with rests [{unit}] | cut-off [Hz]"
    kinds = "text text number share number count share number number"
    caption = f"Errors of {place.joint}, {plural(len(rows), 'log')}"
    return table(caption, titles, kinds, rows, unit=place.unit)
