"""A case of the study of undeclared effects, its diagnosis, its truth; cells of its tables."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.studies.undeclared.cases import Condition, Truth, built, in_the_model
from tests.studies.undeclared.run import Record
from tests.studies.undeclared.score import Score, right, score, visible
from tests.unit.params.documents import diagnosis_file

# Neither quiet nor right.
FAILED = replace(diagnosis_file(), findings=[], unexplained=[], joints={}, events=[], hidden=[])


@dataclass(frozen=True)
class Judged:
    """A case, its diagnosis and its truth; `scores` is per effect, one where clean."""

    record: Record
    condition: Condition
    diagnosis: DiagnosisFile
    truths: tuple[Truth, ...]
    scores: tuple[Score, ...]

    @property
    def score(self) -> Score:
        """Of the only effect, or of none."""
        return self.scores[0]

    @property
    def seen(self) -> bool:
        """Whether all effects leave something to find."""
        names = [name for name, _, _ in self.condition.effects]
        missing = all(not in_the_model(self.condition, name) for name in names)
        return missing and all(map(visible, self.record.excess))

    @property
    def first_right(self) -> bool:
        """Whether the first finding is one of the true effects."""
        first = self.diagnosis.findings[0]
        return any(right(first, truth) for truth in self.truths)


Select = Callable[[Judged], bool]
Cases = Sequence[Judged]
Cell = Callable[[Cases], str]


def judged(records: Sequence[Record]) -> list[Judged]:
    """Judge every record; one without a diagnosis is wrong in every respect."""
    found = []
    for record in records:
        diagnosis = record.diagnosis or FAILED
        _, truths = built(record.condition)
        scores = tuple(score(diagnosis, truths, k) for k in range(max(len(truths), 1)))
        found.append(Judged(record, record.condition, diagnosis, truths, scores))
    return found


def percent(hits: int, of: int) -> str:
    """Share and count, "-" of none."""
    return f"{100 * hits / of:.0f} % of {of}" if of else "-"


def share(hit: Select, only: Select = lambda case: True) -> Cell:
    """A cell: the share of the cases that a condition holds for, of some of them."""

    def cell(cases: Cases) -> str:
        own = [c for c in cases if only(c)]
        return percent(sum(map(hit, own)), len(own))

    return cell


def of_rig(rig: str) -> Select:
    """Cases of a rig."""
    return lambda case: case.condition.rig == rig


def mistaken(hit: Select, only: Select = lambda case: True) -> Cell:
    """A cell: what the first finding says most often where it is wrong."""

    def cell(cases: Cases) -> str:
        names = Counter(_said(c) for c in cases if only(c) and not hit(c))
        return ", ".join(f"{name} {count}" for name, count in names.most_common(2)) or "-"

    return cell


def _said(case: Judged) -> str:
    if case.record.diagnosis is None:
        return "failed"
    findings = case.diagnosis.findings
    return findings[0].effect if findings else case.diagnosis.verdict


def of_group(cases: Cases, group: str) -> list[Judged]:
    """Cases of a group that leave something to find."""
    return [c for c in cases if c.condition.group == group and c.seen]


def by_name(cases: Cases, names: Iterable[str]) -> dict[str, Cases]:
    """Cases by the name of their effect, and all of them."""
    groups: dict[str, Cases] = {n: [c for c in cases if c.truths[0].name == n] for n in names}
    return groups | {"all": cases}
