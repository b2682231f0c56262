"""Logs on object storage: found, read through a copy, named by their URL; refusals in
words.
"""

import json
import pickle
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from seqid_cli import identify
from seqid_cli.commands.app import run
from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.storage.files import expand
from seqid_cli.logs.storage.remote import StoredLog, is_url, local_copy
from seqid_cli.logs.storage.spool import Spool
from tests import ROOT

fsspec = pytest.importorskip("fsspec")

RIG = ROOT / "sample_logs" / "two_joint"
GIVEN = (
    "-r",
    str(RIG / "robot.toml"),
    "-p",
    str(RIG / "golden.json"),
    "--motion",
    "encoder",
)
GIVEN += ("--jobs", "1")  # a store in memory is of one process
Captured, Patch = pytest.CaptureFixture[str], pytest.MonkeyPatch


@pytest.fixture
def store(tmp_path: Path, monkeypatch: Patch) -> Iterator[str]:
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
    assert not any(
        map(is_url, ("logs/a.parquet", "C://a.parquet", "file:///a.parquet", "s3:/a"))
    )
    url = "s3://bucket/robot=a/x y.parquet"
    for log in (StoredLog(url), pickle.loads(pickle.dumps(StoredLog(url)))):
        assert (str(log), type(log)) == (url, StoredLog)
        assert (log.name, log.suffix) == ("x y.parquet", ".parquet")


@pytest.mark.parametrize("end", ["", "/", "/**", "/robot=*/*/*.parquet"])
def test_folders_and_globs_find_the_logs(store: str, end: str) -> None:
    found = [str(path) for path in expand([store + end], stored=True)]
    assert [path.partition("/date")[0] for path in found] == [
        f"{store}/robot=r{k}" for k in (0, 1)
    ]
    one = f"{store}/readme.txt"  # whatever its suffix
    assert [str(path) for path in expand([one], stored=True)] == [one]


@pytest.mark.slow
def test_the_result_is_that_of_local_logs(
    store: str, tmp_path: Path, capsys: Captured
) -> None:
    found = []
    for logs in (str(RIG / "inertia"), store):
        assert run(["inertia", logs, *GIVEN, "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["stages"]["inertia"])
    named = [use["log"] for use in found[1]["motion_use"]]
    assert [name.partition("=")[0] for name in named] == ["memory://lab/robot"] * 2
    for stage in found:  # notes and verdicts name the logs
        del stage["motion"], stage["motion_use"]
    local, stored = (
        re.sub(r"[^\s\"']+\.parquet", "", json.dumps(stage)) for stage in found
    )
    assert local == stored
    options = identify.RigidOptions(source="encoder")
    file = identify.inertia(store, GIVEN[1], GIVEN[3], options, output=tmp_path / "o")
    assert file.inputs[-1].path == named[1]


def test_damage_has_the_name_of_the_object(store: str, capsys: Captured) -> None:
    fsspec.filesystem("memory").pipe_file(
        "/lab/robot=r1/bad.parquet", b"PAR1" + b"\0" * 50
    )
    assert run(["inertia", store, *GIVEN]) == 2
    told = capsys.readouterr().err
    assert (
        "error: memory://lab/robot=r1/bad.parquet: the Parquet file is cut short"
        in told
    )
    assert run(["inertia", store, *GIVEN, "--skip-failed"]) == 3
    assert "left out: memory://lab/robot=r1/bad.parquet: " in capsys.readouterr().err


def test_a_long_log_keeps_its_copy(
    store: str, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.setattr(long_logs, "LONG", 1)
    assert run(["inertia", store, *GIVEN, "--json"]) == 0
    stage = json.loads(capsys.readouterr().out)["stages"]["inertia"]
    assert [use["log"].split("/")[3] for use in stage["motion_use"]] == [
        "robot=r0",
        "robot=r1",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("spooled", [True, False])
def test_a_long_log_is_predicted_when_its_copy_is_gone(
    spooled: bool, store: str, monkeypatch: Patch, capsys: Captured
) -> None:
    assert run(["predict", store, *GIVEN, "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    monkeypatch.setattr(long_logs, "LONG", 1)
    if not spooled:
        monkeypatch.setattr(Spool, "complete", False)
    assert run(["predict", store, *GIVEN, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["inputs"] == held["inputs"]
    for name, joint in held["joints"].items():
        assert found["joints"][name]["rmse"] == pytest.approx(joint["rmse"], rel=1e-6)


def test_what_is_not_there_and_what_reads_local_files_only(
    store: str, capsys: Captured
) -> None:
    for url in (f"{store}/none", f"{store}/*.mcap"):
        with pytest.raises(InputError, match="no log at this place") as caught:
            expand([url], stored=True)
        assert caught.value.where == url
    with pytest.raises(InputError, match="does not exist"):
        local_copy(StoredLog(f"{store}/none.parquet")).__enter__()
    assert run(["inspect", store, *GIVEN[:2]]) == 2
    assert (
        "on object storage, which this command does not read" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("missing", "url", "message", "hint"),
    [
        ("gcsfs", "gs://bucket/logs", "not installed", "'seqid[gs]'"),
        ("fsspec.core", "s3://bucket/logs", "not installed", "'seqid[s3]'"),
        ("", "nonsense://bucket/logs", "no kind of storage that is known", ""),
    ],
)
def test_packages_that_are_missing_are_named_with_the_extra(
    monkeypatch: Patch, missing: str, url: str, message: str, hint: str
) -> None:
    if missing:
        monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(UsageError, match=message) as caught:
        expand([url], stored=True)
    assert hint in caught.value.hint


class NoCredentialsError(Exception):
    """As the library of S3 has it, which is not needed here."""


def test_a_refusing_store_is_told_once(
    store: str, monkeypatch: Patch, capsys: Captured
) -> None:
    def refuse(*arguments: object, **named: object) -> None:
        raise NoCredentialsError("Unable to locate credentials")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "get_file", refuse)
    assert run(["inertia", store, *GIVEN, "--skip-failed"]) == 2
    told = capsys.readouterr().err
    assert told.count("refuses access") == 1
    assert (
        ".parquet: the store refuses access (NoCredentialsError: Unable to locate"
        in told
    )
    with pytest.raises(ConfigError):
        local_copy(StoredLog(f"{store}/1.parquet")).__enter__()
