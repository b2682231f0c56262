"""Dask does the same work to the last bit, on a cluster inside this very process."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow.parquet as pq
import pytest

pytest.importorskip("distributed", reason="Dask is not installed (seqid[dask])")

from seqid_cli.commands.app import run
from seqid_cli.errors import UsageError
from seqid_cli.identify import RigidOptions, inertia
from seqid_cli.scale import dask_cluster
from tests import ROOT

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning:distributed"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

RIG = ROOT / "sample_logs" / "two_joint"
GOLDEN = (
    "-r",
    str(RIG / "robot.toml"),
    "-p",
    str(RIG / "golden.json"),
    "--motion",
    "encoder",
)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def logs(tmp_path: Path) -> list[str]:
    source = sorted((RIG / "inertia").glob("*.parquet"))
    names = [tmp_path / f"{k}.parquet" for k in range(5)]
    for k, name in enumerate(names):  # no two alike: a copy would be left out
        pq.write_table(pq.read_table(source[k % 2]).slice(10 * k), name)
    names[2].write_bytes(b"PAR1" + b"\0" * 100 + b"PAR1")
    return [str(name) for name in names]


@pytest.mark.slow
def test_the_cluster_changes_no_bit_and_no_order(
    scheduler: str, logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, torques, found = tmp_path / "out.json", tmp_path / "torques.parquet", []
    for engine in ((), ("--engine", "dask", "--scheduler", scheduler)):
        files = ["-o", str(output), "--torques", str(torques), "--skip-failed"]
        assert run(["predict", *logs, *GOLDEN, *files, *engine]) == 3
        assert f"warning: left out: {logs[2]}: " in capsys.readouterr().err
        document = json.loads(output.read_text())
        found.append((document, torques.read_bytes()))
    assert found[0] == found[1]
    assert [log["path"] for log in found[0][0]["logs"]] == [*logs[:2], *logs[3:]]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x"])
def test_a_missing_scheduler_is_named(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("seqid_cli.scale.PATIENCE_S", 0.2)
    with (
        pytest.raises(UsageError, match="no Dask scheduler answers"),
        dask_cluster(address),
    ):
        raise AssertionError


@pytest.mark.slow
def test_any_executor_will_do(scheduler: str, logs: list[str]) -> None:
    """A thread pool and a client's own executor give what this process gives, bit by
    bit.
    """
    from distributed import Client

    given = [*logs[:2], *logs[3:]], RIG / "robot.toml", RIG / "golden.json"
    options = RigidOptions(source="encoder")
    expected = inertia(*given, options).stages
    with ThreadPoolExecutor(2) as threads:
        assert inertia(*given, options, executor=threads).stages == expected
    with Client(scheduler, set_as_default=False) as client:
        assert (
            inertia(*given, options, executor=client.get_executor()).stages == expected
        )
