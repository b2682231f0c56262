"""A refinement on the screen: what was tried, what it changed, what the model holds now."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.commands.screen.show_diagnosis import effect_at, parameters_text
from seqid_cli.params.results import tables
from seqid_cli.params.results.tables import values
from seqid_cli.params.schema import ClosedLoop, EffectOfJoint, RefinementRound


def show_refinement(screen: Screen, loop: ClosedLoop, effects: Sequence[EffectOfJoint]) -> None:
    """Print the rounds, the errors before and after, and the effects of the refined model."""
    if loop.rounds:
        screen.result(f"Added: {_named(loop.rounds)}.")
    else:
        why = "no effect predicts left-out blocks better" if loop.refused else "nothing was found"
        screen.result(f"Nothing was added: {why}.")
    doubtful = [item for item in loop.rounds if not item.confirmed]
    if doubtful:
        screen.warn(f"verdict poor: the held-out logs do not confirm {_named(doubtful)}")
    elif loop.rounds and not loop.verdicts:
        screen.result("Verdict good: the held-out logs confirm what was added.")
    show_poor(screen, loop.verdicts, "refinement")
    screen.values(tables.rounds(loop))
    screen.values(tables.loop_errors(loop))
    if loop.evaluated_on:
        screen.note(
            "errors are on held-out logs where joints slide; outside: beyond the positions and"
            f" speeds at which friction was identified: {', '.join(loop.evaluated_on)}"
        )
    rows = [(item.effect, item.joint or "whole arm", parameters_text(item)) for item in effects]
    screen.values(values("effect | joint | parameters", "text text text", rows))
    for note in loop.notes:
        screen.remark(note)


def _named(rounds: Sequence[RefinementRound]) -> str:
    return ", ".join(effect_at(item.effect, item.joint) for item in rounds)
