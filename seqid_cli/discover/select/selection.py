"""Forward and backward selection of what a model lacks.

A term is taken if it foretells blocks of time that were left out better than the model without it:
by more than `certain` standard errors, and by so much of their squared error that it matters. Of
terms that do so equally well, an effect is taken before a smooth function, and then the one of the
largest evidence. What does not hold beside terms that came later is taken back.

What the file says of its own parameters is believed in one of three ways: as it says; friction's
slow terms free, as files have them that have taken up an effect; all free. The evidence of the
finished models decides.

References: J. Piironen, A. Vehtari, "Comparison of Bayesian predictive methods for model
selection", Statistics and Computing 27, 2017; R. E. Kass, A. E. Raftery, "Bayes factors", JASA 90,
1995.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import Base
from seqid_cli.discover.candidates import Candidate, Stage, candidates_of
from seqid_cli.discover.rivals import Rival
from seqid_cli.discover.select.linear import Foretold, Gained, Linear, Part, Rows, scatter
from seqid_cli.discover.select.noise import Noise, settled
from seqid_cli.discover.select.terms import Term, smooth_functions
from seqid_cli.discover.select.tuning import NEAR, Tried, Tuner
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import CATALOGUE

Array = NDArray[np.float64]
Shape = Literal["held", "slow terms free", "free"]
T = TypeVar("T")

SHAPES: tuple[Shape, ...] = ("held", "slow terms free", "free")
FREE = 30.0  # standard errors of the file, in multiples, that a free base may move by
OWN_OFFSET = 0.75  # sample periods: time offset that every drive has, and no effect
LEAST_VISIBLE = 4e-4  # share of a term's square that the base leaves
CLOSE = 0.5  # of the best's evidence, from which settings are searched
SHORTLIST = 14  # effects, of which settings are searched and blocks are left out
SMOOTH_SHORTLIST = 3  # smooth functions per joint
BATCH = 200  # terms that are tried at once
DRAWS = 400  # of weights of the blocks


@dataclass(frozen=True)
class Options:
    """What decides.

    `certain` standard errors and `improvement` (share of the squared error left out) that a term
    must be worth; `chance` is the log evidence that the best of all terms has on noise; an effect's
    law is known to `law` of its torque; terms that gain within `tie` of each other are equal; at
    most `most` terms.
    """

    certain: float = 2.0
    improvement: float = 0.04
    chance: float = 6.0
    law: float = 0.03
    tie: float = 0.04
    most: int = 8


@dataclass(frozen=True)
class Ranked:
    """A term, what it gains given all rows, and on blocks that were left out."""

    term: Term
    gained: Gained
    foretold: Foretold


@dataclass(frozen=True)
class Selected:
    """Terms that were taken, the model with them, and each with its rivals beside the others.

    `rivals[k]` ranks all that touches the channels of term k, itself included.
    """

    shape: Shape
    terms: tuple[Ranked, ...]
    linear: Linear
    noise: Noise
    rivals: tuple[tuple[Ranked, ...], ...]


@dataclass(frozen=True)
class Ground:
    """What does not change during a selection."""

    stage: Stage
    base: Base
    rows: Rows
    size: Array  # (channels,) N m, what the file leaves
    catalogue: Sequence[Effect]
    options: Options

    @classmethod
    def of(
        cls,
        stage: Stage,
        base: Base,
        options: Options,
        catalogue: Sequence[Effect] = tuple(CATALOGUE.values()),
    ) -> Ground:
        """Rows of all joints, below and above the cut-off."""
        own, high = stage.rows, stage.high
        y = (*base.y, *high.y)
        block = (*(own.blocks_of(j) for j in range(own.n)), *high.block)
        size = np.array([np.sqrt(np.mean(v**2)) if len(v) else 1.0 for v in y])
        rows = Rows(y, block, len(own.fold))
        return cls(stage, base, rows, np.maximum(size, 1e-12), catalogue, options)

    def parts(self, shape: Shape, timed: Sequence[bool]) -> list[Part]:
        """The base, as free as its shape says; joints may have a time offset of their own."""
        base, joints = self.base, range(self.stage.rows.n)
        slow = shape == "slow terms free"
        rigid = base.rigid_hold(1.0 if shape == "held" else FREE)
        friction = [
            base.friction_hold(j, FREE if shape == "free" else 1.0, free=slow) for j in joints
        ]
        timing = [np.diag(base.bounds[2][j] ** 2 + self.own_offset**-2) for j in joints]
        return [
            Part(dict(enumerate(base.rigid)), rigid.T @ rigid),
            *(Part({j: base.friction[j]}, friction[j].T @ friction[j]) for j in joints),
            *(
                Part({j: base.timing[j] if timed[j] else base.untimed[j]}, timing[j])
                for j in joints
            ),
        ]

    @property
    def own_offset(self) -> float:
        """Time [s] by which torque may be early or late at any drive."""
        return OWN_OFFSET * max(scene.period for scene in self.stage.scenes)


def select(ground: Ground) -> Selected:
    """Select what the model lacks, with the base in every shape; the evidence chooses one.

    Models are compared under one noise, that of the one that leaves least.
    """
    every = [_Search(ground, shape) for shape in SHAPES]
    for one in every:
        one.run()
    n = ground.stage.rows.n
    least = min((one.noise for one in every), key=lambda noise: noise.level(n))
    best = max(every, key=lambda one: one.evidence(least))
    return best.selected()


class _Search:
    """A selection under way: `taken` terms, the model with them, and its noise."""

    def __init__(self, ground: Ground, shape: Shape) -> None:
        self.ground, self.shape = ground, shape
        self.taken: list[Ranked] = []
        self._timed = [True] * ground.stage.rows.n
        self._settle()

    @property
    def parts(self) -> list[Part]:
        """Base and terms."""
        return [*self._base, *(one.term.part for one in self.taken)]

    def _settle(self) -> None:
        """Fit all anew; an offset that is more than every drive has is left to effects."""
        g, n = self.ground, self.ground.stage.rows.n
        self._base = g.parts(self.shape, self._timed)
        self.linear, self.noise = settled(g.stage, g.rows, g.size, self.parts)
        offsets = [float(self.linear.theta[at][0]) for at in self.linear.where[1 + n : 1 + 2 * n]]
        late = [t and abs(x) > g.own_offset for t, x in zip(self._timed, offsets, strict=True)]
        if any(late):
            self._timed = [t and not x for t, x in zip(self._timed, late, strict=True)]
            self._settle()

    def _everywhere(self, linear: Linear) -> list[Array]:
        """What a model leaves (N, n) N m at all samples of every scene; zero where none slides."""
        g, n = self.ground, self.ground.stage.rows.n
        rigid, *friction = [linear.theta[at] for at in linear.where[: 1 + n]]
        shown = g.base.deviation(rigid, friction)
        for part, at in zip(linear.parts, linear.where, strict=True):
            term = self._term_of(part)
            if term is not None:
                add_torque(shown, g.stage, term.what, linear.theta[at])
        return [
            np.where(scene.slides, whole.residual - torque, 0.0)
            for whole, torque, scene in zip(g.base.whole, shown, g.stage.scenes, strict=True)
        ]

    def _term_of(self, part: Part) -> Term | None:
        return next((one.term for one in self.taken if one.term.part is part), None)

    def _beside(self, taken: Sequence[Ranked]) -> Linear:
        """The model with other terms, the noise as it is."""
        return self._under([one.term.part for one in taken], self.noise)

    def _under(self, parts: Sequence[Part], noise: Noise) -> Linear:
        """Base and some parts under a noise."""
        every = [*self._base, *parts, *noise.slow(self.ground.stage)]
        return Linear(self.ground.rows, every, noise.weight)

    def evidence(self, noise: Noise) -> float:
        """Log density of the rows under a noise, all taken terms in."""
        return self._under([one.term.part for one in self.taken], noise).evidence

    def run(self) -> None:
        """Forward, and backward after each step."""
        refused: set[tuple[str, int | None]] = set()
        while len(self.taken) < self.ground.options.most:
            best = self._best(refused)
            if best is None:
                return
            self.taken.append(best)
            self._settle()
            self._polish()
            gone = self._take_back()
            refused |= gone
            if best.term.key in gone:
                return

    def _best(self, refused: set[tuple[str, int | None]]) -> Ranked | None:
        """The term to take next; none where none is worth it."""
        ranked = self._ranked(self.linear, refused)
        passing = [one for one in ranked if self._passes(one)]
        if not passing:
            return None
        near = [one for one in passing if self._as_good(one, passing[0])]
        return max(near, key=lambda one: (not one.term.smooth, one.gained.evidence))

    def _passes(self, one: Ranked) -> bool:
        """Whether a term is worth it, and no error of a larger one's law."""
        options, told = self.ground.options, one.foretold
        sure = one.gained.evidence > options.chance and told.total > options.certain * told.error
        return sure and told.share > options.improvement

    def _of_a_law(self, one: Ranked) -> bool:
        """Whether it takes away no more than the error of a taken term's law may leave."""
        least = self.ground.options.law**2
        squares = float(one.foretold.squares.sum())
        return any(
            squares < least * self._torque(other, one.term.channels)
            for other in self.taken
            if other.term.channels & one.term.channels and other is not one
        )

    def _torque(self, taken: Ranked, channels: frozenset[int]) -> float:
        """Weighted square of a taken term's torque at some channels."""
        where = self._where(taken)
        total = 0.0
        for c in taken.term.channels & channels:
            torque = taken.term.part.columns[c] @ self.linear.theta[where]
            total += float(self.noise.weight[c] @ torque**2)
        return total

    def _where(self, taken: Ranked) -> slice:
        number = next(k for k, one in enumerate(self.taken) if one is taken)
        return self.linear.where[len(self._base) + number]

    def _as_good(self, one: Ranked, best: Ranked) -> bool:
        """Whether a term at one of the same channels is not clearly behind the best."""
        options, behind = self.ground.options, best.foretold.density - one.foretold.density
        least = max(options.certain * scatter(behind), options.tie * best.foretold.total, 1.0)
        return bool(one.term.channels & best.term.channels) and float(behind.sum()) <= least

    def _polish(self) -> None:
        """Search the settings of all taken effects again, with all others in place."""
        if len(self.taken) < 2:
            return
        for number, one in enumerate(self.taken):
            if isinstance(one.term.what, Candidate):
                linear = self._beside([x for x in self.taken if x is not one])
                tuner = Tuner(self.ground.stage, linear, self.ground.size)
                tried = next(iter(tuner.tried([one.term.what])), None)
                if tried is not None:
                    tried = tuner.tuned(tried, NEAR)
                    self.taken[number] = replace(one, term=tried.term, gained=tried.gained)
        self._settle()

    def _take_back(self) -> set[tuple[str, int | None]]:
        """Take back, the weakest first, what is not worth it beside all others."""
        gone: set[tuple[str, int | None]] = set()
        while len(self.taken) > 1:
            self.taken = [self._again(one) for one in self.taken]
            weak = [one for one in self.taken if not self._passes(one)]
            if not weak:
                break
            weakest = min(weak, key=lambda one: one.foretold.total)
            self.taken = [one for one in self.taken if one is not weakest]
            gone.add(weakest.term.key)
            self._settle()
        return gone

    def _again(self, one: Ranked) -> Ranked:
        """A taken term as it gains beside all others."""
        linear = self._beside([x for x in self.taken if x is not one])
        part = [one.term.part]
        return Ranked(one.term, linear.gained(part)[0], linear.foretold(part)[0])

    def _ranked(
        self,
        linear: Linear,
        refused: Collection[tuple[str, int | None]],
        near: frozenset[int] | None = None,
    ) -> list[Ranked]:
        """The best settings of every effect, and smooth functions, the largest gain first."""
        g = self.ground
        tuner = Tuner(g.stage, linear, g.size)
        tried = [*self._effects(tuner, near), *self._smooth(linear, near)]
        there = [t for t in tried if t.evidence > 0.0 and t.term.key not in refused]
        told = linear.foretold([t.term.part for t in there])
        ranked = [Ranked(t.term, t.gained, f) for t, f in zip(there, told, strict=True)]
        return sorted(ranked, key=lambda one: -one.foretold.total)

    def _effects(self, tuner: Tuner, near: frozenset[int] | None) -> list[Tried]:
        g, n = self.ground, self.ground.stage.rows.n
        joints = None if near is None else {c % n for c in near}
        left = self._everywhere(tuner.linear)
        every = list(candidates_of(g.stage.scenes, g.catalogue, left, joints))
        tried = [t for some in _batches(every) for t in tuner.tried(some)]
        had = set() if near else {t.term.key for t in self.taken if not is_wide(t.term)}
        seen = [t for t in tried if t.gained.visible > LEAST_VISIBLE and t.term.key not in had]
        shapes = _best_of(seen, lambda t: (*t.term.key, t.candidate.below, t.candidate.kind))
        first = sorted(shapes, key=lambda t: -t.evidence)[:SHORTLIST]
        reach = CLOSE * max((t.evidence for t in first), default=0.0)
        found = [tuner.tuned(one) if one.evidence > reach else one for one in first]
        return _best_of(found, lambda t: (*t.term.key, t.candidate.below))

    def _smooth(self, linear: Linear, near: frozenset[int] | None) -> list[Tried]:
        g, n = self.ground, self.ground.stage.rows.n
        terms = [
            t for t in smooth_functions(g.stage.rows, g.size) if near is None or t.channels & near
        ]
        found = [x for some in _batches(terms) for x in linear.gained([t.part for t in some])]
        tried = [Tried(t, x) for t, x in zip(terms, found, strict=True)]
        had = {one.term.key for one in self.taken}
        fresh = [t for t in tried if t.term.key not in had or near]
        first = sorted(fresh, key=lambda t: -t.evidence)
        return [
            t
            for j in range(n)
            for t in [one for one in first if one.term.joint == j][:SMOOTH_SHORTLIST]
        ]

    def selected(self) -> Selected:
        """What was taken, each term with its rivals."""
        self.taken = [self._again(one) for one in self.taken]
        told, rivals = [one for one in self.taken if not self._of_a_law(one)], []
        for one in told:
            linear = self._beside([x for x in self.taken if x is not one])
            others = self._ranked(linear, [one.term.key], one.term.channels)
            others = [x for x in others if x.term.channels & one.term.channels]
            rivals.append(tuple(sorted([one, *others], key=lambda x: -x.foretold.total)))
        return Selected(self.shape, tuple(told), self.linear, self.noise, tuple(rivals))


def add_torque(
    total: Sequence[Array], stage: Stage, what: Candidate | Rival, coefficients: Array
) -> None:
    """Add a term's torque, low-passed, to (N, n) N m at all samples of every scene."""
    for torque, scene in zip(total, stage.scenes, strict=True):
        if isinstance(what, Rival):
            at, passes, columns = scene, 2, what.columns(scene)
        else:
            at = (scene.full or scene) if what.effect.wide else scene
            passes = what.effect.passes
            columns = dict(what.effect.columns(at, what.joint, what.settings))
        every = round(at.motion.rate_hz / scene.motion.rate_hz)
        for joint, X in columns.items():
            torque[:, joint] += at.motion.filtered(X @ coefficients, times=passes)[::every]


def _best_of(tried: Sequence[Tried], key: Callable[[Tried], Hashable]) -> list[Tried]:
    """The one of the largest evidence for each key."""
    best: dict[Hashable, Tried] = {}
    for one in sorted(tried, key=lambda t: -t.evidence):
        best.setdefault(key(one), one)
    return list(best.values())


def is_wide(term: Term) -> bool:
    """Whether it is an effect of which a joint may have several: a ripple, a line in time."""
    return isinstance(term.what, Candidate) and term.what.effect.wide


def _batches(values: Sequence[T]) -> Iterator[Sequence[T]]:
    for first in range(0, len(values), BATCH):
        yield values[first : first + BATCH]
