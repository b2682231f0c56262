"""Findings of known codes, and the verdict on a log."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from seqid_cli.inspect.findings.codes import CODES
from seqid_cli.params.results.inspection import InspectionFinding, InspectionVerdict


def found(code: str, message: str, *, joint: str = "", channel: str = "") -> InspectionFinding:
    """Make a finding of a known code, with the severity and remedy that belong to it."""
    entry = CODES[code]
    return InspectionFinding(
        code=code,
        severity=entry.severity,
        log="",
        joint=joint,
        channel=channel,
        message=message,
        remedy=entry.remedy,
    )


def located(findings: Iterable[InspectionFinding], log: object) -> tuple[InspectionFinding, ...]:
    """Findings with the log that they are about."""
    return tuple(replace(finding, log=str(log)) for finding in findings)


def verdict_of(findings: Sequence[InspectionFinding]) -> InspectionVerdict:
    """Judge by the worst finding; notes do not count."""
    if any(finding.code == "unreadable" for finding in findings):
        return "unreadable"
    severities = {finding.severity for finding in findings}
    if "error" in severities:
        return "faulty"
    return "usable" if "warning" in severities else "good"
