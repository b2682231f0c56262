"""Names from logs, files and topics as they may be shown: nothing in them steers a terminal."""

from __future__ import annotations

import re

# Controls but for tab and new line, marks that turn the direction of text, halves of characters.
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]"
)


def visible(text: str) -> str:
    """Return a text with such characters written out as JSON does, by their number."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def visible_cell(text: str) -> str:
    """Return a text that is one line of a table as well."""
    return visible(text).replace("\n", "\\n").replace("\t", "\\t")
