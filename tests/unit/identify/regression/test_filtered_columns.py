"""The regressor filtered part by part against that of the whole motion, filtered at once."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.identify.regression.equations import filtered_regressor
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base_parameters import base_regressor, free_basis
from seqid_cli.robot.file import load_robot
from tests.plants.robots.made import made_motion
from tests.plants.robots.seven_joint import RATE_HZ, motion, write_arm

LOWPASS = Lowpass(25.0, RATE_HZ)
PART = 1024
SAMPLES = 9_500


def moved(samples: int, gap: slice) -> Motion:
    """Some motion with a gap, its edges as sharp as they come."""
    q, dq, ddq = motion(np.arange(samples) / RATE_HZ)
    valid = np.ones(samples, dtype=bool)
    valid[gap] = False
    return made_motion(q, dq, ddq, LOWPASS, valid=valid)


@pytest.mark.parametrize("gap", [slice(0, 0), slice(5_000, 5_030), slice(4_096, 4_097)])
def test_parts_are_as_of_the_whole(tmp_path: Path, gap: slice) -> None:
    robot = load_robot(write_arm(tmp_path))
    basis, whole = free_basis(robot), moved(SAMPLES, gap)
    H = base_regressor(robot, basis, whole.q, whole.dq, whole.ddq)
    expected = LOWPASS(H, whole.valid)
    # The column beside shows which samples it was asked for.
    parts = filtered_regressor(whole, robot, basis, chunk=PART, beside=lambda motion: motion.q**2)
    for own, found in parts:
        start, stop = own.start, own.stop
        assert found.shape == (stop - start, 7, basis.size + 1)
        inside = whole.valid[start:stop]
        off = np.abs(found[:, :, :-1] - expected[start:stop])[inside]
        assert off.max() < 1e-12 * np.abs(H).max()
        np.testing.assert_array_equal(found[:, :, -1], whole.q[start:stop] ** 2)
