"""What an inspection says: typed, without any rendering."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from seqid_cli.inspect.code import Severity
from seqid_cli.inspect.codes import CODES

Verdict = Literal["good", "usable", "faulty", "unreadable"]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing, with the remedy.

    `log` is empty for what concerns the robot file or all logs; `joint` and `channel` name what it
    is about where that is one joint (or IMU) or one channel.
    """

    code: str
    severity: Severity
    message: str
    remedy: str
    log: str = ""
    joint: str = ""
    channel: str = ""


@dataclass(frozen=True)
class JointSummary:
    """What a log shows of one joint: rad (m), rad/s (m/s), N m (N), A, degC."""

    name: str
    moves: bool
    low: float
    high: float
    top_speed: float
    encoder_step: float | None
    effort: str  # "torque", "current" or empty
    effort_rms: float | None
    temperature: tuple[float, float] | None = None


@dataclass(frozen=True)
class ImuSummary:
    """What a log shows of one IMU; `rest_norm` m/s^2 is the specific force at rest."""

    name: str
    accelerometers: int
    gyro: bool
    rate_hz: float
    rest_norm: float | None
    delay_s: float | None  # behind the encoders, where the motion tells


@dataclass(frozen=True)
class Moves:
    """The constant-velocity stretches of one joint."""

    joint: str
    forward: int
    backward: int
    slowest: float
    fastest: float
    postures: int


@dataclass(frozen=True)
class LogReport:
    """One log: what is in it, what it serves for, and what is wrong with it.

    `missing` are channels of the robot file that the log lacks, with the nearest name that it has.
    """

    path: str
    format: str
    samples: int = 0
    seconds: float = 0.0
    rate_hz: float = 0.0
    jitter: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    non_monotonic: int = 0
    duplicates: int = 0
    log_minus_header_s: float | None = None
    sha256: str = ""
    channels: tuple[str, ...] = ()
    missing: dict[str, str] = field(default_factory=dict)
    joints: tuple[JointSummary, ...] = ()
    imus: tuple[ImuSummary, ...] = ()
    moves: tuple[Moves, ...] = ()
    moving_together: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    partial: str = ""
    findings: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Return how far the log can be used."""
        return verdict_of(self.findings)


@dataclass(frozen=True)
class InspectReport:
    """All logs; `findings` are those of the robot file and of the set of logs, then each log's."""

    logs: tuple[LogReport, ...]
    findings: tuple[Finding, ...]
    advice: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Return how far the logs can be used."""
        return verdict_of(self.findings)


def verdict_of(findings: tuple[Finding, ...]) -> Verdict:
    """Judge by the worst finding; notes do not count."""
    if any(finding.code == "unreadable" for finding in findings):
        return "unreadable"
    severities = {finding.severity for finding in findings}
    if "error" in severities:
        return "faulty"
    return "usable" if "warning" in severities else "good"


def found(code: str, message: str, *, joint: str = "", channel: str = "") -> Finding:
    """Make a finding of a known code, with the severity and remedy that belong to it."""
    entry = CODES[code]
    return Finding(code, entry.severity, message, entry.remedy, joint=joint, channel=channel)
