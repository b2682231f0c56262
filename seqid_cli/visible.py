"""Text from outside as it may be shown: nothing in it steers what shows it."""

import re

# Controls but for tab and new line, marks that turn the direction of text, halves of
# characters.
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e"
    "\u2060-\u2069\ufeff\ud800-\udfff]"
)


def visible(text: str) -> str:
    """Return a text whose characters that steer are written by number, as in JSON."""
    return _STEERING.sub(lambda match: f"\\u{ord(match[0]):04x}", text)
