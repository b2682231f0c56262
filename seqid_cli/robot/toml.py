"""Reading `robot.toml` and the URDF that it names.

Every failure names the file and the full path of the key. Imports neither numpy nor
Pinocchio, so that a wrong file is reported at once.
"""

import glob
import re
import tomllib
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.robot import formula, toml_schema
from seqid_cli.robot.checks import MOST_JOINTS as MOST_JOINTS  # as others import it
from seqid_cli.robot.checks import nearest, problems
from seqid_cli.robot.toml_schema import SCHEMA, EffectEntry, RobotFile

SIZE_LIMIT = 4 << 20  # bytes of a robot file
URDF_LIMIT = 64 << 20  # bytes of a URDF
MOST_PARTS = 32  # of a dotted key
_PART = r"(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')"
_DEEP_KEY = re.compile(
    rf"(?<![\w\-\"'.]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{{MOST_PARTS}}}"
)

# None where an installed package offers the effect
Formulas = list[formula.Formula | None]


class ReadRobotFile(NamedTuple):
    """A robot file whose own text is in order."""

    content: RobotFile
    formulas: Formulas  # of its effects
    raw: bytes
    urdf_raw: bytes | None  # of the URDF beside it, None where it names none


def read_robot_file(path: Path) -> ReadRobotFile:
    """Read a robot file and check all that needs neither a URDF nor geometry.

    Raises ConfigError naming the file and the key's full path.
    """
    raw = read_limited(path, "robot file", SIZE_LIMIT)
    document = _parse(path, raw)
    _check_schema(path, document.get("schema"))
    content = _converted(path, document)
    for message, hint in problems(content):
        raise ConfigError(message, where=str(path), hint=hint)
    n_joints = len(content.joint)
    formulas = [
        _formula(path, k, effect, n_joints) for k, effect in enumerate(content.effect)
    ]
    urdf_raw = None
    if content.urdf is not None:
        urdf_raw = read_limited(path.parent / content.urdf, "URDF", URDF_LIMIT)
    return ReadRobotFile(content, formulas, raw, urdf_raw)


def _check_schema(path: Path, schema: object) -> None:
    """Raise ConfigError for a document of another kind, or of a newer version."""
    match = re.fullmatch(r"seqid/robot@([1-9][0-9]{0,5})", str(schema))
    if match is None:
        message = f"schema is {schema!r}, not {SCHEMA!r}"
        if schema is None:
            message = "the key 'schema' is missing"
        raise ConfigError(
            message,
            where=str(path),
            hint=f'Write schema = "{SCHEMA}" in the first line.',
        )
    if int(match[1]) > toml_schema.SCHEMA_VERSION:
        raise ConfigError(
            f"schema {schema!r} is newer than this seqid knows ({SCHEMA!r})",
            where=str(path),
            hint="Update seqid.",
        )


def _converted(path: Path, document: dict[str, object]) -> RobotFile:
    """Convert a document to its types; raises ConfigError if it does not have them."""
    try:
        return msgspec.convert(document, RobotFile)
    except msgspec.ValidationError as problem:
        raise _explained(path, document, problem) from None
    except (OverflowError, RecursionError):
        raise ConfigError(
            "a number is too large or the nesting too deep",
            where=str(path),
            hint="Correct the value.",
        ) from None


def _formula(
    path: Path, number: int, effect: EffectEntry, n_joints: int
) -> formula.Formula | None:
    """Read the formula of an effect, None where it has none; raises ConfigError."""
    if effect.torque is None:
        return None
    try:
        return formula.parse_formula(effect.torque, n_joints, effect.settings)
    except formula.FormulaError as problem:
        raise ConfigError(
            f"effect[{number}].torque {problem} (effect {effect.name!r})",
            where=str(path),
            hint="Write a sum of terms as in 'c1 * sign(dq) * abs(load)'; of"
            f" {', '.join(formula.SYMBOLS)}.",
        ) from None


def read_limited(path: Path, what: str, limit: int) -> bytes:
    """Read a file.

    Parameters
    ----------
    what : str
        What it is called in messages.
    limit : int
        Bytes that it may have.

    Raises
    ------
    ConfigError
        It is missing, no file, too large or cannot be read.
    """
    where = str(path)
    try:
        if path.is_dir():
            raise ConfigError(
                f"the {what} is a folder", where=where, hint="Name the file in it."
            )
        # a pipe would be waited for without end
        if path.exists() and not path.is_file():
            raise ConfigError(f"the {what} is not a regular file", where=where)
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except FileNotFoundError:
        siblings = path.parent.glob(f"*{glob.escape(path.suffix)}")
        names = sorted(sibling.name for sibling in siblings)
        listed = ", ".join(names[:10]) or f"no *{path.suffix} file"
        raise ConfigError(
            f"{what} not found",
            where=where,
            hint=f"In {path.parent} there is: {listed}.",
        ) from None
    except (OSError, ValueError) as problem:
        raise ConfigError(
            f"the {what} cannot be read: {problem}", where=where
        ) from None
    if len(raw) > limit:
        raise ConfigError(
            f"the {what} is larger than {limit} bytes",
            where=where,
            hint=f"Is this really a {what}?",
        )
    return raw


def _parse(path: Path, raw: bytes) -> dict[str, object]:
    """Parse TOML; raises ConfigError where the bytes are none."""
    try:
        # Windows editors put a mark of the byte order in front.
        text = raw.decode("utf-8-sig")
        # each part is a table, and the parser keeps the way to each
        if not _DEEP_KEY.search(text):
            return tomllib.loads(text)
        message = f"a key has more than {MOST_PARTS} parts"
        hint = "Write tables by their names."
    except UnicodeDecodeError as problem:
        line = raw.count(b"\n", 0, problem.start) + 1
        message = f"line {line} is not UTF-8 text"
        hint = "A robot file is plain text in UTF-8; save it so."
    except (RecursionError, ValueError) as problem:
        message = f"not valid TOML: {problem}"
        hint = "Correct that line, nesting or number."
        if raw.lstrip().startswith(b"<"):
            message = "this is XML, as a URDF is, not a robot file"
            hint = f"Make one that names it: seqid init LOG --urdf {path} -o robot.toml"
    raise ConfigError(message, where=str(path), hint=hint)


# Forms of msgspec's messages.
_AT = re.compile(r"^(?P<what>.*?)(?: - at `\$\.?(?P<path>.*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`", re.DOTALL)


def _explained(
    path: Path, document: dict[str, object], problem: msgspec.ValidationError
) -> ConfigError:
    """Turn msgspec's message into one with the key's full path and the nearest key."""
    match = cast("re.Match[str]", _AT.match(str(problem)))
    fault = match["what"]
    at = match["path"] or ""
    prefix = f"{at}." if at else ""
    unknown = _UNKNOWN.match(fault)
    missing = _MISSING.match(fault)
    if unknown is not None:
        table = re.sub(r"\[[^\]]*\]", "", at)
        keys = toml_schema.TABLES.get(table, RobotFile).__struct_fields__
        message = f"unknown key '{prefix}{unknown['key']}'"
        known = f"Known here: {', '.join(keys)}."
        elsewhere = _elsewhere(unknown["key"])
        hint = f"{elsewhere or nearest(unknown['key'], keys)}{known}"
    elif missing is not None:
        message = f"the key '{prefix}{missing['key']}' is missing"
        hint = f"Add {missing['key']} = ..."
    else:
        sentence = f"{fault[:1].lower()}{fault[1:]}"
        message = f"{at or 'the document'}: {sentence}".replace("`", "'")
        hint = "Correct the value."
    return ConfigError(message + _owner(at, document), where=str(path), hint=hint)


def _elsewhere(key: str) -> str:
    """Say in a sentence in which tables a key belongs; empty if in none."""
    tables: dict[str, type[toml_schema.Table]] = {"": RobotFile, **toml_schema.TABLES}
    places = [
        f"under [{table}]" if table else "at the top of the file, before any table"
        for table, entry in tables.items()
        if key in entry.__struct_fields__
    ]
    return f"It stands {' or '.join(places)}. " if places else ""


def _owner(at: str, document: dict[str, object]) -> str:
    """Name the joint, IMU or effect that a path points into, if it has a name."""
    match = re.match(r"(joint|imu|effect)\[(\d+)\]", at)
    if match is None:
        return ""
    table = match[1]
    entry = cast("list[dict[str, object]]", document[table])[int(match[2])]
    name = entry.get("name") if isinstance(entry, dict) else None
    return f" ({table} {name!r})" if isinstance(name, str) else ""
