"""The story of one joint: its residual, what was tried, what was taken and not, what is left."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from seqid_cli.commands.screen.render import Screen, limits, number, percent
from seqid_cli.commands.screen.show import show_poor
from seqid_cli.commands.screen.show_diagnosis import (
    effect_at,
    parameters_text,
    quantities_text,
    show_evidence,
)
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.results.diagnosis import (
    DiagnosisFile,
    FindingEntry,
    ResidualEntry,
    UnexplainedPart,
)
from seqid_cli.params.results.diagnosis_words import flatness


def show_explained(screen: Screen, file: DiagnosisFile, joint: str) -> None:
    """Print what a diagnosis says of one joint, and why."""
    residual = file.joints[joint]
    screen.result(_size(joint, residual))
    show_poor(screen, file.verdicts, "diagnosis")
    pushed = {name for event in file.events for name in event.joints}
    findings = [item for item in file.findings if _touches(item, joint, pushed)]
    parts = [part for part in file.unexplained if part.joint == joint]
    for item in findings:
        _taken(screen, item)
    for part in parts:
        _function(screen, part)
    if not findings and not parts:
        screen.result("Nothing was taken.")
    _tried(screen, residual.tried, "Tried beside that, and not taken:")
    screen.result(_left(joint, residual))
    hidden = [item.effect for item in file.hidden if item.joint in (joint, None)]
    if hidden:
        screen.result(f"These motions cannot show: {', '.join(dict.fromkeys(hidden))}.")
    for note in file.notes:
        screen.remark(note)


def _touches(item: FindingEntry, joint: str, pushed: Collection[str]) -> bool:
    """Whether a finding is of a joint: there, or shown there, or of the whole arm."""
    if item.effect == "external_contact":
        return joint in pushed
    shown = item.evidence
    return item.joint in (joint, None) or (shown is not None and joint in (shown.joint, shown.of))


def _size(joint: str, residual: ResidualEntry) -> str:
    if residual.rmse is None or not residual.noise_floor:
        return f"{joint}: no sample counts; it slides too seldom in these logs."
    times = number(residual.rmse / residual.noise_floor)
    return (
        f"{joint}: the model leaves {number(residual.rmse)} N m (RMS), {times} times the noise"
        f" floor of {number(residual.noise_floor)} N m ({limits(residual.noise_floor_interval)})."
    )


def _taken(screen: Screen, item: FindingEntry) -> None:
    name = effect_at(item.effect, item.joint or "the whole arm")
    screen.result(f"Taken: {name}, {_sure(item)}.")
    screen.result(
        f"  It takes away {percent(item.gain)} of the squared error on blocks that were left out:"
        f" {percent(item.explains)} of what is above the noise."
    )
    if item.parameters:
        screen.result(f"  {parameters_text(item)}")
    if item.note:
        screen.result(f"  {item.note}")
    _shown(screen, item.evidence)
    _tried(screen, item.rivals, f"Tried in its place ({_nats(item.log_gain)}):")
    if item.separate_by:
        why = "To tell it from" if item.confusable_with else "To make sure"
        rest = f" {' and '.join(item.confusable_with)}" if item.confusable_with else ""
        screen.result(f"{why}{rest}, record: {item.separate_by}.")


def _sure(item: FindingEntry) -> str:
    sure = f"{percent(item.confidence)} sure"
    if not item.confusable_with or item.name_confidence is None:
        return sure
    others = " or ".join(item.confusable_with)
    return f"or {others}: {sure}, of this name {percent(item.name_confidence)}"


def _function(screen: Screen, part: UnexplainedPart) -> None:
    share = percent(part.share)
    screen.result(
        f"Unexplained: {share} of what is left goes with {quantities_text(part.depends_on)}."
    )
    _shown(screen, part.evidence)
    if part.closest:
        near = part.closest
        screen.result(f"Closest: {near.effect}, with {percent(near.share)} of the gain.")
    _tried(screen, part.rivals, f"Tried in its place ({_nats(part.log_gain)}):")


def _shown(screen: Screen, shown: EvidenceEntry | None) -> None:
    show_evidence(screen, shown)
    swing = flatness(shown) if shown else None
    if swing:
        before, after = number(swing[0]), number(swing[1])
        screen.result(f"Over it the residual varies by {before} N m before, {after} N m after.")


def _tried(screen: Screen, rivals: Sequence[RivalEntry], title: str) -> None:
    if not rivals:
        return
    screen.result(title)
    rows = [
        (one.effect, one.joint or "whole arm", f"{one.log_gain:.0f}", one.why_not) for one in rivals
    ]
    screen.table(("tried", "joint", "gain, nats", "why not"), rows)


def _nats(gain: float | None) -> str:
    return "its gain is not known" if gain is None else f"its own gain: {gain:.0f} nats"


def _left(joint: str, residual: ResidualEntry) -> str:
    if residual.rmse_explained is None or not residual.noise_floor:
        return "Nothing can be said of what is left."
    times = number(residual.rmse_explained / residual.noise_floor)
    left = f"Left: {number(residual.rmse_explained)} N m, {times} times the noise floor"
    return f"{left}, {'white' if residual.white else 'not white'}."
