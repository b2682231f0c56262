"""Values of a Parquet file by its footer: as Arrow counts them, and never a crash."""

import io
import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.tables import columns
from seqid_cli.logs.tables.parquet_footer import FooterError, values_by_column
from tests.studies.fuzz.thrift import Value, decoded, encoded

TABLE = pa.table(
    {
        "t": np.arange(1000.0),
        "name": [["a", "b"]] * 1000,
        "state": [[1.0, 2.0, 3.0], None] * 500,
        "deep": [{"values": [[1.0], [2.0, 3.0]]}] * 1000,
        "flag": [True, False] * 500,
    }
)

# A column whose metadata is an empty list.
_COLUMN = Value(12, {3: Value(9, [], 5)})
_GROUP = Value(12, {1: Value(9, [_COLUMN], 12)})
OF_ANOTHER_TYPE = encoded(Value(12, {4: Value(9, [_GROUP], 12)}))


def with_values(count: int) -> bytes:
    """Return a footer of one column with so many values."""
    metadata = Value(12, {3: Value(9, [Value(8, b"t")], 8), 5: Value(6, count)})
    group = Value(12, {1: Value(9, [Value(12, {3: metadata})], 12)})
    return encoded(Value(12, {4: Value(9, [group], 12)}))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.parquet"
    pq.write_table(TABLE, path, row_group_size=300)
    return path


def footer_of(raw: bytes) -> int:
    """Return where the footer begins."""
    (length,) = struct.unpack("<I", raw[-8:-4])
    return len(raw) - 8 - int(length)


def test_columns_are_counted_as_arrow_counts_them(path: Path) -> None:
    metadata = pq.ParquetFile(path).metadata
    counts: dict[str, int] = {}
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for k in range(group.num_columns):
            column = group.column(k)
            name = column.path_in_schema
            counts[name] = counts.get(name, 0) + column.num_values
    assert metadata.num_row_groups == 4
    assert values_by_column(path) == counts


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (3, b"\x2a"),
        (7, struct.pack("<d", 1.5)),
        # In a list, as in a set, a truth value has a byte of its own.
        (9, b"\x21\x01\x02"),
        (9, b"\x22\x00\x01"),
        (10, b"\x25\x02\x04"),
        # From two texts to numbers.
        (11, b"\x02\x86" + b"\x01a\x02" + b"\x01b\x04"),
        (11, b"\x00"),
    ],
    ids=["byte", "double", "trues", "falses", "set", "map", "empty map"],
)
def test_fields_of_other_kinds_are_passed_over(
    path: Path, kind: int, content: bytes
) -> None:
    """What a later version of the format may add does not change the counts."""
    expected = values_by_column(path)
    raw = path.read_bytes()
    start = footer_of(raw)
    # Field 100 comes first; field 1 then has its whole number as well.
    added = bytes([kind]) + b"\xc8\x01" + content
    assert raw[start] == 0x15
    footer = added + b"\x05\x02" + raw[start + 1 : -8]
    tail = struct.pack("<I", len(footer)) + b"PAR1"
    path.write_bytes(raw[:start] + footer + tail)
    assert values_by_column(path) == expected


@pytest.mark.parametrize("count", [0, 1, 300, 2**62])
def test_a_column_may_have_any_number_of_values(tmp_path: Path, count: int) -> None:
    footer = with_values(count)
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    assert values_by_column(path) == {"t": count}


def test_damaged_footers_are_refused_or_read(path: Path) -> None:
    """Two bytes of each are others: a count or a refusal comes back, in time."""
    raw = path.read_bytes()
    start, rng = footer_of(raw), np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        damaged = bytearray(raw)
        for at in rng.integers(start, len(raw) - 4, 2):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            counts = values_by_column(path)
        except FooterError:
            refused += 1
        else:
            assert min(counts.values(), default=0) >= 0
    assert 40 < refused < 400


@pytest.mark.parametrize(
    ("footer", "message"),
    [
        (b"\x1c" * 100, "too deep"),
        (b"\x19\xfc\xff\xff\xff\xff\x0f", "longer than the footer"),
        (b"\x16" + b"\xff" * 12, "too many bytes"),
        (b"\x16" + b"\xff" * 10 + b"\x01\x00", "too many bytes"),
        (b"\x1e\x00", "unknown kind"),
        (b"\x18\x05ab", "ends within"),
        (b"\x16\x02\x00", "a field is missing"),
        (OF_ANOTHER_TYPE, "a field is missing or of another type"),
        (with_values(-3), "fewer values than none"),
    ],
)
def test_what_is_wrong_with_a_footer_is_said(
    tmp_path: Path, footer: bytes, message: str
) -> None:
    path = tmp_path / "log.parquet"
    tail = struct.pack("<I", len(footer)) + b"PAR1"
    path.write_bytes(b"PAR1" + footer + tail)
    with pytest.raises(FooterError, match=message):
        values_by_column(path)
    for content in (b"PAR1", b"PAR1" + footer + struct.pack("<I", 1 << 30) + b"PAR1"):
        path.write_bytes(content)
        with pytest.raises(FooterError, match=r"too short|does not end"):
            values_by_column(path)


def test_arrow_makes_no_object_for_a_column_before_its_footer_is_read(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some footers end the process where it does; their refusal names the file."""

    def refused(_: Path) -> dict[str, int]:
        raise FooterError("a value is of the unknown kind 0")

    monkeypatch.setattr(columns, "values_by_column", refused)
    with pytest.raises(InputError, match="its footer is damaged: a value") as raised:
        columns.opened_table(path)
    assert raised.value.where == str(path)


@pytest.mark.slow
def test_few_bytes_that_stand_for_many_values_are_refused(tmp_path: Path) -> None:
    sink = io.BytesIO()
    values = pa.array(np.zeros(180_000_000, dtype=np.int8))
    offsets = np.arange(0, 180_000_001, 60_000, dtype=np.int32)
    lists = pa.ListArray.from_arrays(offsets, values)
    pq.write_table(pa.table({"state": lists}), sink, compression="zstd")
    path = tmp_path / "log.parquet"
    path.write_bytes(sink.getvalue())
    with pytest.raises(InputError, match="times as many"):
        columns.opened_table(path)


def test_footers_are_damaged_field_by_field(path: Path) -> None:
    """What the study writes is what it has read, where it changes nothing."""
    raw = path.read_bytes()
    footer = raw[footer_of(raw) : -8]
    tree, end = decoded(footer)
    assert end == len(footer)
    assert encoded(tree) == footer


def test_a_nan_of_any_pattern_is_a_missing_value(tmp_path: Path) -> None:
    signalling = np.array([0x7FF0000000000001], dtype=np.uint64).view(np.float64)
    table = pa.table({"t": np.concatenate([[0.0, 1.0], signalling])})
    with np.errstate(all="raise"):
        read = columns.numbers("log", table, "t") / 2.0
    np.testing.assert_array_equal(read, [0.0, 0.5, np.nan])
