"""Which files are meant, whether they are logs, and what becomes of their copies."""

import errno
import os
import tempfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.logs.storage.remote import temporary_folder


def write(folder: Path, names: str) -> Path:
    for path in map(folder.joinpath, names.split()):
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_bytes(b"{}")
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(
        tmp_path, "run10.parquet run2.parquet sub/run1.MCAP .hidden.mcap notes.txt"
    )


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
def test_logs_come_once_in_order(
    folder: Path, arguments: list[str], expected: list[str]
) -> None:
    assert names(expand([str(folder / each) for each in arguments]), folder) == expected


@pytest.mark.parametrize(
    "missing", ["run3.parquet", "*.csv", "empty", "x" * 5000, "a\0b"]
)
def test_nothing_found_names_the_argument(folder: Path, missing: str) -> None:
    (folder / "empty").mkdir()
    argument = str(folder / missing)
    with pytest.raises(InputError) as caught:
        expand([str(folder), argument])
    assert caught.value.where == argument
    assert caught.value.exit_code == 2
    assert missing != "run3.parquet" or "run2.parquet" in caught.value.hint


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "empty"),
        (b"\x00\x01\x02\x03", "neither Parquet nor MCAP, no ROS bag and no CSV"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "neither Parquet"),
        (b"#ROSBAG V1.2\n", "ROS bag of an old version"),
        (
            b"hello",
            "neither Parquet nor MCAP.*: the table has names but no line of data",
        ),
        (b"\x28\xb5\x2f\xfdxxxx", "zstd"),
        (b"version https://git-lfs.github.com/spec/v1", "LFS"),
        (b"PAR1", "footer"),
        (b"PAR1" + b"\0" * 50, "footer"),
    ],
)
def test_other_files_are_refused_by_name(
    tmp_path: Path, content: bytes, fragment: str
) -> None:
    path = tmp_path / "log.parquet"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fragment) as caught:
        check_log(path)
    assert caught.value.hint
    assert caught.value.where == str(path)


COLUMN = pa.array([0.0, 1.0])
PREDICTED = ("position", "torque", "predicted", "residual", "sliding")
TABLES = {
    "a/log.csv": "t,q_0\n0,1\n",
    "a/times.csv": "time_ms q_0\n0 1\n",
    "a/result.csv": "joint,rmse\nelbow,0.1\n",
    "a/points.csv": "x,y,z\n0,1,2\n",
    "a/numbers.tsv": "1\t2\n3\t4\n",
}


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    (tmp_path / "a").mkdir()
    for name, content in TABLES.items():
        (tmp_path / name).write_text(content)
    columns = {"t": COLUMN, **{f"j.{kind}": COLUMN for kind in PREDICTED}}
    pq.write_table(pa.table(columns), tmp_path / "a" / "torques.parquet")
    return tmp_path


@pytest.mark.parametrize("argument", ["", "a", "a/*", "**"])
def test_tables_in_a_folder_that_are_no_logs_are_left_out(
    tables: Path, argument: str
) -> None:
    notes: list[str] = []
    found = expand([str(tables / argument)], notes.append)
    assert names(found, tables) == ["a/log.csv", "a/times.csv"]
    assert len(notes) == 4
    told = dict.fromkeys(("result.csv", "points.csv"), "no column of time")
    told |= {
        "numbers.tsv": "no line of names",
        "torques.parquet": "seqid predict wrote it",
    }
    for name, said in told.items():
        assert any(name in note and said in note for note in notes), notes
    for name in ("a/log.csv", "a/times.csv"):
        (tables / name).unlink()
    with pytest.raises(InputError, match="no log in this folder"):
        expand([str(tables)])


def test_tables_named_by_themselves_or_by_suffix_are_taken(tables: Path) -> None:
    for name in ("points.csv", "torques.parquet"):
        assert expand([str(tables / "a" / name)]) == [tables / "a" / name]
    assert len(expand([str(tables / "a" / "*.csv")])) == 4


def test_bag_folder_stands_for_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    with pytest.raises(InputError, match=r"without \*\.mcap"):
        check_log(bag)
    for k in (10, 9):
        (bag / f"bag_{k}.db3").write_bytes(b"SQLite format 3\0" + bytes(84))
    assert names(expand([str(tmp_path)]), tmp_path) == [
        "bag/bag_9.db3",
        "bag/bag_10.db3",
    ]
    with pytest.raises(InputError, match="bag of 2 files"):
        check_log(bag)
    (bag / "bag_9.db3").unlink()
    assert check_log(bag) == "rosbag2"


def test_description_of_a_data_set_is_no_log(tmp_path: Path) -> None:
    write(
        tmp_path,
        "meta/info.json meta/tasks.parquet meta/episodes/x.parquet data/e.parquet",
    )
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


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_copies_that_killed_runs_left_are_removed(room: Path) -> None:
    left = room / "seqid-log-a"
    left.mkdir()
    (left / "bag.mcap").write_bytes(b"half")
    with temporary_folder("log") as running:
        (running / "bag.mcap").write_bytes(b"half")
        with temporary_folder("log") as folder:
            assert folder.parent == room
            assert (left.exists(), running.exists()) == (False, True)
        assert not folder.exists()
    assert list(room.iterdir()) == []


def test_no_room_for_a_copy_is_told(
    room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    with pytest.raises(InputError, match="cannot be copied: No space") as caught:
        temporary_folder("a").__enter__()
    assert caught.value.where == "a"
    assert str(room) in caught.value.hint


@pytest.mark.parametrize("pattern", ["**", "**/*.mcap", "{}/**/*.mcap", "*/**/*.mcap"])
def test_a_folder_that_links_to_itself_is_met_once(
    pattern: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "logs"
    (folder / "deep").mkdir(parents=True)
    for name in ("one", "two"):
        (folder / name).symlink_to(folder)
    (folder / "deep" / "log.mcap").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    (path,) = expand([pattern.format(tmp_path)])
    assert path.resolve() == folder / "deep" / "log.mcap"


def test_a_linked_folder_is_looked_into(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "log.mcap").write_bytes(b"")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "day").symlink_to(tmp_path / "elsewhere")
    assert expand([f"{tmp_path}/logs/**/*.mcap"]) == [
        tmp_path / "logs" / "day" / "log.mcap"
    ]
