"""Every effect on arms of one, two and six joints: is exported code as good as its
file?

An effect is put at every joint that can have it, in all variants of its law in turn. It
is as large as `EFFECT_SHARE` of the joint's other torque. The torque of a held-out
motion is that of the whole file, up to ten times its cut-off, with white noise of
`NOISE_SHARE` of the effect. So an export whose error is `MAX_RATIO` of the file's says
the effect to 2 %; one that lacks it is replayed as well.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
from msgspec.structs import replace as replace_struct

from seqid_cli.effects import own
from seqid_cli.effects.effect import Coefficient, Effect, Settings
from seqid_cli.effects.fitted import FittedEffect
from seqid_cli.effects.law import Law
from seqid_cli.effects.memory import Bristles, Rate
from seqid_cli.effects.registry import CATALOGUE, catalogue_of
from seqid_cli.export.formats import export
from seqid_cli.export.motions import FullModel
from seqid_cli.export.replay import replayed
from seqid_cli.export.written import code
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import EffectSession, Stages
from seqid_cli.robot.formula import parse_formula
from seqid_cli.robot.types import OwnEffect, Robot
from tests import Array
from tests.plants.robots.made import made_recording
from tests.studies.tables import table
from tests.unit.export.arms import sample
from tests.unit.export.motions import CASES, Case, case, fitted, with_effects
from tests.unit.logs.writers import write_parquet

ARMS = ("one_joint", "two_joint", "six_joint")
FORMS = {"C header": "arm.h", "numpy module": "arm.py"}
MAX_RATIO = 1.02
EFFECT_SHARE = 0.2
NOISE_SHARE = 0.1
RATE_HZ = 1000.0
CUTOFF_HZ = 10.0  # of the file
TORQUE_HZ = 100.0  # up to which the log's torque is the file's
SECONDS = 12.0
# At either end, so that states begin at rest. Predictions know no derivative at the
# very end of a log that is cut off in motion.
REST_S = 0.3
RISE_S = 0.5  # in which the motion sets in, and in which it fades
IN_PYTHON = 1500  # samples of the numpy module

FORMULA = "a formula of the robot file"
PACKAGE = "a class of a package"
SUBJECTS = (*CATALOGUE, FORMULA, PACKAGE)


class CableDrag(Effect):
    """Drag of a cable that stretches and lags, as a package would declare it."""

    name = "cable_drag"
    family = "friction"
    linear = (Coefficient("drag", "1"), Coefficient("lag", "s"))

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return bristles under the gear's load, and the rate of the torque."""
        law = Law(
            terms=("stretch * abs(load)", "tau_rate"),
            memories={"stretch": Bristles(0.02), "tau_rate": Rate("tau")},
        )
        return {joint: law}


OWN_FORMULA = "c1*sign(dq)*abs(load) + c2*cos(v*q)*ddq - c3*dq*abs(friction)"
OWN: Mapping[str, Case] = {
    FORMULA: case(0, 0.1, 0.2, 0.3, v=3.0),
    PACKAGE: case(0, 0.1, 0.002),
}


@dataclass(frozen=True, kw_only=True)
class Planted:
    """An arm with an effect at every joint that can have it."""

    robot: Robot
    plain: Stages  # without the effect
    items: Sequence[FittedEffect]  # empty where the arm cannot have it

    @property
    def stages(self) -> Stages:
        """The file of the arm with the effect."""
        return with_effects(self.plain, self.robot, self.items)

    def scaled(self) -> "Planted":
        """Return the same with the effect as large as it is to be at every joint.

        Torque is linear in the coefficients.
        """
        full = FullModel.of(self.robot, self.stages)
        torque, effect = _torque_and_effect(full, warming_log(self.robot))
        other = np.sqrt(np.mean((torque - effect) ** 2, axis=0))
        size = np.sqrt(np.mean(effect**2, axis=0))
        if not size.any():
            return self
        factor = EFFECT_SHARE * other / np.maximum(size, 1e-12)
        # Of the whole arm: where it is largest beside the joint's other torque.
        of_arm = float(np.min(factor))
        items = [
            replace(
                item,
                coefficients=item.coefficients
                * (of_arm if item.joint is None else factor[item.joint]),
            )
            for item in self.items
        ]
        return replace(self, items=items)


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """How an effect on one arm came out in one form.

    `ratio` is the largest of the joints' errors, each by that of the file, `left_out`
    the same of a form that lacks the effect. They are None where an arm cannot have it.
    """

    subject: str
    arm: str
    form: str
    ratio: float | None
    left_out: float | None


def study(chosen: Namespace) -> str:
    """Return the table of all effects on all arms;
    the first arm alone with `--quick`.
    """
    arms = ARMS[:1] if chosen.quick else ARMS
    rows = []
    for subject in SUBJECTS:
        row = [f"`{subject}`" if subject in CATALOGUE else subject]
        for arm in arms:
            found = replays(subject, arm)
            row += [_ratio_cell(one.ratio) for one in found]
            left_out = found[0].left_out
            row.append("-" if left_out is None else f"{left_out:.1f}")
            sys.stderr.write(f"{subject} {arm}: {' '.join(row[-3:])}\n")
        rows.append(row)
    header = ["effect"]
    for arm in arms:
        header += [f"{arm.replace('_', ' ')}, C", "numpy", "left out"]
    return table(header, rows)


def _ratio_cell(ratio: float | None) -> str:
    if ratio is None:
        return "-"
    return f"{ratio:.4f}" if ratio <= MAX_RATIO else f"**{ratio:.4f}**"


def planted(subject: str, arm: str) -> Planted:
    """Return an arm with an effect at every joint that can have it, its variants in
    turn.
    """
    robot, plain = sample(arm)
    plain.inertia.cutoff_hz = CUTOFF_HZ
    if subject in CATALOGUE:
        effect, cases = CATALOGUE[subject], list(CASES[subject])
    else:
        robot = replace(robot, effects=(_own(subject, robot.n),))
        effect, cases = catalogue_of(robot)[robot.effects[0].name], [OWN[subject]]
    if effect.arm:
        items = [fitted(effect, cases[0])]
    else:
        of_joints = [one for one in cases if one.joint is not None]
        items = [
            fitted(effect, one)
            for joint in range(robot.n)
            for one in _at(of_joints[joint % len(of_joints)], joint, robot.n)
        ]
    # A session of one log that began when the held-out one did.
    session = EffectSession(logs=["0" * 64], starts=[0.0], origin=0.0)
    items = [replace(item, session=session) for item in items]
    return Planted(robot=robot, plain=plain, items=items)


def _own(subject: str, joints: int) -> OwnEffect:
    if subject == PACKAGE:
        return OwnEffect(CableDrag.name)
    formula = parse_formula(OWN_FORMULA, joints, ("v",))
    return OwnEffect("own_drag", None, formula, {"v": (0.0, 10.0)})


def _at(one: Case, joint: int, joints: int) -> Iterator[Case]:
    """Yield a case at a joint, if the joint can have it."""
    settings = dict(one.settings)
    if "neighbour" in settings:
        if joints == 1:
            return
        settings["neighbour"] = 1.0 if joint == 0 else -1.0
    yield replace(one, joint=joint, settings=settings)


def replays(
    subject: str,
    arm: str,
    *,
    forms: Sequence[str] = tuple(FORMS),
    seconds: float = SECONDS,
) -> list[Replayed]:
    """Write an arm with an effect in some forms,
    and run these over a held-out motion.
    """
    with package_installed():
        plant = planted(subject, arm)
        if not plant.items:
            return [
                Replayed(subject=subject, arm=arm, form=form, ratio=None, left_out=None)
                for form in forms
            ]
        plant = plant.scaled()
        full = FullModel.of(plant.robot, plant.stages)
        with TemporaryDirectory() as place, _shorter_in_python():
            folder = Path(place)
            log = _written_log(folder / "held_out.parquet", full, seconds)

            def largest_ratio(stages: Stages, form: str) -> float:
                path = folder / FORMS[form]
                text = export(plant.robot, stages, kind=form).text
                path.write_text(text, encoding="utf-8")
                joints = replayed(path, form, full, [log], {}).values()
                return max(
                    (joint.export_rmse or np.inf) / joint.file_rmse
                    for joint in joints
                    if joint.file_rmse
                )

            left_out = largest_ratio(plant.plain, forms[0])
            return [
                Replayed(
                    subject=subject,
                    arm=arm,
                    form=form,
                    ratio=largest_ratio(plant.stages, form),
                    left_out=left_out,
                )
                for form in forms
            ]


@contextmanager
def package_installed() -> Iterator[None]:
    """Offer the effect of the package as an installed one does."""
    value = f"{CableDrag.__module__}:{CableDrag.__name__}"
    point = EntryPoint(name=CableDrag.name, value=value, group=own.GROUP)
    with patch.object(own, "entry_points", lambda group: EntryPoints([point])):
        yield


@contextmanager
def _shorter_in_python() -> Iterator[None]:
    """Run numpy modules over the first second of a log: Python takes its time."""
    with patch.object(code, "MOST_IN_PYTHON", IN_PYTHON):
        yield


def _written_log(path: Path, full: FullModel, seconds: float) -> Path:
    """Write a held-out log of an arm that warms up, with the file's torque and noise.

    What is well above the cut-off passes: the low-pass is then that of a log.
    """
    robot = full.robot
    log = warming_log(robot, seconds=seconds)
    assert full.stages.inertia is not None
    inertia = replace_struct(full.stages.inertia, cutoff_hz=TORQUE_HZ)
    wide = FullModel.of(robot, replace_struct(full.stages, inertia=inertia))
    torque, _ = wide.predicted(log, wide.motion(log))
    low_passed, effect = _torque_and_effect(full, log)
    size = np.sqrt(np.mean(effect**2, axis=0))
    if not size.any():  # a contact: with as much noise as the others
        size = EFFECT_SHARE * np.sqrt(np.mean(low_passed**2, axis=0))
    # White noise loses most of its power in the low-pass; what passes is to be a tenth.
    passing = np.sqrt(2.0 * CUTOFF_HZ / RATE_HZ)
    white = np.random.default_rng(7).normal(size=torque.shape)
    torque = torque + NOISE_SHARE * size / passing * white
    return write_parquet(
        path,
        log.t,
        robot.joint_names,
        log.q,
        torque=torque,
        temperature=log.temperature,
    )


def _torque_and_effect(full: FullModel, log: Recording) -> tuple[Array, Array]:
    """Return a file's torque and what of it is the effect, both (N, n) N m."""
    motion = full.motion(log)
    torque, _ = full.predicted(log, motion)
    without, _ = full.predicted(log, motion, effects=())
    return torque, torque - without


def warming_log(robot: Robot, *, seconds: float = SECONDS) -> Recording:
    """Return a log without torque of an arm that warms up, from rest to rest.

    Its joints move at incommensurate rates.
    """
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rng = np.random.default_rng(23)
    hz = rng.uniform(0.2, 0.8, (8, robot.n))
    phase = rng.uniform(0.0, 2.0 * np.pi, (8, robot.n))
    # Time itself sets in slowly, and fades.
    pace = _smooth_step((t - REST_S) / RISE_S)
    pace = pace * _smooth_step((seconds - REST_S - t) / RISE_S)
    paced = np.cumsum(pace) / RATE_HZ
    turns = 2.0 * np.pi * hz * paced[:, None, None] + phase
    q = np.asarray(0.17 * np.sum(np.sin(turns), axis=1))

    warmth = 25.0 + 10.0 * (1.0 - np.exp(-t / 4.0))
    celsius = np.outer(warmth, np.ones(robot.n)) + np.arange(robot.n)
    return made_recording(q, np.zeros_like(q), rate_hz=RATE_HZ, temperature=celsius)


def _smooth_step(x: Array) -> Array:
    """Return 0 before 0, 1 after 1, and what joins them with two steady derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))
