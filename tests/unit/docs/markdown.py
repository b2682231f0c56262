"""The parts of a Markdown page that can be wrong: code, links, headings."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from tests import ROOT

TOP = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
PAGES = (*(ROOT / name for name in TOP), *sorted((ROOT / "docs").glob("**/*.md")))

_FENCE = re.compile(r"^(`{3,})(\w*)\s*$")
_EXIT = re.compile(r"<!-- exit: (\d+) -->")
_LINK = re.compile(r"!?\[[^\]\n]*\]\(([^)\s]+)\)")
_ASSIGNMENT = re.compile(r"^([A-Z]+)=(\S+)$")
SHELL = ("sh", "bash", "", "indented")
PROGRAMS = ("seqid", "make", "pip", "python", "rerun", "apt-get")


@dataclass(frozen=True)
class Block:
    """A block of code; `line` counts from 1, `exit_code` is what its last command ends
    with.
    """

    page: Path
    line: int
    language: str
    text: str
    exit_code: int = 0


@dataclass(frozen=True)
class Step:
    """One command line; `shown` is the output that the page prints after its block."""

    page: Path
    line: int
    words: tuple[str, ...]
    exit_code: int = 0
    shown: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}: {shlex.join(self.words)}"


def blocks(page: Path) -> list[Block]:
    """Return fenced blocks, and indented ones as language "indented", in order."""
    lines = page.read_text(encoding="utf-8").splitlines()
    found, k, code = [], 0, 0
    while k < len(lines):
        start = k
        if told := _EXIT.search(lines[k]):
            code = int(told[1])
        if fence := _FENCE.match(lines[k]):
            end = next(
                i for i in range(k + 1, len(lines)) if lines[i].strip() == fence[1]
            )
            found.append(
                Block(page, k + 2, fence[2], "\n".join(lines[k + 1 : end]), code)
            )
            k, code = end, 0
        elif lines[k].startswith("    ") and (k == 0 or not lines[k - 1]):
            while k + 1 < len(lines) and (
                lines[k + 1].startswith("    ") or not lines[k + 1]
            ):
                k += 1
            text = "\n".join(line[4:] for line in lines[start : k + 1]).rstrip()
            found.append(Block(page, start + 1, "indented", text))
        k += 1
    return found


def steps(page: Path) -> list[Step]:
    """Return the command lines of a page in order; of unknown programs it raises
    ValueError.
    """
    found: list[Step] = []
    known: dict[str, str] = {}
    pages = blocks(page)
    for block, after in zip(pages, [*pages[1:], None], strict=False):
        if block.language not in SHELL:
            continue
        end = block.line + block.text.count("\n")
        told = after and after.language == "text" and after.line - end < 5
        shown = tuple(after.text.splitlines()) if told else ()
        *own, last = [*_commands(block, known)] or [None]
        found += own
        found += [replace(last, exit_code=block.exit_code, shown=shown)] if last else []
    return found


def _commands(block: Block, known: dict[str, str]) -> Iterator[Step]:
    """Yield command lines; those that a backslash continues are put together."""
    for number, line in enumerate(
        block.text.replace("\\\n", " ").splitlines(), block.line
    ):
        if given := _ASSIGNMENT.match(line.strip()):
            known[given[1]] = given[2]
            continue
        for name, value in known.items():
            line = line.replace(f"${name}", value)
        program = line.split(maxsplit=1)[0] if line.strip() else "#"
        if program in PROGRAMS:
            yield Step(block.page, number, tuple(shlex.split(line, comments=True)))
        elif block.language in ("sh", "bash") and not program.startswith("#"):
            raise ValueError(f"{block.page.name}:{number}: nobody checks {program!r}")


def _prose(page: Path) -> str:
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def links(page: Path) -> list[str]:
    return _LINK.findall(re.sub(r"`[^`\n]*`", "", _prose(page)))


def anchors(page: Path) -> set[str]:
    """Return the anchors that headings of a page have, as GitHub makes them."""
    headings = re.findall(r"^#{1,6} (.+)$", _prose(page), flags=re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }
