"""A refinement on the screen: what was tried, what it changed, what the model holds now."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.screen.render import Screen, limits, number, percent
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.commands.screen.show_diagnosis import effect_at, parameters_text
from seqid_cli.params.schema import ClosedLoop, EffectOfJoint, RefinementRound


def show_refinement(screen: Screen, loop: ClosedLoop, effects: Sequence[EffectOfJoint]) -> None:
    """Print the rounds, the errors before and after, and the effects of the refined model."""
    if loop.rounds:
        added = ", ".join(effect_at(item.effect, item.joint) for item in loop.rounds)
        screen.result(f"Added: {added}.")
        _verdict(screen, loop)
    else:
        why = "no effect predicts left-out blocks better" if loop.refused else "nothing was found"
        screen.result(f"Nothing was added: {why}.")
    show_poor(screen, loop.verdicts, "refinement")
    _rounds(screen, [*loop.rounds, *loop.refused])
    _errors(screen, loop)
    columns = ("effect", "joint", "parameters")
    rows = [(item.effect, item.joint or "whole arm", parameters_text(item)) for item in effects]
    screen.table(columns, rows)
    for note in loop.notes:
        screen.remark(note)


def _verdict(screen: Screen, loop: ClosedLoop) -> None:
    """Say whether logs that had no say in it confirm the effects."""
    doubtful = [item for item in loop.rounds if not item.confirmed]
    if doubtful:
        named = ", ".join(effect_at(item.effect, item.joint) for item in doubtful)
        screen.warn(f"verdict poor: the held-out logs do not confirm {named}")
    elif not loop.verdicts:
        screen.result("Verdict good: the held-out logs confirm what was added.")


def _rounds(screen: Screen, rounds: Sequence[RefinementRound]) -> None:
    columns = (
        "effect",
        "joint",
        "gain left out",
        "95 % interval",
        "gain held out",
        "95 % interval",
        "outcome",
    )
    rows = [
        (
            item.effect,
            item.joint or "whole arm",
            percent(item.training_gain),
            _interval(item.training_interval),
            percent(item.held_out_gain),
            _interval(item.interval),
            _outcome(item),
        )
        for item in rounds
    ]
    screen.table(columns, rows)


def _outcome(item: RefinementRound) -> str:
    if not item.accepted:
        return f"refused: {item.reason or 'no gain'}"
    confirmed = "confirmed" if item.confirmed else "not confirmed"
    return f"added, {confirmed}: {item.reason}" if item.reason else f"added, {confirmed}"


def _errors(screen: Screen, loop: ClosedLoop) -> None:
    columns = (
        "joint",
        "before N m",
        "after N m",
        "noise floor N m",
        "its 95 % interval",
        "variance less by",
        "95 % interval",
        "outside",
        "before, after there",
    )
    rows = []
    for name, error in loop.before.items():
        new = loop.after.get(name)
        gain = None if new is None or not error.rmse else 1.0 - (new.rmse / error.rmse) ** 2
        interval = _interval(loop.gain_interval.get(name, []))
        floor = (
            number(loop.noise_floor.get(name)),
            limits(loop.noise_floor_interval.get(name, ())),
        )
        after = None if new is None else new.rmse
        there = [error.rmse_outside, None if new is None else new.rmse_outside]
        outside = (percent(error.share_outside), ", ".join(map(number, there)))
        rows.append(
            (name, number(error.rmse), number(after), *floor, percent(gain), interval, *outside)
        )
    screen.table(columns, rows)
    if loop.evaluated_on:
        screen.note(
            "errors are on held-out logs where joints slide; outside: beyond the positions and"
            f" speeds at which friction was identified: {', '.join(loop.evaluated_on)}"
        )


def _interval(limits: Sequence[float]) -> str:
    return f"{percent(limits[0])} to {percent(limits[1])}" if limits else "-"
