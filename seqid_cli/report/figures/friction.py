"""Friction over position and velocity: the surface, and cuts through it with their intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionJoint
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import (
    Scale,
    element,
    label,
    line,
    padded,
    points_text,
    tick_texts,
)
from seqid_cli.report.figures.torque import SMALL, Place
from seqid_cli.report.views import Column, Figure, Key, Table
from seqid_cli.report.words import Z95, number, unit_text
from seqid_cli.robot.types import Array

_CELLS = (22, 11)  # of the surface: along position, along speed in either direction
_COLOURS = 12
_CURVE = 81
_TURN, _LIFT = np.radians(36.0), np.radians(28.0)


@dataclass(frozen=True)
class _View:
    """Projects the unit box, friction upwards, onto the drawing."""

    centre: tuple[float, float] = (196.0, 136.0)
    size: float = 138.0

    def __call__(self, x: float, y: float, z: float) -> tuple[float, float]:
        """Return the drawing coordinates of a point of [-1, 1] x [-1, 1] x [0, 1]."""
        across = x * np.cos(_TURN) - y * np.sin(_TURN)
        depth = x * np.sin(_TURN) + y * np.cos(_TURN)
        up = (z - 0.5) * 1.15
        left = self.centre[0] + self.size * 0.74 * across
        down = self.centre[1] - self.size * (0.5 * depth * np.sin(_LIFT) + up * np.cos(_LIFT))
        return float(left), float(down)


def drawable(joint: FrictionJoint) -> bool:
    """Return whether the surface has finite values and errors all over its range."""
    q, v = (np.linspace(low, high, 5) for low, high in (joint.position_range, joint.speed_range))
    with np.errstate(all="ignore"):
        surface, grid = FrictionSurface.from_stage(joint), (np.repeat(q, 5), np.tile(v, 5))
        torque, error = surface.torque(*grid), surface.stated_error(*grid)
        return bool(np.isfinite([torque, error]).all() and np.ptp(torque) < np.inf)


def surface_figure(joint: FrictionJoint, place: Place) -> Figure:
    """Draw the friction torque over position and velocity (the paper's Fig. 1 and 10)."""
    surface = FrictionSurface.from_stage(joint)
    q = np.linspace(joint.position_range[0], joint.position_range[1], _CELLS[0] + 1)
    speed = np.linspace(max(joint.speed_range[0], 0.0), joint.speed_range[1], _CELLS[1] + 1)
    v = np.concatenate([-speed[::-1], speed])
    torque = surface.torque(np.repeat(q, len(v)), np.tile(v, len(q))).reshape(len(q), len(v))
    low, high = padded(float(torque.min()), float(torque.max()), 0.02)
    view = _View()
    fast = float(speed[-1]) or 1.0
    spread = float(q[-1] - q[0]) or 1.0
    x = 2.0 * (q - q[0]) / spread - 1.0
    y, z = v / fast, (torque - low) / (high - low)
    corners = [
        [view(a, b, c) for b, c in zip(y, row, strict=True)] for a, row in zip(x, z, strict=True)
    ]
    cells = []
    for i in reversed(range(_CELLS[0])):  # the far ones first
        for k in reversed(range(len(v) - 1)):
            if k == _CELLS[1]:  # between the slowest speeds of both directions nothing is known
                continue
            level = float(np.mean(z[i : i + 2, k : k + 2]))
            shade = min(int(level * _COLOURS), _COLOURS - 1)
            around = (corners[i][k], corners[i + 1][k], corners[i + 1][k + 1], corners[i][k + 1])
            cells.append(element("polygon", {"class": f"h{shade}", "points": points_text(around)}))
    title = f"Friction of {place.joint} over position and velocity"
    text = (
        f"Surface of friction torque from {number(float(torque.min()))} to "
        f"{number(float(torque.max()))} {place.torque_unit}, positions {number(q[0])} to "
        f"{number(q[-1])} {place.position_unit}, speeds {number(speed[0])} to "
        f"{number(speed[-1])} {place.position_unit}/s in both directions."
    )
    axes = _box_axes(view, (q[0], q[-1]), (-fast, fast), (low, high), place)
    svg = drawing(SMALL, 268, title, text, [axes, element("g", {"class": "surface"}, *cells)])
    return Figure("Over position and velocity", svg, (), _table(surface, q, speed, place, title))


def _box_axes(
    view: _View,
    q: tuple[float, float],
    v: tuple[float, float],
    torque: tuple[float, float],
    place: Place,
) -> Markup:
    parts: list[Markup] = []
    frame = (
        [(-1, 1, 0), (-1, -1, 0), (1, -1, 0)],
        [(-1, 1, 0), (1, 1, 0), (1, -1, 0)],
        [(-1, 1, 0), (-1, 1, 1), (1, 1, 1), (1, 1, 0)],
    )
    for corners in frame:
        points = points_text(view(*corner) for corner in corners)
        parts.append(element("polyline", {"class": "box", "points": points}))
    parts += _ticks(view, q, lambda s: (2 * s - 1, -1.0, 0.0), (4, 16), "start")
    parts += _ticks(view, v, lambda s: (-1.0, 2 * s - 1, 0.0), (-6, 12), "end")
    parts += _ticks(view, torque, lambda s: (-1.0, 1.0, s), (-6, 4), "end")
    unit = unit_text(place.position_unit)
    words = (
        (view(0.1, -1.0, 0.0), (16, 36), f"position, {unit}", "start"),
        (view(-1.0, -0.2, 0.0), (-14, 34), f"velocity, {unit}/s", "end"),
        (view(-1.0, 1.0, 1.0), (-6, -14), f"friction, {unit_text(place.torque_unit)}", "start"),
    )
    for at, (dx, dy), text, anchor in words:
        parts.append(label(at[0] + dx, at[1] + dy, text, anchor, "axis-title"))
    return element("g", {}, *parts)


def _ticks(
    view: _View,
    limits: tuple[float, float],
    corner: Callable[[float], tuple[float, float, float]],
    shift: tuple[float, float],
    anchor: str,
) -> list[Markup]:
    scale = Scale(*limits, 0.0, 1.0)
    ticks = scale.ticks(4)
    found = []
    for tick, text in zip(ticks, tick_texts(ticks), strict=True):
        x, y = view(*corner(scale(tick)))
        found.append(label(x + shift[0], y + shift[1], text.replace("-", "\u2212"), anchor))
        found.append(line("tick", x, y, x + shift[0] / 2, y + abs(shift[0]) / 2))
    return found


def _table(surface: FrictionSurface, q: Array, speed: Array, place: Place, title: str) -> Table:
    some_q, some_v = np.linspace(q[0], q[-1], 5), np.linspace(speed[0], speed[-1], 5)
    unit = unit_text(place.position_unit)
    columns = [Column("velocity", numeric=True, unit=f"{unit}/s")]
    columns += [Column(f"at {number(at)}", numeric=True, unit=unit) for at in some_q]
    rows = []
    for at in (*(-some_v[::-1]), *some_v):
        torque = surface.torque(some_q, np.full(len(some_q), at))
        rows.append((number(float(at)), *(number(float(value)) for value in torque)))
    return Table(f"{title}, {unit_text(place.torque_unit)}", columns, rows)


def over_velocity(joint: FrictionJoint, place: Place) -> Figure:
    """Draw cuts at three positions over velocity, with 95 % intervals and the recorded speeds."""
    surface = FrictionSurface.from_stage(joint)
    low, high = joint.position_range
    slow, fast = joint.speed_range
    arm = np.linspace(slow, fast, _CURVE)
    velocity = [-arm[::-1], arm]
    places = [_round(at, high - low) for at in np.linspace(low, high, 5)[1:4].tolist()]
    cuts = [(at, [np.full(_CURVE, at)] * 2, velocity) for at in places]
    unit = unit_text(place.position_unit)
    return _cuts(
        surface,
        place,
        cuts,
        over="velocity",
        x_unit=f"{unit}/s",
        cut_unit=unit,
        span=padded(-fast, fast, 0.02),
        marks=[s.speed for s in joint.speeds],
    )


def over_position(joint: FrictionJoint, place: Place) -> Figure:
    """Draw cuts at three speeds over position, with 95 % intervals."""
    surface = FrictionSurface.from_stage(joint)
    low, high = joint.position_range
    q = np.linspace(low, high, _CURVE)
    slow, fast = joint.speed_range
    speeds = [_round(at, fast - slow) for at in (slow, 0.5 * (slow + fast), fast)]
    cuts = [(at, [q], [np.full(_CURVE, at)]) for at in speeds]
    unit = unit_text(place.position_unit)
    return _cuts(
        surface,
        place,
        cuts,
        over="position",
        x_unit=unit,
        cut_unit=f"{unit}/s",
        span=padded(low, high, 0.02),
        marks=[],
    )


def _cuts(
    surface: FrictionSurface,
    place: Place,
    cuts: Sequence[tuple[float, Sequence[Array], Sequence[Array]]],
    *,
    over: str,
    x_unit: str,
    cut_unit: str,
    span: tuple[float, float],
    marks: Sequence[float],
) -> Figure:
    curves = [
        (at, k, x, *_with_error(surface, q, v))
        for k, (at, qs, vs) in enumerate(cuts)
        for q, v in zip(qs, vs, strict=True)
        for x in [v if over == "velocity" else q]
    ]
    every = np.concatenate([np.concatenate([y - e, y + e]) for *_, y, e in curves])
    unit = unit_text(place.torque_unit)
    names = [f"{at:g}".replace("-", "\u2212") for at, _, _ in cuts]
    panel = Panel(
        Box(62, 26, SMALL - 74, 178),
        span,
        padded(float(every.min()), float(every.max())),
        x_title=f"{over}, {x_unit}",
        y_title=f"friction, {unit}",
        x_ticks=4,
        hover=f"{over}|{x_unit}",
    )
    for _, k, x, y, e in curves:
        panel.band(_points(x, y - e), _points(x, y + e), f"cut{k}")
    for _, k, x, y, _ in curves:
        panel.line(_points(x, y), f"cut{k}", name=f"at {names[k]} {cut_unit}", unit=unit)
    bottom = panel.box.bottom
    for speed in (*marks, *(-mark for mark in marks)):
        at_x = panel.x(speed)
        panel.add(line("rug", at_x, bottom, at_x, bottom - 6))
    title = f"Friction of {place.joint} over {over}"
    text = "Three cuts through the surface with 95 % intervals."
    legend = [Key(f"cut{k}", f"at {name} {cut_unit}") for k, name in enumerate(names)]
    note = "Small marks below: the speeds that were recorded." if marks else ""
    svg = drawing(SMALL, 248, title, text, [panel])
    table = _cut_table(curves, f"{title}, {unit}", over, x_unit, cut_unit)
    return Figure(f"Over {over}", svg, legend, table, note)


def _cut_table(
    curves: Sequence[tuple[float, int, Array, Array, Array]],
    title: str,
    over: str,
    x_unit: str,
    cut_unit: str,
) -> Table:
    columns = (
        Column("cut at", numeric=True, unit=cut_unit),
        Column(over, numeric=True, unit=x_unit),
        Column("friction", numeric=True),
        Column("95 % half-width", numeric=True),
    )
    rows = [
        (number(at), number(float(x[i])), number(float(y[i])), number(float(e[i]), 2))
        for at, _, x, y, e in curves
        for i in np.linspace(0, len(x) - 1, 5).astype(int)
    ]
    return Table(title, columns, rows)


def _round(value: float, span: float) -> float:
    """Return a value with the decimals that resolve a hundredth of the span."""
    if not span > 0.0:
        return value
    decimals = max(0, 2 - int(np.floor(np.log10(span)))) if span < 1e6 else 0
    return round(value, decimals) + 0.0  # never minus zero


def _with_error(surface: FrictionSurface, q: Array, v: Array) -> tuple[Array, Array]:
    return surface.torque(q, v), Z95 * surface.stated_error(q, v)


def _points(x: Array, y: Array) -> list[tuple[float, float]]:
    return list(zip(x.tolist(), y.tolist(), strict=True))


FIGURES = (surface_figure, over_velocity, over_position)  # of each joint
