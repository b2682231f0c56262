"""The documentation lists every code with the package's severity and remedy."""

import re

from seqid_cli.inspect.findings import ERRORS, WARNINGS
from tests import ROOT

ROW = re.compile(r"^\| `(\w+)` \| (error|warning) \| [^|]+ \| [^|]+ \| ([^|]+) \|$", re.MULTILINE)


def test_the_table_of_codes_is_the_packages_own() -> None:
    rows = ROW.findall((ROOT / "docs" / "inspect.md").read_text())
    assert len(rows) == len(ERRORS) + len(WARNINGS)
    assert {code: remedy for code, severity, remedy in rows if severity == "error"} == ERRORS
    assert {code: remedy for code, severity, remedy in rows if severity == "warning"} == WARNINGS
