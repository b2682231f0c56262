"""The page of the catalogue is the catalogue's."""

from tests.unit.docs.effects import PAGE, page


def test_the_page_is_what_the_registry_says() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m tests.unit.docs.effects"
