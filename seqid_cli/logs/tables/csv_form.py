"""How a CSV file is written, by its first lines (loggers do not agree): standard library only."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.errors import InputError

HEAD = 1 << 20  # bytes that are looked at
_DELIMITERS = (",", ";", "\t", " ")
_COMMENTS = ("#", "%")
_BEGIN = 64  # bytes in which a binary file shows itself
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
MISSING = (
    "",
    "nan",
    "-nan",
    "na",
    "n/a",
    "null",
    "none",
    "inf",
    "-inf",
    "+inf",
    "infinity",
)
_CONTROL = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]")
_HINT = "Write a line of names, then one line per sample: t,<joint>.position,..."


@dataclass(frozen=True)
class CsvForm:
    """The form of one file."""

    encoding: str
    delimiter: str
    decimal: str
    names: tuple[str, ...]  # in order; "1", "2" ... where no line names them
    skip: int  # lines before the data
    filler: int = 0  # columns without a name, where every line ends with delimiters


def is_text(head: bytes) -> bool:
    """Tell whether a file begins as text; a table may hold NUL bytes further on, by accident."""
    begin = head[:_BEGIN] + head[_BEGIN:].split(b"\n", 1)[0]
    return bool(head) and b"\0" not in begin and not _CONTROL.search(begin)


def read_form(path: Path, *, looked_at: int = 20) -> CsvForm:
    """Look at the first lines of a CSV file. Raises InputError: it is no table."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    where = str(path)
    encoding, lines = _lines(head, where)
    header_at, names_line = _header(lines, where)
    data = [line for line in lines[header_at + 1 :] if line.strip()][:looked_at]
    names_line = names_line or data[0]
    if not data:
        hint = "Was the recording stopped at once? Record again."
        raise InputError(
            "the table has names but no line of data", hint=hint, where=where
        )
    delimiter = _delimiter(names_line, data[0], where)
    names = [name.strip() for name in _split(names_line, delimiter)]
    if names_line == data[0]:
        names = [str(k + 1) for k in range(len(names))]
    rows = [_split(line, delimiter) for line in data]
    while names and not names[-1] and max(map(len, rows)) < len(names):
        names.pop()  # the header alone ends with a delimiter
    _require_numbers(rows[0], len(names), delimiter, header_at + 2, where)
    beyond = any("".join(row[len(names) :]).strip() for row in rows)
    filler = 0 if beyond else max(0, min(map(len, rows)) - len(names))
    decimal = _decimal(rows, delimiter)
    return CsvForm(encoding, delimiter, decimal, tuple(names), header_at + 1, filler)


def _lines(head: bytes, where: str) -> tuple[str, list[str]]:
    """Return the encoding and the whole lines of the head, which must be text."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "Convert it: `iconv -f UTF-16 -t UTF-8 FILE > NEW.csv`."
        raise InputError(
            "is UTF-16 text; CSV logs are read as UTF-8", hint=hint, where=where
        )
    if b"\0" in head:
        line = head[: head.index(b"\0")].count(b"\n") + 1
        text = (
            f"line {line} holds NUL bytes: it is not text, or the recording computer"
            " lost power"
        )
        hint = "Remove the NUL bytes: `tr -d '\\000' < FILE > NEW.csv`."
        raise InputError(text, hint=hint, where=where)
    encoding = "utf8"
    try:
        head[: head.rfind(b"\n") + 1].decode(encoding)
    except UnicodeDecodeError:
        encoding = "latin-1"
    lines = re.split(
        r"\r\n|\n|\r", head.decode(encoding, "replace").removeprefix("\ufeff")
    )
    if len(head) == HEAD:
        if len(lines) == 1:
            message = (
                f"its first line is longer than {HEAD} bytes: it is no table of samples"
            )
            raise InputError(message, hint=_HINT, where=where)
        lines.pop()
    return encoding, lines


def _header(lines: Sequence[str], where: str) -> tuple[int, str]:
    """Find the line of names: the first that is no comment, or the last comment before numbers."""
    # The names are empty, and the line is that before the numbers, where there are
    # none.
    comment = ""
    for at, line in enumerate(lines):
        stripped = line.strip()
        if stripped.startswith(_COMMENTS):
            comment = stripped.lstrip("#% \t")
        elif stripped and not _all_numbers(stripped):
            return at, stripped if "\t" not in line else line.rstrip("\r\n")
        elif stripped:
            return at - 1, "" if _all_numbers(comment or "0") else comment
    raise InputError("the file holds no line of names", hint=_HINT, where=where)


def nameless(names: Sequence[str]) -> bool:
    """Tell whether the columns only have their numbers for names."""
    return bool(names) and list(names) == [str(k + 1) for k in range(len(names))]


def _all_numbers(line: str) -> bool:
    fields = [field for field in re.split(r"[,;\t ]+", line) if field]
    return bool(fields) and all(map(is_number, fields))


def is_number(field: str) -> bool:
    """Tell whether a field is a number, with a decimal point or comma, in quotes or not."""
    stripped = field.strip().strip('"')
    return bool(_NUMBER.fullmatch(stripped) or _DECIMAL_COMMA.fullmatch(stripped))


def _delimiter(names: str, data: str, where: str) -> str:
    """Choose the delimiter that splits both the names and the numbers into most fields."""
    counts = {d: min(len(_split(names, d)), len(_split(data, d))) for d in _DELIMITERS}
    best = max(_DELIMITERS, key=lambda d: counts[d])
    if counts[best] < 2:
        text = f"nothing separates columns in {names[:40]!r} and {data[:40]!r}"
        raise InputError(f"is text but no table: {text}", hint=_HINT, where=where)
    if best == " " and "  " in data.strip():
        message = "columns are separated by a varying number of spaces"
        hint = "Write one space or comma between them: `tr -s ' ' < FILE > NEW.csv`."
        raise InputError(message, hint=hint, where=where)
    return best


def _split(line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []


def _decimal(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    fields = [field.strip().strip('"') for row in rows for field in row]
    commas = any(_DECIMAL_COMMA.fullmatch(field) for field in fields)
    points = any("." in field and _NUMBER.fullmatch(field) for field in fields)
    return "," if commas and not points else "."


def _require_numbers(
    row: Sequence[str], names: int, delimiter: str, line: int, where: str
) -> None:
    if delimiter == "," and names < len(row) <= 2 * names and all(map(is_number, row)):
        text = (
            f"line {line} has {len(row)} numbers for {names} names: they seem to have"
            " decimal "
        )
        hint = (
            "Write numbers with a decimal point, or separate the columns by semicolons."
        )
        raise InputError(f"{text}commas", hint=hint, where=where)
    if not any(map(is_number, row)):
        message = (
            f"line {line} holds no number: it is no table of samples"
            f" ({' '.join(row)[:60]!r})"
        )
        hint = _HINT + " A line of units below the names must go."
        raise InputError(message, hint=hint, where=where)
