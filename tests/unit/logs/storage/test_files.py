"""Which files are meant, and whether they are logs."""

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.files import check_log, expand


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("run10.parquet", "run2.parquet", "sub/run1.MCAP", ".hidden.mcap", "notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def names(paths: list[Path], folder: Path) -> list[str]:
    return [str(path.relative_to(folder)) for path in paths]


ALL = ["run2.parquet", "run10.parquet", "sub/run1.MCAP"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([""], ALL),
        (["run10.parquet", "", "sub/../run2.parquet"], ALL),
        (["*.parquet"], ALL[:2]),
        (["**/*.MCAP"], ALL[2:]),
        (["s*"], ALL[2:]),
        (["run?.parquet"], ALL[:1]),
    ],
)
def test_logs_come_once_in_natural_order(
    folder: Path, arguments: list[str], expected: list[str]
) -> None:
    assert names(expand([str(folder / each) for each in arguments]), folder) == expected


def test_name_with_brackets_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "run[1].parquet"
    path.write_bytes(b"x")
    assert expand([str(path)]) == [path]


@pytest.mark.parametrize("missing", ["nothing.parquet", "*.csv", "empty", "x" * 5000, "a\0b"])
def test_nothing_found_names_the_argument(folder: Path, missing: str) -> None:
    (folder / "empty").mkdir()
    argument = str(folder / missing)
    with pytest.raises(InputError) as caught:
        expand([str(folder), argument])
    assert caught.value.where == argument
    assert caught.value.exit_code == 2


def test_misspelt_name_gets_a_hint(folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        expand([str(folder / "run3.parquet")])
    assert "run2.parquet" in caught.value.hint


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "empty"),
        (b"\x00\x01\x02\x03", "neither Parquet nor MCAP, no ROS bag and no CSV"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "neither Parquet"),
        (b"#ROSBAG V1.2\n", "ROS bag of an old version"),
        (b"hello", "neither Parquet nor MCAP.*: the table has names but no line of data"),
        (b"\x28\xb5\x2f\xfdxxxx", "zstd"),
        (b"version https://git-lfs.github.com/spec/v1", "LFS"),
        (b"PAR1", "footer"),
        (b"PAR1" + b"\0" * 50, "footer"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path: Path, content: bytes, fragment: str) -> None:
    path = tmp_path / "log.parquet"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fragment) as caught:
        check_log(path)
    assert caught.value.hint
    assert caught.value.where == str(path)


TABLES = {
    "a/log.csv": "t,q_0\n0,1\n",
    "a/times.csv": "time_ms q_0\n0 1\n",
    "a/result.csv": "joint,rmse\nelbow,0.1\n",
    "a/points.csv": "x,y,z\n0,1,2\n",
    "a/numbers.tsv": "1\t2\n3\t4\n",
}


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    for name, content in TABLES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
    return tmp_path


@pytest.mark.parametrize("argument", ["", "a", "a/*", "**"])
def test_csv_files_of_a_folder_that_are_no_logs_are_left_out_and_told(
    tables: Path, argument: str
) -> None:
    notes: list[str] = []
    found = expand([str(tables / argument)], notes.append)
    assert names(found, tables) == ["a/log.csv", "a/times.csv"]
    assert len(notes) == 3
    told = {
        word for word in ("result.csv", "points.csv", "numbers.tsv") for n in notes if word in n
    }
    assert len(told) == 3
    assert any("no column of time" in note for note in notes)
    assert any("no line of names" in note for note in notes)


def test_csv_files_named_by_themselves_or_by_suffix_are_taken(tables: Path) -> None:
    points = tables / "a" / "points.csv"
    assert expand([str(points)]) == [points]
    assert len(expand([str(tables / "a" / "*.csv")])) == 4


def test_folder_with_other_tables_only(tables: Path) -> None:
    for name in ("a/log.csv", "a/times.csv"):
        (tables / name).unlink()
    with pytest.raises(InputError, match="no log in this folder"):
        expand([str(tables)])


def test_bag_folder_stands_for_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    with pytest.raises(InputError, match=r"without \*\.mcap"):
        check_log(bag)
    for k in (10, 9):
        (bag / f"bag_{k}.db3").write_bytes(b"SQLite format 3\0" + bytes(84))
    assert names(expand([str(tmp_path)]), tmp_path) == ["bag/bag_9.db3", "bag/bag_10.db3"]
    with pytest.raises(InputError, match="bag of 2 files"):
        check_log(bag)
    (bag / "bag_9.db3").unlink()
    assert check_log(bag) == "rosbag2"


def test_description_of_a_data_set_is_no_log(tmp_path: Path) -> None:
    for name in (
        "meta/info.json",
        "meta/tasks.parquet",
        "meta/episodes/x.parquet",
        "data/e.parquet",
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"{}")
    assert names(expand([str(tmp_path)]), tmp_path) == ["data/e.parquet"]


def test_missing_file_folder_and_unreadable_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        check_log(tmp_path / "none.mcap")
    with pytest.raises(InputError, match="folder"):
        check_log(tmp_path)
    path = tmp_path / "locked.mcap"
    path.write_bytes(b"x")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(InputError, match="may not be read"):
        check_log(path)


def test_a_table_of_predicted_torques_in_a_folder_is_no_log(tmp_path: Path) -> None:
    column = pa.array([0.0, 1.0])
    kinds = ("position", "torque", "predicted", "residual", "sliding")
    log = {"t": column, "a.position": column, "a.torque": column}
    pq.write_table(pa.table(log), tmp_path / "log.parquet")
    predicted = pa.table({"t": column, **{f"a.{kind}": column for kind in kinds}})
    pq.write_table(predicted, tmp_path / "torques.parquet")
    notes: list[str] = []
    assert expand([str(tmp_path)], note=notes.append) == [tmp_path / "log.parquet"]
    (note,) = notes
    assert "seqid predict wrote it" in note
    assert expand([str(tmp_path / "torques.parquet")]) == [tmp_path / "torques.parquet"]
