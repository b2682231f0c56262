"""Friction, joint by joint: a map over position and velocity, and cuts through it.

Cuts have 95 % intervals. The map shows the torque f(q, v) at positions q and speeds v
of both directions.
"""

from dataclasses import dataclass

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.tables import Head, Values
from seqid_cli.params.schema import FrictionJoint, FrictionStage
from seqid_cli.report import views
from seqid_cli.report.chart import Panel, figure, line, padded, small_panel
from seqid_cli.report.collection import Collection, Place
from seqid_cli.report.words import MINUS, Z95, number, percent
from seqid_cli.typing import Array

_CALL = "seqid friction LOG... -r robot.toml -o friction.json"
_CELLS = (22, 11)  # of the map: along position, along speed in either direction
_COLOURS = 12
_CURVE = 81  # points of a line
_HEIGHT = 178.0
# Averages within this part of the range count for a cut: the width of a quarter trial,
# over which they are averages, on either side of the cuts at the quarters.
_REACH = 8.0


def friction(collection: Collection) -> views.Section:
    """Return the section on friction."""
    model = collection.model
    stage = model.stages.friction if model else None
    if model is None or stage is None:
        text = "No friction stage is in the files given."
        return views.lacking("friction", "Friction", text, _CALL)

    lead = (
        "Friction torque as a function of position and velocity (Eq. 7-11). Nothing is"
        " known between the slowest recorded speeds of both directions, where the sign"
        " turns; outside the recorded range Coulomb and viscous friction goes on, at"
        " its mean over position."
    )

    notes = list(stage.notes)
    if model.stages.effects:
        notes.append("Effects that refinement added are not part of these surfaces.")
    return views.Section(
        id="friction",
        title="Friction",
        lead=lead,
        groups=[_joint_group(collection, stage, name) for name in stage.joints],
        notes=notes,
    )


def _joint_group(
    collection: Collection, stage: FrictionStage, name: str
) -> views.Group:
    """Return the group on one joint."""
    joint = stage.joints[name]
    place = collection.place(name)
    verdicts = [verdict for verdict in stage.verdicts if verdict.joint == name]
    figures = friction_figures(joint, place)
    absent = []
    if not figures:
        text = "Its surface is not finite: identify it anew."
        absent.append(views.Absent(text, _CALL))

    speeds = views.table(
        f"Recorded speeds of {name}",
        "speed [{length}/s] | moves forward | backward | RMS error [{unit}]",
        "number count count number",
        [(x.speed, x.forward, x.backward, x.rmse) for x in joint.speeds],
        unit=place.unit,
        length=place.length,
    )
    parameters = views.Table(
        caption=f"Friction parameters of {name}",
        values=Values(
            views.VALUE_HEADS,
            [
                views.value_row(x.name, x.value, x.std_error, x.unit)
                for x in joint.parameters
            ],
        ),
    )
    return views.Group(
        id=f"friction-{collection.robot.joints.index(name) + 1}",
        title=name,
        joint=name,
        lead=views.reasons(verdicts),
        badge=views.badge(verdicts),
        facts=_facts(joint, place),
        figures=figures,
        absent=absent,
        tables=[speeds, parameters],
    )


def _facts(joint: FrictionJoint, place: Place) -> list[tuple[str, str]]:
    """Return the orders of a surface, and its errors."""
    facts = [
        ("orders", f"{joint.position_order}, {joint.velocity_order}"),
        ("RMS error of the fit", f"{number(joint.rmse)} {place.unit}"),
    ]
    if joint.held_out_rmse is not None:
        held_out_rmse = f"{number(joint.held_out_rmse)} {place.unit}"
        facts.append(("at left-out speeds", held_out_rmse))
    if joint.criterion_met is not None:
        facts.append(("largest error (Eq. 11)", percent(joint.max_error)))
    if joint.max_error_of_noise is not None:
        facts.append(("noise alone makes", percent(joint.max_error_of_noise)))
    if joint.asymmetry is not None:
        facts.append(("depends on direction", percent(joint.asymmetry)))
    return facts


def friction_figures(joint: FrictionJoint, place: Place) -> list[views.Figure]:
    """Draw a joint's friction.

    There are no figures unless values and errors are finite all over its range.
    """
    # Coefficients of a file may be anything.
    with np.errstate(all="ignore"):
        surface = FrictionSurface.from_stage(joint)
        if not _is_finite(joint, surface):
            return []
    return [
        _map(joint, surface, place),
        _cuts(joint, surface, place, over="velocity"),
        _cuts(joint, surface, place, over="position"),
    ]


def _is_finite(joint: FrictionJoint, surface: FrictionSurface) -> bool:
    """Return whether a surface and its errors are finite all over its range."""
    q = np.repeat(np.linspace(joint.position_range[0], joint.position_range[1], 5), 5)
    v = np.tile(np.linspace(joint.speed_range[0], joint.speed_range[1], 5), 5)
    torque = surface.torque(q, v)
    error = surface.stated_error(q, v)
    # Even finite values may be too far apart to be drawn.
    return bool(np.isfinite([torque, error]).all() and np.ptp(torque) < np.inf)


def _map(joint: FrictionJoint, surface: FrictionSurface, place: Place) -> views.Figure:
    """Draw friction over position and velocity (Fig. 1 and 10).

    About rest nothing is known.
    """
    n_positions, n_speeds = _CELLS
    q = np.linspace(joint.position_range[0], joint.position_range[1], n_positions + 1)
    slowest = max(joint.speed_range[0], 0.0)
    speed = np.linspace(slowest, joint.speed_range[1], n_speeds + 1)
    directions = (-speed[::-1], speed)
    torques = [_on_grid(surface, q, v) for v in directions]
    low = float(np.min(torques))
    high = float(np.max(torques))

    panel = small_panel(
        ("position", place.length),
        padded(q, 0.0),
        f"velocity, {place.length}/s",
        padded([-speed[-1], speed[-1]], 0.0),
        height=_HEIGHT,
        readable=False,
    )
    for v, torque in zip(directions, torques, strict=True):
        _draw_cells(panel, q, v, torque, low, high)

    title = f"Friction of {place.joint} over position and velocity"
    text = f"Map of friction torque from {number(low)} to {number(high)} {place.unit}."
    legend = {}
    for k in (0, 4, 7, _COLOURS - 1):
        torque_of_colour = low + k / (_COLOURS - 1) * (high - low)
        legend[f"heat h{k}"] = f"{number(torque_of_colour, 2)} {place.unit}"

    # The table has three positions, and three speeds of each direction.
    half = n_positions // 2
    columns = [Head("velocity", "number", f"{place.length}/s")]
    columns += [
        Head(f"at {number(position)}", "number", place.length) for position in q[::half]
    ]
    rows = []
    for v, torque in zip(directions, torques, strict=True):
        for k in (0, n_speeds // 2, n_speeds):
            rows.append((float(v[k]), *torque[::half, k].tolist()))
    values = views.Table(caption=f"{title}, {place.unit}", values=Values(columns, rows))
    return figure(
        [panel], title, text, legend, values, name="Over position and velocity"
    )


def _on_grid(surface: FrictionSurface, q: Array, v: Array) -> Array:
    """Return the torque (Q, V) of all positions q (Q,) and speeds v (V,) [N m]."""
    torque = surface.torque(np.repeat(q, len(v)), np.tile(v, len(q)))
    return torque.reshape(len(q), -1)


def _draw_cells(
    panel: Panel, q: Array, v: Array, torque: Array, low: float, high: float
) -> None:
    """Draw a cell between all neighbours, by the mean torque of its corners."""
    upper_corners = torque[1:, 1:] + torque[1:, :-1]
    corners = upper_corners + torque[:-1, 1:] + torque[:-1, :-1]
    share = (0.25 * corners - low) / ((high - low) or 1.0)
    shades = np.minimum((share * _COLOURS).astype(int), _COLOURS - 1)
    for (i, k), shade in np.ndenumerate(shades):
        bottom = v[[k, k]]
        top = v[[k + 1, k + 1]]
        panel.band(q[i : i + 2], bottom, top, f"heat h{shade}")


@dataclass(frozen=True, kw_only=True)
class _Curve:
    """One piece of a cut: torques (N,) over x (N,), with half their 95 % intervals."""

    cut: int
    x: Array
    torque: Array
    half_width: Array


def _cuts(
    joint: FrictionJoint, surface: FrictionSurface, place: Place, *, over: str
) -> views.Figure:
    """Draw three cuts over velocity or position, with 95 % intervals.

    Cuts over velocity are drawn at the speeds that were recorded, without rest.
    """
    over_velocity = over == "velocity"
    position_low, position_high = joint.position_range
    slowest, fastest = joint.speed_range
    if over_velocity:
        x_unit = f"{place.length}/s"
        cut_unit = place.length
        cuts = np.linspace(position_low, position_high, 5)[1:4]
        speeds = np.linspace(slowest, fastest, _CURVE)
        pieces = [-speeds[::-1], speeds]
        recorded_speeds = [item.speed for item in joint.speeds]
    else:
        x_unit = place.length
        cut_unit = f"{place.length}/s"
        cuts = np.linspace(slowest, fastest, 3)
        pieces = [np.linspace(position_low, position_high, _CURVE)]
        recorded_speeds = []

    curves = []
    for k, cut in enumerate(cuts):
        for x in pieces:
            at_cut = np.full(len(x), cut)
            q, v = (at_cut, x) if over_velocity else (x, at_cut)
            curve = _Curve(
                cut=k,
                x=x,
                torque=surface.torque(q, v),
                half_width=Z95 * surface.stated_error(q, v),
            )
            curves.append(curve)
    measured = [
        _points_at(joint, surface, float(cut), over_velocity=over_velocity)
        for cut in cuts
    ]
    names = [f"at {float(cut):.3g} {cut_unit}".replace("-", MINUS) for cut in cuts]
    panel = _cut_panel(
        curves, measured, (over, x_unit), np.concatenate(pieces), names, place
    )
    _draw_marks(panel, recorded_speeds)

    title = f"Friction of {place.joint} over {over}"
    values = views.table(
        f"{title}, {place.unit}",
        "cut at [{cut}] | {over} [{unit}] | friction | 95 % half-width",
        "number number number number2",
        _cut_rows(curves, cuts),
        cut=cut_unit,
        over=over,
        unit=x_unit,
    )
    note = ""
    if recorded_speeds:
        note = "Small marks below: the speeds that were recorded."
    if any(len(points.x) for points in measured):
        near = "the cut's positions" if over_velocity else "the nearest recorded speed"
        note = (
            f"Points: measured averages at {near} with 95 % intervals. {note}".strip()
        )
    return figure(
        [panel],
        title,
        "Three cuts through the surface with 95 % intervals.",
        {f"cut{k}": name for k, name in enumerate(names)},
        values,
        name=f"Over {over}",
        note=note,
    )


@dataclass(frozen=True, kw_only=True)
class _Points:
    """Measured averages near a cut: torques (N,) over x (N,), half their intervals."""

    x: Array
    torque: Array
    half_width: Array


def _points_at(
    joint: FrictionJoint, surface: FrictionSurface, cut: float, *, over_velocity: bool
) -> _Points:
    """Return what was measured near a cut, over velocity or over position.

    A point lies at the surface by what was measured more than the surface has where it
    was measured: the cut itself passes between the places of the averages.
    """
    if over_velocity:
        levels = joint.speeds
    else:
        levels = sorted(joint.speeds, key=lambda level: abs(level.speed - cut))[:1]
    low, high = joint.position_range
    reach = (high - low) / _REACH

    rows: list[tuple[float, float, float]] = []
    for level in levels:
        points = np.reshape(level.points, (-1, 4))
        for direction in (1.0, -1.0):
            q, _, error, std_error = points[points[:, 1] == direction].T
            if not over_velocity:
                if direction > 0.0:
                    rows += zip(q, error, std_error, strict=True)
                continue
            is_near = np.abs(q - cut) <= reach
            if is_near.any():
                # What trials have for themselves is common to averages of one trial:
                # the error of their mean is not taken as smaller than theirs.
                spread = float(np.sqrt(np.mean(std_error[is_near] ** 2)))
                missed = direction * float(error[is_near].mean())
                rows.append((direction * level.speed, missed, spread))
    x, errors, std_errors = np.array(rows).reshape(-1, 3).T
    at_cut = np.full(len(x), cut)
    q, v = (at_cut, x) if over_velocity else (x, at_cut)
    return _Points(
        x=x, torque=surface.torque(q, v) + errors, half_width=Z95 * std_errors
    )


def _cut_panel(
    curves: list[_Curve],
    measured: list[_Points],
    x_axis: tuple[str, str],
    x: Array,
    names: list[str],
    place: Place,
) -> Panel:
    """Draw the curves of cuts, all lines above all bands."""
    edges = []
    for curve in curves:
        edges += [curve.torque - curve.half_width, curve.torque + curve.half_width]
    edges += [points.torque for points in measured]
    panel = small_panel(
        x_axis,
        padded(x, 0.02),
        f"friction, {place.unit}",
        padded(np.concatenate(edges)),
        height=_HEIGHT,
    )

    for curve in curves:
        low = curve.torque - curve.half_width
        high = curve.torque + curve.half_width
        panel.band(curve.x, low, high, f"cut{curve.cut}")
    for curve in curves:
        panel.line(
            curve.x,
            curve.torque,
            f"cut{curve.cut}",
            name=names[curve.cut],
            unit=place.unit,
        )
    for k, points in enumerate(measured):
        panel.points(points.x, points.torque, points.half_width, f"cut{k}")
    return panel


def _draw_marks(panel: Panel, recorded_speeds: list[float]) -> None:
    """Draw small marks below at the speeds that were recorded, in both directions."""
    bottom = panel.box.bottom
    for speed in (*recorded_speeds, *(-speed for speed in recorded_speeds)):
        at = panel.x(speed)
        panel.marks.append(line("rug", at, bottom, at, bottom - 6))


def _cut_rows(
    curves: list[_Curve], cuts: Array
) -> list[tuple[float, float, float, float]]:
    """Return five points of each curve: cut, x, torque and half its interval."""
    rows = []
    for curve in curves:
        for i in np.linspace(0, len(curve.x) - 1, 5).astype(int):
            row = (
                float(cuts[curve.cut]),
                float(curve.x[i]),
                float(curve.torque[i]),
                float(curve.half_width[i]),
            )
            rows.append(row)
    return rows
