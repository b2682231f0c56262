"""A model under selection: the base as free as its hold says, terms, and the noise they leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from seqid_cli.discover.absorbed import FileTrials
from seqid_cli.discover.base import Base, base_of
from seqid_cli.discover.candidates import Candidate, CandidateColumns, candidates_of
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.nuisances import DELAY
from seqid_cli.discover.select.algebra import factored, half_log_det, scale_of
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.noise import Noise, settled
from seqid_cli.discover.select.rows import ColumnGroup, Observations
from seqid_cli.discover.select.smooth import smooth_functions, smooth_products
from seqid_cli.discover.select.terms import Term, effects, smooth_term
from seqid_cli.discover.select.tuning import NEAR, Tuner
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.motion.torque_noise import DETAIL
from seqid_cli.params.schema import Stages
from seqid_cli.typing import Array

SCALES = (1.0, 3.0, 10.0, 30.0)  # of the file's errors, of which the evidence chooses


@dataclass(frozen=True)
class PriorScale:
    """By how many of the file's errors rigid body and `own` friction of each joint may move."""

    rigid: float = 1.0
    friction: tuple[float, ...] = ()

    def of(self, joint: int) -> float:
        """By how much friction of a joint may move."""
        return self.friction[joint] if self.friction else self.rigid

    def alternatives(
        self, number: int, joints: int, loosest: float = SCALES[-1]
    ) -> Iterator[PriorScale]:
        """The same with the rigid body (0), or friction of a joint (from 1), held otherwise.

        None by more than `loosest` of the file's errors.
        """
        own = [self.of(j) for j in range(joints)]
        for scale in (scale for scale in SCALES if scale <= loosest):
            if scale != [self.rigid, *own][number]:
                each = [*own[: number - 1], scale, *own[number:]] if number else own
                yield replace(
                    self, rigid=self.rigid if number else scale, friction=tuple(each)
                )

    def capped(self, most: float) -> PriorScale:
        """The same where nothing may move by more than so many of the file's errors."""
        own = tuple(min(scale, most) for scale in self.friction)
        return replace(self, rigid=min(self.rigid, most), friction=own)

    def doubt(self, joints: int, *, spread: float = 0.8) -> float:
        """Log odds against standard errors that are so many times too small, part by part.

        ln s of a scale s is normal, with `spread`. Zero where all is held as the file
        says.
        """
        scales = (self.rigid, *map(self.of, range(joints)))
        return float(sum(np.log(max(scale, 1.0)) ** 2 for scale in scales)) / (
            2.0 * spread**2
        )


HELD = PriorScale()
FREE = PriorScale(max(SCALES))
FIRM = PriorScale(0.1)


@dataclass(frozen=True)
class Ground:
    """What does not change during a selection: rows of all joints, below and above the cut-off."""

    stage: CandidateColumns
    base: Base
    rows: Observations
    size: Array  # (channels,) N m, what the file leaves
    _smooth: dict[tuple[int, bool], list[Term]] = field(default_factory=dict)

    @classmethod
    def of(cls, own: Rows, stages: Stages) -> Ground:
        """Rows of all logs, and what they have to be explained by beside the file's stages."""
        base = base_of(own, stages)
        stage = CandidateColumns(own, FileTrials(own.scenes[0], base, stages))
        high, drive = stage.high, stage.drive
        below, y = (
            [own.blocks_of(j) for j in range(own.n)],
            (*base.y, *high.y, *drive.y),
        )
        seen = [b[: len(v)] for b, v in zip(below, drive.y, strict=False)]
        size = np.array([np.sqrt(np.mean(v**2)) if len(v) else 1.0 for v in y])
        views = tuple(
            1 + (c // own.n != 1 and drive.of(c % own.n)) for c in range(len(y))
        )
        rows = Observations(y, (*below, *high.block, *seen), len(own.fold), views)
        return cls(stage, base, rows, np.maximum(size, 1e-12))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.stage.rows.n

    @cached_property
    def torque(self) -> tuple[Array, ...]:
        """Torque (M_j,) N m of the file's model at each joint's rows."""
        rows = self.stage.rows
        every = [scene.modelled_filtered for scene in rows.scenes]
        return tuple(
            rows.torque(j, [tau[:, j] for tau in every]) for j in range(rows.n)
        )

    def smooth_terms(self, joint: int, *, products: bool = False) -> list[Term]:
        """Smooth functions of everything measured, or of two quantities, for one joint."""
        key, make = (joint, products), smooth_products if products else smooth_functions
        if key not in self._smooth:
            made = make(self.stage.rows, joint) if self.stage.rows.count(joint) else []
            self._smooth[key] = [
                smooth_term(self.stage, one, self.size) for one in made
            ]
        return self._smooth[key]

    def precision(self, hold: PriorScale, number: int) -> Array:
        """Precision (k, k) beforehand of the rigid body (0), or friction of a joint (from 1)."""
        scale = hold.of(number - 1) if number else hold.rigid
        rows = np.vstack(
            [self.base.prior[number] / scale, np.diag(self.base.bounds[number])]
        )
        return rows.T @ rows

    def parts(self, hold: PriorScale, free: Sequence[bool]) -> list[ColumnGroup]:
        """The base: rigid body, friction by joint, nuisance terms where they are `free`."""
        base, stage, joints, n = self.base, self.stage, range(self.n), self.n
        drives = [j for j in joints if stage.drive.of(j)]
        rigid, *friction = [self.precision(hold, number) for number in range(1 + n)]
        bare, *own = [np.diag(bound**2) for bound in base.bounds]
        nuisances = [
            ColumnGroup(
                dict(rows.columns) if shown else {}, base.nuisance_precision(rows)
            )
            for rows, shown in zip(base.nuisances, free, strict=True)
        ]
        return [
            ColumnGroup(dict(enumerate(base.rigid)), rigid, bare),
            *(
                ColumnGroup(
                    stage.with_drive({j: base.friction[j]}), friction[j], own[j]
                )
                for j in joints
            ),
            *nuisances,
            *(stage.drive.part(j, 2 * n + j, self.size[2 * n + j]) for j in drives),
        ]


class Model:
    """Base and terms, fitted together with the noise that they leave."""

    def __init__(
        self, ground: Ground, hold: PriorScale, candidates: Sequence[Candidate] = ()
    ) -> None:
        self.ground, self.hold = ground, hold
        self.terms: list[Term] = []
        self.free = (True,) * len(ground.base.nuisances)
        self.settle()
        if candidates:
            self.add(candidates)

    def settle(self) -> None:
        """Fit all anew; a nuisance that is larger than any drive has it is left to effects."""
        g = self.ground
        self._base = g.parts(self.hold, self.free)
        parts = [*self._base, *(term.part for term in self.terms)]
        self.linear, self.noise = settled(g.stage, g.rows, g.size, parts)
        self._fitted = tuple(self.terms)
        self.__dict__.pop("deviation", None)  # of the model before
        free = tuple(
            shown and abs(size) <= rows.term.largest
            for shown, size, rows in zip(
                self.free, self.nuisance_sizes, g.base.nuisances, strict=True
            )
        )
        if free != self.free:
            self.free = free
            self.settle()

    def rescale(self) -> bool:
        """Hold the base as loosely as the evidence says; return whether anything changes."""
        first, best = self.hold, self._best_hold(self.linear)[0]
        self.hold = best if best.doubt(self.ground.n) else HELD
        self.settle()
        return best is not first

    def margin(self, without: LinearModel, loosest: float = SCALES[-1]) -> float:
        """Log evidence against the model without a term, its base held as explains it best.

        It may leave the file by up to `loosest` of the file's errors.
        """
        own = self.linear.evidence - self.hold.doubt(self.ground.n)
        return own - self._best_hold(without, loosest)[1]

    def _best_hold(
        self, linear: LinearModel, loosest: float = SCALES[-1]
    ) -> tuple[PriorScale, float]:
        """The hold that the evidence prefers, part by part, and its evidence less its doubt."""
        n = self.ground.n
        best, most = self.hold, linear.evidence - self.hold.doubt(n)
        model, known = PriorUpdate(linear), most + self.hold.doubt(n)
        for number, at in enumerate(linear.where[: 1 + n]):
            first = best
            held, gains = self.ground.precision(first, number), {first: 0.0}
            for hold in first.alternatives(number, n, loosest):
                gains[hold] = model.evidence_gain(
                    at, held, self.ground.precision(hold, number)
                )
                if known + gains[hold] - hold.doubt(n) > most:
                    best, most = hold, known + gains[hold] - hold.doubt(n)
            if best is not first:
                model.hold(at, held, self.ground.precision(best, number))
                known += gains[best]
        return best, most

    @property
    def nuisance_sizes(self) -> list[float]:
        """Deviation of each nuisance term from what was known of it, in its own unit."""
        first = 1 + self.ground.n
        where = self.linear.where[first : first + len(self.free)]
        return [float(self.linear.theta[at][0]) for at in where]

    @property
    def delays(self) -> dict[int, float]:
        """Time [s] by which each joint's torque is late, where that is the joint's own nuisance."""
        found = dict[int, float]()
        for size, shown, rows in zip(
            self.nuisance_sizes, self.free, self.ground.base.nuisances, strict=True
        ):
            term = rows.term
            if shown and term.name == DELAY and term.joint is not None:
                found[term.joint] = size
        return found

    def where(self, term: Term) -> slice:
        """Where a term's coefficients stand in the solution."""
        return self.linear.where[len(self._base) + self.terms.index(term)]

    def under(self, noise: Noise, terms: Sequence[Term] | None = None) -> LinearModel:
        """The model, or the base and some terms, under another noise."""
        own = [term.part for term in (self.terms if terms is None else terms)]
        parts = [*self._base, *own, *noise.slow(self.ground.stage)]
        return LinearModel(self.ground.rows, parts, noise.weight)

    def beside(self, *terms: Term) -> LinearModel:
        """The model without some terms, the noise as it is."""
        rest = [one for one in self.terms if one not in terms]
        if not set(rest) <= set(self._fitted):
            return self.under(self.noise, rest)
        return self.linear.without(
            *(one.part for one in self._fitted if one not in rest)
        )

    def add(self, candidates: Sequence[Candidate]) -> None:
        """Take in effects, and search their settings once more."""
        self.terms += effects(self.ground.stage, candidates, self.ground.size)
        self.settle()
        self.polish()

    def polish(self) -> None:
        """Search the settings of all effects again, with all others in place."""
        for number, term in enumerate(self.terms):
            if isinstance(what := term.what, Candidate):
                tuner, some = (
                    Tuner(self.ground.stage, self.beside(term), self.ground.size),
                    [what],
                )
                # a line in time, a ripple: where what is left without it says
                if what.effect.wide:
                    given = tuner.stage.scenes, [what.effect], self.left(without=term)
                    near = (
                        x
                        for x in candidates_of(*given, {what.joint})
                        if x.is_same_as(what)
                    )
                    some += [one for one in near if one.apart == what.apart]
                if every := tuner.tried(some):
                    best = max(every, key=lambda one: one.evidence)
                    self.terms[number] = tuner.tuned(best, NEAR).term
        self.settle()

    def squares(self, term: Term, channels: frozenset[int]) -> float:
        """Weighted square of a term's torque beside the file at some channels."""
        torque, weight = self.linear.torque_beside_file, self.noise.weight
        there = term.channels & channels
        return sum(float(weight[c] @ torque(term.part, c) ** 2) for c in there)

    def beyond(self, before: Sequence[Array], channels: frozenset[int]) -> float:
        """Share of the squared error that goes where it was not fitted, of `before`, (M_c,) N m.

        Of what the file leaves: a model of a log that is too short takes off what its
        own freedom has added.
        """
        scale, parts = self.noise.sigma, (self.linear.left_out, before)
        left, first = (
            sum(float(r[c] @ r[c]) / scale[c] ** 2 for c in channels) for r in parts
        )
        return float(1.0 - left / max(first, 1e-300))

    def is_detail(self, term: Term) -> bool:
        """Whether a term is small beside the torque of the model, which ends at the cut-off."""
        channels, torque, n = term.channels, self.ground.torque, self.ground.n
        if any(c // n == 1 for c in channels):
            return False
        whole = sum(float(self.noise.weight[c] @ torque[c % n] ** 2) for c in channels)
        return self.squares(term, channels) < DETAIL**2 * whole

    @cached_property
    def deviation(self) -> list[Array]:
        """What the base adds to the file's model (N, n) N m, at all samples of every scene."""
        return self._deviation(self.linear.held)

    def _deviation(self, theta: Array) -> list[Array]:
        rigid, *friction = [theta[at] for at in self.linear.where[: 1 + self.ground.n]]
        first = 1 + self.ground.n
        where = self.linear.where[first : first + len(self.free)]
        return self.ground.base.deviation(
            rigid, friction, [float(theta[at][0]) for at in where]
        )

    @property
    def candidates(self) -> list[Candidate]:
        """The effects among the terms."""
        return [term.what for term in self.terms if isinstance(term.what, Candidate)]

    def shown(self, without: Term | None = None) -> list[Array]:
        """Torque (N, n) N m of all terms but one beside the file, at all samples of every scene."""
        scenes, linear = self.ground.stage.scenes, self.linear
        total, absorbed = (
            [np.zeros_like(x.motion.q) for x in scenes],
            np.zeros(linear.size),
        )
        for term in (one for one in self.terms if one is not without):
            for torque, scene in zip(total, scenes, strict=True):
                for j, own in term.what.torques(scene, self.coefficients(term)).items():
                    torque[:, j] += own
            absorbed += linear.in_file(term.part) @ linear.theta[self.where(term)]
        if np.any(absorbed):
            parts = zip(total, self._deviation(absorbed), strict=True)
            total = [torque - in_file for torque, in_file in parts]
        return total

    def left(self, without: Term | None = None) -> list[Array]:
        """What is left (N, n) N m without a term, by scene; zero where a joint may stick."""
        parts = zip(
            self.ground.base.scene_bases,
            self.deviation,
            self.shown(without),
            strict=True,
        )
        return [
            np.where(own.scene.slides, own.residual - b - t, 0.0) for own, b, t in parts
        ]

    def rms(self) -> Array:
        """RMS (n,) N m of each joint's residual where it was not fitted."""
        return np.array(list(map(rms, self.linear.left_out[: self.ground.n])))

    def coefficients(self, term: Term) -> Array:
        """A term's coefficients (k,), those below the cut-off where it has others above."""
        return self.linear.theta[self.where(term)][: term.what.size]

    def variances(self, term: Term) -> Array:
        """Variance (k,) of these coefficients given all rows, by the noise alone."""
        first = self.where(term).start
        return np.asarray(
            np.diag(self.linear.covariance)[first : first + term.what.size]
        )

    def covariance(self, term: Term) -> Array:
        """Covariance (k, k) of these coefficients, no narrower than they scatter over blocks."""
        first = self.where(term).start
        at = slice(first, first + term.what.size)
        white, scattered = (
            self.linear.covariance[at, at],
            np.diag(self.linear.jackknife(at)),
        )
        wider = np.sqrt(np.maximum(scattered / np.maximum(np.diag(white), 1e-300), 1.0))
        return np.asarray(white * np.outer(wider, wider))


class PriorUpdate:
    """A solved model while parts of what is held get other precisions, one after the other.

    With C the covariance of some of it, t their values and D what their precision grows
    by, all by those of before, the log evidence grows by (log det(P + D) - log det P -
    log det(1 + D C) - t' (1 + D C)^-1 D t) / 2.
    """

    def __init__(self, linear: LinearModel) -> None:
        self.theta = linear.held
        self.covariance = linear.lift @ linear.covariance @ linear.lift.T
        self._told = np.diag(linear.sums[0])  # by the rows

    def evidence_gain(self, at: slice, before: Array, after: Array) -> float:
        """Log evidence that other precisions (k, k) of some parameters gain."""
        t, K, spread = self.theta[at], *self._change(at, after - before)
        grown = self._half_log_det(at, after) - self._half_log_det(at, before)
        return grown - 0.5 * float(spread + t @ K @ t)

    def hold(self, at: slice, before: Array, after: Array) -> None:
        """Have them hold from now on."""
        C, K = self.covariance[:, at], self._change(at, after - before)[0]
        self.theta -= C @ (K @ self.theta[at])
        self.covariance -= C @ K @ C.T

    def _half_log_det(self, at: slice, precision: Array) -> float:
        scale = scale_of(np.diag(precision) + self._told[at])
        factor = factored(precision * np.outer(scale, scale))
        return half_log_det(factor) - float(np.log(scale).sum())

    def _change(self, at: slice, more: Array) -> tuple[Array, float]:
        """(1 + D C)^-1 D and the logarithm of the determinant of 1 + D C."""
        M = np.eye(len(more)) + more @ self.covariance[at, at]
        return np.asarray(np.linalg.solve(M, more)), float(np.linalg.slogdet(M)[1])
