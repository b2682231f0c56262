"""Wide Parquet files: what is asked of a file does not grow with its columns."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.logs.tables.parquet import open_table


@pytest.mark.parametrize("columns", [3, 60])
def test_the_schema_is_made_a_few_times_however_many_lists_there_are(
    columns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "wide.parquet"
    lists = {f"c{k}": [[0.0, 1.0]] * 4 for k in range(columns)}
    pq.write_table(pa.table(lists), path)

    made = pq.ParquetFile.schema_arrow.fget
    n_made = 0

    def counted(file: pq.ParquetFile) -> pa.Schema:
        nonlocal n_made
        n_made += 1
        return made(file)

    monkeypatch.setattr(pq.ParquetFile, "schema_arrow", property(counted))
    table = open_table(path)
    assert table.lists == dict.fromkeys(lists, 2)
    assert n_made <= 5
