"""Friction, joint by joint: a map over position and velocity, and cuts with their intervals."""

import numpy as np

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.tables import Head, Values
from seqid_cli.params.schema import FrictionJoint, FrictionStage
from seqid_cli.report import views
from seqid_cli.report.chart import figure, line, padded, small_panel
from seqid_cli.report.collection import Collection, Place
from seqid_cli.report.words import MINUS, Z95, number, percent

_CALL = "seqid friction LOG... -r robot.toml -o friction.json"
_CELLS = (22, 11)  # of the map: along position, along speed in either direction
_COLOURS = 12
_CURVE = 81
_HEIGHT = 178.0


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
    groups = [_joint(collection, stage, name) for name in stage.joints]
    notes = list(stage.notes)
    if model.stages.effects:
        notes.append("Effects that refinement added are not part of these surfaces.")
    return views.Section("friction", "Friction", lead, groups, notes=notes)


def _joint(collection: Collection, stage: FrictionStage, name: str) -> views.Group:
    joint, place = stage.joints[name], collection.place(name)
    own = [verdict for verdict in stage.verdicts if verdict.joint == name]
    figures = friction_figures(joint, place)
    fault = views.Absent("Its surface is not finite: identify it anew.", _CALL)
    facts = [
        ("orders", f"{joint.position_order}, {joint.velocity_order}"),
        ("RMS error of the fit", f"{number(joint.rmse)} {place.unit}"),
    ]
    if joint.held_out_rmse is not None:
        facts.append(
            ("at left-out speeds", f"{number(joint.held_out_rmse)} {place.unit}")
        )
    if joint.criterion_met is not None:
        facts.append(("largest error (Eq. 11)", percent(joint.max_error)))
    if joint.max_error_of_noise is not None:
        facts.append(("noise alone makes", percent(joint.max_error_of_noise)))
    if joint.asymmetry is not None:
        facts.append(("depends on direction", percent(joint.asymmetry)))
    terms = [
        views.value_row(x.name, x.value, x.std_error, x.unit) for x in joint.parameters
    ]
    titles = "speed [{length}/s] | moves forward | backward | RMS error [{unit}]"
    kinds, units = (
        "number count count number",
        {"unit": place.unit, "length": place.length},
    )
    speeds = [(x.speed, x.forward, x.backward, x.rmse) for x in joint.speeds]
    return views.Group(
        f"friction-{collection.robot.joints.index(name) + 1}",
        name,
        joint=name,
        lead=views.reasons(own),
        badge=views.badge(own),
        facts=facts,
        figures=figures,
        absent=[] if figures else [fault],
        tables=[
            views.table(f"Recorded speeds of {name}", titles, kinds, speeds, **units),
            views.Table(
                f"Friction parameters of {name}", Values(views.VALUE_HEADS, terms)
            ),
        ],
    )


def friction_figures(joint: FrictionJoint, place: Place) -> list[views.Figure]:
    """Draw a joint's friction: none unless values and errors are finite all over its range."""
    q, v = (
        np.linspace(low, high, 5)
        for low, high in (joint.position_range, joint.speed_range)
    )
    with np.errstate(all="ignore"):
        surface, grid = (
            FrictionSurface.from_stage(joint),
            (np.repeat(q, 5), np.tile(v, 5)),
        )
        torque, error = surface.torque(*grid), surface.stated_error(*grid)
        if not (np.isfinite([torque, error]).all() and np.ptp(torque) < np.inf):
            return []
    cuts = [_cuts(joint, surface, place, over) for over in ("velocity", "position")]
    return [_map(joint, surface, place), *cuts]


def _map(joint: FrictionJoint, surface: FrictionSurface, place: Place) -> views.Figure:
    """Draw friction over position and velocity (Fig. 1 and 10); about rest nothing is known."""
    q = np.linspace(joint.position_range[0], joint.position_range[1], _CELLS[0] + 1)
    speed = np.linspace(
        max(joint.speed_range[0], 0.0), joint.speed_range[1], _CELLS[1] + 1
    )
    halves = (-speed[::-1], speed)
    grids = [(np.repeat(q, len(v)), np.tile(v, len(q))) for v in halves]
    torques = [surface.torque(*grid).reshape(len(q), -1) for grid in grids]
    low, high = float(np.min(torques)), float(np.max(torques))
    x_range, y_range = padded(q, 0.0), padded([-speed[-1], speed[-1]], 0.0)
    x, y_title = ("position", place.length), f"velocity, {place.length}/s"
    panel = small_panel(x, x_range, y_title, y_range, height=_HEIGHT, hover="")
    for v, torque in zip(halves, torques, strict=True):
        middle = 0.25 * (
            torque[1:, 1:] + torque[1:, :-1] + torque[:-1, 1:] + torque[:-1, :-1]
        )
        share = (middle - low) / ((high - low) or 1.0)
        shades = np.minimum((share * _COLOURS).astype(int), _COLOURS - 1)
        for (i, k), shade in np.ndenumerate(shades):
            panel.band(q[i : i + 2], v[[k, k]], v[[k + 1, k + 1]], f"heat h{shade}")
    title = f"Friction of {place.joint} over position and velocity"
    text = f"Map of friction torque from {number(low)} to {number(high)} {place.unit}."
    marks = [
        (k, low + k / (_COLOURS - 1) * (high - low)) for k in (0, 4, 7, _COLOURS - 1)
    ]
    legend = {f"heat h{k}": f"{number(at, 2)} {place.unit}" for k, at in marks}
    heads = [Head("velocity", "number", f"{place.length}/s")]
    heads += [
        Head(f"at {number(at)}", "number", place.length) for at in q[:: _CELLS[0] // 2]
    ]
    rows = [
        (float(v[k]), *torque[:: _CELLS[0] // 2, k].tolist())
        for v, torque in zip(halves, torques, strict=True)
        for k in (0, _CELLS[1] // 2, _CELLS[1])
    ]
    values = views.Table(f"{title}, {place.unit}", Values(heads, rows))
    return figure(
        [panel], title, text, legend, values, name="Over position and velocity"
    )


def _cuts(
    joint: FrictionJoint, surface: FrictionSurface, place: Place, over: str
) -> views.Figure:
    """Draw three cuts with 95 % intervals, in the pieces and at the speeds that were recorded."""
    (low, high), (slow, fast) = joint.position_range, joint.speed_range
    x_unit, cut_unit = place.length, f"{place.length}/s"
    cuts, pieces = np.linspace(slow, fast, 3), [np.linspace(low, high, _CURVE)]
    along = over == "velocity"
    if along:
        x_unit, cut_unit, arm = cut_unit, x_unit, np.linspace(slow, fast, _CURVE)
        cuts, pieces = np.linspace(low, high, 5)[1:4], [-arm[::-1], arm]
    curves = []
    for k, at in enumerate(cuts):
        for x in pieces:
            q, v = (np.full(len(x), at), x) if along else (x, np.full(len(x), at))
            curves.append(
                (k, x, surface.torque(q, v), Z95 * surface.stated_error(q, v))
            )
    every = np.concatenate([np.concatenate([y - e, y + e]) for *_, y, e in curves])
    x_range, y_title = padded(np.concatenate(pieces), 0.02), f"friction, {place.unit}"
    panel = small_panel((over, x_unit), x_range, y_title, padded(every), height=_HEIGHT)
    names = [f"at {float(at):.3g} {cut_unit}".replace("-", MINUS) for at in cuts]
    for k, x, y, e in curves:
        panel.band(x, y - e, y + e, f"cut{k}")
    for k, x, y, _ in curves:
        panel.line(x, y, f"cut{k}", name=names[k], unit=place.unit)
    bottom, speeds = (
        panel.box.bottom,
        [item.speed for item in joint.speeds] if along else [],
    )
    for speed in (*speeds, *(-speed for speed in speeds)):
        panel.marks.append(
            line("rug", panel.x(speed), bottom, panel.x(speed), bottom - 6)
        )
    rows = [
        (float(cuts[k]), float(x[i]), float(y[i]), float(e[i]))
        for k, x, y, e in curves
        for i in np.linspace(0, len(x) - 1, 5).astype(int)
    ]
    title = f"Friction of {place.joint} over {over}"
    titles = "cut at [{cut}] | {over} [{unit}] | friction | 95 % half-width"
    kinds, own = (
        "number number number number2",
        {"cut": cut_unit, "over": over, "unit": x_unit},
    )
    return figure(
        [panel],
        title,
        "Three cuts through the surface with 95 % intervals.",
        {f"cut{k}": name for k, name in enumerate(names)},
        views.table(f"{title}, {place.unit}", titles, kinds, rows, **own),
        name=f"Over {over}",
        note="Small marks below: the speeds that were recorded." if speeds else "",
    )
