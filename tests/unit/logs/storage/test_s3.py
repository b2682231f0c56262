"""Logs on an S3 server on the loopback: over HTTP, by several processes, refused and
gone.

`pip install -e '.[store-tests]'` installs the server; without it nothing is run here.
"""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from seqid_cli.commands.app import run
from seqid_cli.errors import InputError
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.storage.files import expand, time_of_log
from seqid_cli.logs.storage.remote import StoredLog, local_copy
from tests import ROOT

moto_server = pytest.importorskip("moto.server")
s3fs = pytest.importorskip("s3fs")

RIG = ROOT / "sample_logs" / "two_joint"
GIVEN = ("-r", str(RIG / "robot.toml"), "-p", str(RIG / "golden.json"))
GIVEN += ("--motion", "encoder")
LAB = "s3://lab/logs"
Captured, Patch = pytest.CaptureFixture[str], pytest.MonkeyPatch


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def access(address: str, tmp_path: Path, monkeypatch: Patch) -> Iterator[None]:
    """Set the server up as the store's own tools are: by the environment."""
    for name, value in {
        "AWS_ENDPOINT_URL": address,
        "AWS_ACCESS_KEY_ID": "somebody",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_MAX_ATTEMPTS": "1",
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_CONFIG_FILE": str(tmp_path / "none"),
        "AWS_SHARED_CREDENTIALS_FILE": str(tmp_path / "none"),
    }.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    s3fs.S3FileSystem.clear_instance_cache()
    yield
    s3fs.S3FileSystem.clear_instance_cache()
    assert not list((tmp_path / "temporary").glob("seqid-*"))


@pytest.fixture
def store(access: None) -> str:
    del access
    system = s3fs.S3FileSystem()
    if not system.exists("lab"):
        system.mkdir("lab")
    for log in sorted((RIG / "inertia").glob("*.parquet")):
        system.pipe_file(f"lab/logs/date=2026-01-01/{log.name}", log.read_bytes())
    system.pipe_file("lab/logs/read me.txt", b"no log")
    return LAB


def inertia_of(capsys: Captured, logs: str, *more: str) -> tuple[dict, list[str]]:
    """Return the parameters that logs give, and the logs as they are named."""
    assert run(["inertia", logs, *GIVEN, *more, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    stage = document["stages"]["inertia"]
    return stage["parameters"], [log["path"] for log in document["inputs"][-2:]]


@pytest.mark.parametrize("end", ["", "/", "/**", "/date=*/*.parquet"])
def test_folders_and_globs_find_the_logs(store: str, end: str) -> None:
    found = [str(path) for path in expand([store + end], stored=True)]
    assert found == [
        f"{store}/date=2026-01-01/joint_1__joint_2_{k}.parquet" for k in (1, 2)
    ]
    one = f"{store}/read me.txt"
    assert [str(path) for path in expand([one], stored=True)] == [one]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_the_result_is_that_of_local_logs(
    jobs: str, store: str, capsys: Captured
) -> None:
    local, _ = inertia_of(capsys, str(RIG / "inertia"))
    stored, names = inertia_of(capsys, store, "--jobs", jobs)
    assert stored == local
    assert all(name.startswith(f"{LAB}/date=") for name in names)


def test_a_long_log_is_passed_over(
    store: str, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.setattr(long_logs, "LONG", 1)
    assert run(["predict", store, *GIVEN, "--jobs", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [log["path"] for log in document["inputs"]] == [
        str(path) for path in expand([store], stored=True)
    ]


def test_an_object_has_the_date_of_the_store(store: str) -> None:
    (log, _) = expand([store], stored=True)
    modified_s = time_of_log(log, None)
    assert modified_s is not None
    assert modified_s > 1.7e9


def test_damage_has_the_name_of_the_object(store: str, capsys: Captured) -> None:
    s3fs.S3FileSystem().pipe_file("lab/damaged/bad.parquet", b"PAR1" + bytes(50))
    assert run(["inertia", "s3://lab/damaged", *GIVEN]) == 2
    said = capsys.readouterr().err
    assert "error: s3://lab/damaged/bad.parquet: the Parquet file is cut short" in said


@pytest.mark.usefixtures("store")
def test_what_is_not_there() -> None:
    for url in ("s3://lab/none", "s3://lab/logs/*.mcap"):
        with pytest.raises(InputError, match="no log at this place") as caught:
            expand([url], stored=True)
        assert caught.value.where == url
    with pytest.raises(InputError, match="does not exist"):
        expand(["s3://no-such-bucket/logs"], stored=True)
    with pytest.raises(InputError, match="does not exist"):
        local_copy(StoredLog(f"{LAB}/none.parquet")).__enter__()


@pytest.mark.usefixtures("store")
def test_without_credentials_the_store_refuses(
    monkeypatch: Patch, capsys: Captured
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    s3fs.S3FileSystem.clear_instance_cache()
    assert run(["inertia", LAB, *GIVEN]) == 2
    said = capsys.readouterr().err
    assert f"error: {LAB}: the store refuses access" in said
    assert "AWS_PROFILE" in said


@pytest.mark.usefixtures("store")
def test_a_server_that_is_gone_is_told(monkeypatch: Patch, capsys: Captured) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    s3fs.S3FileSystem.clear_instance_cache()
    assert run(["inertia", LAB, *GIVEN]) == 2
    said = capsys.readouterr().err
    assert f"error: {LAB}: cannot be read (" in said
    assert "Check the network" in said
