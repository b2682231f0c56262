"""A refinement on the screen: what was tried, what it changed, what the model holds now."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.render import Screen, number, percent
from seqid_cli.commands.show_diagnosis import effect_at, setting_units
from seqid_cli.params.schema import ClosedLoop, EffectOfJoint, RefinementRound


def show_refinement(screen: Screen, loop: ClosedLoop, effects: Sequence[EffectOfJoint]) -> None:
    """Print the rounds, the errors before and after, and the effects of the refined model."""
    if loop.rounds:
        added = ", ".join(effect_at(item.effect, item.joint) for item in loop.rounds)
        screen.result(f"Added: {added}.")
    else:
        why = "no effect predicts the held-out logs better" if loop.refused else "nothing was found"
        screen.result(f"Nothing was added: {why}.")
    _rounds(screen, [*loop.rounds, *loop.refused])
    _errors(screen, loop)
    _effects(screen, effects)
    for note in loop.notes:
        screen.note(f"note: {note}")


def _rounds(screen: Screen, rounds: Sequence[RefinementRound]) -> None:
    columns = ("effect", "joint", "gain fitted", "gain held out", "95 % interval", "outcome")
    rows = [
        (
            item.effect,
            item.joint or "whole arm",
            percent(item.training_gain),
            percent(item.held_out_gain),
            _interval(item.interval),
            _outcome(item),
        )
        for item in rounds
    ]
    screen.table(columns, rows)


def _outcome(item: RefinementRound) -> str:
    if item.accepted:
        return f"added: {item.reason}" if item.reason else "added"
    return f"refused: {item.reason or 'no gain'}"


def _errors(screen: Screen, loop: ClosedLoop) -> None:
    columns = (
        "joint",
        "before N m",
        "after N m",
        "noise floor N m",
        "variance less by",
        "95 % interval",
    )
    rows = []
    for name, error in loop.before.items():
        before, after = error.rmse, loop.after[name].rmse if name in loop.after else None
        gain = None if after is None or not before else 1.0 - (after / before) ** 2
        interval = _interval(loop.gain_interval.get(name, []))
        floor = number(loop.noise_floor.get(name))
        rows.append((name, number(before), number(after), floor, percent(gain), interval))
    screen.table(columns, rows)
    if loop.evaluated_on:
        screen.note(f"errors are on held-out logs: {', '.join(loop.evaluated_on)}")


def _effects(screen: Screen, effects: Sequence[EffectOfJoint]) -> None:
    rows = []
    for item in effects:
        joint, units = item.joint or "whole arm", setting_units(item.effect)
        named = {value.name for value in item.parameters}
        for value in item.parameters:
            error = number(value.std_error, 2)
            rows.append((item.effect, joint, value.name, number(value.value), error, value.unit))
        for name, setting in item.settings.items():
            if name not in named:
                text = number(setting) if isinstance(setting, float) else str(setting)
                rows.append((item.effect, joint, name, text, "-", units.get(name, "-")))
    screen.table(("effect", "joint", "parameter", "value", "std error", "unit"), rows)


def _interval(limits: Sequence[float]) -> str:
    return f"{percent(limits[0])} to {percent(limits[1])}" if limits else "-"
