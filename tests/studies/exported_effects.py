"""Every effect on arms of one, two and six joints: is exported code as good as its
file?

An effect is put at every joint that can have it, in all variants of its law in turn. The
torque of a held-out motion is that of the whole file, by `predict`, with white noise of a
tenth of the effect's torque. So an export whose error is `MAX_RATIO` of the file's says
the effect to 2 %.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seqid_cli.export import written
from seqid_cli.export.formats import export
from seqid_cli.export.motions import FullModel
from seqid_cli.export.replay import replayed
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import FittedEffect
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import EffectSession
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.made import made_recording
from tests.studies.tables import table
from tests.unit.export.arms import sample
from tests.unit.export.motions import (
    CASES,
    fitted,
    is_modelled,
    with_effects,
    without_friction,
)
from tests.unit.logs.writers import write_parquet

ARMS = ("one_joint", "two_joint", "six_joint")
FORMS = {"C header": "arm.h", "numpy module": "arm.py"}
MAX_RATIO = 1.02
NOISE_SHARE = 0.1
LEAST_NOISE = 1e-3  # N m, of joints at which the effect makes no torque
RATE_HZ = 1000.0
CUTOFF_HZ = 10.0
SECONDS = 12.0
REST_S = 0.3  # before the motion, so that states begin at rest
RISE_S = 0.3  # in which the motion sets in
IN_PYTHON = 1500  # samples of the numpy module


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """How an effect on one arm came out in one form.

    `ratio` is the largest of the joints' errors, each by that of the file. It is None
    where an arm cannot have the effect.
    """

    effect: str
    arm: str
    form: str
    ratio: float | None


def study(chosen: Namespace) -> str:
    """Return the table of all effects on all arms; the first arm alone with `--quick`."""
    arms = ARMS[:1] if chosen.quick else ARMS
    rows = []
    for name in CATALOGUE:
        row = [f"`{name}`"]
        for arm in arms:
            found = {one.form: one for one in replays(name, arm)}
            row += [_cell(found[form]) for form in FORMS]
            sys.stderr.write(f"{name} {arm}: {' '.join(row[-2:])}\n")
        rows.append(row)
    header = ["effect"]
    for arm in arms:
        header += [f"{arm.replace('_', ' ')}, C", "numpy"]
    return table(header, rows)


def _cell(one: Replayed) -> str:
    return "-" if one.ratio is None else f"{one.ratio:.4f}"


def effects_of(name: str, robot: Robot) -> list[FittedEffect]:
    """Return an effect at every joint of an arm that can have it, its variants in turn."""
    effect, cases = CATALOGUE[name], CASES[name]
    if effect.arm:
        return [fitted(effect, cases[0])]
    of_joints = [one for one in cases if one.joint is not None]
    items = []
    for joint in range(robot.n):
        one = of_joints[joint % len(of_joints)]
        settings = dict(one.settings)
        if "neighbour" in settings:
            if robot.n == 1:
                continue
            settings["neighbour"] = 1.0 if joint == 0 else -1.0
        items.append(fitted(effect, replace(one, joint=joint, settings=settings)))
    return items


def replays(name: str, arm: str, forms: Sequence[str] = tuple(FORMS)) -> list[Replayed]:
    """Write an arm with an effect in some forms, and run these over a held-out motion."""
    robot, plain = sample(arm)
    plain.inertia.cutoff_hz = CUTOFF_HZ
    items = effects_of(name, robot)
    if not items:
        return [Replayed(effect=name, arm=arm, form=form, ratio=None) for form in forms]
    if all(is_modelled(item) for item in items):
        # Delays are seen through one low-pass, friction through two: a replay cannot
        # tell the delay of friction from that of the rest.
        plain = without_friction(plain)
    session = EffectSession(logs=[], starts=[], origin=0.0)
    items = [replace(item, session=session) for item in items]
    stages = with_effects(plain, robot, items)
    full = FullModel.of(robot, stages)
    found = []
    with TemporaryDirectory() as place, _shorter_in_python():
        folder = Path(place)
        log = _written_log(folder / "held_out.parquet", full)
        for form in forms:
            path = folder / FORMS[form]
            text = export(robot, stages, kind=form).text
            path.write_text(text, encoding="utf-8")
            joints = replayed(path, form, full, [log], {})
            ratios = [
                (joint.export_rmse or np.inf) / joint.file_rmse
                for joint in joints.values()
                if joint.file_rmse
            ]
            found.append(
                Replayed(effect=name, arm=arm, form=form, ratio=float(max(ratios)))
            )
    return found


@contextmanager
def _shorter_in_python() -> Iterator[None]:
    """Run numpy modules over the first second of a log: Python takes its time."""
    before = written.MOST_IN_PYTHON
    written.MOST_IN_PYTHON = IN_PYTHON
    try:
        yield
    finally:
        written.MOST_IN_PYTHON = before


def _written_log(path: Path, full: FullModel) -> Path:
    """Write a held-out log of an arm that warms up, with the file's torque and noise."""
    n_joints = full.robot.n
    q = _motion(n_joints)
    t = np.arange(len(q)) / RATE_HZ
    warmth = 25.0 + 10.0 * (1.0 - np.exp(-t / 4.0))
    celsius = np.outer(warmth, np.ones(n_joints)) + np.arange(n_joints)
    log = made_recording(q, np.zeros_like(q), rate_hz=RATE_HZ, temperature=celsius)
    torque = _predicted(full, log)
    effect = torque - _predicted(replace(full, effects=()), log)
    size = np.sqrt(np.mean(effect**2, axis=0))
    # White noise loses most of its power in the low-pass; what passes is to be a tenth.
    passing = np.sqrt(2.0 * CUTOFF_HZ / RATE_HZ)
    noise = np.maximum(NOISE_SHARE * size, LEAST_NOISE) / passing
    torque = torque + noise * np.random.default_rng(7).normal(size=torque.shape)
    return write_parquet(
        path, t, full.robot.joint_names, q, torque=torque, temperature=celsius
    )


def _predicted(full: FullModel, log: Recording) -> Array:
    torque, _ = full.predicted(log, full.motion(log))
    return torque


def _motion(n_joints: int) -> Array:
    """Return positions (N, n) rad of a motion from rest, joints at incommensurate
    rates.
    """
    t = np.arange(round(SECONDS * RATE_HZ))[:, None, None] / RATE_HZ
    rng = np.random.default_rng(23)
    hz = rng.uniform(0.2, 0.8, (8, n_joints))
    phase = rng.uniform(0.0, 2.0 * np.pi, (8, n_joints))
    # Time itself sets in slowly.
    moving = np.maximum(t - REST_S, 0.0)
    paced = RISE_S * (np.hypot(moving / RISE_S, 1.0) - 1.0)
    return np.asarray(0.17 * np.sum(np.sin(2.0 * np.pi * hz * paced + phase), axis=1))
