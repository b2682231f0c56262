"""The documentation lists every code as the package knows it."""

from __future__ import annotations

from seqid_cli.inspect.findings.codes import CODES
from tests import ROOT

DOCS = ROOT / "docs" / "inspect.md"


def table() -> str:
    rows = [
        f"| `{name}` | {code.severity} | {code.meaning} | {code.test} | {code.remedy} |"
        for name, code in CODES.items()
    ]
    return "\n".join(rows)


def test_the_table_of_codes_is_the_packages_own() -> None:
    assert table() in DOCS.read_text()
