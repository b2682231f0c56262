"""How well moves tell two effects apart, asked as the diagnosis asks (T-optimality).

The rows of a move, in units of the noise, hold the columns of the rigid base parameters and of the
joint's friction, which are held as the parameter file says, and those of both effects at the
settings that a search may reach. Their Gram matrices add up over moves. Let S be the Schur
complement of both effects when the base is free, and c the coefficients of a true effect A:

    G = c' S_aa c / 2,        T = min_b c' (S_aa - S_ab S_bb^-1 S_ba) c

is the gain of A, and what the rival B leaves of it at its best plausible settings b. The diagnosis
drops a rival that lacks more than `asked` = BEHIND max(TEMPER G, 1) of the gain. It lacks T / 2 on
average, with a standard deviation of sqrt(T), so that it is dropped with the probability
Phi((T / 2 - asked) / sqrt(T)). No length of motion helps where T / 2 is less than BEHIND TEMPER G:
where the rival reaches 95.3 % of the gain.

Settings and coefficients of the true effect are drawn: of the grid and in all directions, so that a
mean trace does not hide the least favourable of them; and where there are logs also from what those
show, which is what both effects share where the name was left open. The smaller chance counts: logs
of which something else is wrong show coefficients that are not the effect's. Rows at rest do not
count, as they do not in a diagnosis: what a joint at rest under control carries is anything within
its friction.

References
----------
Atkinson, Fedorov, "The design of experiments for discriminating between two rival models",
Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.special import ndtr

from seqid_cli.discover.select.naming import SELDOM, TEMPER
from seqid_cli.model.effects.scene import Scene, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import NOISE_HZ, Belief
from seqid_cli.plan.discrimination.columns import Layout, gram_of
from seqid_cli.plan.discrimination.question import (
    Question,
    Reading,
    Slot,
    drawn_of,
    seen,
    size_of,
    square_of,
    without_base,
)
from seqid_cli.plan.moves.trajectories import RATE_HZ, sampled
from seqid_cli.typing import Array

BEHIND = float(np.log(1.0 / SELDOM - 1.0))  # tempered gain by which a rival is not told
NESTED = 0.999  # share that the rival imitates on all moves of the pool, from which it always does


@dataclass(frozen=True)
class Told:
    """What the diagnosis will make of a true effect, over its settings and coefficients (..., D).

    `gain` is G, `left` T.
    """

    gain: Array
    left: Array

    def longer(self, factor: float) -> Told:
        """The same on moves that last so many times as long."""
        return Told(factor * self.gain, factor * self.left)

    @property
    def asked(self) -> Array:
        """Gain (..., D) that a rival must lack to be dropped."""
        return np.asarray(BEHIND * np.maximum(TEMPER * self.gain, 1.0))

    @property
    def power(self) -> Array:
        """Probability (...) that it is dropped, over all that may be true."""
        spread = np.sqrt(np.maximum(self.left, 1e-12))
        return np.asarray(ndtr((self.left / 2.0 - self.asked) / spread).mean(axis=-1))

    @property
    def merit(self) -> Array:
        """The same (...) without a step: what the rival lacks, over it and what is asked."""
        lacks = self.left / 2.0
        return np.asarray((lacks / (lacks + self.asked)).mean(axis=-1))

    @property
    def imitated(self) -> float:
        """Largest share of the gain that the rival reaches."""
        return float(np.max(1.0 - self.left / np.maximum(2.0 * self.gain, 1e-300)))


@dataclass(frozen=True)
class Separation:
    """Gram matrices of moves: `of` (M, K, K) of both effects' columns, the base eliminated last.

    Columns are base (`base` many), then those of each setting in `slots`, by effect. `true` are the
    readings of each effect, `size` N m the root mean square torque of what may be true.
    """

    base: int
    slots: tuple[list[Slot], list[Slot]]
    prior: Array  # (K, K)
    of: Array
    true: tuple[list[Reading], list[Reading]]
    size: float

    def effects(self, total: Array, *, ridge: float = 1e-12) -> Array:
        """Gram matrix of the effects' columns with the base free, (..., k, k).

        The ridge, of columns of unit length, is for parts of the base that no move shows.
        """
        G, b = total + self.prior, self.base
        size = np.sqrt(np.maximum(np.diagonal(G, axis1=-2, axis2=-1)[..., :b], 1e-300))[..., None]
        base = G[..., :b, :b] / size / np.swapaxes(size, -1, -2) + ridge * np.eye(b)
        gain = np.linalg.solve(base, G[..., :b, b:] / size) / size
        return np.asarray(G[..., b:, b:] - np.swapaxes(G[..., :b, b:], -1, -2) @ gain)

    def told(self, total: Array, true: int) -> Told:
        """Of one of the effects being the true one, on moves of this Gram matrix (..., K, K)."""
        E = self.effects(total)
        return self._of(E, list(chain(*self.true[true])), true)

    def surely(self, total: Array, true: int) -> Told:
        """The same of the reading with the smallest chance, on moves of one matrix (K, K)."""
        E = self.effects(total)
        every = [self._of(E, reading, true) for reading in self.true[true]]
        return min(every, key=lambda told: float(told.power))

    def _of(self, E: Array, reading: Reading, true: int) -> Told:
        found = [self._against(E, a.at, c, self.slots[1 - true]) for a, c in reading]
        return Told(*(np.concatenate(parts, axis=-1) for parts in zip(*found, strict=True)))

    def _against(self, E: Array, a: slice, c: Array, rivals: Sequence[Slot]) -> tuple[Array, Array]:
        """G and T (..., D) of coefficients c (D, k) with rivals at all of their settings."""
        own = square_of(E[..., a, a], c)
        left = own
        for b in rivals:
            S = E[..., b.at, b.at]
            ridge = 1e-9 * np.trace(S, axis1=-2, axis2=-1)[..., None, None] + 1e-12
            right = E[..., b.at, a] @ c.T
            fitted = np.linalg.solve(S + ridge * np.eye(S.shape[-1]), right)
            rest = own - np.sum(right * fitted, axis=-2)
            left = np.where(b.fits(np.swapaxes(fitted, -1, -2)), np.minimum(left, rest), left)
        return own / 2.0, np.maximum(left, 0.0)

    @cached_property
    def open(self) -> tuple[bool, bool]:
        """Whether not even all moves of the pool together show what an effect has of its own."""
        total = self.of.sum(axis=0)
        found = [self.told(total, true) for true in (0, 1)]
        first, second = (x.left.mean() < (1 - NESTED) * 2.0 * x.gain.mean() for x in found)
        return bool(first), bool(second)

    def value(self, total: Array) -> Array:
        """Merit (...) of moves: mean over what may be true, of both effects."""
        return np.asarray(np.mean([self.told(total, k).merit for k in (0, 1)], axis=0))


def scenes_of(belief: Belief, stages: Stages, moves: Sequence[PlannedMove]) -> list[Scene]:
    """Planned moves as the effects see logs: motion as it is planned, the model's own torque."""
    model = TorqueModel.from_stages(stages, belief.robot)
    width = sign_widths(model, belief.limits.speed)
    n = belief.robot.n
    cutoff = Cutoff(NOISE_HZ, np.zeros(n), 0.0, False, np.zeros(n))
    scenes = []
    for number, move in enumerate(moves):
        t, q, dq, ddq = sampled(move, belief.robot.joint_names, RATE_HZ)
        every = np.ones(len(t), dtype=bool)
        motion = Motion(
            t, q, dq, ddq, None, np.abs(dq) > 1e-6, every, every, RATE_HZ,
            Lowpass(NOISE_HZ, RATE_HZ), cutoff,
        )  # fmt: skip
        blank = Scene(belief.robot, motion, model, width, log=number, period=1.0 / RATE_HZ)
        scenes.append(replace(blank, motion=replace(motion, tau=blank.modelled)))
    return scenes


def separation_of(
    belief: Belief,
    question: Question,
    scenes: Sequence[Scene],
    size: float,
    have: Sequence[Scene] = (),
) -> Separation:
    """Gram matrices of all moves, of which logs that there are already count as known.

    True effects have a root mean square torque of `size` N m, or what the logs say of it.
    """
    layout = Layout.of(belief, question, scenes[0])
    planned = [gram_of(belief, question, scene, layout) for scene in scenes]
    logged = [gram_of(belief, question, scene, layout) for scene in have]
    squares = np.sum([one.squares for one in (*planned, *logged)], axis=0)
    squares /= sum(x.samples for x in (*scenes, *have))
    known = np.sum([layout.prior, *(one.gram for one in logged)], axis=0)
    first = len(question.settings[0])
    slots = layout.slots[:first], layout.slots[first:]
    found = Separation(
        layout.base, slots, known, np.stack([one.gram for one in planned]), ([], []), size
    )
    readings: tuple[list[Reading], list[Reading]] = ([], [])
    if logged:
        moment = without_base(known, np.sum([one.moment for one in logged], axis=0), layout.base)
        E = found.effects(np.zeros_like(known))
        for own, reading in zip(slots, readings, strict=True):
            reading.append(seen(own, E, moment))
        size = max(size_of(one, squares) for (one,) in readings)
    for own, many, reading in zip(slots, question.true, readings, strict=True):
        reading.append([(x, drawn_of(x, squares[x.at, x.at], size)) for x in own[:many]])
    return replace(found, true=readings, size=size)
