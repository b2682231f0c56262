"""Parquet logs block by block: one row group at a time, only the needed columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.logs import parquet
from seqid_cli.logs.columns import ARROW_ERRORS, opened_table
from seqid_cli.logs.raw import RawLog, TimeSource
from seqid_cli.logs.tabular import make_plan, read_table
from seqid_cli.robot.types import Robot

BLOCK_ROWS = 65_536


def read_tables(
    path: Path, columns: Sequence[str], *, rows: int = BLOCK_ROWS
) -> Iterator[pa.Table]:
    """Read columns of a Parquet file in blocks of up to `rows` rows.

    Memory stays that of one row group: nothing is read ahead, and pages are checked against their
    checksums where the file has them.

    Raises
    ------
    InputError
        The file is damaged.
    """
    pool = _pool()
    try:
        with _opened(path, pool) as file:
            for group in range(file.num_row_groups):
                for batch in file.iter_batches(
                    rows, row_groups=[group], columns=list(columns), use_threads=False
                ):
                    yield pa.Table.from_batches([batch])
                    del batch
                pool.release_unused()  # or it keeps some row groups' worth
    except ARROW_ERRORS as error:
        raise parquet.damaged(path, error) from error


def _pool() -> pa.MemoryPool:
    """The memory that is had at the least cost: Arrow's usual one takes a third of decoding."""
    try:
        return pa.jemalloc_memory_pool()
    except NotImplementedError:
        return pa.default_memory_pool()


def _opened(path: Path, pool: pa.MemoryPool) -> pq.ParquetFile:
    """Open a file whose columns go into a memory pool."""
    usual = pa.default_memory_pool()
    pa.set_memory_pool(pool)
    try:
        return opened_table(path, pre_buffer=False, page_checksum_verification=True)
    finally:
        pa.set_memory_pool(usual)  # a reader keeps the one that it was opened with


def read_blocks(
    path: Path, robot: Robot, time_source: TimeSource = "header", *, rows: int = BLOCK_ROWS
) -> Iterator[RawLog]:
    """Read a Parquet log block by block, in memory that does not grow with its length.

    Parameters
    ----------
    path, robot, time_source
        As for `parquet.read`.
    rows : int
        Rows in a block.

    Yields
    ------
    RawLog
        The next rows. What was noticed of the file is told by the first block, what was noticed of
        rows by theirs. A file that holds several episodes is one block: they are put one behind the
        other as a whole.

    Raises
    ------
    InputError
        As for `parquet.read`.
    """
    file = parquet.open_table(path, robot.joint_names)
    plan = make_plan(file, robot)
    if plan.episode is not None:
        yield parquet.read(path, robot, time_source)
        return
    notes: tuple[str, ...] = (*file.notes, *plan.warnings)
    first = True
    for table in read_tables(path, file.stored(plan.columns), rows=rows):
        raw = read_table(_Block(file, table), robot)
        warnings = tuple(note for note in raw.warnings if first or note not in notes)
        yield RawLog(raw.joints, raw.imus, "", warnings, prefer_current=raw.prefer_current)
        first = False


@dataclass(frozen=True)
class _Block:
    """Some rows of a file; see `tabular.TableFile`."""

    file: parquet.ParquetTable
    table: pa.Table

    @property
    def where(self) -> str:
        return self.file.where

    @property
    def names(self) -> Sequence[str]:
        return self.file.names

    @property
    def entries(self) -> Mapping[str, int]:
        return self.file.entries

    @property
    def notes(self) -> Sequence[str]:
        return self.file.notes

    def load(self, columns: Sequence[str]) -> tuple[pa.Table, str]:
        return self.file.arranged(self.table, columns), ""
