"""Reading `robot.toml`: every failure names file and full path of the key.

Imports neither numpy nor Pinocchio, so that a wrong file is reported at once.
"""

import glob
import re
import tomllib
from pathlib import Path
from typing import cast

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.robot.formula import SYMBOLS, Formula, FormulaError, parse_formula
from seqid_cli.robot.toml.checks import nearest, problems
from seqid_cli.robot.toml.schema import SCHEMA, SCHEMA_VERSION, TABLES, RobotFile

SIZE_LIMIT = 4 * 2**20  # bytes
MOST_PARTS = 32  # of a dotted key
_PART = r"(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')"
_DEEP_KEY = re.compile(rf"(?<![\w\-\"'.]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{{MOST_PARTS}}}")


def read_robot_file(path: Path) -> tuple[bytes, RobotFile, list[Formula | None]]:
    """Read a robot file and check all that needs neither a URDF nor geometry.

    Returns its bytes, its content, and the formulas of its effects: None where an installed package
    offers the effect. Raises ConfigError naming the file and the key's full path.
    """
    raw = read_limited(path, "robot file", SIZE_LIMIT)
    document = _parse(path, raw)
    schema, hint = document.get("schema"), f'Write schema = "{SCHEMA}" in the first line.'
    match = re.fullmatch(r"seqid/robot@([1-9][0-9]{0,5})", str(schema))
    if match is None:
        message = f"schema is {schema!r}, not {SCHEMA!r}"
        message = "the key 'schema' is missing" if schema is None else message
        raise ConfigError(message, where=str(path), hint=hint)
    if int(match[1]) > SCHEMA_VERSION:
        message = f"schema {schema!r} is newer than this seqid knows ({SCHEMA!r})"
        raise ConfigError(message, where=str(path), hint="Update seqid.")
    try:
        content = msgspec.convert(document, RobotFile)
    except msgspec.ValidationError as problem:
        raise _explained(path, document, problem) from None
    except (OverflowError, RecursionError):
        message, hint = "a number is too large or the nesting too deep", "Correct the value."
        raise ConfigError(message, where=str(path), hint=hint) from None
    for message, hint in problems(content):
        raise ConfigError(message, where=str(path), hint=hint)
    formulas: list[Formula | None] = []
    for k, effect in enumerate(content.effect):
        text, joints = effect.torque, len(content.joint)
        try:
            formulas.append(None if text is None else parse_formula(text, joints, effect.settings))
        except FormulaError as problem:
            message = f"effect[{k}].torque {problem} (effect {effect.name!r})"
            sums = "Write a sum of terms as in 'c1 * sign(dq) * abs(load)'"
            hint = f"{sums}; of {', '.join(SYMBOLS)}."
            raise ConfigError(message, where=str(path), hint=hint) from None
    return raw, content, formulas


def read_limited(path: Path, what: str, limit: int) -> bytes:
    """Read a file, called `what` in messages; ConfigError if it cannot, or is over `limit`."""
    where = str(path)
    try:
        if path.is_dir():
            raise ConfigError(f"the {what} is a folder", where=where, hint="Name the file in it.")
        if path.exists() and not path.is_file():  # a pipe would be waited for without end
            raise ConfigError(f"the {what} is not a regular file", where=where)
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except FileNotFoundError:
        names = sorted(other.name for other in path.parent.glob(f"*{glob.escape(path.suffix)}"))
        hint = f"In {path.parent} there is: {', '.join(names[:10]) or f'no *{path.suffix} file'}."
        raise ConfigError(f"{what} not found", where=where, hint=hint) from None
    except (OSError, ValueError) as problem:
        raise ConfigError(f"the {what} cannot be read: {problem}", where=where) from None
    if len(raw) > limit:
        message = f"the {what} is larger than {limit} bytes"
        raise ConfigError(message, where=where, hint=f"Is this really a {what}?")
    return raw


def _parse(path: Path, raw: bytes) -> dict[str, object]:
    try:
        text = raw.decode("utf-8")
        if not _DEEP_KEY.search(text):  # each part is a table, and the parser keeps the way to each
            return tomllib.loads(text)
        message, hint = f"a key has more than {MOST_PARTS} parts", "Write tables by their names."
    except UnicodeDecodeError as problem:
        line = raw.count(b"\n", 0, problem.start) + 1
        message = f"line {line} is not UTF-8 text"
        hint = "A robot file is plain text in UTF-8; save it so."
    except (RecursionError, ValueError) as problem:
        message, hint = f"not valid TOML: {problem}", "Correct that line, nesting or number."
        if raw.lstrip().startswith(b"<"):
            message = "this is XML, as a URDF is, not a robot file"
            hint = f"Make one that names it: seqid init LOG --urdf {path} -o robot.toml"
    raise ConfigError(message, where=str(path), hint=hint)


_AT = re.compile(r"^(?P<what>.*?)(?: - at `\$\.?(?P<path>.*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`", re.DOTALL)


def _explained(
    path: Path, document: dict[str, object], problem: msgspec.ValidationError
) -> ConfigError:
    """Turn msgspec's message into one with the key's full path and the nearest known key."""
    match = cast("re.Match[str]", _AT.match(str(problem)))
    what, at = match["what"], match["path"] or ""
    prefix = f"{at}." if at else ""
    if unknown := _UNKNOWN.match(what):
        known = TABLES.get(re.sub(r"\[[^\]]*\]", "", at), RobotFile).__struct_fields__
        hint = f"{nearest(unknown['key'], known)}Known here: {', '.join(known)}."
        message = f"unknown key '{prefix}{unknown['key']}'"
    elif missing := _MISSING.match(what):
        message = f"the key '{prefix}{missing['key']}' is missing"
        hint = f"Add {missing['key']} = ..."
    else:
        message = f"{at or 'the document'}: {what[:1].lower()}{what[1:]}".replace("`", "'")
        hint = "Correct the value."
    owner = re.match(r"(joint|imu|effect)\[(\d+)\]", at)
    if owner is not None:  # points into a table that may have a name
        entry = cast("list[dict[str, object]]", document[owner[1]])[int(owner[2])]
        name = entry.get("name") if isinstance(entry, dict) else None
        message += f" ({owner[1]} {name!r})" if isinstance(name, str) else ""
    return ConfigError(message, where=str(path), hint=hint)
