"""Texts that tests compare to the letter; TRANSCRIPTS=write writes them anew after a
change.
"""

import os
from pathlib import Path


def check_text(path: Path, shown: str) -> None:
    """Compare a text with what stands in a file."""
    if os.environ.get("TRANSCRIPTS") == "write":
        path.write_text(shown, encoding="utf-8")
    assert shown == path.read_text(encoding="utf-8")
