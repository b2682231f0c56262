"""How findings bear on each other: which comes first, and what makes one less sure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.results import Finding, Unexplained
from seqid_cli.model.effects.registry import CATALOGUE

LESSER = 0.5  # of what is above the noise floor, that the first finding explains
REST = 0.5  # of the certainty, where a finding may be the rest of another


def beside_rest(finding: Finding, rest: Sequence[Unexplained]) -> Finding:
    """Less sure where more of its joints' residual depends on things unknown than it explains.

    What shows above the cut-off is judged there, and the rest lies below.
    """
    shares: dict[str, float] = {}
    for part in rest:
        shares[part.joint] = max(part.share, shares.get(part.joint, 0.0))
    return _beside_unknown(finding, shares)


def _beside_unknown(finding: Finding, shares: Mapping[str, float]) -> Finding:
    """Less sure by what share of its joint's residual, or of any if it has none, is not known."""
    near = [share for joint, share in shares.items() if finding.joint in (None, joint)]
    share = max(near, default=0.0)
    if not share or CATALOGUE[finding.effect].wide:
        return finding
    unknown = share * (1.0 - finding.explains)
    return less_sure(finding, finding.explains / max(finding.explains + unknown, 1e-12))


def less_sure(finding: Finding, share: float) -> Finding:
    """Both confidences times `share`."""
    return replace(
        finding,
        confidence=share * finding.confidence,
        name_confidence=share * finding.name_confidence,
    )


def ordered(
    findings: Sequence[Finding], louder: Mapping[str, float], told: Collection[str] = ()
) -> list[Finding]:
    """The weightiest first; none is more certain than one that it was found beside.

    Where a joint stays `louder` (share of its squared residual that noise does not make), the first
    has not quite the right shape, and what comes after may be made of that. Where it is so loud
    that it is `told`, a first that explains the lesser part may be no more than the likest thing.
    """
    row = sorted(findings, key=lambda f: (-f.explains * f.confidence, -f.gain))
    row = [_of_company(f, row[:k], row[k + 1 :]) for k, f in enumerate(row)]
    row[1:] = [_beside_unknown(f, louder) for f in row[1:]]
    if row and row[0].explains < LESSER:
        row[0] = _beside_unknown(row[0], {j: x for j, x in louder.items() if j in told})
    certainties = np.minimum.accumulate([f.confidence for f in row])
    return [
        replace(f, confidence=float(c), name_confidence=min(f.name_confidence, float(c)))
        for f, c in zip(row, certainties, strict=True)
    ]


def _of_company(finding: Finding, before: Sequence[Finding], after: Sequence[Finding]) -> Finding:
    """Findings alike at one joint may be one effect, and so may one wave at several joints.

    The lesser is half as sure.
    """
    weightier, lesser = (_alike(finding, others) for others in (before, after))
    source = _source(finding, before)
    names = dict.fromkeys((*finding.confusable_with, *weightier, *lesser))
    sure = less_sure(finding, REST if weightier or source else 1.0)
    said = f"as at {source}, which may shake this joint" if source else finding.note
    return replace(sure, confusable_with=tuple(names), note=said)


def _source(finding: Finding, weightier: Sequence[Finding]) -> str:
    """Another joint at which the same wave in time is larger; empty if there is none."""
    effect = CATALOGUE[finding.effect]
    for other in weightier:
        there = other.effect == finding.effect and None not in (other.joint, finding.joint)
        if there and effect.one_source(finding.settings, other.settings):
            return str(other.joint)
    return ""


def _alike(finding: Finding, others: Sequence[Finding]) -> list[str]:
    return [
        f.effect
        for f in others
        if f.joint == finding.joint
        and (
            f.effect in CATALOGUE[finding.effect].alike
            or finding.effect in CATALOGUE[f.effect].alike
        )
    ]
