"""A diagnosis and a refinement on the screen: the verdict first, then evidence and what is open."""

from collections.abc import Collection, Sequence

from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.model.effects.units import UNEXPLAINED, UNTOLD, smooth_in_words
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
_COLUMNS, _ROWS = 56, 7  # of a chart


def show_diagnosis(
    screen: Screen, file: diagnosis.DiagnosisFile, joint: str | None = None
) -> None:
    """Print a diagnosis, or what it says of one joint, with the evidence and all that was tried."""
    why = joint is not None
    findings = [
        item for item in file.findings if not joint or joint in _places(item, file)
    ]
    parts = [part for part in file.unexplained if part.joint == (joint or part.joint)]
    joints = {joint: file.joints[joint]} if joint else file.joints
    if joint is None:
        screen.result(verdict_sentence(file))
    elif not findings and not parts:
        screen.result(nothing_found_at(file, joint))
    show_poor(screen, file.verdicts, "diagnosis")
    _findings(screen, findings, file.robot, why=why)
    _unexplained(screen, parts, file.robot, why=why)
    changed = [one for one in file.changed if one.joint == (joint or one.joint)]
    screen.values(tables.changed_values(changed, file.robot))
    screen.values(tables.joint_residuals(joints, file.robot))
    if joint is not None:
        screen.values(tables.rivals(joints[joint].tried, "tried beside that"))
    events = [event for event in file.events if not joint or joint in event.joints]
    shown = events if screen.verbose else events[:_EVENTS_SHOWN]
    screen.values(tables.events(shown))
    if len(shown) < len(events):
        screen.note(f"{len(events) - len(shown)} more such events: -v shows them all.")
    hidden = [item for item in file.hidden if not joint or item.joint in (joint, None)]
    if screen.verbose:
        screen.values(tables.hidden(hidden))
    elif hidden:
        screen.note(f"{len(hidden)} effects these motions cannot show: -v lists them.")
    screen.remark(*file.notes)


def _places(
    item: diagnosis.FindingEntry, file: diagnosis.DiagnosisFile
) -> Collection[str]:
    """Joints that a finding is of: there, or shown there; all of one of the whole arm."""
    if item.effect == "external_contact":
        return {name for event in file.events for name in event.joints}
    if item.joint is None:
        return list(file.joints)
    return {
        item.joint,
        *((item.evidence.joint, item.evidence.of) if item.evidence else ()),
    }


def verdict_sentence(file: diagnosis.DiagnosisFile) -> str:
    """Return the verdict in one sentence."""
    if file.verdict in ("nothing_missing", "too_short", "nothing_seen"):
        return diagnosis.nothing_found(file)
    if file.verdict == "values_changed":
        return diagnosis.values_sentence(file)
    rest = "; ".join(
        f"{part.joint}: {_quantities(part.depends_on)}" for part in file.unexplained
    )
    if file.verdict == "unexplained":
        where = f" ({rest})" if rest else ""
        return f"Something is missing that no known effect explains{where}."
    found = ", ".join(effect_at(item.effect, item.joint) for item in file.findings)
    more = f"; a part stays unexplained ({rest})" if rest else ""
    changed = ", ".join(one.joint for one in file.changed)
    values = f"; its values do not hold at {changed}" if changed else ""
    return f"The model lacks {found}{more}{values}."


def nothing_found_at(file: diagnosis.DiagnosisFile, joint: str) -> str:
    """Return the sentence of a joint at which no effect was found."""
    changed = [one for one in file.changed if one.joint == joint]
    if changed:
        return diagnosis.values_at(changed[0])
    if file.joints[joint].samples == 0:
        return f"{joint}: no sample could be looked at."
    return f"{joint}: nothing was found."


def effect_at(effect: str, joint: str | None) -> str:
    """Return the name of an effect with its place."""
    return f"{effect} at {joint}" if joint else effect


def _findings(
    screen: Screen,
    findings: Sequence[diagnosis.FindingEntry],
    robot: RobotId,
    *,
    why: bool,
) -> None:
    rows = [
        (x.effect, x.joint or "whole arm", x.confidence, x.explains, parameters_text(x))
        for x in findings
    ]
    titles = "effect | joint | confidence | explains | parameters"
    screen.values(values(titles, "text text share share text", rows))
    for item in findings:
        name = effect_at(item.effect, item.joint)
        if item.confusable_with:
            others, sure = " or ".join(item.confusable_with), item.name_confidence
            alone = "" if sure is None else f" ({percent(sure)} by this name)"
            screen.result(f"{name}{alone}: could also be {others}")
        if item.separate_by and (item.confusable_with or why):
            aim = "tell them apart" if item.confusable_with else "make sure"
            screen.result(f"  to {aim}, record: {item.separate_by}")
        if item.note:
            screen.note(f"note: {name}: {item.note}")
        if why:
            nats = "" if item.log_gain is None else f" ({item.log_gain:.0f} nats)"
            share = f"{percent(item.gain)} of the squared error on blocks left out"
            screen.result(f"{name}: takes away {share}{nats}")
            _shown(screen, item.evidence, robot)
            screen.values(tables.rivals(item.rivals, f"tried for {name}"))


def parameters_text(item: diagnosis.FindingEntry | EffectOfJoint) -> str:
    """Return the parameters of an effect with their errors, and its settings."""
    # help of commands needs none
    from seqid_cli.model.effects.registry import setting_units

    if not item.parameters:
        return "not determined by these logs"
    if item.effect == UNEXPLAINED:
        return smooth_in_words(item.parameters, item.settings)
    told = [
        x for x in item.parameters if x.std_error is not None and x.std_error < UNTOLD
    ]
    texts = [
        f"{x.name} {number(x.value)} +- {number(x.std_error, 2)}{_unit(x.unit)}"
        for x in told
    ]
    named, units = {x.name for x in item.parameters}, setting_units(item.effect)
    for name, value in item.settings.items():
        if name not in named:
            text = value if isinstance(value, str) else number(value)
            texts.append(f"{name} {text}{_unit(units.get(name, ''))}")
    untold = [x.name for x in item.parameters if x not in told]
    texts += [f"not determined: {', '.join(untold)}"] if untold else []
    return ", ".join(texts)


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _unexplained(
    screen: Screen,
    parts: Sequence[diagnosis.UnexplainedPart],
    robot: RobotId,
    *,
    why: bool,
) -> None:
    rows = []
    for part in parts:
        near = part.closest
        closest = f"{near.effect}, {percent(near.share)}" if near else "none"
        rows.append((part.joint, _quantities(part.depends_on), part.share, closest))
    titles = (
        "joint | unexplained, depends on | share | closest effect, share of its gain"
    )
    screen.values(values(titles, "text text share text", rows))
    for part in parts:
        _shown(screen, part.evidence, robot)
        if why:
            screen.values(tables.rivals(part.rivals, "tried for what is unexplained"))


def _shown(screen: Screen, shown: EvidenceEntry | None, robot: RobotId) -> None:
    """Draw the residual over what an effect goes with, before and after that is taken off."""
    if shown is None:
        return
    sided = " times direction" if shown.sided else ""
    marks = ": * before, o after" if shown.after else ""
    force = robot.unit("N m", shown.joint)
    label, over = (
        f"residual of {shown.joint}{sided} {force}{marks}",
        diagnosis.over_words(shown),
    )
    over += _unit(shown.unit)
    for line in text_chart(shown.x, shown.before, shown.after, over=over, label=label):
        screen.result(line)


def _quantities(names: Sequence[str]) -> str:
    return ", ".join(names) or "nothing that was logged"


def show_refinement(screen: Screen, loop: ClosedLoop, file: ParameterFile) -> None:
    """Print the rounds, the errors before and after, and the effects of the refined model."""
    added = (
        f"Added: {_named(loop.rounds)}"
        if loop.rounds
        else diagnosis.nothing_added(loop)
    )
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
    effects = file.stages.effects or []
    rows = [
        (item.effect, item.joint or "whole arm", parameters_text(item))
        for item in effects
    ]
    screen.values(values("effect | joint | parameters", "text text text", rows))
    screen.remark(*loop.notes)


def stopped_sentence(stopped: StoppedAt) -> str:
    """Return at which limit of rounds a refinement stopped, and what it has not tried."""
    limit = f"the limit of rounds (--rounds {stopped.rounds})"
    return f"stopped at {limit}; found and not tried: {_named(stopped.untried)}"


def _named(rounds: Sequence[RefinementRound | EffectOfPlace]) -> str:
    """Return effects with their places, an effect at several joints once."""
    joints: dict[tuple[str, bool], list[str]] = {}
    for item in rounds:
        of_effect = joints.setdefault((item.effect, item.joint is None), [])
        if item.joint is not None:
            of_effect.append(item.joint)
    named = (
        effect_at(effect, ", ".join(places)) for (effect, _), places in joints.items()
    )
    return "; ".join(named) if max(map(len, joints.values())) > 1 else ", ".join(named)


def text_chart(
    x: Sequence[float],
    y: Sequence[float],
    after: Sequence[float] = (),
    *,
    over: str,
    label: str,
) -> list[str]:
    """Draw y (`*`) and what it is `after` something (`o`) over x, with the ranges at the axes.

    Nothing below two points. Those in one column are averaged; x need not be even or
    sorted.
    """
    if len(x) < 2 or min(x) == max(x):
        return []
    curves = [("o", _column_means(x, after))] if after else []
    curves.append(("*", _column_means(x, y)))
    every = [value for _, means in curves for value in means.values()]
    low, high = min(every), max(every)
    rows = [[" "] * _COLUMNS for _ in range(_ROWS)]
    for mark, means in curves:
        for column, value in means.items():
            share = (value - low) / (high - low) if high > low else 0.5
            rows[_ROWS - 1 - round(share * (_ROWS - 1))][column] = mark
    labels = [number(high), *[""] * (_ROWS - 2), number(low)]
    width = max(map(len, labels))
    drawn = (
        f"{y.rjust(width)} |{''.join(row)}" for y, row in zip(labels, rows, strict=True)
    )
    left, right = number(min(x)), number(max(x))
    margin = " " * (width + 2)
    return [
        f"{margin}{label}",
        *map(str.rstrip, drawn),
        f"{' ' * width} +{'-' * _COLUMNS}",
        f"{margin}{left}{right.rjust(_COLUMNS - len(left))}  {over}",
    ]


def _column_means(x: Sequence[float], y: Sequence[float]) -> dict[int, float]:
    left, span = min(x), max(x) - min(x)
    columns: dict[int, list[float]] = {}
    for at, value in zip(x, y, strict=True):
        columns.setdefault(round((at - left) / span * (_COLUMNS - 1)), []).append(value)
    return {column: sum(values) / len(values) for column, values in columns.items()}
