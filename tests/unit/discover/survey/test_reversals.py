"""Rows that feel a reversal count for what they are worth."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.survey.reversals import reversals_of
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import runs
from tests import Array
from tests.plants.robots.two_joint import COULOMB
from tests.unit.discover.arms import arm_scenes, at_joint

JOINT = 0
LATE, TAKES = 0.05, 0.6  # friction at a reversal, of the time for which it may stick
LITTLE = (0.01, 0.01)  # N m, of noise


def sticking(scene: Scene) -> Array:
    """Return what friction (N,) N m lacks of a joint that sticks a while where it turns back."""
    rng = np.random.default_rng(scene.log)
    t, v = scene.motion.t, scene.motion.dq[:, JOINT]
    lacks = np.zeros(len(t))
    for start, stop in runs(~scene.slides[:, JOINT], len(t)):
        for at in start + np.flatnonzero(v[start : stop - 1] * v[start + 1 : stop] < 0):
            since = t[start:stop] - t[at] - (t[1] - t[0]) * v[at] / (v[at] - v[at + 1])
            slow = t[stop - 1] - t[start]
            ramp = np.clip(2.0 * (since / slow - LATE * rng.normal()) / TAKES, -1.0, 1.0)
            change = COULOMB[JOINT] * np.sign(v[at + 1])
            lacks[start:stop] += change * (ramp - np.sign(since))
    return lacks


def torque_of(scenes: list[Scene], rows: Rows) -> tuple[Array, Array]:
    """Return what the model leaves (M,) N m: as it is, and whitened."""
    left = []
    for scene in scenes:
        assert scene.motion.tau is not None
        left.append((scene.motion.tau - scene.modelled_filtered)[:, JOINT])
    return rows.of(JOINT, left), rows.torque(JOINT, left)


def size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_sticking_is_left_to_nobody() -> None:
    clean = arm_scenes(noise=LITTLE)
    rough = arm_scenes(at_joint(JOINT, sticking), noise=LITTLE)
    rows = rows_of(clean)
    noise = np.random.default_rng(0).normal(size=rows.count(JOINT))
    without, sticks = torque_of(clean, rows), torque_of(rough, rows)
    as_it_is, whitened = (size(b - a) for a, b in zip(without, sticks, strict=True))
    assert as_it_is > 0.05
    assert whitened < 0.5 * as_it_is
    assert size(rows.whitened(JOINT, noise)) > 0.9 * size(noise)


def test_what_is_large_beside_a_reversal_is_still_seen() -> None:
    """A torque that rises with speed has its rows away from reversals."""
    scenes = arm_scenes()
    rows = rows_of(scenes)
    drag = [s.motion.filtered(s.motion.dq * np.abs(s.motion.dq))[:, JOINT] for s in scenes]
    assert size(rows.torque(JOINT, drag)) > 0.95 * size(rows.of(JOINT, drag))


@pytest.mark.parametrize("mirrored", [False, True])
def test_rests_at_either_end_of_a_log_are_uncertain(*, mirrored: bool) -> None:
    scenes = arm_scenes(logs=1)
    rows = rows_of(scenes)
    used = rows.used[0][:, JOINT].copy()
    order = used[::-1] if mirrored else used
    edge = int(np.flatnonzero(order)[0])
    found = reversals_of(scenes[0], rows.picked[0], used, JOINT)
    number = int(used.sum()) - 1 if mirrored else 0
    felt = any(t.first <= number < t.first + len(t.directions) for t in found)
    assert felt == (edge > 0)
