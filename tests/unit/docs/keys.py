"""The keys of the result files as tables, from their types: `python -m
tests.unit.docs.keys`.

A table stands between `<!-- keys: NAME -->` and `<!-- /keys -->`. Keys, their order and
their types are written anew, what they mean is kept.
"""

import re
import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from seqid_cli.params import bands_schema, evidence_schema, schema
from seqid_cli.params.base import Document, FrozenStruct, Struct
from seqid_cli.params.results import (
    diagnosis,
    drive,
    inspection,
    plan,
    prediction,
    replay,
)
from tests.unit.docs.markdown import ROOT

PAGE = ROOT / "docs" / "reference" / "files.md"
MODULES = (
    schema,
    bands_schema,
    prediction,
    evidence_schema,
    diagnosis,
    inspection,
    plan,
    drive,
    replay,
)
STRUCTS: dict[str, type[msgspec.Struct]] = {
    name: kind
    for module in MODULES
    for name, kind in vars(module).items()
    if isinstance(kind, type) and issubclass(kind, Struct | FrozenStruct)
    if kind not in (Struct, FrozenStruct, Document, schema.Written, schema.OfRobot)
}
# Told where they stand: an object of one or two keys that needs no table.
INLINE = ("Tool", "FileId", "JointRmse")
TABLE = re.compile(r"<!-- keys: (\w+) -->\n(.*?)<!-- /keys -->", re.DOTALL)
_NAMES = {
    float: "number",
    int: "integer",
    str: "string",
    bool: "boolean",
    types.NoneType: "null",
}


def rewritten(text: str) -> str:
    return TABLE.sub(
        lambda m: f"<!-- keys: {m[1]} -->\n{_table(m[1], m[2])}<!-- /keys -->", text
    )


def _table(name: str, before: str) -> str:
    meanings = dict(
        re.findall(r"^\| `([^`]+)` \| [^|]* \| (.*) \|$", before, flags=re.MULTILINE)
    )
    kind = STRUCTS[name]
    hints = get_type_hints(kind)
    rows = [
        f"| `{field.encode_name}` | {_type(hints[field.name])} |"
        f" {meanings.get(field.encode_name, 'TODO')} |\n"
        for field in msgspec.structs.fields(kind)
    ]
    return "| key | type | meaning |\n|---|---|---|\n" + "".join(rows)


def _type(hint: Any) -> str:
    origin, inside = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(_type(item) for item in inside)
    if origin is list:
        return f"list of {_type(inside[0])}"
    if origin is dict:
        return f"object of {_type(inside[1])}"
    if origin is Literal:
        return " or ".join(f'"{item}"' for item in inside)
    if hint in _NAMES:
        return _NAMES[hint]
    name = hint.__name__
    return "object" if name in INLINE else f"[{name}](#{name.lower()})"


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
