"""Chunks of the filtered regressor have no seams; blocks are a partition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.equations import filtered_regressor, torque_motion
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from tests.plants.robots.made import made_recording
from tests.plants.robots.small import planar_2r

RATE = 100.0


def recording(samples: int) -> Recording:
    t = np.arange(samples) / RATE
    q = np.column_stack([np.sin(1.7 * t), 1.2 * np.sin(2.9 * t + 0.4)])
    return made_recording(q, np.cos(q), rate_hz=RATE)


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
