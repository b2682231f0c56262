"""What a seed stands for: an arm, what it lacks, when that came, and how it is
recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tests import Array
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm, drawn_arm, published_links
from tests.studies.outside.effects import KINDS
from tests.studies.outside.pushes import Push
from tests.studies.outside.simulate import Effect, simulate

Flow = Literal["late", "early", "step_late", "step_early", "single"]
RESERVED = 10_000  # seeds from here on judge, and are not looked at before
LEAST, MOST = 0.02, 0.2  # of the joint's torque, RMS, that an effect is drawn to make

# Nothing is missing of a model that was identified with these inside.
COMES_LATER = {
    "payload",
    "base_tilt",
    "friction_change",
    "rotor_inertia",
    "torque_constant",
}
COMES_LATER |= {"external_contact"}
FLOWS: tuple[Flow, ...] = (
    "late",
    "early",
    "late",
    "step_late",
    "early",
    "step_early",
    "single",
)
MANY = 5  # joints; more would take minutes a case, and with IMUs even these do
PUBLISHED = ("ur5", "panda", "so101", "ur10", "jaco", "xarm7", "z1")


@dataclass(frozen=True)
class Outline:
    """What a case is, without numbers: `label` and `n` as in `drawn_arm`."""

    seed: int
    kinds: tuple[str, ...]
    flow: Flow
    label: str
    n: int
    imus: bool
    mcap: bool
    clock: bool  # the logs share one


@dataclass(frozen=True)
class Asked:
    """One log that is asked about: its motion (N, n) rad, and what acts in it."""

    motion: Array
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Case:
    """One case; `shares` are the effects' parts of the torque's RMS where they act
    most.

    Where `asked` is empty, the recorder draws the motions of the logs that are asked
    about, and all of the effects act in all of them. `variant` is a sort of the effect.
    """

    outline: Outline
    arm: Arm
    effects: tuple[Effect, ...]
    shares: tuple[float, ...]
    group: str = "mixed"
    variant: str = ""
    asked: tuple[Asked, ...] = ()
    pushes: tuple[Push, ...] = ()

    @property
    def before(self) -> Sequence[Effect]:
        """What is there while the model is identified."""
        return () if self.outline.flow in ("late", "step_late") else self.effects

    @property
    def joints(self) -> list[list[str]]:
        pairs = [(effect.joint, effect.partner) for effect in self.effects]
        return [[self.arm.names[j] for j in pair if j is not None] for pair in pairs]


def kinds_of(seed: int) -> tuple[str, ...]:
    """Every fifth seed is clean, every fourth of the others has two effects."""
    if seed % 5 == 0:
        return ()
    names, turn = list(KINDS), seed - seed // 5 - 1
    first = names[turn % len(names)]
    if turn % 4 != 3:
        return (first,)
    rng = np.random.default_rng([seed, 9])
    return first, str(rng.choice([name for name in names if name != first]))


def outlined(seed: int, whole: bool = False) -> Outline:
    """Which sort of case a seed is; `whole` ones are published arms of which all joints
    move.
    """
    rng, kinds = np.random.default_rng([seed, 77]), kinds_of(seed)
    flow = FLOWS[int(rng.integers(len(FLOWS)))]
    if COMES_LATER & set(kinds):
        flow = "step_late" if flow.startswith("s") else "late"
    label, n = "drawn", int(rng.choice([1, 2, 2, 2, 2, 3]))
    if seed % 6 == 1:
        label, n = (
            PUBLISHED[(seed // 6) % len(PUBLISHED)],
            int(rng.choice([2, 3, 3, MANY])),
        )
    if whole:
        n = len(published_links(label := PUBLISHED[seed % len(PUBLISHED)]))
    if "transmission_coupling" in kinds:
        n = max(n, 2)
    imus, mcap = bool(rng.random() < 0.5) and n < MANY, bool(rng.random() < 0.3)
    clock = mcap or bool(rng.random() < 0.5)
    return Outline(seed, kinds, flow, label, n, imus, mcap, clock)


def drawn(seed: int, coarser: float = 1.0, whole: bool = False) -> Case:
    outline, rng = outlined(seed, whole), np.random.default_rng([seed, 78])
    arm = drawn_arm(rng, outline.label, outline.n, outline.imus)
    coarse = (replace(drive, count=coarser * drive.count) for drive in arm.drives)
    arm = replace(arm, drives=tuple(coarse))
    found = [
        sized(arm, KINDS[kind](arm, int(rng.integers(arm.n)), rng), rng)
        for kind in outline.kinds
    ]
    return Case(
        outline, arm, tuple(e for e, _ in found), tuple(share for _, share in found)
    )


def sized(
    arm: Arm, effect: Effect, rng: np.random.Generator, least: float = LEAST
) -> tuple[Effect, float]:
    """Make an effect as large as drawn, or as it can be; and how large that is."""
    target = float(np.exp(rng.uniform(np.log(least), np.log(MOST))))
    arm = replace(arm, imus=(), noise=0.0)
    motion = motions.multisine(arm, np.random.default_rng([int(1e6 * target), 1]), 6.0)
    plain = simulate(arm, motion, 0, start=60.0).torque
    width = max(int(0.05 * arm.rate_hz), 1)
    window = np.ones(width) / width

    def share(scale: float) -> float:
        changed = simulate(arm, motion, 0, [effect.make(scale)], start=60.0).torque
        apart = np.array([np.convolve(x, window, "valid") for x in (changed - plain).T])
        shares = np.sqrt(np.mean(apart**2, axis=1) / np.mean(plain**2, axis=0))
        return float(shares.max() if effect.joint is None else shares[effect.joint])

    scale, found = 1.0, share(1.0)
    for _ in range(3):
        wanted = float(np.clip(scale * target / max(found, 1e-9), 0.02, effect.most))
        if abs(np.log(wanted / scale)) < 0.15:
            break
        scale, found = wanted, share(wanted)
    return effect.make(scale), found
