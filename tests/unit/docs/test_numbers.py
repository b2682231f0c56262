"""The page of the numbers that decide: every number is in the source where the page
says, and every group of them says what a reader wants to know first.
"""

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import pytest

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from seqid_cli.settings import entries
from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "deciding_numbers.md"
TEXT = re.sub(
    r"(?s)<!-- study:.*?<!-- /study -->", "", PAGE.read_text(encoding="utf-8")
)


class Row(NamedTuple):
    names: str
    default: str
    unit: str
    where: str
    guards: str


class Group(NamedTuple):
    """What a reader sees decided: prose, the rooms of its numbers, and its rows."""

    title: str
    prose: str
    rooms: list[str]
    rows: list[Row]


def groups() -> Iterator[Group]:
    for part in re.split(r"(?m)^## ", TEXT)[1:]:
        title, _, body = part.partition("\n")
        rows = [
            Row(*(cell.strip() for cell in line.split("|")[1:6]))
            for line in body.splitlines()
            if line.startswith("| `")
        ]
        if rows:
            prose, _, tables = body.partition("\nRooms: ")
            rooms = re.findall(r"`([^`]+)`", tables.splitlines()[0])
            yield Group(title, prose, rooms, rows)


GROUPS = list(groups())
ROWS = [row for group in GROUPS for row in group.rows]


def modules(where: str) -> list[ModuleType]:
    paths = re.findall(r"`([\w/]+)\.py`", where)
    return [import_module(f"seqid_cli.{path.replace('/', '.')}") for path in paths]


def defaults(module: ModuleType, owner: str) -> dict[str, object]:
    classes = [kind for kind in vars(module).values() if inspect.isclass(kind)]
    owners = [vars(place).get(owner) for place in (module, *classes)]
    signatures = [inspect.signature(own).parameters for own in owners if callable(own)]
    return {
        name: given.default for known in signatures for name, given in known.items()
    }


def test_names_are_in_the_files_of_their_row() -> None:
    assert len(ROWS) > 200
    for names, _, _, where, _ in ROWS:
        text = "\n".join(map(inspect.getsource, modules(where)))
        for name in re.findall(r"`(?:\w+\.)*(\w+)`", names) if text else ():
            assert re.search(rf"\b{name}\b", text), f"{name} in {where}"


def test_arguments_have_the_default_of_their_row() -> None:
    for names, default, _, where, _ in ROWS:
        if not (asked := re.fullmatch(r"`(\w+)` of `(\w+)`", names)):
            continue
        allowed = [tuple(map(float, part.split(","))) for part in default.split(";")]
        found = [known for x in modules(where) if (known := defaults(x, asked[2]))]
        values = [known.get(asked[1]) for known in found]
        tuples = [value if isinstance(value, tuple) else (value,) for value in values]
        assert values, names
        assert all(value in allowed for value in tuples), (
            f"{names}: {default}, not {values}"
        )


def test_constants_have_the_value_of_their_row() -> None:
    """Of numbers in capitals that stand in one module as they are written."""
    checked = 0
    for names, default, _, where, _ in ROWS:
        name = re.fullmatch(r"`([A-Z][A-Z_]+)`", names)
        if name is None or not re.fullmatch(r"[-+\d.e]+", default):
            continue
        for module in modules(where):
            value = vars(module).get(name[1])
            if isinstance(value, int | float):
                assert value == pytest.approx(float(default)), names
                checked += 1
    assert checked > 30


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.title)
def test_a_group_says_how_its_numbers_were_chosen(group: Group) -> None:
    """Before its tables: prose, and what half and double of its numbers do."""
    assert len(group.prose.split()) > 60
    assert "half" in group.prose.lower()
    assert "double" in group.prose.lower()


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.title)
def test_a_number_is_in_the_group_of_its_room(group: Group) -> None:
    for row in group.rows:
        for place in re.findall(r"`([^`]+)`", row.where):
            assert place.startswith(tuple(group.rooms)), f"{row.names}: {place}"


def test_no_number_is_listed_twice_and_none_refers_to_a_row_above() -> None:
    places = [(row.names, row.where, row.unit, row.guards) for row in ROWS]
    assert len(set(places)) == len(places)
    assert not [row.names for row in ROWS if row.guards.startswith("the same")]


def test_settings_are_on_their_own_page() -> None:
    settings = {
        entry.name for one in SETTINGS_OF_COMMANDS.values() for entry in entries(one)
    }
    assert settings
    assert not [row.names for row in ROWS if row.names.strip("`") in settings]
