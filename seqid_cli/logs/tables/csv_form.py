"""How a CSV file is written, by its first lines: standard library only.

Loggers do not agree on encoding, delimiter, decimal mark, comments or names. A cell may
hold a list of numbers, as pandas or a shell script writes an array of a message.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from seqid_cli.errors import InputError
from seqid_cli.logs.tables.echoed import echoed_names, joint_places, name_columns
from seqid_cli.logs.tables.naming_schemes import NAME_COLUMNS

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
LONGEST_LIST = 256  # elements of a list that can be one number per joint
LIST_SEPARATOR = re.compile(r"[,;\s]+")  # of elements in a cell
LIST_BRACKETS = "[]() "  # around them
_LIST = re.compile(r"[\[(](?P<content>[^\[\]()]*)[\])]")
LEAST_NUMBERS = 2  # of a line of data with texts: a time and a value
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
    # columns whose cells are lists of numbers, and how many these hold
    lists: Mapping[str, int] = field(default_factory=dict)
    # columns that hold names of joints, and the place in the lists of each name
    name_columns: tuple[str, ...] = ()
    places: Mapping[str, int] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """All that can be read: `names`, and elements of lists as `column[k]`."""
        elements = [f"{name}[{k}]" for name, n in self.lists.items() for k in range(n)]
        return (*self.names, *elements)


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
    rows = [_split(line, delimiter) for line in data]
    if names_line == data[0]:  # they are values
        numbered = [str(k + 1) for k in range(len(names))]
        names = list(echoed_names(rows[0], _is_value)) or numbered
    while names and not names[-1] and max(map(len, rows)) < len(names):
        names.pop()  # the header alone ends with a delimiter
    _require_numbers(rows[0], len(names), delimiter, header_at + 2, where)

    # Fields beyond the names are filler where they are empty in every line.
    has_content_beyond = any("".join(row[len(names) :]).strip() for row in rows)
    filler = 0
    if not has_content_beyond:
        filler = max(0, min(map(len, rows)) - len(names))
    cells = dict(zip(names, rows[0], strict=False))
    lists = {name: list_length(cell) for name, cell in cells.items()}
    places = dict(joint_places(names, rows[0]))
    named_in = name_columns(names)
    for name in NAME_COLUMNS:
        if not places and name in cells:
            places = {joint: k for k, joint in enumerate(names_in(cells[name]))}
            named_in = [name] if places else []
    return CsvForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=_decimal(rows, delimiter),
        names=tuple(names),
        skip=header_at + 1,
        filler=filler,
        lists={name: length for name, length in lists.items() if length},
        name_columns=tuple(named_in),
        places=places,
    )


def list_length(cell: str) -> int:
    """Return how many numbers a cell such as `[0.1, 0.2]` lists, 0 for another."""
    match = _LIST.fullmatch(cell.strip())
    if match is None:
        return 0
    elements = [each for each in LIST_SEPARATOR.split(match["content"].strip()) if each]
    is_list = len(elements) <= LONGEST_LIST and all(map(_is_value, elements))
    return len(elements) if is_list else 0


def names_in(cell: str) -> list[str]:
    """Return the names that a cell such as `["a", "b"]` lists; empty for another."""
    match = _LIST.fullmatch(cell.strip())
    if match is None:
        return []
    names = re.findall(r"""["']([^"',]+)["']""", match["content"])
    # What remains without the names separates them.
    rest = re.sub(r"""["'][^"',]+["']""", "", match["content"])
    return names if not rest.strip(" ,") and len(names) <= LONGEST_LIST else []


def _is_value(field: str) -> bool:
    """Tell whether a field is a number, or a word for a missing one."""
    return is_number(field) or (bool(field) and field.strip().lower() in MISSING)


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

    It is the first line that is no comment, or the last comment before data. The names
    are empty where there are none.
    """
    comment = ""
    for at, line in enumerate(lines):
        stripped = line.strip()
        if not stripped:
            continue
        if stripped.startswith(_COMMENTS):
            comment = stripped.lstrip("#% \t")
        elif _is_data(stripped, comment, lines[at + 1 :]):
            return at - 1, comment if _names_columns(comment, stripped) else ""
        elif not _all_numbers(stripped):
            # A tab at the end may be a delimiter.
            return at, line.rstrip("\r\n") if "\t" in line else stripped
        else:
            has_names = bool(comment) and not _all_numbers(comment)
            return at - 1, comment if has_names else ""
    raise InputError("the file holds no line of names", hint=_HINT, where=where)


def _is_data(line: str, comment: str, following: Sequence[str]) -> bool:
    """Tell whether the first line that is no comment holds values, texts among them.

    It does where a comment above has a name for each of its fields, or where the next
    line has numbers and texts in the same places: names have texts above numbers.
    """
    kinds = _kinds(line)
    n_numbers = kinds.count("number")
    if n_numbers < LEAST_NUMBERS or n_numbers == len(kinds):
        return False
    if _names_columns(comment, line):
        return True
    next_line = next((each for each in following if each.strip()), "")
    next_kinds = _kinds(next_line)
    return len(kinds) == len(next_kinds) and all(
        a == b or "" in (a, b) for a, b in zip(kinds, next_kinds, strict=True)
    )


def _names_columns(comment: str, line: str) -> bool:
    """Tell whether a comment has a name for each field of a line."""
    return bool(comment) and len(_kinds(comment)) == len(_kinds(line))


def _kinds(line: str) -> list[str]:
    """Say of each field of a line whether it is a number or a text; empty where empty.

    The delimiter is the one that gives most fields.
    """
    rows = [_split(line, delimiter) for delimiter in _DELIMITERS]
    return [
        "number" if _is_value(each) else "text" if each.strip() else ""
        for each in max(rows, key=len)
    ]


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
