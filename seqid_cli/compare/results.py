"""Differences of two predictions and of two diagnoses."""

from collections.abc import Iterator, Sequence

from seqid_cli.compare.judging import judged, missing, pairs
from seqid_cli.params.results.comparison import Difference, RuleEntry
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.prediction import PredictionFile


def prediction_differences(
    a: PredictionFile, b: PredictionFile, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield the differences of the torque errors of every joint."""
    yield from _errors("prediction", a, b, ("rmse", "max_abs"), rule)


def diagnosis_differences(
    a: DiagnosisFile, b: DiagnosisFile, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield the differences of verdict, findings and residuals."""
    if a.verdict != b.verdict:
        remark = f"{a.verdict}, then {b.verdict}"
        yield Difference(stage="diagnosis", name="verdict", joint="", remark=remark)

    first = {(finding.effect, finding.joint or ""): finding for finding in a.findings}
    second = {(finding.effect, finding.joint or ""): finding for finding in b.findings}
    for (effect, joint), in_first, in_second in pairs(first, second):
        if in_first is None or in_second is None:
            yield missing("diagnosis", effect, joint, in_first=in_first is not None)

    yield from _errors("diagnosis", a, b, ("rmse", "noise_floor"), rule)


def _errors(
    stage: str,
    a: PredictionFile | DiagnosisFile,
    b: PredictionFile | DiagnosisFile,
    names: Sequence[str],
    rule: RuleEntry,
) -> Iterator[Difference]:
    """Yield the judged errors of every joint; one that neither file has is left out."""
    for joint, first, second in pairs(a.joints, b.joints):
        if first is None or second is None:
            # A diagnosis has only the joints that its logs move: those may differ.
            if stage == "prediction":
                yield missing(stage, "joint", joint, in_first=first is not None)
            continue
        for name in names:
            value = getattr(first, name)
            other_value = getattr(second, name)
            if value is not None and other_value is not None:
                unit = a.robot.unit("N m", joint)
                place = Difference(stage=stage, name=name, joint=joint, unit=unit)
                yield judged(place, rule, (value, other_value))
            elif value is not None or other_value is not None:
                yield missing(stage, name, joint, in_first=value is not None)
