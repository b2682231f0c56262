"""Every finding with its evidence and whether it was right, to calibrate confidence with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from seqid_cli.params.results.diagnosis import FindingEntry
from tests.studies.undeclared_score import named, right
from tests.studies.undeclared_tables import Judged


@dataclass(frozen=True)
class Evidence:
    """One finding, the `rank`-th of its diagnosis, from 0.

    `rivals` are the other findings as effect@joint; `unexplained` is the largest share of the
    finding's joint that depends on something unknown; `excess` is, per true effect, the largest
    share by which it raises a joint's held-out RMSE.
    """

    case: str
    group: str
    rig: str
    start: str
    sensors: str
    truths: tuple[str, ...]
    sizes: tuple[float, ...]
    excess: tuple[float, ...]
    verdict: str
    rank: int
    effect: str
    joint: str | None
    right: bool
    kind_right: bool
    name_right: bool
    confidence: float
    name_confidence: float
    explains: float
    gain: float

    confusables: int
    confusable_with: tuple[str, ...]
    rivals: tuple[str, ...]
    unexplained: float
    rmse: float | None
    noise_floor: float | None
    rmse_explained: float | None


def evidence(cases: Sequence[Judged]) -> Iterator[Evidence]:
    """Yield all findings of all cases."""
    for case in cases:
        for rank, finding in enumerate(case.diagnosis.findings):
            yield _of(case, rank, finding)


def _of(case: Judged, rank: int, finding: FindingEntry) -> Evidence:
    condition, diagnosis = case.condition, case.diagnosis
    others = [f for f in diagnosis.findings if f is not finding]
    shares = [u.share for u in diagnosis.unexplained if finding.joint in (None, u.joint)]
    residual = diagnosis.joints.get(finding.joint or "")
    return Evidence(
        case=case.record.key,
        group=condition.group,
        rig=condition.rig,
        start=condition.start,
        sensors=condition.sensors,
        truths=tuple(f"{t.name}@{'|'.join(map(str, t.joints))}" for t in case.truths),
        sizes=tuple(size for _, _, size in condition.effects),
        excess=tuple(max(more) for more in case.record.excess),
        verdict=diagnosis.verdict,
        rank=rank,
        effect=finding.effect,
        joint=finding.joint,
        right=any(right(finding, t) for t in case.truths),
        kind_right=any(named(finding, t) for t in case.truths),
        name_right=any(finding.effect == t.kind and finding.joint in t.joints for t in case.truths),
        confidence=finding.confidence,
        name_confidence=finding.name_confidence,
        explains=finding.explains,
        gain=finding.gain,
        confusables=len(finding.confusable_with),
        confusable_with=finding.confusable_with,
        rivals=tuple(f"{f.effect}@{f.joint}" for f in others),
        unexplained=max(shares, default=0.0),
        rmse=None if residual is None else residual.rmse,
        noise_floor=None if residual is None else residual.noise_floor,
        rmse_explained=None if residual is None else residual.rmse_explained,
    )


def write_evidence(path: Path, cases: Sequence[Judged]) -> None:
    """Write one JSON line per finding."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(msgspec.json.encode(e) + b"\n" for e in evidence(cases)))
