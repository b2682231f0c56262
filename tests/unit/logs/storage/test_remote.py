"""Logs on object storage: found, read through a copy, named by their URL; refusals in words."""

import json
import pickle
import re
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from seqid_cli import identify
from seqid_cli.commands.app import run
from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.identify.regression.equations import open_if_long
from seqid_cli.identify.rigid import inertia
from seqid_cli.logs.storage.files import expand
from seqid_cli.logs.storage.remote import StoredLog, is_url, local_copy
from tests import ROOT

fsspec = pytest.importorskip("fsspec")

RIG = ROOT / "sample_logs" / "two_joint"
GIVEN = ("-r", str(RIG / "robot.toml"), "-p", str(RIG / "golden.json"), "--motion", "encoder")
ONE = ("--jobs", "1")  # a store in memory is of one process


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Fill a store in memory with the sample's logs; temporary files go to a folder of our own."""
    memory = fsspec.filesystem("memory")
    for k, log in enumerate(sorted((RIG / "inertia").glob("*.parquet"))):
        folder = f"/lab/robot=r{k}/date=2026-01-01"
        memory.pipe_file(f"{folder}/{log.name}", log.read_bytes())
    memory.pipe_file("/lab/readme.txt", b"no log")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    yield "memory://lab"
    memory.store.clear()
    assert not list((tmp_path / "temporary").iterdir())


def test_a_url_stays_one_and_is_no_windows_drive() -> None:
    assert is_url("s3://bucket/a.parquet")
    assert not any(map(is_url, ("logs/a.parquet", "C://a.parquet", "file:///a.parquet", "s3:/a")))
    log = StoredLog("s3://bucket/robot=a/x y.parquet")
    assert str(log) == "s3://bucket/robot=a/x y.parquet"
    assert (log.name, log.suffix) == ("x y.parquet", ".parquet")
    again = pickle.loads(pickle.dumps(log))
    assert (str(again), type(again)) == (str(log), StoredLog)


@pytest.mark.parametrize("end", ["", "/", "/**", "/robot=*/*/*.parquet"])
def test_folders_and_globs_find_the_logs(store: str, end: str) -> None:
    found = [str(path) for path in expand([store + end], stored=True)]
    assert [path.split("/")[3] for path in found] == ["robot=r0", "robot=r1"]
    assert all(path.startswith("memory://lab/") for path in found)
    one = f"{store}/readme.txt"  # whatever its suffix
    assert [str(path) for path in expand([one], stored=True)] == [one]


def test_the_result_is_that_of_local_logs_under_other_names(
    store: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = []
    for logs in (str(RIG / "inertia"), store):
        assert run(["inertia", logs, *GIVEN, "--json", *ONE]) == 0
        found.append(json.loads(capsys.readouterr().out)["stages"]["inertia"])
    named = [use["log"] for use in found[1]["motion_use"]]
    assert [name.split("/")[2] for name in named] == ["lab", "lab"]
    assert all(name.startswith("memory://lab/robot=") for name in named)
    for stage in found:
        del stage["motion"], stage["motion_use"]
        for key in ("notes", "verdicts"):  # they name the logs
            stage[key] = re.sub(r"[^\s\"']+\.parquet", "", json.dumps(stage[key]))
    assert found[0] == found[1]
    options = identify.RigidOptions(source="encoder")
    file = identify.inertia(store, GIVEN[1], GIVEN[3], options, output=tmp_path / "o")
    assert file.inputs[-1].path == named[1]


def test_damage_has_the_name_of_the_object(store: str, capsys: pytest.CaptureFixture[str]) -> None:
    fsspec.filesystem("memory").pipe_file("/lab/robot=r1/bad.parquet", b"PAR1" + b"\0" * 50)
    assert run(["inertia", store, *GIVEN, *ONE]) == 2
    told = capsys.readouterr().err
    assert "error: memory://lab/robot=r1/bad.parquet: the Parquet file is cut short" in told
    assert run(["inertia", store, *GIVEN, "--skip-failed", *ONE]) == 3
    assert "left out: memory://lab/robot=r1/bad.parquet: " in capsys.readouterr().err


def test_a_long_log_keeps_its_copy_until_it_is_done(
    store: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(inertia, "open_if_long", partial(open_if_long, least=1))
    assert run(["inertia", store, *GIVEN, "--json", *ONE]) == 0
    stage = json.loads(capsys.readouterr().out)["stages"]["inertia"]
    assert [use["log"].split("/")[3] for use in stage["motion_use"]] == ["robot=r0", "robot=r1"]


def test_what_is_not_there_and_commands_that_read_local_files_only(
    store: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for url in (f"{store}/none", f"{store}/*.mcap"):
        with pytest.raises(InputError, match="no log at this place") as caught:
            expand([url], stored=True)
        assert caught.value.where == url
    with pytest.raises(InputError, match="does not exist"):
        local_copy(StoredLog(f"{store}/none.parquet")).__enter__()
    assert run(["inspect", store, *GIVEN[:2]]) == 2
    assert "on object storage, which this command does not read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("missing", "url", "message", "hint"),
    [
        ("gcsfs", "gs://bucket/logs", "not installed", "'seqid[gs]'"),
        ("fsspec.core", "s3://bucket/logs", "not installed", "'seqid[s3]'"),
        ("", "nonsense://bucket/logs", "no kind of storage that is known", ""),
    ],
)
def test_packages_that_are_missing_are_named_with_the_extra(
    monkeypatch: pytest.MonkeyPatch, missing: str, url: str, message: str, hint: str
) -> None:
    if missing:
        monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(UsageError, match=message) as caught:
        expand([url], stored=True)
    assert hint in caught.value.hint


class NoCredentialsError(Exception):
    """As the library of S3 has it, which is not needed here."""


def test_a_store_that_refuses_is_told_once_whatever_was_asked_for(
    store: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*arguments: object, **named: object) -> None:
        raise NoCredentialsError("Unable to locate credentials")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "get_file", refuse)
    assert run(["inertia", store, *GIVEN, "--skip-failed", *ONE]) == 2
    told = capsys.readouterr().err
    assert told.count("refuses access") == 1
    assert ".parquet: the store refuses access (NoCredentialsError: Unable to locate" in told
    with pytest.raises(ConfigError):
        local_copy(StoredLog(f"{store}/1.parquet")).__enter__()
