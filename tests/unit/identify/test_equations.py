"""Chunks of the filtered regressor have no seams; blocks are a partition."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.equations import blocks, filtered_regressor, torque_motion
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from tests.plants.robots.small import planar_2r

Array = NDArray[np.float64]

RATE = 100.0


def recording(samples: int) -> Recording:
    t = np.arange(samples) / RATE
    q = np.column_stack([np.sin(1.7 * t), 1.2 * np.sin(2.9 * t + 0.4)])
    return Recording(
        path=Path("log.parquet"),
        sha256="",
        format="parquet",
        t=t,
        q=q,
        valid=np.ones(samples, dtype=bool),
        health=Health(rate_hz=RATE, jitter=0.0),
        tau=np.cos(q),
    )


def motion_of(log: Recording) -> Motion:
    return torque_motion(log, planar_2r(), MotionOptions(cutoff_hz=4.0))


def test_chunks_join_without_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(equations, "CHUNK", 300)
    robot = planar_2r()
    basis = base_parameters(robot, rotor=(0, 1))
    log = recording(3100)
    valid = log.valid.copy()
    valid[1510:1530] = False
    motion = motion_of(replace(log, valid=valid))
    found = filtered_regressor(motion, robot, basis)
    parts = [replace(part, H=part.H.copy()) for part in found]
    assert len(parts) > 3
    whole = motion.filtered(base_regressor(robot, basis, motion.q, motion.dq, motion.ddq))
    joined = np.concatenate([part.H for part in parts])
    own = motion.usable
    np.testing.assert_allclose(joined[own], whole[own], atol=1e-6 * np.abs(whole).max())
    np.testing.assert_array_equal(np.concatenate([p.motion.q for p in parts]), motion.q)
    np.testing.assert_array_equal(np.concatenate([p.motion.usable for p in parts]), own)
    places = [i for part in parts for i in range(part.where.start, part.where.stop)]
    assert places == list(range(motion.samples))


def test_a_log_without_torque_is_refused() -> None:
    with pytest.raises(InputError, match="neither joint torque nor motor current") as caught:
        motion_of(replace(recording(500), tau=None))
    assert caught.value.where == "log.parquet"
    assert caught.value.hint


@given(st.integers(1, 20000), st.floats(1.0, 2000.0))
def test_blocks_are_a_partition_into_about_a_second(samples: int, rate_hz: float) -> None:
    found = list(blocks(samples, rate_hz))
    assert found[0].start == 0
    assert found[-1].stop == samples
    assert all(a.stop == b.start for a, b in pairwise(found))
    lengths = [block.stop - block.start for block in found]
    assert max(lengths) - min(lengths) <= 1
    wanted = max(8, round(rate_hz))
    assert max(lengths) <= 1.5 * wanted + 1
    assert len(found) == 1 or min(lengths) >= wanted / 1.5 - 1
