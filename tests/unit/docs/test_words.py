"""Words that were replaced by the field's terms do not come back.

The terms: docs/reference/glossary.md.
"""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.unit.docs.markdown import PAGES, ROOT

# What to say instead. A word gets here once it is gone.
INSTEAD = {
    "tellings?": "equivalent parametrisation",
    "foretells?|foretold": "predict, predicted (on left-out blocks)",
    "steadier|sharper|simplest": "the parsimony rule",
    "smoothest": "smooth term",
    "louder|loud": "excess residual",
    "company|less sure": "confidence adjustment",
    "look over|looked over": "residual survey",
    "withdraws?|take back|taken back|prune": "backward elimination",
    "slowness": "low-frequency share",
    "goes with the motion|beyond chance": "heteroscedasticity test",
    "stance": "prior scale of the base",
    "sieves?|sieved": "decimation, decimating filter",
    "scenes?": "data set, design columns",
    "swallows?|swallowed": "take in, hold",
    "nobody": "not known, not given",
}
# Rooms or files of the package whose docstrings and messages have been read; others
# follow.
ROOMS = (
    *(
        "compare",
        "discover/excerpts",
        "discover/noise",
        "discover/refinement",
        "discover/survey",
    ),
    *(
        "export",
        "identify",
        "imu",
        "inspect",
        "model/bodies",
        "motion",
        "params",
        "plan",
        "report",
    ),
    *("robot", "scale"),
)
WORD = re.compile(rf"\b(?:{'|'.join(INSTEAD)})\b", re.IGNORECASE)
MARKED = re.compile(r"<!-- study:.*?<!-- /study -->|```.*?```|`[^`\n]*`", re.DOTALL)
GENERATED = "docs/reference/effects.md"  # from docstrings of a room that follows
NAMES = [name for page in PAGES if (name := str(page.relative_to(ROOT))) != GENERATED]


def texts(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield re.sub(r"`[^`\n]*`", "", node.value)
    for line in source.splitlines():
        yield line.partition("  # ")[2]


@pytest.mark.parametrize("page", NAMES)
def test_pages_use_the_words_of_the_field(page: str) -> None:
    text = MARKED.sub("", (ROOT / page).read_text(encoding="utf-8"))
    rows = page == "docs/reference/deciding_numbers.md"
    kept = [line for line in text.splitlines() if not (rows and line.startswith("|"))]
    assert not WORD.findall("\n".join(kept))


@pytest.mark.parametrize("room", ROOMS)
def test_docstrings_and_messages_use_the_words_of_the_field(room: str) -> None:
    place = ROOT / "seqid_cli" / room
    for file in sorted(place.rglob("*.py")) or [place.with_suffix(".py")]:
        text = "\n".join(texts(file.read_text(encoding="utf-8")))
        assert not WORD.findall(text), file.name


def test_the_glossary_has_every_term_once() -> None:
    text = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
    terms = [
        line.split("|")[1].strip()
        for line in text.splitlines()
        if line.startswith("| ")
    ]
    own = [term for term in terms if term != "term"]
    assert len(own) == len(set(own)) >= 30
