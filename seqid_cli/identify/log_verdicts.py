"""From what is wrong with the logs to the verdicts of whatever was made of them."""

from collections.abc import Iterable, Sequence

from seqid_cli.inspect.findings import grouped
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.params.schema import Verdict


def verdicts_of_logs(findings: Iterable[InspectionFinding]) -> list[Verdict]:
    """A poor verdict for every joint (or IMU) that a log's error is about.

    `findings`: of all logs. Errors count; warnings do not spoil a result. Returns: one per code,
    joint and channel, however many logs show it; the joint is empty where the whole log is meant.
    """
    verdicts = []
    for alike in grouped(f for f in findings if f.severity == "error"):
        verdicts += [
            Verdict(joint=name, good=False, reason=_text(alike) + f". {alike[0].remedy}")
            for name in alike[0].joint.split(", ")
        ]
    return verdicts


def notes_of_logs(findings: Iterable[InspectionFinding], known: Iterable[str] = ()) -> list[str]:
    """Return warnings about the logs in words, but for those `known` already."""
    given = set(known)
    return [
        (f"{alike[0].joint}: " if alike[0].joint else "") + _text(alike)
        for alike in grouped(f for f in findings if f.severity == "warning")
        if alike[0].message not in given
    ]


def as_note(finding: InspectionFinding) -> str:
    """Return a finding in words, as notes have it."""
    return (f"{finding.joint}: " if finding.joint else "") + _text([finding])


def _text(alike: Sequence[InspectionFinding]) -> str:
    first = alike[0]
    logs = list(dict.fromkeys(finding.log for finding in alike))
    more = f" and {len(logs) - 1} more log{'s' if len(logs) > 2 else ''}" if len(logs) > 1 else ""
    channel = f"{first.channel} " if first.channel else ""
    said = first.message.removeprefix(f"{first.joint}: ")
    return f"[{first.code}] {logs[0]}{more}: {channel}{said}"
