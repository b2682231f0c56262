"""How well moves tell two effects apart, asked as the diagnosis asks (T-optimality).

The rows of a move, in units of the noise, hold the columns of the rigid base parameters
and of the joint's friction, which are held as the parameter file says, and those of
both effects at the settings that a search may reach. Their Gram matrices add up over
moves. Let S be the Schur complement of both effects when the base is free, and c the
coefficients of a true effect A:

    G = c' S_aa c / 2,        T = min_b c' (S_aa - S_ab S_bb^-1 S_ba) c

is the gain of A, and what the rival B leaves of it at its best plausible settings b.
The diagnosis drops a rival that lacks more than `asked` of the gain, a small share of G
(see `tempered`). It lacks T / 2 on average, with a standard deviation of sqrt(T), so
that it is dropped with the probability Phi((T / 2 - asked) / sqrt(T)). No length of
motion helps where T / 2 is less than that share: where the rival reaches 96 % of the
gain.

Settings and coefficients of the true effect are drawn: of the grid and in all
directions, so that a mean trace does not hide the least favourable of them; and where
there are logs also from what those show, which is what both effects share where the
name was left open. The smaller chance counts: logs of which something else is wrong
show coefficients that are not the effect's. Rows at rest do not count, as they do not
in a diagnosis: what a joint at rest under control carries is anything within its
friction. Atkinson, Fedorov, "The design of experiments for discriminating between two
rival models", Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from seqid_cli.discover.select.naming import BEHIND, tempered
from seqid_cli.model.effects.scene import Scene, Scenes, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.planned import RATE_HZ, sampled
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import NOISE_HZ, Belief
from seqid_cli.plan.discrimination.question import Question, Slot, gram_of
from seqid_cli.typing import Array

# share that the rival imitates on all moves of the pool, from which it always does
NESTED = 0.999

Reading = list[tuple[Slot, Array]]  # settings with coefficients (D, k) that may be true


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
        return BEHIND * tempered(self.gain)

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
    """Gram matrices of moves, `of` (M, K, K), columns as of the question.

    `prior` (K, K) is what is known beforehand, logs with it. `true` are the readings of
    each effect, `size` N m the root mean square torque of what may be true.
    """

    question: Question
    prior: Array
    of: Array
    true: tuple[list[Reading], list[Reading]]
    size: float

    def effects(self, total: Array, *, ridge: float = 1e-12) -> Array:
        """Gram matrix of the effects' columns with the base free, (..., k, k)."""
        G, b = total + self.prior, self.question.base
        size = np.sqrt(np.maximum(np.diagonal(G, axis1=-2, axis2=-1)[..., :b], 1e-300))[
            ..., None
        ]
        # The ridge, of columns of unit length, is for parts of the base that no move
        # shows.
        base = G[..., :b, :b] / size / np.swapaxes(size, -1, -2) + ridge * np.eye(b)
        gain = np.linalg.solve(base, G[..., :b, b:] / size) / size
        return np.asarray(G[..., b:, b:] - np.swapaxes(G[..., :b, b:], -1, -2) @ gain)

    def told(self, total: Array, true: int) -> Told:
        """Of one of the effects being the true one, on moves of this Gram matrix (..., K, K)."""
        readings = [pair for reading in self.true[true] for pair in reading]
        return self._of(self.effects(total), readings, true)

    def surely(self, total: Array, true: int) -> Told:
        """The same of the reading with the smallest chance, on moves of one matrix (K, K)."""
        E = self.effects(total)
        every = [self._of(E, reading, true) for reading in self.true[true]]
        return min(every, key=lambda told: float(told.power))

    def _of(self, E: Array, reading: Reading, true: int) -> Told:
        """G and T (..., D) of coefficients with rivals at all of their settings."""
        gains, lefts = [], []
        for slot, c in reading:
            own = left = square_of(E[..., slot.at, slot.at], c)
            for rival in self.question.slots[1 - true]:
                S = E[..., rival.at, rival.at]
                ridge = 1e-9 * np.trace(S, axis1=-2, axis2=-1)[..., None, None] + 1e-12
                right = E[..., rival.at, slot.at] @ c.T
                fitted = np.linalg.solve(S + ridge * np.eye(S.shape[-1]), right)
                rest = own - np.sum(right * fitted, axis=-2)
                fits = rival.fits(np.swapaxes(fitted, -1, -2))
                left = np.where(fits, np.minimum(left, rest), left)
            gains.append(own / 2.0)
            lefts.append(np.maximum(left, 0.0))
        return Told(np.concatenate(gains, axis=-1), np.concatenate(lefts, axis=-1))

    def open(self) -> list[bool]:
        """Whether not even all moves of the pool together show what an effect has of its own."""
        total = self.of.sum(axis=0)
        found = [self.told(total, true) for true in (0, 1)]
        return [bool(x.left.mean() < (1 - NESTED) * 2.0 * x.gain.mean()) for x in found]

    def value(self, total: Array) -> Array:
        """Merit (...) of moves: mean over what may be true, of both effects."""
        return np.asarray(np.mean([self.told(total, k).merit for k in (0, 1)], axis=0))


def scenes_of(
    belief: Belief, stages: Stages, moves: Sequence[PlannedMove]
) -> list[Scene]:
    """Planned moves as the effects see logs: motion as it is planned, the model's own torque."""
    model = TorqueModel.from_stages(stages, belief.robot)
    width = sign_widths(model, belief.limits.speed)
    n = belief.robot.n
    cutoff = Cutoff(NOISE_HZ, np.zeros(n), np.zeros(n))
    scenes = []
    for number, move in enumerate(moves):
        t, q, dq, ddq = sampled(move, belief.robot.joint_names, RATE_HZ)
        every = np.ones(len(t), dtype=bool)
        motion = Motion(
            t, q, dq, ddq, None, np.abs(dq) > 1e-6, every, every, RATE_HZ,
            Lowpass(NOISE_HZ, RATE_HZ), cutoff,
        )  # fmt: skip
        blank = Scene(
            belief.robot, motion, model, width, log=number, period=1.0 / RATE_HZ
        )
        scenes.append(replace(blank, motion=replace(motion, tau=blank.modelled)))
    return scenes


def separation_of(
    belief: Belief, question: Question, scenes: Scenes, size: float, have: Scenes = ()
) -> Separation:
    """Gram matrices of all moves, of which logs that there are already count as known.

    True effects have a root mean square torque of `size` N m, or what the logs say of
    it.
    """
    every, count = (*scenes, *have), len(scenes)
    grams, moments, each = zip(
        *(gram_of(belief, question, x) for x in every), strict=True
    )
    squares = np.sum(each, axis=0) / sum(x.samples for x in every)
    known = np.sum([question.prior, *grams[count:]], axis=0)
    readings: tuple[list[Reading], list[Reading]] = ([], [])
    found = Separation(question, known, np.stack(grams[:count]), readings, size)
    if have:
        b, moment = question.base, np.sum(moments[count:], axis=0)
        moment = moment[b:] - known[b:, :b] @ np.linalg.solve(known[:b, :b], moment[:b])
        E = found.effects(np.zeros_like(known))
        for own, reading in zip(question.slots, readings, strict=True):
            reading.append(_seen(own, E, moment))
        sizes = [
            np.concatenate([square_of(squares[x.at, x.at], c) for x, c in one])
            for (one,) in readings
        ]
        size = max(float(np.sqrt(np.median(one))) for one in sizes)
    for own, many, reading in zip(question.slots, question.true, readings, strict=True):
        reading.append([(x, _drawn(x, squares[x.at, x.at], size)) for x in own[:many]])
    return replace(found, size=size)


def _seen(
    slots: Sequence[Slot], E: Array, moment: Array, *, draws: int = 64
) -> Reading:
    """Settings as likely as logs make them, with coefficients (D, k) of their errors.

    `E` (k, k) are the products of the effects' columns, base eliminated, `moment` (k,)
    those with the residual. Likelihoods are tempered as those of names are, as the law
    is not exactly right.
    """
    rng = np.random.default_rng(0)
    fits, gains = [], np.zeros(len(slots))
    for k, one in enumerate(slots):
        S = E[one.at, one.at]
        values, vectors = np.linalg.eigh(
            S + 1e-9 * np.trace(S) * np.eye(len(S)) + 1e-12
        )
        # of the coefficients' covariance
        root = vectors / np.sqrt(np.maximum(values, 1e-300))
        white = root.T @ moment[one.at]
        fits.append((root @ white, root))
        gains[k] = white @ white / 2.0 if one.fits(root @ white) else 0.0
    scale = float(tempered(gains.max()))
    chance = np.exp((gains - gains.max()) / scale)
    counts = rng.multinomial(draws, chance / chance.sum())
    found = []
    for one, (c, root), count in zip(slots, fits, counts, strict=True):
        if count:
            drawn = c + np.sqrt(scale) * rng.normal(size=(count, len(c))) @ root.T
            found.append((one, np.clip(drawn, one.low, one.high)))
    return found


def _drawn(slot: Slot, square: Array, size: float, *, draws: int = 24) -> Array:
    """Coefficients (D, k) of this root mean square torque, every one of as much beforehand."""
    k = len(square)
    drawn = (
        np.random.default_rng(0).normal(size=(draws, k))
        if k > 1
        else np.array([[1.0], [-1.0]])
    )
    c = np.unique(np.where(slot.low >= 0.0, np.abs(drawn), drawn), axis=0)
    c /= np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(
        size * c / np.sqrt(np.maximum(square_of(square, c), 1e-300))[:, None]
    )


def square_of(S: Array, c: Array) -> Array:
    """C' S c (..., D) of coefficients c (D, k)."""
    return np.asarray(np.sum((S @ c.T) * c.T, axis=-2))
