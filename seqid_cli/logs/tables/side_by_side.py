"""Tables of one recording side by side: a file for each quantity, as one table.

A column `elbow` of the file of torques becomes `torque.elbow`, so that the naming
schemes find it. Rows belong together by their number: a file with another number of
rows, or with times of its own, is an error.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from seqid_cli.errors import InputError
from seqid_cli.logs.tables.columns import TimeColumn, read_stamps
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.logs.tables.naming_schemes import stamp_parts, time_names
from seqid_cli.logs.tables.siblings import siblings
from seqid_cli.logs.tables.table import TableFile
from seqid_cli.robot.toml_schema import Quantity

Opened = Callable[[Path], TableFile]
_SAME_NS = 1_000_000  # by which times of one row may differ, as they are printed
_HINT = (
    "Write all quantities of a sample into one row: in one table, or in files of as"
    " many rows. Files that do not belong together need other names."
)


@dataclass(frozen=True)
class _Place:
    """Where a column of the joined table stands."""

    quantity: str
    column: str


@dataclass(frozen=True, kw_only=True)
class SideBySide(TableFile):
    """The table of the positions, and those of other quantities beside it."""

    tables_by_quantity: Mapping[str, TableFile]
    places: Mapping[str, _Place]
    time: TimeColumn | None  # that of the positions

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns as one table."""
        del rows  # rows of several files belong together
        # The positions say the time, and hence are read in any case.
        wanted: dict[str, list[str]] = {"position": []}
        for name in columns:
            place = self.places[name]
            wanted.setdefault(place.quantity, []).append(place.column)
        parts: dict[str, pa.Table] = {}
        losses = []
        for quantity, names in wanted.items():
            table = self.tables_by_quantity[quantity]
            times = _time_columns(table) if self.time is not None else []
            part = list(table.tables([*dict.fromkeys([*names, *times])], None))
            parts[quantity] = pa.concat_tables([rows for rows, _ in part])
            losses += [lost for _, lost in part if lost]
        self._check_rows(parts)
        values = {
            name: parts[self.places[name].quantity].column(self.places[name].column)
            for name in columns
        }
        yield pa.table(values), "; ".join(losses)

    def _check_rows(self, parts: Mapping[str, pa.Table]) -> None:
        """Raise InputError where rows of the files do not belong together."""
        lead = parts["position"]
        for quantity, part in parts.items():
            path = self.tables_by_quantity[quantity].path
            if part.num_rows != lead.num_rows:
                raise InputError(
                    f"{path.name} has {part.num_rows} rows, {self.path.name}"
                    f" {lead.num_rows}",
                    hint=_HINT,
                    where=self.where,
                )
            time = _time_of(part.column_names)
            if self.time is None or time is None or quantity == "position":
                continue
            own, _, _ = read_stamps(str(path), part, time)
            stamps, _, _ = read_stamps(self.where, lead, self.time)
            apart = np.flatnonzero(np.abs(own - stamps) > _SAME_NS)
            if len(apart):
                raise InputError(
                    f"row {apart[0] + 1} of {path.name} is of another time than that of"
                    f" {self.path.name}, by"
                    f" {abs(int(own[apart[0]] - stamps[apart[0]])) * 1e-9:.3g} s",
                    hint=_HINT,
                    where=self.where,
                )


def with_siblings(
    lead: TableFile,
    opened: Opened,
    files: Mapping[Quantity, str] | None = None,
    declared_time: str | int | None = None,
) -> TableFile:
    """Return a table with those of the other quantities beside it, if there are any.

    Parameters
    ----------
    lead : TableFile
        The table of the positions, or one that holds everything.
    opened : callable
        Opens a file of the same format.
    files : mapping of quantity to str, optional
        Names of the other files, as the robot file declares them.
    declared_time : str or int, optional
        The column of the time, as the robot file declares it.
    """
    paths = siblings(lead.path, files)
    if not paths:
        return lead
    tables = {"position": lead}
    for quantity, path in paths.items():
        tables[quantity] = opened(path)

    places = {name: _Place("position", name) for name in lead.names}
    for quantity, table in tables.items():
        for name, column in _names_of(quantity, table, declared_time).items():
            places.setdefault(name, _Place(quantity, column))
    notes = [note for table in tables.values() for note in table.notes]
    listed = ", ".join(path.name for path in paths.values())
    return SideBySide(
        path=lead.path,
        names=tuple(places),
        entries=lead.entries,
        named=lead.named,
        notes=(*notes, f"{listed}: read beside {lead.path.name}, row by row"),
        tables_by_quantity=tables,
        places=places,
        time=_time_of(lead.names),
    )


def _names_of(
    quantity: str, table: TableFile, declared_time: str | int | None
) -> dict[str, str]:
    """Return the columns of a table by the names that they have in the joined one."""
    times = {*time_names(table.names), *(stamp_parts(table.names) or ())}
    if declared_time is not None:
        times.add(table.column(str(declared_time)))
    columns = [name for name in table.names if name not in times]
    names = {f"{quantity}.{column}": column for column in columns}
    # Columns that only have numbers count the joints, in their order.
    if nameless(table.names):
        names |= {f"{quantity}_{k + 1}": column for k, column in enumerate(columns)}
    else:
        names |= {
            f"{quantity}_{number}": column for number, column in _numbered(columns)
        }
        if quantity != "position":
            names |= {column: column for column in columns}
    return names


def _numbered(columns: Sequence[str]) -> list[tuple[int, str]]:
    """Return the number at the end of each column; empty where one has none."""
    numbers = []
    for column in columns:
        digits = column[len(column.rstrip("0123456789")) :]
        if not digits or len(digits) > 3:
            return []
        numbers.append(int(digits))
    is_of_each = len(set(numbers)) == len(numbers)
    return list(zip(numbers, columns, strict=True)) if is_of_each else []


def _time_columns(table: TableFile) -> list[str]:
    """Return the columns of a table by which its rows can be compared with others'."""
    time = _time_of(table.names)
    if time is None:
        return []
    return [time.name, *([time.nanoseconds] if time.nanoseconds else [])]


def _time_of(names: Sequence[str]) -> TimeColumn | None:
    """Return the one column of time of a table, None where there is none or several."""
    units = time_names(names)
    if len(units) == 1 or "t" in units:
        name = "t" if "t" in units else next(iter(units))
        return TimeColumn(name, units[name], sure=units[name] is not None)
    parts = stamp_parts(names)
    if parts is not None and not units:
        return TimeColumn(parts[0], "s", sure=True, nanoseconds=parts[1])
    return None
