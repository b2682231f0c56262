"""What commands show, to the letter: transcripts that are run again.

A line `$ compare a.json b.json` is a command line. Below stand its lines on stdout, those on stderr
behind `! `, and its exit code in brackets; hashes are left out. After an intended change the tests
write them anew with the variable TRANSCRIPTS=write; the commit then shows what users see.
"""

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.commands.conftest import Rig
from tests.transcripts import check_text

FOLDER = Path(__file__).parent / "transcripts"


def check_transcript(rig: Rig, name: str, words: Mapping[str, str] = {}) -> None:
    """Run the command lines of a transcript, and compare all that they show with it.

    Some `words` in them stand for others, which change nothing that is shown.
    """
    path = FOLDER / f"{name}.txt"
    told = path.read_text(encoding="utf-8").splitlines()
    lines = [line.removeprefix("$ ") for line in told if line.startswith("$ ")]
    assert lines
    shown = [(line, _shown(rig, [words.get(x, x) for x in shlex.split(line)])) for line in lines]
    check_text(path, "\n".join(f"$ {line}\n{text}" for line, text in shown))


def _shown(rig: Rig, arguments: Sequence[str]) -> str:
    done = rig.run(*arguments)
    said = [f"! {text}".rstrip() for text in done.err.splitlines()]
    lines = [*done.out.splitlines(), *said, f"[{done.code}]", ""]
    return re.sub(r"\b[0-9a-f]{12}\b", "<hash>", "\n".join(lines))
