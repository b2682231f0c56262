"""The table of docs/reference/licences.md, from what pip-licenses says: `make
licences`.
"""

import sys

from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "licences.md"
GENERATED = "## All of them"  # from here on the page is what the environment says


def rewritten(text: str, said: str) -> str:
    """Return the page with the rows of a Markdown table, without versions."""
    rows = ["| package | licence | source |", "| --- | --- | --- |"]
    for line in said.splitlines()[2:]:
        name, _, licence, address = (cell.strip() for cell in line.split("|")[1:-1])
        source = "not stated" if address == "UNKNOWN" else address
        known = "not stated" if licence == "UNKNOWN" else licence
        rows.append(f"| {name} | {known} | {source} |")
    return (
        "\n\n".join([text.partition(GENERATED)[0] + GENERATED, "\n".join(rows)]) + "\n"
    )


def main() -> int:
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(rewritten(text, sys.stdin.read()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
