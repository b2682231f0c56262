"""CSV logs, one line per sample: Arrow converts the columns that are needed."""

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
_FAULT = re.compile(
    r"In CSV column #(?P<column>\d+):(?: Row #(?P<row>\d+):)?.*?invalid value"
    r" '(?P<value>.*)'",
    re.DOTALL,
)


def _missing_values() -> list[str]:
    """Return the words for a missing value in the cases that loggers write."""
    forms: set[str] = set()
    for word in MISSING:
        forms.update((word, word.upper(), word.capitalize()))
    return sorted(forms)


_MISSING = _missing_values()


@dataclass
class _Ragged:
    """Counts lines that have not as many fields as there are names."""

    first: pc.InvalidRow | None = None
    count: int = 0

    def __call__(self, row: pc.InvalidRow) -> str:
        self.first = self.first or row
        self.count += 1
        return "skip"


@dataclass(frozen=True, kw_only=True)
class CsvTable(TableFile):
    """An opened CSV file."""

    form: CsvForm
    size: int | None = None  # bytes that are whole lines, None for all

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns as one table; lines with too many or few fields are left out."""
        # First without a handler of such lines: that is done by several threads.
        parsed = self._parse(columns)
        ragged = _Ragged()
        if not isinstance(parsed, pa.Table):
            parsed = self._parse(columns, ragged)
        # A time that is text: read as numbers, so that Arrow says which line it is.
        if isinstance(parsed, pa.Table) and any(map(is_text, parsed.schema.types)):
            parsed = self._parse(columns, _Ragged(), numeric=True)
        if not isinstance(parsed, pa.Table):
            raise self._fault(parsed)
        yield parsed, self._loss(ragged, parsed.num_rows + ragged.count)

    def _loss(self, ragged: _Ragged, n_lines: int) -> str:
        """Describe the lines left out; raises InputError where they are too many."""
        first = ragged.first
        if first is None:
            return ""
        line = "a line" if first.number is None else f"line {first.number}"
        fault = (
            f"{line} has {first.actual_columns} fields, the header"
            f" {first.expected_columns}"
        )
        if ragged.count > max(1.0, _RAGGED_SHARE * n_lines):
            raise InputError(
                f"{fault}; so do {ragged.count} of {n_lines} lines",
                hint="Give every line as many fields as there are names.",
                where=self.where,
            )
        return f"{fault}; {ragged.count} of {n_lines} lines were left out"

    def _parse(
        self,
        columns: Sequence[str],
        ragged: _Ragged | None = None,
        *,
        numeric: bool = False,
    ) -> pa.Table | BaseException:
        """Parse the file.

        Parameters
        ----------
        ragged : _Ragged, optional
            Takes lines with another number of fields, which are an error without it.
        numeric : bool
            Whether time is numbers, too.

        Returns
        -------
        pyarrow.Table or BaseException
            The columns, or what Arrow raised.
        """
        # Arrow may find out the type of time itself: seconds, counts or a calendar
        # time.
        times: set[str] = set()
        if not numeric:
            times.update(time_names(self.names))
            times.update(stamp_parts(self.names) or ())
        source: Path | pa.BufferReader = self.path
        if self.size is not None:
            content = pa.memory_map(str(self.path))
            source = pa.BufferReader(content.read_buffer(self.size))

        # Columns by their place: names may be there twice.
        places = [self.names.index(name) for name in columns]
        n_columns = len(self.names) + self.form.filler
        read_options = pc.ReadOptions(
            use_threads=ragged is None,
            block_size=_BLOCK,
            skip_rows=self.form.skip,
            column_names=[f"c{k}" for k in range(n_columns)],
            # Arrow hands damaged lines over as text: any byte must be some character.
            encoding=self.form.encoding if ragged is None else "latin-1",
        )
        parse_options = pc.ParseOptions(
            delimiter=self.form.delimiter, invalid_row_handler=ragged
        )
        convert_options = pc.ConvertOptions(
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
            table = pc.read_csv(source, read_options, parse_options, convert_options)
        except ARROW_ERRORS as error:
            return error
        return table.rename_columns(list(columns))

    def _fault(self, error: BaseException) -> InputError:
        """Make the error for what Arrow could not parse."""
        text = " ".join(str(error).split())
        match = _FAULT.search(text)
        if "straddling" in text:
            message = (
                f"a line is longer than {_BLOCK >> 20} MB: it is no table of samples"
            )
            hint = "End every sample with a line feed."
        elif match is not None:
            name = self.names[int(match["column"])]
            line = f"line {self._line(int(match['row']))}, " if match["row"] else ""
            message = f"{line}column {name!r}: {match['value'][:40]!r} is no number"
            hint = (
                "Correct or delete the line; leave the field empty where a value is"
                " missing."
            )
        else:
            message = f"the CSV file is not readable ({text[:200]})"
            hint = "Export it again, numbers only, one line per sample."
        return InputError(message, hint=hint, where=self.where)

    def _line(self, row: int) -> int:
        """Return the line of a row.

        Arrow counts the lines before the data, and all but empty ones in the data.
        """
        counted = 0
        number = 0
        with self.path.open("rb") as file:
            while line := file.readline(_BLOCK):
                number += 1
                if number <= self.form.skip or line.strip(b"\r\n"):
                    counted += 1
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

    # A last line without an end was cut while it was written: half a number is one.
    end = max(tail.rfind(b"\n"), tail.rfind(b"\r")) + 1
    is_cut = end != len(tail)
    table = CsvTable(
        path=path,
        names=form.names,
        notes=(_CUT,) if is_cut else (),
        form=form,
        size=size - len(tail) + end if is_cut else None,
    )
    return read_table(table, robot, rows)
