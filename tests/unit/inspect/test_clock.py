"""Findings of the clock: what is a gap."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from tests.unit.inspect.faults import write_columns


@pytest.mark.parametrize("lost", [0, 80])
def test_the_hole_between_episodes_is_no_gap(tmp_path: Path, lost: int) -> None:
    t, episode = np.tile(np.arange(0.0, 10.0, 0.01), 3), np.repeat([0.0, 1.0, 2.0], 1000)
    kept = np.delete(np.arange(3000), slice(1500, 1500 + lost))
    table = {
        "t": t,
        "episode_index": episode,
        "a.position": np.round(np.sin(t) / 1e-4) * 1e-4,
        "a.torque": np.cos(1.3 * t) + 0.5 * np.sign(np.cos(t)),
    }
    write_columns(tmp_path / "log.parquet", {name: x[kept] for name, x in table.items()})
    found = [f for f in inspect_log(tmp_path / "log.parquet").findings if f.code == "clock_gap"]
    assert [f.message.split(",")[0] for f in found] == ["1 gaps"] * bool(lost)
