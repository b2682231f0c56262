"""Values that a logger lost, and those that were never there."""

import numpy as np

from seqid_cli.inspect.channels.values import missing
from tests import Array

LIMIT = 0.01


def found(values: Array, stamps: Array) -> list[str]:
    return [f.code for f in missing(values, stamps, "imu", "imu.ax", LIMIT)]


def merged() -> tuple[Array, Array]:
    """Rows of a clock of 125 Hz and of one of 250 Hz that gains, in one table."""
    slow = 0.008 * np.arange(1000)
    fast = np.round(0.004 * 1.003 * np.arange(2000) + 0.0003, 3)
    stamps = np.union1d(np.round(slow, 3), fast)
    values = np.where(np.isin(stamps, fast), 1.0, np.nan)
    return values, stamps


def test_rows_of_two_clocks_in_one_table_are_no_lost_packets() -> None:
    values, stamps = merged()
    assert np.isnan(values).mean() > 0.2
    assert found(values, stamps) == []


def test_values_lost_beside_another_clock_are_found() -> None:
    values, stamps = merged()
    present = np.flatnonzero(np.isfinite(values))
    values[np.random.default_rng(0).choice(present, 100, replace=False)] = np.nan
    assert found(values, stamps) == ["values_missing"]


def test_a_slower_channel_lacks_nothing() -> None:
    values = np.full(1000, np.nan)
    values[::4] = 1.0
    assert found(values, 0.004 * np.arange(1000)) == []
