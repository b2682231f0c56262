"""The controllers behind the torques, and the robot simulated from its commands."""

import numpy as np

from seqid_cli.params.results import tables
from seqid_cli.params.results.drive import DriveFile, JointDrive
from seqid_cli.params.results.replay import ReplayFile, ReplayJoint, ReplayTrace
from seqid_cli.report import views
from seqid_cli.report.chart import figure, padded, small_panel
from seqid_cli.report.collection import Collection
from seqid_cli.report.words import number, percent, plural, short_path, unit_text
from seqid_cli.robust import rms
from seqid_cli.typing import Array

# What a line is, from the back to the front.
LEGEND = {"residual": "command", "measured": "measured", "predicted": "replayed"}


def drive(collection: Collection) -> views.Section | None:
    """Return the section on controllers and replays; None without any file of these."""
    if not collection.drives and not collection.replays:
        return None
    lead = (
        "Each joint's position controller, as the logs show it from what it was asked"
        " for, and the arm simulated in closed loop from its commands. A number that"
        " the logs cannot show says what to record."
    )
    groups = [
        _drive_group(f"drive-{place}", source.path, source.content)
        for place, source in enumerate(collection.drives, start=1)
    ]
    groups += [
        _replay_group(f"replay-{place}", source.path, source.content)
        for place, source in enumerate(collection.replays, start=1)
    ]
    return views.Section(id="drive", title="Drive", lead=lead, groups=groups)


def _drive_group(key: str, path: str, file: DriveFile) -> views.Group:
    """Return the group on the controllers of one file, a table for each joint."""
    facts = [("gains from", _METHODS[file.method])]
    if file.command_delay is not None and file.command_delay.value is not None:
        delay_ms = 1e3 * file.command_delay.value
        facts.append(("command delay of all joints", f"{number(delay_ms)} ms"))
    return views.Group(
        id=key,
        title=short_path(path),
        lead=views.reasons(file.verdicts),
        badge=views.badge(file.verdicts),
        facts=facts,
        tables=[_of_joint(name, joint) for name, joint in file.joints.items()],
        notes=file.notes,
        unfolded=True,
    )


_METHODS = {
    "torque": "the measured torque",
    "motion": "the motion, by the model of the arm",
}


def _of_joint(name: str, joint: JointDrive) -> views.Table:
    """Return the numbers of one controller, each with its error and state."""
    rows = []
    for parameter in joint.parameters:
        value, error, interval, unit = views.value_row(
            parameter.name, parameter.value, parameter.std_error, parameter.unit
        )[1:]
        state = parameter.state.replace("_", " ")
        if parameter.state == "not_reached" and parameter.low is not None:
            value = f"at least {number(parameter.low)}"
        rows.append(
            (
                parameter.name.replace("_", " "),
                value,
                error,
                interval,
                unit,
                state,
                parameter.reason,
            )
        )
    known = "" if joint.command_known else " (assumed)"
    note = f"Commands are {joint.command}{known}."
    if joint.left is not None:
        note += f" The law leaves {percent(joint.left)} of the torque."
    return views.Table(
        caption=f"Controller of {name}",
        values=tables.values(
            "parameter | value | std error | 95 % interval | unit | state | why",
            "text number number number text text text",
            rows,
        ),
        note=note,
    )


def _replay_group(key: str, path: str, file: ReplayFile) -> views.Group:
    """Return the group on one replay.

    A row of figures for each joint: a typical window, the worst one, and a step.
    """
    figures: list[views.Figure | None] = []
    for name, joint in file.joints.items():
        unit = unit_text(file.robot.unit("rad", name))
        figures.append(_typical_window(name, joint, unit))
        figures.append(_worst_window(name, joint, unit))
        figures.append(_step_response(name, joint, unit))
    return views.Group(
        id=key,
        title=short_path(path),
        lead=views.reasons(file.verdicts),
        badge=views.badge(file.verdicts),
        facts=[
            (plural(file.windows, "window"), f"of {number(file.window_s)} s"),
            ("drive", short_path(file.drive.path)),
        ],
        figures=figures,
        tables=[
            views.Table(
                caption="RMS errors of replayed positions, and of simpler guesses",
                values=tables.replay_errors(file),
                note="Positions in rad (m), velocities in rad/s, torques in N m.",
            )
        ],
        notes=file.notes,
        unfolded=True,
    )


def _typical_window(name: str, joint: ReplayJoint, unit: str) -> views.Figure | None:
    """Draw command, measured and replayed position in the window of median error."""
    trace = joint.typical_window
    if trace is None:
        return None
    off = np.array(trace.replayed) - np.array(trace.measured)
    text = (
        f"The window of median error: off by {number(rms(off))} {unit} RMS, from"
        f" {number(trace.t[0], 4)} s on."
    )
    return _window(f"{name}: typical window", trace, unit, text)


def _worst_window(name: str, joint: ReplayJoint, unit: str) -> views.Figure | None:
    """Draw command, measured and replayed position where the replay errs most."""
    trace = joint.worst_window
    if trace is None:
        return None
    worst = joint.position.worst
    text = (
        f"The replayed position is off by {number(worst.rms)} {unit} RMS, in"
        f" {short_path(worst.log)} from {number(worst.start, 4)} s on."
    )
    return _window(f"{name}: worst window", trace, unit, text)


def _window(title: str, trace: ReplayTrace, unit: str, text: str) -> views.Figure:
    """Draw all positions of a window over the time since its begin."""
    t = np.array(trace.t) - trace.t[0]
    return _traces(title, t, trace, unit, text, LEGEND)


def _step_response(name: str, joint: ReplayJoint, unit: str) -> views.Figure | None:
    """Draw what the simulated joint makes of a step of its command."""
    trace = joint.step_response
    if trace is None:
        return None
    text = (
        f"{name} at rest in the middle of its positions, simulated: {_reached(trace)}."
    )
    legend = {key: LEGEND[key] for key in ("residual", "predicted")}
    return _traces(
        f"{name}: step response", np.array(trace.t), trace, unit, text, legend
    )


def _reached(trace: ReplayTrace) -> str:
    """Say when a step response is there, and by how much it overshoots."""
    step = trace.command[-1] - trace.command[0]
    share = (np.array(trace.replayed) - trace.replayed[0]) / step
    t = np.array(trace.t)
    over = max(0.0, float(share.max()) - max(1.0, float(share[-1])))
    reached = np.flatnonzero(share >= 0.9)
    if not len(reached):
        return f"it stops at {percent(float(share[-1]))} of the step"
    rise_ms = 1e3 * float(t[reached[0]])
    return f"90 % after {number(rise_ms)} ms, overshoot {percent(over)}"


def _traces(
    title: str,
    t: Array,
    trace: ReplayTrace,
    unit: str,
    text: str,
    legend: views.Legend,
) -> views.Figure:
    """Draw positions over time; the text stands below the drawing as well."""
    columns = {
        "residual": trace.command,
        "measured": trace.measured,
        "predicted": trace.replayed,
    }
    drawn = np.concatenate([np.array(values) for values in columns.values() if values])
    panel = small_panel(
        ("t", "s"), (float(t[0]), float(t[-1])), f"position, {unit}", padded(drawn)
    )
    for style, values in columns.items():
        if values:
            panel.line(t, values, style, name=LEGEND[style], unit=unit)
    return figure([panel], title, text, legend, None, note=text)
