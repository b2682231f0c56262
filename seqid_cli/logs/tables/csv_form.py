"""How a CSV file is written, by its first lines: standard library only.

Loggers do not agree on encoding, delimiter, decimal mark, comments or names.
"""

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


@dataclass(frozen=True, kw_only=True)
class CsvForm:
    """The form of one file."""

    encoding: str
    delimiter: str
    decimal: str
    names: tuple[str, ...]  # in order; "1", "2" ... where no line names them
    skip: int  # lines before the data
    filler: int = 0  # columns without a name, where every line ends with delimiters


def is_text(head: bytes) -> bool:
    """Tell whether a file begins as text.

    A table may hold NUL bytes further on, by accident: only its first line and bytes
    count.
    """
    begin = head[:_BEGIN] + head[_BEGIN:].split(b"\n", 1)[0]
    return bool(head) and b"\0" not in begin and not _CONTROL.search(begin)


def read_form(path: Path, *, looked_at: int = 20) -> CsvForm:
    """Look at the first lines of a CSV file.

    Parameters
    ----------
    looked_at : int
        Lines of data that are looked at.

    Raises
    ------
    InputError
        It is no table.
    """
    with path.open("rb") as file:
        head = file.read(HEAD)
    where = str(path)
    encoding, lines = _lines(head, where)
    header_at, names_line = _header(lines, where)
    data = [line for line in lines[header_at + 1 :] if line.strip()][:looked_at]
    names_line = names_line or data[0]
    if not data:
        raise InputError(
            "the table has names but no line of data",
            hint="Was the recording stopped at once? Record again.",
            where=where,
        )

    delimiter = _delimiter(names_line, data[0], where)
    names = [name.strip() for name in _split(names_line, delimiter)]
    if names_line == data[0]:  # they are numbers
        names = [str(k + 1) for k in range(len(names))]
    rows = [_split(line, delimiter) for line in data]
    while names and not names[-1] and max(map(len, rows)) < len(names):
        names.pop()  # the header alone ends with a delimiter
    _require_numbers(rows[0], len(names), delimiter, header_at + 2, where)

    # Fields beyond the names are filler where they are empty in every line.
    has_content_beyond = any("".join(row[len(names) :]).strip() for row in rows)
    filler = 0
    if not has_content_beyond:
        filler = max(0, min(map(len, rows)) - len(names))
    return CsvForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=_decimal(rows, delimiter),
        names=tuple(names),
        skip=header_at + 1,
        filler=filler,
    )


def _lines(head: bytes, where: str) -> tuple[str, list[str]]:
    """Return the encoding and the whole lines of the head, which must be text."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(
            "is UTF-16 text; CSV logs are read as UTF-8",
            hint="Convert it: `iconv -f UTF-16 -t UTF-8 FILE > NEW.csv`.",
            where=where,
        )
    if b"\0" in head:
        line = head[: head.index(b"\0")].count(b"\n") + 1
        raise InputError(
            f"line {line} holds NUL bytes: it is not text, or the recording computer"
            " lost power",
            hint="Remove the NUL bytes: `tr -d '\\000' < FILE > NEW.csv`.",
            where=where,
        )

    encoding = "utf8"
    try:
        head[: head.rfind(b"\n") + 1].decode(encoding)
    except UnicodeDecodeError:
        encoding = "latin-1"
    text = head.decode(encoding, "replace").removeprefix("\ufeff")
    lines = re.split(r"\r\n|\n|\r", text)
    if len(head) < HEAD:
        return encoding, lines

    # The last line of a full head is cut.
    if len(lines) == 1:
        raise InputError(
            f"its first line is longer than {HEAD} bytes: it is no table of samples",
            hint=_HINT,
            where=where,
        )
    return encoding, lines[:-1]


def _header(lines: Sequence[str], where: str) -> tuple[int, str]:
    """Find the line of names, and the number of the line before the data.

    It is the first line that is no comment, or the last comment before numbers. The
    names are empty where there are none.
    """
    comment = ""
    for at, line in enumerate(lines):
        stripped = line.strip()
        if not stripped:
            continue
        if stripped.startswith(_COMMENTS):
            comment = stripped.lstrip("#% \t")
        elif not _all_numbers(stripped):
            # A tab at the end may be a delimiter.
            return at, line.rstrip("\r\n") if "\t" in line else stripped
        else:
            has_names = bool(comment) and not _all_numbers(comment)
            return at - 1, comment if has_names else ""
    raise InputError("the file holds no line of names", hint=_HINT, where=where)


def nameless(names: Sequence[str]) -> bool:
    """Tell whether the columns only have their numbers for names."""
    return bool(names) and list(names) == [str(k + 1) for k in range(len(names))]


def _all_numbers(line: str) -> bool:
    fields = [field for field in re.split(r"[,;\t ]+", line) if field]
    return bool(fields) and all(map(is_number, fields))


def is_number(field: str) -> bool:
    """Tell whether a field is a number, with decimal point or comma, quoted or not."""
    stripped = field.strip().strip('"')
    return bool(_NUMBER.fullmatch(stripped) or _DECIMAL_COMMA.fullmatch(stripped))


def _delimiter(names_line: str, data_line: str, where: str) -> str:
    """Choose the delimiter that splits both names and numbers into most fields."""
    counts = {}
    for delimiter in _DELIMITERS:
        n_names = len(_split(names_line, delimiter))
        n_numbers = len(_split(data_line, delimiter))
        counts[delimiter] = min(n_names, n_numbers)
    best = max(_DELIMITERS, key=counts.__getitem__)
    if counts[best] < 2:
        raise InputError(
            "is text but no table: nothing separates columns in"
            f" {names_line[:40]!r} and {data_line[:40]!r}",
            hint=_HINT,
            where=where,
        )
    if best == " " and "  " in data_line.strip():
        raise InputError(
            "columns are separated by a varying number of spaces",
            hint="Write one space or comma between them: `tr -s ' ' < FILE > NEW.csv`.",
            where=where,
        )
    return best


def _split(line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []


def _decimal(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    """Return the decimal mark: a comma where numbers have commas and no points."""
    if delimiter == ",":
        return "."
    fields = [field.strip().strip('"') for row in rows for field in row]
    has_commas = any(_DECIMAL_COMMA.fullmatch(field) for field in fields)
    has_points = any("." in field and _NUMBER.fullmatch(field) for field in fields)
    return "," if has_commas and not has_points else "."


def _require_numbers(
    row: Sequence[str], n_names: int, delimiter: str, line: int, where: str
) -> None:
    """Raise InputError where the first line of data holds no, or broken, numbers."""
    is_of_numbers = all(map(is_number, row))
    if delimiter == "," and n_names < len(row) <= 2 * n_names and is_of_numbers:
        raise InputError(
            f"line {line} has {len(row)} numbers for {n_names} names: they seem to have"
            " decimal commas",
            hint="Write numbers with a decimal point, or separate the columns by"
            " semicolons.",
            where=where,
        )
    if not any(map(is_number, row)):
        raise InputError(
            f"line {line} holds no number: it is no table of samples"
            f" ({' '.join(row)[:60]!r})",
            hint=_HINT + " A line of units below the names must go.",
            where=where,
        )
