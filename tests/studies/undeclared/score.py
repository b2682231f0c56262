"""Whether a diagnosis is right, by the rules that the study's tables are made with."""

from itertools import permutations
from types import SimpleNamespace

from msgspec.structs import replace

from seqid_cli.params.results.diagnosis import FindingEntry
from tests.studies.undeclared.cases import Record, Truth, built, in_the_model
from tests.unit.params.documents import diagnosis_file

SURE = 0.8  # confidence from which a wrong mechanism counts as a confident error
# share by which an effect must raise some joint's held-out RMSE to be seen
INVISIBLE = 0.02
LOOSE = 0.5  # the same for backlash, whose impacts do not repeat

# What stands for a diagnosis that failed: neither quiet nor right.
FAILED = replace(
    diagnosis_file(), findings=[], unexplained=[], joints={}, events=[], hidden=[]
)


def named(finding: FindingEntry, truth: Truth) -> bool:
    return truth.kind is not None and truth.kind in (
        finding.effect,
        *finding.confusable_with,
    )


def right(finding: FindingEntry, truth: Truth) -> bool:
    return named(finding, truth) and finding.joint in truth.joints


class Judged(SimpleNamespace):
    """A case and how its diagnosis is judged; by its first effect if not said
    otherwise.
    """


def judged(record: Record) -> Judged:
    """Judge a record; one without a diagnosis is wrong in every respect."""
    diagnosis, condition = record.diagnosis or FAILED, record.condition
    _, truths = built(condition)
    truth = truths[0] if truths else Truth("clean", None, (), ())
    first = (findings := diagnosis.findings)[:1]
    parts = diagnosis.unexplained if diagnosis.verdict == "unexplained" else ()
    told = [set(part.depends_on) for part in parts if part.joint in truth.joints]
    excess = [max(own, default=0.0) for own in record.excess]
    in_model = [in_the_model(condition, name) for name, _, _ in condition.effects]
    hit = any(right(f, truth) for f in first)
    return Judged(
        record=record,
        condition=condition,
        diagnosis=diagnosis,
        truths=truths,
        truth=truth,
        first=first,
        # The first finding has kind and joint; the kind; both without help of
        # confusable ones; both of any of the effects.
        right=hit,
        kind_right=any(named(f, truth) for f in first),
        own_name=hit and first[0].effect == truth.kind,
        first_right=any(right(f, t) for f in first for t in truths),
        # Some finding has kind and joint of any effect; every effect has one of its
        # own.
        found=any(right(f, t) for f in findings for t in truths),
        all_found=any(
            all(map(right, chosen, truths))
            for chosen in permutations(findings, len(truths))
        ),
        quiet=diagnosis.verdict == "nothing_missing",
        alarm=bool(first),
        silent=not first,
        # Unexplained, with some quantity that the effect depends on at a right joint;
        # with all.
        explained_away=any(own & set(truth.depends_on) for own in told),
        all_quantities=any(set(truth.depends_on) <= own for own in told),
        sure_and_wrong=any(
            f.confidence > SURE and not any(right(f, t) for t in truths)
            for f in findings
        ),
        # All effects leave something to find in these logs; one makes some RMSE half
        # larger.
        seen=not any(in_model) and all(share >= INVISIBLE for share in excess),
        loud=any(share >= LOOSE for share in excess),
    )
