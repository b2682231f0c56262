"""The page of the catalogue is the catalogue's."""

import re

from seqid_cli.effects.registry import CATALOGUE
from tests.unit.docs.effects import PAGE, rewritten

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_is_what_the_registry_says() -> None:
    assert rewritten(TEXT) == TEXT, "run python -m tests.unit.docs.effects"


def test_every_effect_has_a_symptom() -> None:
    symptoms = TEXT.split("## By what the residual looks like")[1].split("\n## ")[0]
    assert set(re.findall(r"\(#(\w+)\)", symptoms)) == set(CATALOGUE)
