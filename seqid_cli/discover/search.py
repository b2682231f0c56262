"""Greedy search for what the base lacks: one effect after the other, each fitted with all others.

The search runs in one of two stances. *Refitted*: the base is free, so that only what it cannot
absorb counts; right where the effect was there when the model was identified and has biased it.
*Kept*: the base is held to the parameter file within its uncertainty; right where the arm has
changed since, which a free base would swallow.

A refitted base may be *broad* besides: the file's friction surface, which a loss under load has
bent when it was identified, is free in its broad terms however little that foretells by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import Base
from seqid_cli.discover.candidates import (
    Candidate,
    Stage,
    Tried,
    again,
    apart,
    best_of_each,
    by_gain,
    candidates_of,
    refined,
    shapes,
)
from seqid_cli.discover.rivals import Filtered, Rival, known_beforehand
from seqid_cli.discover.rows import BLOCK_S
from seqid_cli.discover.stretches import chance, slowness
from seqid_cli.discover.system import Block, System
from seqid_cli.model.effects.effect import Effect

Array = NDArray[np.float64]

# Standard errors of the file, in multiples, that the base may move by: the freest first.
FREE_INFLATIONS = (30.0, 10.0, 3.0, 1.0, 0.1)
KEPT_INFLATIONS = (3.0, 1.0, 0.1)
TIGHTER = 0.3  # of a kept base's inflation, as often as it takes to keep it near the file
NEAR = 8.0  # standard errors of the file, RMS, that a kept base may be away
TIGHTENINGS = 8
FEW_TERMS = 4  # of a joint's friction: Coulomb, viscous, offset
BETTER_HELD = 0.02  # of the squared residual left out, that holding the base must be worth
OWN_OFFSET = 0.75  # of a sample period: time offset that every drive has, and no effect
REFINED = 6  # candidates whose settings are searched
ROUNDS_OF_WEIGHTS = 3
LEAST_VISIBLE = 0.02
BY_CHANCE = 1e-3  # that any joint's slow or small effect is noise: not believed from there on
SELDOM = 0.7  # of the squared residual, that chance takes away
MIDDLING = 0.15  # the same where the noise is white
WHITE = 1.5  # noise floors, that white noise leaves at most
ENOUGH_S = 60.0  # of logs, for slow noise to show its usual share
SLOW = 0.2  # of an effect's torque constant over stretches of time: it is as slow as an offset
SHAPE = 0.04  # of an accepted effect's energy, below which another is its shape's error

Gate = Callable[[Tried], bool]


@dataclass
class Search:
    """Base, accepted effects and noise of one stance; grows by `add`.

    `noise` and `bare` have 2 n entries: the joints' rows below the cut-off, then those above it.
    """

    stage: Stage
    base: Base
    kept: bool
    noise: Array  # N m
    bare: Array  # N m, what the base alone leaves
    accepted: list[Tried] = field(default_factory=list)
    timed: tuple[bool, ...] = ()
    energies: dict[tuple[str, int | None], float] = field(default_factory=dict)
    smooth: tuple[Rival, ...] = ()
    inflation: float = FREE_INFLATIONS[0]
    broad: bool = False

    @classmethod
    def begin(
        cls,
        stage: Stage,
        base: Base,
        *,
        kept: bool,
        broad: bool = False,
        smooth: Sequence[Rival] = (),
    ) -> Search:
        """Start with the base, and smooth functions where no effect is to be looked for.

        A base that is not kept is as free as its folds can bear: where a freer one foretells what
        was left out no better, many parameters on few logs would only swallow what is looked for.
        With `broad` its rigid body and friction's broad terms are free in any case.
        """
        rms = [np.sqrt(np.mean(y**2)) if len(y) else 1.0 for y in [*base.y, *stage.high.y]]
        noise = np.maximum(rms, 1e-12)
        search = cls(stage, base, kept, noise, noise, [], (True,) * stage.rows.n)
        search.smooth, search.broad = tuple(smooth), broad and not kept
        search.inflation = (KEPT_INFLATIONS if kept else FREE_INFLATIONS)[0]
        search.settle()
        search._hold()
        if kept:
            search._tie()
        search.bare = search.noise
        return search

    def _hold(self) -> None:
        """Hold the base as much as helps to foretell what was left out.

        Friction of few terms needs no holding, and a file that was fitted to these very logs would
        always seem to foretell them best.
        """
        if max(f.shape[1] for f in self.base.friction) <= FEW_TERMS:
            return
        chosen, least = self.inflation, 1.0
        scale = np.maximum(self.rms(), 1e-12)
        for inflation in (KEPT_INFLATIONS if self.kept else FREE_INFLATIONS)[1:]:
            held = replace(self, inflation=inflation)
            cost = float(np.mean((held.rms() / scale) ** 2))
            if cost < (1 - BETTER_HELD) * least:
                chosen, least = inflation, cost
        if chosen != self.inflation:
            self.inflation = chosen
            self.settle()

    def _tie(self) -> None:
        """Hold a kept base so that it stays near the file, however loudly the rows call it away."""
        for _ in range(TIGHTENINGS):
            if self._away() <= NEAR:
                return
            self.inflation *= TIGHTER
            self.settle()

    def _away(self) -> float:
        """Standard errors of the file, RMS, by which rigid body or some friction has moved."""
        system, base = self.system(), self.base
        priors = [base.prior_rigid, *base.prior_friction]
        moved = [P @ system.theta[w] for P, w in zip(priors, system.where, strict=False) if len(P)]
        return max((float(np.sqrt(np.mean(m**2))) for m in moved), default=0.0)

    def settle(self) -> None:
        """Weigh joints by what is left, and decide whose time offset is no more than ordinary."""
        self.timed = (True,) * self.stage.rows.n
        for _ in range(ROUNDS_OF_WEIGHTS):
            system = self.system()
            self.noise = self._left(system)
        shifted = {j for t in self.accepted if t.candidate.effect.timing for j in t.columns}
        self.timed = tuple(
            abs(d) <= self._own_offset and j not in shifted
            for j, d in enumerate(self.offsets(system))
        )
        self.noise = self._left(self.system())

    @property
    def _own_offset(self) -> float:
        return OWN_OFFSET * max(scene.period for scene in self.stage.scenes)

    def _left(self, system: System) -> Array:
        left = [np.sqrt(np.mean(r**2)) if len(r) else 1.0 for r in system.residual()]
        return np.maximum(left, 1e-12)

    def offsets(self, system: System) -> list[float]:
        """Time [s] by which each joint's torque is early against its position."""
        first = 1 + self.stage.rows.n
        return [float(system.theta[w][0]) for w in system.where[first : first + self.stage.rows.n]]

    def without(self, tried: Tried) -> Search:
        """The same search with one accepted effect taken back; weights stay."""
        return replace(self, accepted=[t for t in self.accepted if t is not tried])

    def system(self) -> System:
        """Normal equations of base and accepted effects."""
        rows, high = self.stage.rows, self.stage.high
        y = [*self.base.y, *high.y]
        weight = [*np.ones(rows.n), *high.weight]
        noise = [np.full(len(v), s * w) for v, s, w in zip(y, self.noise, weight, strict=True)]
        blocks = [*self._base_blocks(), *self._smooth_blocks()]
        blocks += [_block(t) for t in self.accepted]
        return System(rows, y, noise, blocks, high)

    def _base_blocks(self) -> list[Block]:
        base, n = self.base, self.stage.rows.n
        held = base.rigid_hold(FREE_INFLATIONS[0] if self.broad else self.inflation)
        blocks = [Block(dict(enumerate(base.rigid)), held, lasting=True)]
        for j in range(n):
            held = base.friction_hold(j, self.inflation, free=self.broad)
            blocks.append(Block({j: base.friction[j]}, held, lasting=True))
        for j in range(n):
            columns = base.timing[j] if self.timed[j] else base.untimed[j]
            blocks.append(Block({j: columns}, np.diag(base.bounds[2][j]), lasting=True))
        return blocks

    def rms(self) -> Array:
        """RMS (n,) N m of each joint's residual, below the cut-off, where it was not fitted."""
        left = self.system().left_out()[: self.stage.rows.n]
        return np.array(
            [
                s * np.sqrt(np.mean(r**2)) if len(r) else 0.0
                for s, r in zip(self.noise[: len(left)], left, strict=True)
            ]
        )

    def excess(self) -> Array:
        """`rms` (n,) as a share of the error that the file alone leaves."""
        return np.asarray(self.rms() / np.maximum(self.base.start, 1e-12))

    def _smooth_blocks(self) -> list[Block]:
        filtered = Filtered.of(self.stage.rows)
        blocks = []
        for rival in self.smooth:
            held = known_beforehand(float(self.base.start[rival.joint]), rival.size)
            prior = np.sqrt(held) * np.eye(rival.size + 1)
            columns = {j: _with_constant(X) for j, X in filtered.columns(rival).items()}
            blocks.append(Block(columns, prior))
        return blocks

    def deviation(self, system: System) -> list[Array]:
        """What the base adds to the file's model (N, n) N m, at all samples of every scene."""
        n, theta = self.stage.rows.n, system.theta
        friction = [theta[w] for w in system.where[1 : 1 + n]]
        return self.base.deviation(theta[system.where[0]], friction)

    def residual(self, system: System) -> list[Array]:
        """What base and accepted effects leave (N, n) N m, at all samples of every scene.

        Zero where a joint does not slide: there friction hides anything.
        """
        n, theta = self.stage.rows.n, system.theta
        explained = self.deviation(system)
        added = system.where[1 + 2 * n :]
        for rival, where in zip(self.smooth, added, strict=False):
            for torque, scene in zip(explained, self.stage.scenes, strict=True):
                shown = _with_constant(rival.columns(scene)[rival.joint]) @ theta[where]
                torque[:, rival.joint] += scene.motion.filtered(shown, times=2)
        for tried, where in self.placed(system):
            _add_effect(explained, self.stage, tried.candidate, theta[where])
        result = []
        for whole, torque, scene in zip(self.base.whole, explained, self.stage.scenes, strict=True):
            result.append(np.where(scene.slides, whole.residual - torque, 0.0))
        return result

    def placed(self, system: System) -> list[tuple[Tried, slice]]:
        """Every accepted effect, and where its coefficients stand in the system's solution."""
        last = system.where[len(system.where) - len(self.accepted) :]
        return list(zip(self.accepted, last, strict=True))

    def shown(self, system: System) -> list[Array]:
        """Torque (N, n) N m of the accepted effects, low-passed, at all samples of every scene."""
        result = [np.zeros_like(scene.motion.q) for scene in self.stage.scenes]
        for tried, at in self.placed(system):
            _add_effect(result, self.stage, tried.candidate, system.theta[at])
        return result

    def ranked(
        self,
        effects: Sequence[Effect],
        system: System,
        refine: int = REFINED,
        near: Collection[int] | None = None,
        *,
        doubtful: bool = False,
    ) -> list[Tried]:
        """The best setting of every effect at every joint, the largest gain first.

        The settings of the first `refine` are searched between the grid's values. With `near`,
        effects of other joints than these are left out; with `doubtful`, slow effects that slow
        noise may have given by chance are not.
        """
        residual = self.residual(system)
        candidates = list(candidates_of(self.stage.scenes, effects, residual, near))
        believed = self._believed(self.stage.try_all(system, candidates))
        best = [t for t in best_of_each(believed) if doubtful or self.lasts(t, system)]
        head = [self._refined(system, shapes(t, believed)) for t in best[:refine]]
        return sorted([*head, *best[refine:]], key=by_gain)

    def _refined(self, system: System, points: Sequence[Tried]) -> Tried:
        return min((refined(self.stage, system, t) for t in points), key=by_gain)

    def _believed(self, tried: Sequence[Tried]) -> list[Tried]:
        return [t for t in tried if t.trial.visible > LEAST_VISIBLE and self.stage.plausible(t)]

    def lasts(self, tried: Tried, system: System) -> bool:
        """Whether a slow effect's gain is more than what slow noise gives by chance."""
        least = BY_CHANCE / self.stage.rows.n
        return not tried.candidate.effect.slow or chance(system, tried.columns) < least

    def holds(self, tried: Tried, system: System, floor: Array) -> bool:
        """Whether an accepted effect's gain is more than what coloured noise gives by chance.

        Those that show above the cut-off as well have other evidence than a few slow values. Noise
        seldom gives much, and not so much where it is white: there hardly more is left than the
        noise floor (n,) N m. That tells nothing of noise as slow as slow effects or short logs.
        An effect that these motions leave hardly more than an offset is as slow as one.
        """
        if tried.above_too or tried.trial.relative > SELDOM:
            return True
        slow = tried.candidate.effect.slow or slowness(system, tried.columns) > SLOW
        joints = [j for j in tried.columns if j < len(floor)]
        long = BLOCK_S * len(self.stage.rows.fold) >= ENOUGH_S
        white = long and not slow and bool(np.all(self.noise[joints] < WHITE * floor[joints]))
        if white and tried.trial.relative > MIDDLING:
            return True
        least = BY_CHANCE / self.stage.rows.n
        return chance(system, tried.columns, slow=slow) < least

    def energy(self, tried: Tried) -> float:
        """Gain as a share of the squared residual that the base alone leaves at its joints."""
        joints = [j for j in sorted(tried.columns) if j < self.stage.rows.n]
        return tried.trial.relative * float(np.mean((self.noise / self.bare)[joints] ** 2))

    def is_shape(self, tried: Tried) -> bool:
        """Whether a candidate may only be the error of an accepted effect's shape."""
        joints, energy = set(tried.columns), self.energy(tried)
        return any(
            energy < SHAPE * self.energies[a.candidate.key]
            for a in self.accepted
            if joints & set(a.columns) and not apart(tried, a)
        ) or any(again(tried, a) for a in self.accepted)

    def effect_torques(self, system: System) -> list[Array]:
        """Torque (N, n) N m of the accepted effects, unfiltered, at every log's own rate."""
        result = []
        for scene in self.stage.scenes:
            full = scene.full or scene
            total = np.zeros_like(full.motion.q)
            for tried, at in self.placed(system):
                c = tried.candidate
                for joint, X in c.effect.columns(full, c.joint, c.settings).items():
                    total[:, joint] += X @ system.theta[at]
            result.append(total)
        return result

    def add(self, tried: Tried) -> None:
        """Accept an effect and weigh anew."""
        self.energies[tried.candidate.key] = self.energy(tried)
        self.accepted.append(tried)
        self.settle()

    def marginal(self, tried: Tried) -> Tried:
        """An accepted effect as it gains beside all others."""
        return self.stage.try_all(self.without(tried).system(), [tried.candidate])[0]

    def prune(self, gate: Gate) -> None:
        """Take back accepted effects that the others have made superfluous, the weakest first.

        Also what is so small beside another at its joints that it may be that one's shape's error.
        """
        while len(self.accepted) > 1:
            gains = [self.marginal(t) for t in self.accepted]
            weakest = min(range(len(gains)), key=lambda k: gains[k].trial.total)
            weak = gains[weakest]
            near = [
                t.trial.total
                for t in gains
                if set(t.columns) & set(weak.columns) and not apart(weak, t)
            ]
            if gate(weak) and weak.trial.total >= SHAPE * max(near, default=0.0):
                return
            del self.accepted[weakest]
            self.settle()

    def polish(self) -> None:
        """Search every accepted effect's settings once more, with all others in place."""
        for number, tried in enumerate(self.accepted):
            others = self.without(tried).system()
            again = self.stage.try_all(others, [tried.candidate])[0]
            self.accepted[number] = refined(self.stage, others, again, spacing=1.5)
        self.settle()


def _with_constant(X: Array) -> Array:
    """Columns (N, k + 1): smooth functions have no constant, and not every base has one."""
    return np.column_stack([X, np.ones(len(X))])


def _block(tried: Tried) -> Block:
    size = next(iter(tried.columns.values())).shape[1]
    columns = {j: np.asarray(X, dtype=np.float64) for j, X in tried.columns.items()}
    return Block(columns, np.zeros((0, size)))


def _add_effect(
    explained: list[Array], stage: Stage, candidate: Candidate, coefficients: Array
) -> None:
    effect = candidate.effect
    for torque, scene in zip(explained, stage.scenes, strict=True):
        at = scene.full or scene if effect.wide else scene
        every = round(at.motion.rate_hz / scene.motion.rate_hz)
        for joint, X in effect.columns(at, candidate.joint, candidate.settings).items():
            shown = at.motion.filtered(X @ coefficients, times=effect.passes)
            torque[:, joint] += shown[::every]
