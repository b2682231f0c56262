"""Friction over position and velocity: a map, and cuts through it with their intervals."""

from functools import partial

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.tables import Head, Values
from seqid_cli.params.schema import FrictionJoint
from seqid_cli.report.collection import Place
from seqid_cli.report.figures.chart import small_figure, small_panel
from seqid_cli.report.figures.svg import line, padded
from seqid_cli.report.views import Figure, Key, table, table_of
from seqid_cli.report.words import Z95, number

_CELLS = (22, 11)  # of the surface: along position, along speed in either direction
_COLOURS = 12
_CURVE = 81
_HEIGHT = 178.0


def drawable(joint: FrictionJoint) -> bool:
    """Return whether the surface has finite values and errors all over its range."""
    q, v = (np.linspace(low, high, 5) for low, high in (joint.position_range, joint.speed_range))
    with np.errstate(all="ignore"):
        surface, grid = FrictionSurface.from_stage(joint), (np.repeat(q, 5), np.tile(v, 5))
        torque, error = surface.torque(*grid), surface.stated_error(*grid)
        return bool(np.isfinite([torque, error]).all() and np.ptp(torque) < np.inf)


def surface_figure(joint: FrictionJoint, place: Place) -> Figure:
    """Draw the friction torque as a map over position and velocity (the paper's Fig. 1 and 10).

    Between the slowest speeds of both directions nothing is known: the map has a gap there.
    """
    surface = FrictionSurface.from_stage(joint)
    q = np.linspace(joint.position_range[0], joint.position_range[1], _CELLS[0] + 1)
    speed = np.linspace(max(joint.speed_range[0], 0.0), joint.speed_range[1], _CELLS[1] + 1)
    halves = (-speed[::-1], speed)
    grids = [(np.repeat(q, len(v)), np.tile(v, len(q))) for v in halves]
    torques = [surface.torque(*grid).reshape(len(q), -1) for grid in grids]
    low, high = min(map(np.min, torques)), max(map(np.max, torques))
    panel = small_panel(
        ("position", place.length),
        padded(q[0], q[-1], 0.0),
        f"velocity, {place.length}/s",
        padded(-speed[-1], speed[-1], 0.0),
        height=_HEIGHT,
        read=False,
    )
    for v, torque in zip(halves, torques, strict=True):
        middle = 0.25 * (torque[1:, 1:] + torque[1:, :-1] + torque[:-1, 1:] + torque[:-1, :-1])
        share = (middle - low) / ((high - low) or 1.0)
        shades = np.minimum((share * _COLOURS).astype(int), _COLOURS - 1)
        for (i, k), shade in np.ndenumerate(shades):
            panel.band(q[i : i + 2], v[[k, k]], v[[k + 1, k + 1]], f"heat h{shade}")
    title = f"Friction of {place.joint} over position and velocity"
    text = (
        f"Map of friction torque from {number(low)} to {number(high)} {place.unit}, "
        f"positions {number(q[0])} to {number(q[-1])} {place.length}, speeds "
        f"{number(speed[0])} to {number(speed[-1])} {place.length}/s in both directions."
    )
    marks = [(k, low + k / (_COLOURS - 1) * (high - low)) for k in (0, 4, 7, _COLOURS - 1)]
    legend = [Key(f"heat h{k}", f"{number(at, 2)} {place.unit}") for k, at in marks]
    some_q, some_v = np.linspace(q[0], q[-1], 5), np.linspace(speed[0], speed[-1], 5)
    heads = [Head("velocity", "number", f"{place.length}/s")]
    heads += [Head(f"at {number(at)}", "number", place.length) for at in some_q]
    rows = [
        (at, *surface.torque(some_q, np.full(len(some_q), at)).tolist())
        for at in (*(-some_v[::-1]).tolist(), *some_v.tolist())
    ]
    values = table_of(f"{title}, {place.unit}", Values(heads, rows))
    return small_figure(panel, title, text, legend, values, name="Over position and velocity")


def cuts_figure(joint: FrictionJoint, place: Place, over: str) -> Figure:
    """Draw three cuts over velocity or position, each in the pieces that were recorded.

    95 % intervals are around them, and the recorded speeds are marked.
    """
    surface, along = FrictionSurface.from_stage(joint), over == "velocity"
    (low, high), (slow, fast) = joint.position_range, joint.speed_range
    if along:
        arm = np.linspace(slow, fast, _CURVE)
        at_three, width, pieces = np.linspace(low, high, 5)[1:4], high - low, [-arm[::-1], arm]
    else:
        at_three, width = np.array([slow, 0.5 * (slow + fast), fast]), fast - slow
        pieces = [np.linspace(low, high, _CURVE)]
    cuts = [_round(at, width) for at in at_three.tolist()]

    curves = []
    for k, at in enumerate(cuts):
        for x in pieces:
            q, v = (np.full(len(x), at), x) if along else (x, np.full(len(x), at))
            curves.append((at, k, x, surface.torque(q, v), Z95 * surface.stated_error(q, v)))
    every = np.concatenate([np.concatenate([y - e, y + e]) for *_, y, e in curves])
    x_unit, cut_unit = (
        (f"{place.length}/s", place.length) if along else (place.length, f"{place.length}/s")
    )
    names = [f"at {at:g} {cut_unit}".replace("-", "\u2212") for at in cuts]
    panel = small_panel(
        (over, x_unit),
        padded(float(pieces[0][0]), float(pieces[-1][-1]), 0.02),
        f"friction, {place.unit}",
        padded(float(every.min()), float(every.max())),
        height=_HEIGHT,
    )
    for _, k, x, y, e in curves:
        panel.band(x, y - e, y + e, f"cut{k}")
    for _, k, x, y, _ in curves:
        panel.line(x, y, f"cut{k}", name=names[k], unit=place.unit)
    bottom, speeds = panel.box.bottom, [item.speed for item in joint.speeds] if along else []
    for speed in (*speeds, *(-speed for speed in speeds)):
        panel.add(line("rug", panel.x(speed), bottom, panel.x(speed), bottom - 6))
    title = f"Friction of {place.joint} over {over}"
    rows = [
        (at, float(x[i]), float(y[i]), float(e[i]))
        for at, _, x, y, e in curves
        for i in np.linspace(0, len(x) - 1, 5).astype(int)
    ]
    titles = "cut at [{cut}] | {over} [{unit}] | friction | 95 % half-width"
    kinds, own = "number number number number2", {"cut": cut_unit, "over": over, "unit": x_unit}
    return small_figure(
        panel,
        title,
        "Three cuts through the surface with 95 % intervals.",
        [Key(f"cut{k}", name) for k, name in enumerate(names)],
        table(f"{title}, {place.unit}", titles, kinds, rows, **own),
        name=f"Over {over}",
        note="Small marks below: the speeds that were recorded." if speeds else "",
    )


def _round(value: float, span: float) -> float:
    """Return a value with the decimals that resolve a hundredth of the span."""
    if not span > 0.0:
        return value
    decimals = max(0, 2 - int(np.floor(np.log10(span)))) if span < 1e6 else 0
    return round(value, decimals) + 0.0  # never minus zero


FIGURES = (  # of each joint
    surface_figure,
    partial(cuts_figure, over="velocity"),
    partial(cuts_figure, over="position"),
)
