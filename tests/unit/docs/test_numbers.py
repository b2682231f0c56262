"""The page of the numbers that decide: every number is in the source where the page
says.
"""

import inspect
import re
from importlib import import_module
from types import ModuleType

from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "deciding_numbers.md"
TEXT = re.sub(
    r"(?s)<!-- study:.*?<!-- /study -->", "", PAGE.read_text(encoding="utf-8")
)
ROWS = [
    tuple(cell.strip() for cell in line.split("|")[1:5])
    for line in TEXT.splitlines()
    if line.startswith("| `")
]


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
    for names, _, _, where in ROWS:
        text = "\n".join(map(inspect.getsource, modules(where)))
        for name in re.findall(r"`(?:\w+\.)*(\w+)`", names) if text else ():
            assert re.search(rf"\b{name}\b", text), f"{name} in {where}"


def test_arguments_have_the_default_of_their_row() -> None:
    for names, default, _, where in ROWS:
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
