"""Which files are meant, and whether they are logs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.open import check_log, expand
from tests.logs.samples import JOINTS, grid, make_motion
from tests.logs.writers import write_mcap, write_parquet


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("run10.parquet", "run2.parquet", "sub/run1.MCAP", ".hidden.mcap", "notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def names(paths: list[Path], folder: Path) -> list[str]:
    return [str(path.relative_to(folder)) for path in paths]


def test_folder_gives_logs_in_natural_order(folder: Path) -> None:
    assert names(expand([str(folder)]), folder) == [
        "run2.parquet",
        "run10.parquet",
        "sub/run1.MCAP",
    ]


def test_duplicates_are_removed_and_order_of_arguments_stays(folder: Path) -> None:
    found = expand(
        [str(folder / "run10.parquet"), str(folder), str(folder / "sub/../run2.parquet")]
    )
    assert names(found, folder) == ["run10.parquet", "run2.parquet", "sub/run1.MCAP"]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("*.parquet", ["run2.parquet", "run10.parquet"]),
        ("**/*.MCAP", ["sub/run1.MCAP"]),
        ("s*", ["sub/run1.MCAP"]),
        ("run?.parquet", ["run2.parquet"]),
    ],
)
def test_globs(folder: Path, pattern: str, expected: list[str]) -> None:
    assert names(expand([str(folder / pattern)]), folder) == expected


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


def test_format_is_told_by_content(tmp_path: Path) -> None:
    motion = make_motion(grid())
    parquet = write_parquet(tmp_path / "a.mcap", motion.t, JOINTS, motion.q)
    mcap = write_mcap(tmp_path / "a.parquet", motion.t, JOINTS, motion.q, encoding="cdr")
    assert check_log(parquet) == "parquet"
    assert check_log(mcap) == "mcap"


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "empty"),
        (b"t,q\n0,1\n", "neither Parquet nor MCAP"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"SQLite format 3\0", "SQLite"),
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


def test_no_heavy_import() -> None:
    code = (
        "import sys, seqid_cli.logs.open\n"
        "heavy = {'numpy', 'scipy', 'pyarrow', 'mcap', 'msgspec'} & set(sys.modules)\n"
        "sys.exit(' '.join(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
