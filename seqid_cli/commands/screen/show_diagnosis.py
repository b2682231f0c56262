"""A diagnosis and a refinement on the screen: the verdict first, then the evidence."""

from collections.abc import Collection, Mapping, Sequence

from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.effects.units import (
    UNEXPLAINED,
    smooth_in_words,
)
from seqid_cli.params.evidence_schema import EvidenceEntry, RefinementRound
from seqid_cli.params.results import diagnosis, tables
from seqid_cli.params.results.tables import values
from seqid_cli.params.schema import (
    ClosedLoop,
    EffectOfJoint,
    EffectOfPlace,
    ParameterFile,
    RobotId,
    StoppedAt,
)

_EVENTS_SHOWN = 10
_CHART_COLUMNS = 56
_CHART_ROWS = 7


def show_diagnosis(
    screen: Screen, file: diagnosis.DiagnosisFile, joint: str | None = None
) -> None:
    """Print a diagnosis, or what it says of one joint, with all that was tried there.

    Parameters
    ----------
    screen : Screen
    file : DiagnosisFile
    joint : str, optional
        Show this joint alone, and why its findings were taken.
    """
    explains = joint is not None
    findings = file.findings
    parts = file.unexplained
    changed = file.changed
    events = file.events
    hidden = file.hidden
    joints = file.joints
    if joint is not None:
        findings = [
            finding for finding in findings if joint in _joints_of(finding, file)
        ]
        parts = [part for part in parts if part.joint == joint]
        changed = [change for change in changed if change.joint == joint]
        events = [event for event in events if joint in event.joints]
        # An effect of the whole arm has no joint.
        hidden = [effect for effect in hidden if effect.joint in (joint, None)]
        joints = {joint: joints[joint]}

    if joint is None:
        screen.result(verdict_sentence(file))
    elif not findings and not parts:
        screen.result(nothing_found_at(file, joint))
    show_poor(screen, file.verdicts, "diagnosis")
    _show_findings(screen, findings, file.robot, explains=explains)
    _show_unexplained(screen, parts, file.robot, explains=explains)
    screen.values(tables.changed_values(changed, file.robot))
    screen.values(tables.joint_residuals(joints, file.robot))
    if joint is not None:
        screen.values(tables.rivals(joints[joint].tried, "tried beside that"))

    shown_events = events if screen.verbose else events[:_EVENTS_SHOWN]
    screen.values(tables.events(shown_events))
    further_events = len(events) - len(shown_events)
    if further_events:
        screen.note(f"{further_events} more such events: -v shows them all.")
    if screen.verbose:
        screen.values(tables.hidden(hidden))
    elif hidden:
        screen.note(f"{len(hidden)} effects these motions cannot show: -v lists them.")
    screen.remark(*file.notes)


def _joints_of(
    finding: diagnosis.FindingEntry, file: diagnosis.DiagnosisFile
) -> Collection[str | None]:
    """Return the joints at which a finding is, or at which its evidence shows it."""
    if finding.effect == "external_contact":
        joints: set[str | None] = set()
        for event in file.events:
            joints.update(event.joints)
        return joints
    if finding.joint is None:  # an effect of the whole arm
        return list(file.joints)
    if finding.evidence is None:
        return {finding.joint}
    return {finding.joint, finding.evidence.joint, finding.evidence.of}


def verdict_sentence(file: diagnosis.DiagnosisFile) -> str:
    """Return the verdict in one sentence."""
    if file.verdict in ("nothing_missing", "too_short", "nothing_seen"):
        return diagnosis.nothing_found(file)
    if file.verdict == "values_changed":
        return diagnosis.values_sentence(file)

    unexplained = "; ".join(
        f"{part.joint}: {_quantities(part.depends_on)}" for part in file.unexplained
    )
    if file.verdict == "unexplained":
        where = f" ({unexplained})" if unexplained else ""
        return f"Something is missing that no known effect explains{where}."

    effects = ", ".join(
        effect_at(finding.effect, finding.joint) for finding in file.findings
    )
    sentence = f"The model lacks {effects}"
    if unexplained:
        sentence += f"; a part stays unexplained ({unexplained})"
    if file.changed:
        joints = ", ".join(change.joint for change in file.changed)
        sentence += f"; its values do not hold at {joints}"
    return f"{sentence}."


def nothing_found_at(file: diagnosis.DiagnosisFile, joint: str) -> str:
    """Return the sentence of a joint at which no effect was found."""
    for change in file.changed:
        if change.joint == joint:
            return diagnosis.values_at(change)
    if joint in diagnosis.unseen_joints(file):
        return f"{joint}: nothing could be seen."
    return f"{joint}: nothing was found."


def effect_at(effect: str, joint: str | None) -> str:
    """Return the name of an effect with its place."""
    return f"{effect} at {joint}" if joint else effect


def _show_findings(
    screen: Screen,
    findings: Sequence[diagnosis.FindingEntry],
    robot: RobotId,
    *,
    explains: bool,
) -> None:
    """Print the effects that were found, then what else each of them could be."""
    rows = [
        (
            finding.effect,
            finding.joint or "whole arm",
            finding.confidence,
            finding.explains,
            parameters_text(finding),
        )
        for finding in findings
    ]
    titles = "effect | joint | confidence | explains | parameters"
    screen.values(values(titles, "text text share share text", rows))
    for finding in findings:
        _show_doubts(screen, finding, explains=explains)
        if explains:
            _show_reasons(screen, finding, robot)


def _show_doubts(
    screen: Screen, finding: diagnosis.FindingEntry, *, explains: bool
) -> None:
    """Say what else a finding could be, and what to record to know."""
    name = effect_at(finding.effect, finding.joint)
    if finding.confusable_with:
        others = " or ".join(finding.confusable_with)
        by_itself = ""
        if finding.name_confidence is not None:
            by_itself = f" ({percent(finding.name_confidence)} by this name)"
        screen.result(f"{name}{by_itself}: could also be {others}")
    if finding.separate_by and (finding.confusable_with or explains):
        aim = "tell them apart" if finding.confusable_with else "make sure"
        screen.result(f"  to {aim}, record: {finding.separate_by}")
    if finding.note:
        screen.note(f"note: {name}: {finding.note}")


def _show_reasons(
    screen: Screen, finding: diagnosis.FindingEntry, robot: RobotId
) -> None:
    """Say why a finding was taken: its gain, its residual, and its rivals."""
    name = effect_at(finding.effect, finding.joint)
    nats = "" if finding.log_gain is None else f" ({finding.log_gain:.0f} nats)"
    share = f"{percent(finding.gain)} of the squared error on blocks left out"
    screen.result(f"{name}: takes away {share}{nats}")
    _show_evidence(screen, finding.evidence, robot)
    screen.values(tables.rivals(finding.rivals, f"tried for {name}"))


def parameters_text(effect: diagnosis.FindingEntry | EffectOfJoint) -> str:
    """Return the parameters of an effect with their errors, and its settings."""
    # Imported here: the help of commands needs no effects.
    from seqid_cli.effects.registry import setting_units

    if not effect.parameters:
        return "not determined by these logs"
    if effect.effect == UNEXPLAINED:
        return smooth_in_words(effect.parameters, effect.settings)

    texts = []
    undetermined = []
    for parameter in effect.parameters:
        std_error = parameter.std_error
        if std_error is None:
            undetermined.append(parameter.name)
            continue
        value = f"{number(parameter.value)} +- {number(std_error, 2)}"
        texts.append(f"{parameter.name} {value}{_unit(parameter.unit)}")

    parameter_names = {parameter.name for parameter in effect.parameters}
    units = setting_units(effect.effect)
    for name, setting in effect.settings.items():
        if name not in parameter_names:
            text = setting if isinstance(setting, str) else number(setting)
            texts.append(f"{name} {text}{_unit(units.get(name, ''))}")
    if undetermined:
        texts.append(f"not determined: {', '.join(undetermined)}")
    return ", ".join(texts)


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _show_unexplained(
    screen: Screen,
    parts: Sequence[diagnosis.UnexplainedPart],
    robot: RobotId,
    *,
    explains: bool,
) -> None:
    """Print what no effect explains, and on what it depends."""
    rows = []
    for part in parts:
        closest = "none"
        if part.closest:
            closest = f"{part.closest.effect}, {percent(part.closest.share)}"
        rows.append((part.joint, _quantities(part.depends_on), part.share, closest))
    titles = (
        "joint | unexplained, depends on | share | closest effect, share of its gain"
    )
    screen.values(values(titles, "text text share text", rows))
    for part in parts:
        _show_evidence(screen, part.evidence, robot)
        if explains:
            screen.values(tables.rivals(part.rivals, "tried for what is unexplained"))


def _show_evidence(
    screen: Screen, evidence: EvidenceEntry | None, robot: RobotId
) -> None:
    """Draw the residual over what an effect goes with, with the effect and without."""
    if evidence is None:
        return
    direction = " times direction" if evidence.sided else ""
    marks = ": * before, o after" if evidence.after else ""
    torque_unit = robot.unit("N m", evidence.joint)
    lines = text_chart(
        evidence.x,
        evidence.before,
        evidence.after,
        over=f"{diagnosis.over_words(evidence)}{_unit(evidence.unit)}",
        label=f"residual of {evidence.joint}{direction} {torque_unit}{marks}",
    )
    for line in lines:
        screen.result(line)


def _quantities(names: Sequence[str]) -> str:
    return ", ".join(names) or "nothing that was logged"


def show_refinement(
    screen: Screen, loop: ClosedLoop, file: ParameterFile, joint: str | None = None
) -> None:
    """Print what was added, the errors before and after, and the refined effects.

    Parameters
    ----------
    screen : Screen
    loop : ClosedLoop
    file : ParameterFile
    joint : str, optional
        Show of this joint as well what was tried there, and why it was not taken.
    """
    added = diagnosis.nothing_added(loop)
    if loop.rounds:
        added = f"Added: {_named(loop.rounds)}"
    screen.result(f"{added}.")
    if loop.unconfirmed:
        screen.result(
            "Not kept, as the held-out logs do not confirm it:"
            f" {_named(loop.unconfirmed)} (--keep-unconfirmed keeps it)."
        )
    if loop.stopped_at is not None:
        screen.warn(stopped_sentence(loop.stopped_at))
    if loop.doubtful:
        screen.warn(
            f"verdict poor: the held-out logs do not confirm {_named(loop.doubtful)}"
        )
    elif loop.rounds and not loop.verdicts:
        screen.result("Verdict good: the held-out logs confirm what was added.")
    show_poor(screen, loop.verdicts, "refinement")

    screen.values(tables.rounds(loop))
    screen.values(tables.loop_errors(loop, file.robot))
    if loop.evaluated_on:
        screen.note(
            "errors are on held-out logs where joints slide; outside: beyond the"
            " positions and speeds at which friction was identified:"
            f" {', '.join(loop.evaluated_on)}"
        )
    rows = [
        (effect.effect, effect.joint or "whole arm", parameters_text(effect))
        for effect in file.stages.effects or []
    ]
    screen.values(values("effect | joint | parameters", "text text text", rows))
    if joint is not None:
        _explain_joint(screen, loop, file.robot, joint)
    screen.remark(*loop.notes)


def _explain_joint(
    screen: Screen, loop: ClosedLoop, robot: RobotId, joint: str
) -> None:
    """Print what was tried at a joint: its evidence, each log, and its rivals."""
    outcomes = (
        ("added", loop.rounds),
        ("not kept", loop.unconfirmed),
        ("refused", loop.refused),
    )
    for outcome, entries in outcomes:
        for entry in entries:
            if joint not in _joints_of_round(entry):
                continue
            name = effect_at(entry.effect, entry.joint)
            reason = f": {entry.reason}" if entry.reason else ""
            screen.result(f"{name}: {outcome}{reason}")
            screen.values(tables.gains_of_logs(entry))
            _show_evidence(screen, entry.evidence, robot)
            screen.values(tables.rivals(entry.rivals, f"tried for {name}"))
    screen.values(tables.rivals(loop.tried.get(joint, []), "tried beside that"))


def _joints_of_round(entry: RefinementRound) -> Collection[str | None]:
    """Return the joints at which an effect was tried, acts, or shows in evidence."""
    joints = {entry.joint, *entry.acts_on}
    if entry.evidence is None:
        return joints
    return {*joints, entry.evidence.joint, entry.evidence.of}


def stopped_sentence(stopped: StoppedAt) -> str:
    """Return at which limit a refinement stopped, and what it has not tried."""
    limit = f"the limit of rounds (--rounds {stopped.rounds})"
    return f"stopped at {limit}; found and not tried: {_named(stopped.untried)}"


def _named(effects: Sequence[RefinementRound | EffectOfPlace]) -> str:
    """Return effects with their places, an effect at several joints once."""
    # An effect of the whole arm stays apart from the same one at a joint.
    joints: dict[tuple[str, bool], list[str]] = {}
    for effect in effects:
        places = joints.setdefault((effect.effect, effect.joint is None), [])
        if effect.joint is not None:
            places.append(effect.joint)

    texts = [effect_at(name, ", ".join(places)) for (name, _), places in joints.items()]
    has_commas = any(len(places) > 1 for places in joints.values())
    return ("; " if has_commas else ", ").join(texts)


def text_chart(
    x: Sequence[float],
    y: Sequence[float],
    lower: Sequence[float] = (),
    *,
    over: str,
    label: str,
) -> list[str]:
    """Draw values over x in characters, with the ranges at the axes.

    Parameters
    ----------
    x : sequence of float, N
        Need not be even or sorted. Values that fall into one column are averaged.
    y : sequence of float, N
        Drawn as `*`, above what is drawn as `o`.
    lower : sequence of float, N or none
        The same after something was taken off, drawn as `o`.
    over, label : str
        What x and y are.

    Returns
    -------
    list of str
        The lines; none below two points.
    """
    if len(x) < 2 or min(x) == max(x):
        return []
    curves = [("*", _column_means(x, y))]
    if lower:
        curves.insert(0, ("o", _column_means(x, lower)))
    heights: list[float] = []
    for _, means in curves:
        heights += means.values()
    low = min(heights)
    high = max(heights)

    canvas = [[" "] * _CHART_COLUMNS for _ in range(_CHART_ROWS)]
    last_row = _CHART_ROWS - 1
    for mark, means in curves:
        for column, value in means.items():
            share = (value - low) / (high - low) if high > low else 0.5
            canvas[last_row - round(share * last_row)][column] = mark
    return _framed(canvas, (min(x), max(x)), (low, high), over=over, label=label)


def _framed(
    canvas: Sequence[Sequence[str]],
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    *,
    over: str,
    label: str,
) -> list[str]:
    """Return the lines of a chart with its axes, their ends, and what they are."""
    low, high = (number(end) for end in y_range)
    first, last = (number(end) for end in x_range)
    ends = [high, *[""] * (len(canvas) - 2), low]
    width = max(map(len, ends))
    margin = " " * (width + 2)

    lines = [f"{margin}{label}"]
    for end, row in zip(ends, canvas, strict=True):
        lines.append(f"{end.rjust(width)} |{''.join(row)}".rstrip())
    lines.append(f"{' ' * width} +{'-' * _CHART_COLUMNS}")
    lines.append(f"{margin}{first}{last.rjust(_CHART_COLUMNS - len(first))}  {over}")
    return lines


def _column_means(x: Sequence[float], y: Sequence[float]) -> Mapping[int, float]:
    """Return the mean of y in each column of the chart that has any, by its number."""
    first = min(x)
    span = max(x) - first
    columns: dict[int, list[float]] = {}
    for position, value in zip(x, y, strict=True):
        column = round((position - first) / span * (_CHART_COLUMNS - 1))
        columns.setdefault(column, []).append(value)
    return {column: sum(inside) / len(inside) for column, inside in columns.items()}
