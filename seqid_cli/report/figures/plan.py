"""A planned move: positions, speeds and torques of all joints in shares of their limits."""

from __future__ import annotations

import numpy as np

from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.plan.moves.trajectories import sampled
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import line
from seqid_cli.report.views import Figure, Key

_LEFT, _WIDTH, _HEIGHT, _GAP = 40.0, 190.0, 110.0, 50.0
_POINTS = 80


def move_figure(move: PlannedMove, file: PlanFile) -> Figure:
    """Draw a move; every joint is a line that names itself when it is pointed at."""
    names, limits = list(file.limits), file.limits
    t, q, dq, _ = sampled(move, names, _POINTS / move.duration_s)
    low, high = np.array([limits[name].position for name in names]).T
    width = np.where(high > low, high - low, 1.0)
    speed = np.array([limits[name].speed or 1.0 for name in names])
    shown = [
        ("position in its range", 0.0, t, (q - low) / width, names),
        ("speed over its limit", -1.0, t, dq / speed, names),
    ]
    known = [name for name in names if name in move.torque and limits[name].torque]
    if known:
        torque = np.array([move.torque[n] for n in known]).T
        torque /= np.array([limits[n].torque or 1.0 for n in known])
        times = (np.arange(len(torque)) + 0.5) * move.duration_s / len(torque)
        shown.append(("torque over its limit", 0.0, times, torque, known))
    panels = []
    for place, (title, least, x, values, joints) in enumerate(shown):
        room = 0.08 * (1.0 - least)
        box = Box(_LEFT + place * (_WIDTH + _GAP), 26, _WIDTH, _HEIGHT)
        y_range = (least - room, 1.0 + room)
        panel = Panel(
            box, (0.0, float(x[-1])), y_range, "time, s", title, x_ticks=4, y_ticks=3, hover="t|s"
        )
        for at in [panel.y(limit) for limit in (least, 1.0) if limit]:
            panel.add(line("rule line-mark", box.left, at, box.right, at))
        for name, column in zip(joints, values.T, strict=True):
            panel.line(x, column, "predicted", name=name)
        panels.append(panel)
    text = f"{len(move.joints)} joints move for {move.duration_s:.3g} s within dashed limits"
    total = _LEFT + len(panels) * (_WIDTH + _GAP)
    svg = drawing(total, _HEIGHT + 76, move.name, text, panels)
    return Figure(move.name, svg, [Key("predicted", "each joint"), Key("line-mark", "limit")])
