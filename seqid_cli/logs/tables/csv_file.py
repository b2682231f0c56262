"""CSV logs, one line per sample: Arrow converts the columns that are needed."""

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import RawLog, TimeSource
from seqid_cli.logs.tables.columns import ARROW_ERRORS, is_text, times_of_day
from seqid_cli.logs.tables.csv_form import (
    LIST_BRACKETS,
    LIST_SEPARATOR,
    MISSING,
    CsvForm,
    read_form,
)
from seqid_cli.logs.tables.naming_schemes import stamp_parts, time_names
from seqid_cli.logs.tables.side_by_side import with_siblings
from seqid_cli.logs.tables.table import TableFile, elements_in, read_table
from seqid_cli.robot.toml_schema import DEFAULTS, Channels
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

_BLOCK = 8 << 20  # bytes; no line can be longer
_CUT = "the last line has no end and may be cut short, it is left out"
_SHOWN = 40  # characters of a cell in a message
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

    first: pa_csv.InvalidRow | None = None
    count: int = 0

    def __call__(self, row: pa_csv.InvalidRow) -> str:
        self.first = self.first or row
        self.count += 1
        return "skip"


@dataclass(frozen=True, kw_only=True)
class CsvTable(TableFile):
    """An opened CSV file."""

    form: CsvForm
    times: tuple[str, ...] = ()  # columns that the robot file declares as times
    size: int | None = None  # bytes that are whole lines, None for all

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns as one table; lines with too many or few fields are left out."""
        element_of = elements_in(columns, self.form.lists)
        lists = list(dict.fromkeys(name for name, _ in element_of.values()))
        plain = [name for name in columns if name not in element_of]
        named_in = self.form.name_columns
        wanted = list(dict.fromkeys([*plain, *lists, *named_in]))

        # First without a handler of such lines: that is done by several threads.
        parsed = self._parse(wanted)
        ragged = _Ragged()
        if not isinstance(parsed, pa.Table):
            parsed = self._parse(wanted, ragged)
        # A time that is text: of the day, or else read as numbers, so that Arrow says
        # which line it is.
        if isinstance(parsed, pa.Table):
            parsed = self._with_times_of_day(parsed, {*lists, *named_in})
            is_other_text = any(
                is_text(parsed.schema.field(name).type) for name in plain
            )
            if is_other_text:
                parsed = self._parse(wanted, _Ragged(), numeric=True)
        if not isinstance(parsed, pa.Table):
            raise self._fault(parsed)

        loss = self._loss(ragged, parsed.num_rows + ragged.count)
        for name in named_in:
            self._require_same_names(parsed, name)
        if element_of:
            parsed = self._with_elements(parsed, plain, element_of)
        yield parsed, loss

    def _with_times_of_day(self, table: pa.Table, texts: Collection[str]) -> pa.Table:
        """Turn columns of texts such as 13:05:07.250 into times, but for some."""
        for place, name in enumerate(table.column_names):
            if name in texts or not is_text(table.schema.field(place).type):
                continue
            try:
                times = times_of_day(table.column(place))
            except ValueError as error:
                raise InputError(
                    f"column {name!r}: {str(error)[:_SHOWN]!r} is no time of the day",
                    hint="Correct or delete the line.",
                    where=self.where,
                ) from error
            if times is not None:
                table = table.set_column(place, name, times)
        return table

    def _require_same_names(self, table: pa.Table, name: str) -> None:
        """Raise InputError where a column of joints' names has others in some rows."""
        names = table.column(name).unique().drop_null().to_pylist()
        if len(names) > 1:
            listed = ", ".join(repr(each[:_SHOWN]) for each in names[:2])
            raise InputError(
                f"the names in column {name!r} change from row to row: {listed}",
                hint="Values of joints would be mixed up: log the messages of one"
                " publisher, or convert the bag to MCAP.",
                where=self.where,
            )

    def _with_elements(
        self,
        table: pa.Table,
        plain: Sequence[str],
        element_of: Mapping[str, tuple[str, int]],
    ) -> pa.Table:
        """Return plain columns of a table, and elements of its cells with lists."""
        values = {name: table.column(name) for name in plain}
        matrices: dict[str, Array] = {}
        for name, (list_column, k) in element_of.items():
            if list_column not in matrices:
                matrices[list_column] = self._matrix(table, list_column)
            values[name] = pa.chunked_array([matrices[list_column][:, k]])
        return pa.table(values)

    def _matrix(self, table: pa.Table, name: str) -> Array:
        """Return cells that hold lists of numbers as (M, length); NaN without a list.

        Raises InputError for a list of another length, or of something else.
        """
        import pyarrow.compute as pc

        length = self.form.lists[name]
        cells = pc.utf8_trim(table.column(name), characters=LIST_BRACKETS)
        cells = pc.replace_substring_regex(cells, r"(?i)\b(?:null|none)\b", "nan")
        try:
            lists = pc.split_pattern_regex(cells, LIST_SEPARATOR.pattern)
            lists = lists.combine_chunks()
            counts = np.asarray(pc.fill_null(pc.list_value_length(lists), -1))
            faulty = np.flatnonzero((counts != length) & (counts > 1))
            if len(faulty):
                raise InputError(
                    f"row {faulty[0] + 1}: the list in column {name!r} has"
                    f" {counts[faulty[0]]} values, the first {length}"
                    f" ({len(faulty)} such rows)",
                    hint="Write one value per joint in every row.",
                    where=self.where,
                )
            is_whole = counts == length
            elements = pc.list_flatten(lists.filter(pa.array(is_whole)))
            numbers = pc.cast(elements, pa.float64()).to_numpy(zero_copy_only=False)
        except ARROW_ERRORS as error:
            raise InputError(
                f"the lists in column {name!r} are not of numbers"
                f" ({' '.join(str(error).split())[:120]})",
                hint="Write lists such as [0.1, 0.2], null where a value is missing.",
                where=self.where,
            ) from error
        matrix = np.full((len(lists), length), np.nan)
        matrix[is_whole] = numbers.reshape(-1, length)
        return matrix

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
            times.update(self.times)
            times.update(time_names(self.form.names))
            times.update(stamp_parts(self.form.names) or ())
        source: Path | pa.BufferReader = self.path
        if self.size is not None:
            content = pa.memory_map(str(self.path))
            source = pa.BufferReader(content.read_buffer(self.size))

        # Columns by their place: names may be there twice.
        names = self.form.names
        places = [names.index(name) for name in columns]
        n_columns = len(names) + self.form.filler
        kinds = {name: pa.string() for name in self.form.lists}
        for name in self.form.name_columns:
            kinds[name] = pa.dictionary(pa.int32(), pa.string())
        read_options = pa_csv.ReadOptions(
            use_threads=ragged is None,
            block_size=_BLOCK,
            skip_rows=self.form.skip,
            column_names=[f"c{k}" for k in range(n_columns)],
            # Arrow hands damaged lines over as text: any byte must be some character.
            encoding=self.form.encoding if ragged is None else "latin-1",
        )
        parse_options = pa_csv.ParseOptions(
            delimiter=self.form.delimiter, invalid_row_handler=ragged
        )
        convert_options = pa_csv.ConvertOptions(
            column_types={
                f"c{k}": kinds.get(names[k], pa.float64())
                for k in places
                if names[k] not in times
            },
            include_columns=[f"c{k}" for k in places],
            null_values=_MISSING,
            quoted_strings_can_be_null=True,
            decimal_point=self.form.decimal,
            check_utf8=False,
        )
        try:
            table = pa_csv.read_csv(
                source, read_options, parse_options, convert_options
            )
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
            name = self.form.names[int(match["column"])]
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
    return read_table(open_table(path, robot.channels), robot, rows)


def open_table(path: Path, channels: Channels = DEFAULTS) -> TableFile:
    """Look at a CSV file, and at those of other quantities that belong to it.

    Raises InputError where it is no table.
    """

    def opened(file: Path) -> CsvTable:
        return _opened(file, channels)

    return with_siblings(opened(path), opened, channels.files, channels.time)


def _opened(path: Path, channels: Channels) -> CsvTable:
    """Look at a CSV file; raises InputError where it is no table."""
    form = read_form(path)
    declared_time = channels.time
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _BLOCK))
        tail = file.read()

    # A last line without an end was cut while it was written: half a number is one.
    end = max(tail.rfind(b"\n"), tail.rfind(b"\r")) + 1
    is_cut = end != len(tail)
    return CsvTable(
        path=path,
        names=form.columns,
        entries=form.places,
        named=bool(form.places),
        times=() if declared_time is None else (str(declared_time),),
        notes=(_CUT,) if is_cut else (),
        form=form,
        size=size - len(tail) + end if is_cut else None,
    )
