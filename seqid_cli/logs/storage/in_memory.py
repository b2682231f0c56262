"""Logs that are tables in memory: Arrow tables and whatever turns into one (pandas, polars).

Such a table stands in the place of a path, as a log on object storage does: whoever reads it gets
a local copy, a Parquet file, which is removed afterwards. So it is read, checked and passed over
like any other log, in this process or in others.
"""

from pathlib import Path
from typing import Any

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.remote import StoredLog


class TableLog(StoredLog):
    """A table in the default column names, in the place of a path; `content` is the table."""

    content: Any

    @classmethod
    def of(cls, data: object, name: str) -> "TableLog":
        """Take a table under the name that results give it."""
        log = cls(f"{name}.parquet")
        log.content = _table(data)
        return log

    def __reduce__(self) -> Any:
        return TableLog.of, (self.content, self.stem)

    def __str__(self) -> str:
        return self.stem

    def fetch(self, copy: Path) -> None:
        """Write the table to a local file."""
        import pyarrow.parquet as pq

        pq.write_table(self.content, copy)


def _table(data: object) -> Any:
    import pyarrow as pa

    if isinstance(data, pa.Table):
        return data
    try:
        if hasattr(data, "__arrow_c_stream__"):
            return pa.table(data)
        return pa.Table.from_pandas(data)
    except (TypeError, ValueError, AttributeError, pa.ArrowException) as error:
        hint = "Give a path, a pyarrow.Table, a pandas.DataFrame or a Recording."
        raise InputError(f"{type(data).__name__} is no log ({error})", hint=hint) from error
