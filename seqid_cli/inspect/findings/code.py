"""One kind of finding: severity, meaning, test and remedy."""

from __future__ import annotations

from typing import Literal, NamedTuple

Severity = Literal["error", "warning", "note"]


class Code(NamedTuple):
    """One kind of finding.

    `error`: what is identified from the log is wrong; `warning`: it is worse than it could be, or
    may be wrong; `note`: put right on reading, good to know.
    """

    severity: Severity
    meaning: str
    test: str
    remedy: str
