"""Whether a diagnosis is right, by the rules that the study's tables are made with."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry, UnexplainedPart
from tests.studies.undeclared.cases import Truth

SURE = 0.8  # confidence from which a wrong mechanism counts as a confident error
INVISIBLE = 0.02  # share by which an effect must raise some joint's held-out RMSE to be seen
LOOSE = 0.5  # the same for backlash, whose impacts do not repeat


def named(finding: FindingEntry, truth: Truth) -> bool:
    """Whether the finding is of the true kind, or says that it might be."""
    return truth.kind is not None and truth.kind in (finding.effect, *finding.confusable_with)


def right(finding: FindingEntry, truth: Truth) -> bool:
    """Whether it is of the true kind at the right joint; None is the whole arm's."""
    return named(finding, truth) and finding.joint in truth.joints


def wrong(finding: FindingEntry, truths: Sequence[Truth]) -> bool:
    """Whether it is none of the true effects."""
    return not any(right(finding, truth) for truth in truths)


def quantity_named(entry: UnexplainedPart, truth: Truth) -> bool:
    """Whether it is at a right joint and names something that the effect depends on."""
    return entry.joint in truth.joints and bool(set(entry.depends_on) & set(truth.depends_on))


def quantities_named(entry: UnexplainedPart, truth: Truth) -> bool:
    """Whether it is at a right joint and names everything that the effect depends on."""
    return entry.joint in truth.joints and set(truth.depends_on) <= set(entry.depends_on)


@dataclass(frozen=True)
class Score:
    """One diagnosis against one true effect, or none.

    Attributes
    ----------
    right, kind_right, own_name : bool
        The first finding: kind and joint; kind alone; kind without help of confusable ones.
    anywhere : bool
        Some finding has kind and joint.
    quiet : bool
        The verdict is nothing_missing.
    alarm : bool
        There is a finding.
    explained_away : bool
        The verdict is unexplained with a right quantity at the right joint; `all_quantities` with
        all of them.
    sure_and_wrong : bool
        Some finding of confidence above `SURE` is none of the true effects.
    """

    right: bool
    kind_right: bool
    own_name: bool
    anywhere: bool
    quiet: bool
    alarm: bool
    explained_away: bool
    all_quantities: bool
    sure_and_wrong: bool


def score(diagnosis: DiagnosisFile, truths: Sequence[Truth], number: int = 0) -> Score:
    """Judge a diagnosis by true effect `number`; the others only keep findings from being wrong."""
    truth = truths[number] if truths else Truth("clean", None, (), ())
    first = diagnosis.findings[0] if diagnosis.findings else None
    unknown = diagnosis.verdict == "unexplained"
    return Score(
        right=first is not None and right(first, truth),
        kind_right=first is not None and named(first, truth),
        own_name=first is not None and first.effect == truth.kind and right(first, truth),
        anywhere=any(right(f, truth) for f in diagnosis.findings),
        quiet=diagnosis.verdict == "nothing_missing",
        alarm=bool(diagnosis.findings),
        explained_away=unknown and any(quantity_named(u, truth) for u in diagnosis.unexplained),
        all_quantities=unknown and any(quantities_named(u, truth) for u in diagnosis.unexplained),
        sure_and_wrong=any(f.confidence > SURE and wrong(f, truths) for f in diagnosis.findings),
    )


def both_found(diagnosis: DiagnosisFile, truths: Sequence[Truth]) -> bool:
    """Whether every true effect is some finding's, and no finding stands for two of them."""
    return any(
        all(right(f, t) for f, t in zip(chosen, truths, strict=True))
        for chosen in permutations(diagnosis.findings, len(truths))
    )


def visible(excess: Sequence[float]) -> bool:
    """Whether an effect leaves something to find in these logs."""
    return max(excess, default=0.0) >= INVISIBLE


def loud(excess: Sequence[float]) -> bool:
    """Whether some joint's held-out RMSE is half larger than without the effect."""
    return max(excess, default=0.0) >= LOOSE
