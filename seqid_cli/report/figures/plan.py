"""A planned move: positions, speeds and torques of all joints in shares of their limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.plan.moves.trajectories import sampled
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import Point, line
from seqid_cli.report.views import Figure, Key
from seqid_cli.robot.types import Array

_LEFT, _WIDTH, _HEIGHT, _GAP = 40.0, 190.0, 110.0, 50.0
_POINTS = 80


def move_figure(move: PlannedMove, file: PlanFile) -> Figure:
    """Draw a move; every joint is a line that names itself when it is pointed at."""
    names = list(file.limits)
    t, q, dq, _ = sampled(move, names, _POINTS / move.duration_s)
    limits = [file.limits[name] for name in names]
    low, high = np.array([limit.position for limit in limits]).T
    width = np.where(high > low, high - low, 1.0)
    speed = np.array([limit.speed or 1.0 for limit in limits])
    panels = [
        _panel(0, "position in its range", (0.0, 1.0), t, (q - low) / width, names),
        _panel(1, "speed over its limit", (-1.0, 1.0), t, dq / speed, names),
    ]
    known = [name for name in names if name in move.torque and file.limits[name].torque]
    if known:
        torque = np.array([move.torque[n] for n in known]).T
        torque /= np.array([file.limits[n].torque or 1.0 for n in known])
        times = (np.arange(len(torque)) + 0.5) * move.duration_s / len(torque)
        panels.append(_panel(2, "torque over its limit", (0.0, 1.0), times, torque, known))
    text = f"{len(move.joints)} joints move for {move.duration_s:.3g} s within dashed limits"
    total = _LEFT + len(panels) * (_WIDTH + _GAP)
    svg = drawing(total, _HEIGHT + 76, move.name, text, panels)
    return Figure(move.name, svg, [Key("predicted", "each joint"), Key("line-mark", "limit")])


def _panel(
    place: int,
    title: str,
    limits: tuple[float, float],
    t: Array,
    values: Array,
    names: Sequence[str],
) -> Panel:
    low, high = limits
    room = 0.08 * (high - low)
    box = Box(_LEFT + place * (_WIDTH + _GAP), 26, _WIDTH, _HEIGHT)
    shown = (low - room, high + room)
    panel = Panel(
        box, (0.0, float(t[-1])), shown, "time, s", title, x_ticks=4, y_ticks=3, hover="t|s"
    )
    for limit in limits:
        if limit:
            at = panel.y(limit)
            panel.add(line("rule line-mark", box.left, at, box.right, at))
    for j, name in enumerate(names):
        panel.line(_points(t, values[:, j]), "predicted", name=name)
    return panel


def _points(t: Array, values: Array) -> Iterable[Point]:
    return zip(t.tolist(), values.tolist(), strict=True)
