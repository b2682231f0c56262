import re

import pytest

from seqid_cli.shares import percent
from tests import ROOT

PACKAGE = ROOT / "seqid_cli"
# A share formatted by hand: {100 * x:.1f} or {x:.0%}.
BY_HAND = re.compile(r"\{[^{}]*(?:\b100(?:\.0)? \* [^{}]*:\.\d[fg]\} ?%|:\.\d%\})")


@pytest.mark.parametrize(
    ("share", "digits", "text"),
    [
        (0.5, 1, "50.0 %"),
        (1.0, 1, "100.0 %"),
        (0.0, 0, "0 %"),
        (0.998, 0, "99.8 %"),
        (0.9996, 1, "99.96 %"),
        (0.99999999, 1, "> 99.999 %"),
        (0.0004, 1, "0.04 %"),
        (1e-9, 0, "< 0.01 %"),
        (-0.25, 0, "-25 %"),
        (1.7, 1, "170.0 %"),
        (float("nan"), 1, "-"),
    ],
)
def test_a_part_is_neither_none_nor_all(share: float, digits: int, text: str) -> None:
    assert percent(share, digits) == text


def test_every_percentage_is_printed_by_the_one_function() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{number}: {line.strip()}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name != "shares.py"
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if BY_HAND.search(line)
    ]
    assert not found, "\n".join(found)
