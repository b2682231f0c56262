"""A refinement on the screen: what was tried, what it changed, what the model holds now."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.screen.render import Screen
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.commands.screen.show_diagnosis import effect_at, parameters_text
from seqid_cli.params.results import tables
from seqid_cli.params.schema import ClosedLoop, EffectOfJoint


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
    screen.values(tables.rounds(loop))
    screen.values(tables.loop_errors(loop))
    if loop.evaluated_on:
        screen.note(
            "errors are on held-out logs where joints slide; outside: beyond the positions and"
            f" speeds at which friction was identified: {', '.join(loop.evaluated_on)}"
        )
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
