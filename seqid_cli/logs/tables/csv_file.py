"""CSV logs: one line per sample, converted by Arrow; only the needed columns are kept."""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pc

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import RawLog, TimeSource
from seqid_cli.logs.tables.columns import ARROW_ERRORS, is_text
from seqid_cli.logs.tables.csv_form import MISSING, CsvForm, read_form
from seqid_cli.logs.tables.naming_schemes import stamp_parts, time_names
from seqid_cli.logs.tables.table import TableFile, read_table
from seqid_cli.robot.types import Robot

_BLOCK = 8 << 20  # bytes; no line can be longer
_CUT = "the last line has no end and may be cut short, it is left out"
_RAGGED_SHARE = 0.01  # of the lines, that may be left out
_MISSING = sorted(
    {form for word in MISSING for form in (word, word.upper(), word.capitalize())}
)
_FAULT = re.compile(
    r"In CSV column #(?P<column>\d+):(?: Row #(?P<row>\d+):)?.*?invalid value"
    r" '(?P<value>.*)'",
    re.DOTALL,
)


@dataclass
class _Ragged:
    """Counts lines that have another number of fields than the names, and keeps the first."""

    first: pc.InvalidRow | None = None
    count: int = 0

    def __call__(self, row: pc.InvalidRow) -> str:
        self.first = self.first or row
        self.count += 1
        return "skip"


@dataclass(frozen=True, kw_only=True)
class CsvTable(TableFile):
    """An opened CSV file; `size` bytes of it are whole lines, all of them if that is None."""

    form: CsvForm
    size: int | None = None

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns as one table; lines with another number of fields are left out."""
        parsed = self._parse(columns)
        ragged = _Ragged()
        if not isinstance(parsed, pa.Table):
            parsed = self._parse(columns, ragged)
        if isinstance(parsed, pa.Table) and any(
            is_text(kind) for kind in parsed.schema.types
        ):
            # the time, too, for the fault
            parsed = self._parse(columns, _Ragged(), numeric=True)
        if not isinstance(parsed, pa.Table):
            raise self._fault(parsed)
        first, lines = ragged.first, parsed.num_rows + ragged.count
        if first is None:
            yield parsed, ""
            return
        what = "a line" if first.number is None else f"line {first.number}"
        what += (
            f" has {first.actual_columns} fields, the header {first.expected_columns}"
        )
        if ragged.count > max(1.0, _RAGGED_SHARE * lines):
            message = f"{what}; so do {ragged.count} of {lines} lines"
            hint = "Give every line as many fields as there are names."
            raise InputError(message, hint=hint, where=self.where)
        yield parsed, f"{what}; {ragged.count} of {lines} lines were left out"

    def _parse(
        self,
        columns: Sequence[str],
        ragged: _Ragged | None = None,
        *,
        numeric: bool = False,
    ) -> pa.Table | BaseException:
        """Parse the file, time as numbers if `numeric`; returns what Arrow raised otherwise.

        `ragged`: takes lines with another number of fields, which are an error without
        it.
        """
        places = [self.names.index(name) for name in columns]
        # Arrow may find out the type of time itself: seconds, counts or a calendar
        # time.
        times = (
            ()
            if numeric
            else {*time_names(self.names), *(stamp_parts(self.names) or ())}
        )
        source: Path | pa.BufferReader = self.path
        if self.size is not None:
            source = pa.BufferReader(
                pa.memory_map(str(self.path)).read_buffer(self.size)
            )
        reading = pc.ReadOptions(
            use_threads=ragged is None,
            block_size=_BLOCK,
            skip_rows=self.form.skip,
            column_names=[f"c{k}" for k in range(len(self.names) + self.form.filler)],
            # Arrow hands damaged lines over as text: any byte must be some character.
            encoding=self.form.encoding if ragged is None else "latin-1",
        )
        parsing = pc.ParseOptions(
            delimiter=self.form.delimiter, invalid_row_handler=ragged
        )
        conversion = pc.ConvertOptions(
            column_types={
                f"c{k}": pa.float64() for k in places if self.names[k] not in times
            },
            include_columns=[f"c{k}" for k in places],
            null_values=_MISSING,
            quoted_strings_can_be_null=True,
            decimal_point=self.form.decimal,
            check_utf8=False,
        )
        try:
            table = pc.read_csv(source, reading, parsing, conversion)
        except ARROW_ERRORS as error:
            return error
        return table.rename_columns(list(columns))

    def _fault(self, error: BaseException) -> InputError:
        text = " ".join(str(error).split())
        message = f"the CSV file is not readable ({text[:200]})"
        hint = "Export it again, numbers only, one line per sample."
        if "straddling" in text:
            message = (
                f"a line is longer than {_BLOCK >> 20} MB: it is no table of samples"
            )
            hint = "End every sample with a line feed."
        elif found := _FAULT.search(text):
            name = self.names[int(found["column"])]
            line = f"line {self._line(int(found['row']))}, " if found["row"] else ""
            message = f"{line}column {name!r}: {found['value'][:40]!r} is no number"
            hint = (
                "Correct or delete the line; leave the field empty where a value is"
                " missing."
            )
        return InputError(message, hint=hint, where=self.where)

    def _line(self, row: int) -> int:
        """Return the line of a row: Arrow counts all lines but empty ones among the data."""
        counted = 0
        with self.path.open("rb") as file:
            for number, line in enumerate(
                iter(lambda: file.readline(_BLOCK), b""), start=1
            ):
                counted += number <= self.form.skip or bool(line.strip(b"\r\n"))
                if counted >= row:
                    return number
        return row


def read_blocks(
    path: Path,
    robot: Robot,
    time_source: TimeSource = "header",
    *,
    rows: int | None = None,
) -> Iterator[RawLog]:
    """Read a CSV log as one block; see `read_table`. A line has one time."""
    del time_source
    form = read_form(path)
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _BLOCK))
        tail = file.read()
    end = max(tail.rfind(b"\n"), tail.rfind(b"\r")) + 1
    cut = end != len(tail)
    whole, notes = size - len(tail) + end if cut else None, (_CUT,) * cut
    return read_table(
        CsvTable(path, form.names, notes=notes, form=form, size=whole), robot, rows
    )
