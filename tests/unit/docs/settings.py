"""The page of the settings, from their classes: `python -m tests.unit.docs.settings`.

Names, defaults, units, bounds and reasons are written anew. The last column says what
moving a setting does. What stands there by hand is kept; behind `SAMPLES` a study
writes what changes on the sample logs (`python -m tests.studies --only settings`).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from seqid_cli.settings import Group
from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "settings.md"
TABLES = re.compile(r"(?s)<!-- settings -->\n.*?<!-- /settings -->")
_ROW = re.compile(r"\| `(\w+\.\w+)` \|.*\| ([^|]*) \|$")
_HEADING = re.compile(r"### \w+: `([\w-]+)`")
SAMPLES = "On the samples, "
HEAD = "| setting | default | unit | from | to | what it guards | what moving it does |"


def rewritten(text: str, measured: Mapping[tuple[str, str], str] | None = None) -> str:
    """Return the page with its tables as the classes say.

    Parameters
    ----------
    text : str
        The page.
    measured : mapping of (str, str) to str, optional
        What a study has measured, by the first command of a table and the setting.
    """
    cells = dict(_measured(text))
    for place, said in (measured or {}).items():
        by_hand = cells.get(place, "").partition(SAMPLES)[0].strip(" .")
        before = f"{by_hand}. " if by_hand else ""
        cells[place] = f"{before}{SAMPLES}{said}"
    tables = "".join(_tables(cells))
    new = f"<!-- settings -->\n{tables}<!-- /settings -->"
    return TABLES.sub(lambda _: new, text)


def _tables(measured: Mapping[tuple[str, str], str]) -> Iterator[str]:
    commands: dict[tuple[str, type[Group]], list[str]] = {}
    for command, settings in SETTINGS_OF_COMMANDS.items():
        if command == "run":  # it has the settings of its stages
            continue
        for each in fields(settings):
            kind = type(getattr(settings, each.name))
            commands.setdefault((each.name, kind), []).append(command)

    for (name, kind), users in commands.items():
        heading = f"{name}: {', '.join(f'`{user}`' for user in users)}"
        yield f"### {heading}\n\n{kind.__doc__}\n\n{HEAD}\n"
        yield "|---|---|---|---|---|---|---|\n"
        for each in fields(kind):
            about = each.metadata
            cells = (
                f"`{name}.{each.name}`",
                f"{each.default:g}",
                about["unit"],
                f"{about['low']:g}",
                f"{about['high']:g}",
                about["reason"],
                measured.get((users[0], f"{name}.{each.name}"), ""),
            )
            yield f"| {' | '.join(cells)} |\n"
        yield "\n"


def _measured(text: str) -> Mapping[tuple[str, str], str]:
    """Return the last cell of every row, by the first command of its table and its
    name.
    """
    found = {}
    first = ""
    for line in text.splitlines():
        if heading := _HEADING.match(line):
            first = heading[1]
        elif row := _ROW.match(line):
            found[first, row[1]] = row[2].strip()
    return found


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
