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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise

import numpy as np
from scipy.special import ndtr

from seqid_cli.discover.select.naming import SELDOM, TEMPER
from seqid_cli.model.effects.effect import Columns, Effect
from seqid_cli.model.effects.scene import Scene, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import NOISE_HZ, Belief
from seqid_cli.plan.moves.trajectories import RATE_HZ, sampled
from seqid_cli.plan.stages.choose import Goal
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.typing import Array, Index

BEHIND = float(np.log(1.0 / SELDOM - 1.0))  # tempered gain by which a rival is not told
NESTED = 0.999  # share that the rival imitates on all moves of the pool, from which it always does


@dataclass(frozen=True)
class Question:
    """Two effects at a joint (None: of the whole arm), each with the settings that are tried.

    The first ones of `settings` are true in turn, `true` many; a rival may have any.
    """

    effects: tuple[Effect, Effect]
    joint: int | None
    settings: tuple[Sequence[dict[str, float]], Sequence[dict[str, float]]]
    true: tuple[int, int]

    @classmethod
    def of(
        cls, effects: tuple[Effect, Effect], joint: int | None, scenes: Sequence[Scene]
    ) -> Question:
        """Take settings from the grids over some data sets, and what is reached of them."""
        first, second = (_settings(effect, joint, scenes) for effect in effects)
        settings = [*first[0], *first[1]], [*second[0], *second[1]]
        return cls(effects, joint, settings, (len(first[0]), len(second[0])))


def _settings(
    effect: Effect, joint: int | None, scenes: Sequence[Scene], *, true: int = 6, rival: int = 32
) -> list[list[dict[str, float]]]:
    """Plausible settings, of the grid and what is reached of it; shapes are sought in white noise.

    Where an effect is plausible at none, as only coefficients that agree with the settings would
    be, all are taken.
    """
    rng = np.random.default_rng(0)
    white = [rng.normal(size=scene.motion.q.shape) for scene in scenes]
    grid = list(effect.grid(scenes, joint, white))
    found = []
    for some, most in ((grid, true), ([x for one in grid for x in effect.reached(one)], rival)):
        ones = [np.ones(len(effect.coefficients(x))) for x in some]
        fit = [x for x, c in zip(some, ones, strict=True) if effect.plausible(scenes, joint, x, c)]
        found.append(_evenly(fit or some, most))
    return found


def _evenly(some: Sequence[dict[str, float]], most: int) -> list[dict[str, float]]:
    """At most so many of them, evenly."""
    return [some[k] for k in np.unique(np.linspace(0, len(some) - 1, most).round().astype(int))]


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
class Slot:
    """Where the columns of an effect at one setting stand, and the bounds of coefficients (k,)."""

    at: slice
    low: Array
    high: Array

    def fits(self, c: Array) -> Array:
        """Whether coefficients (..., k) are within them."""
        return np.asarray(((c >= self.low) & (c <= self.high)).all(axis=-1))


Reading = list[tuple[Slot, Array]]  # settings with coefficients (D, k) that may be true


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

    def effects(self, total: Array) -> Array:
        """Gram matrix of the effects' columns with the base free, (..., k, k)."""
        G, b = total + self.prior, self.base
        gain = np.linalg.solve(G[..., :b, :b], G[..., :b, b:])
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
        own = _square(E[..., a, a], c)
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


def _square(S: Array, c: Array) -> Array:
    """C' S c (..., D) of coefficients c (D, k)."""
    return np.asarray(np.sum((S @ c.T) * c.T, axis=-2))


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
    layout = _Layout.of(belief, question, scenes[0])
    planned = [_gram(belief, question, scene, layout) for scene in scenes]
    logged = [_gram(belief, question, scene, layout) for scene in have]
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
        moment = _without_base(known, np.sum([one.moment for one in logged], axis=0), layout.base)
        E = found.effects(np.zeros_like(known))
        for own, reading in zip(slots, readings, strict=True):
            reading.append(_seen(own, E, moment))
        size = max(_size(one, squares) for (one,) in readings)
    for own, many, reading in zip(slots, question.true, readings, strict=True):
        reading.append([(x, _drawn(x, squares[x.at, x.at], size)) for x in own[:many]])
    return replace(found, true=readings, size=size)


@dataclass(frozen=True)
class _Gram:
    """Sums over a data set: of weighted columns (K, K), with the residual (K,), unweighted ones.

    `squares` (k, k) is of the effects' columns at the joint in question.
    """

    gram: Array
    moment: Array
    squares: Array


def _gram(belief: Belief, question: Question, scene: Scene, layout: _Layout) -> _Gram:
    K, b = layout.size, layout.base
    gram, moment, squares = np.zeros((K, K)), np.zeros(K), np.zeros((K, K))
    measured = scene.modelled_filtered if scene.motion.tau is None else scene.motion.tau
    left = measured - scene.modelled_filtered
    for j, (index, X) in enumerate(_rows(belief, question, scene, layout)):
        if question.joint in (None, j):
            squares[np.ix_(index, index)] += X.T @ X
        weight = np.sqrt(belief.density[j] * scene.slides[:, j] / scene.motion.rate_hz)
        X *= weight[:, None]
        gram[np.ix_(index, index)] += X.T @ X
        moment[index] += X.T @ (weight * left[:, j])
    return _Gram(gram, moment, squares[b:, b:])


def _without_base(G: Array, moment: Array, base: int) -> Array:
    """What the base leaves of the effects' products with the residual (k,)."""
    return np.asarray(
        moment[base:] - G[base:, :base] @ np.linalg.solve(G[:base, :base], moment[:base])
    )


def _seen(slots: Sequence[Slot], E: Array, moment: Array, *, draws: int = 64) -> Reading:
    """Settings as likely as logs make them, with coefficients (D, k) of their errors.

    `E` (k, k) are the products of the effects' columns, base eliminated, `moment` (k,) those with
    the residual. Likelihoods are tempered as those of names are, as the law is not exactly right.
    """
    rng = np.random.default_rng(0)
    fits = [_fit(E[one.at, one.at], moment[one.at]) for one in slots]
    gains = np.array(
        [gain if one.fits(c) else 0.0 for one, (c, _, gain) in zip(slots, fits, strict=True)]
    )
    scale = max(TEMPER * float(gains.max()), 1.0)
    chance = np.exp((gains - gains.max()) / scale)
    counts = rng.multinomial(draws, chance / chance.sum())
    found = []
    for one, (c, root, _), count in zip(slots, fits, counts, strict=True):
        if count:
            drawn = c + np.sqrt(scale) * rng.normal(size=(count, len(c))) @ root.T
            found.append((one, np.clip(drawn, one.low, one.high)))
    return found


def _fit(S: Array, moment: Array) -> tuple[Array, Array, float]:
    """Coefficients (k,), a root (k, k) of their covariance, and the gain."""
    values, vectors = np.linalg.eigh(S + 1e-9 * np.trace(S) * np.eye(len(S)) + 1e-12)
    root = vectors / np.sqrt(np.maximum(values, 1e-300))
    seen = root.T @ moment
    return root @ seen, root, float(seen @ seen / 2.0)


def _size(true: Reading, squares: Array) -> float:
    """Root mean square torque N m, median over what may be true."""
    every = [_square(squares[one.at, one.at], c) for one, c in true]
    return float(np.sqrt(np.median(np.concatenate(every))))


def _drawn(slot: Slot, square: Array, size: float, *, draws: int = 24) -> Array:
    """Coefficients (D, k) of this root mean square torque, every one of as much beforehand."""
    k = len(square)
    drawn = np.random.default_rng(0).normal(size=(draws, k)) if k > 1 else np.array([[1.0], [-1.0]])
    c = np.unique(np.where(slot.low >= 0.0, np.abs(drawn), drawn), axis=0)
    c /= np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(size * c / np.sqrt(np.maximum(_square(square, c), 1e-300))[:, None])


@dataclass(frozen=True)
class _Layout:
    """Where columns stand: rigid ones, friction of the joints that count, settings of effects.

    `known` is what is known beforehand of the base columns, part by part.
    """

    friction: list[slice]
    base: int
    slots: list[Slot]  # from the base on
    known: list[tuple[slice, Array]]

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.base + int(self.slots[-1].at.stop)

    @property
    def prior(self) -> Array:
        """What is known beforehand of all columns (K, K)."""
        found = np.zeros((self.size, self.size))
        for at, known in self.known:
            found[at, at] = known
        return found

    @classmethod
    def of(cls, belief: Belief, question: Question, scene: Scene) -> _Layout:
        """Friction of joints that no effect touches tells nothing."""
        touched = {j for made in _columns(question, scene) for j in made}
        friction = [
            _friction(belief, scene, j)[1] if j in touched else np.zeros((0, 0))
            for j in range(belief.robot.n)
        ]
        b = belief.basis.size
        at = _between(b, [len(own) for own in friction])
        specs = [
            effect.coefficients(one)
            for effect, settings in zip(question.effects, question.settings, strict=True)
            for one in settings
        ]
        slots = [
            Slot(part, np.array([x.low for x in own]), np.array([x.high for x in own]))
            for part, own in zip(_between(0, [len(own) for own in specs]), specs, strict=True)
        ]
        known = [(slice(0, b), _rigid_prior(belief)), *zip(at, friction, strict=True)]
        return cls(at, at[-1].stop, slots, known)


def _between(first: int, widths: Sequence[int]) -> list[slice]:
    return [slice(int(a), int(b)) for a, b in pairwise(first + np.cumsum([0, *widths]))]


def _rows(
    belief: Belief, question: Question, scene: Scene, layout: _Layout
) -> Iterator[tuple[Index, Array]]:
    """Columns (N, k) of each joint, and where they stand (k,)."""
    motion, b = scene.motion, belief.basis.size
    H = base_regressor(belief.robot, belief.basis, motion.q, motion.dq, motion.ddq)
    made = _columns(question, scene)
    for j, part in enumerate(layout.friction):
        parts, columns = [slice(0, b)], [H[:, j]]
        if part.stop > part.start:
            parts, columns = [*parts, part], [*columns, _friction(belief, scene, j)[0]]
        for slot, own in zip(layout.slots, made, strict=True):
            if j in own:
                parts.append(slice(layout.base + slot.at.start, layout.base + slot.at.stop))
                columns.append(scene.motion.filtered(own[j]))
        yield np.concatenate([np.arange(p.start, p.stop) for p in parts]), np.hstack(columns)


def _columns(question: Question, scene: Scene) -> list[Columns]:
    """Columns of all settings of the first effect, then of the second, by joint."""
    return [
        effect.columns(scene, question.joint, one)
        for effect, settings in zip(question.effects, question.settings, strict=True)
        for one in settings
    ]


def _friction(belief: Belief, scene: Scene, j: int) -> tuple[Array, Array]:
    """Columns (N, k) of a joint's friction, and what is known of their coefficients (k, k)."""
    motion, surface = scene.motion, belief.surfaces[j]
    if surface is None:
        return np.stack([scene.sign[:, j], motion.dq[:, j]], axis=1), np.zeros((2, 2))
    columns = surface.columns(motion.q[:, j], motion.dq[:, j])
    return columns, _known(surface.covariance, np.mean(columns**2, axis=0))


def _rigid_prior(belief: Belief) -> Array:
    """Information (b, b) of the stages on the base parameters."""
    scale = Goal.of(belief, 0).scale
    return _known(belief.root @ belief.root.T, scale**2)


def _known(covariance: Array, square: Array, *, inflation: float = 1.0) -> Array:
    """Inverse of an inflated covariance; a column of mean square 1 has a doubt of 1e-3 at least."""
    floor = 1e-6 / np.maximum(square, 1e-12 * square.max(initial=1e-300))
    return np.asarray(np.linalg.inv(inflation**2 * (covariance + np.diag(floor))))
