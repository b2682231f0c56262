"""A model under selection: a base, terms, and the noise that they leave.

The base is held to the file by a scale of the file's standard errors, which the
evidence chooses. Channels, and the shapes M_c and k, are those of `select.rows`; p is
the number of all parameters, M_j the number of rows of joint j, and N that of the
samples of a data set.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from seqid_cli.discover.absorbed import FileTrials
from seqid_cli.discover.base import Base, base_of, has_trials
from seqid_cli.discover.candidates import (
    Candidate,
    CandidateColumns,
    DriveRows,
    candidates_of,
)
from seqid_cli.discover.link_rows import KIND as LINKS
from seqid_cli.discover.nuisances import DELAY
from seqid_cli.discover.select.algebra import factored, half_log_det, scale_of
from seqid_cli.discover.select.bounds import within_bounds
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.noise import Noise, settled
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.rows import ColumnGroup, Observations
from seqid_cli.discover.select.smooth import (
    SmoothFunction,
    smooth_functions,
    smooth_products,
)
from seqid_cli.discover.select.terms import Term, effects, smooth_term
from seqid_cli.discover.select.tuning import NEAR, Tuner
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.motion.torque_noise import DETAIL
from seqid_cli.params.schema import Stages
from seqid_cli.robust import rms
from seqid_cli.typing import Array

# Of the logarithm of a size, over which its coefficient is differentiated.
SHAPE_STEP = 0.05
SCALES = (1.0, 3.0, 10.0, 30.0)  # of the file's errors, of which the evidence chooses


@dataclass(frozen=True)
class PriorScale:
    """By how many of the file's errors rigid body and each joint's friction may move.

    Attributes
    ----------
    rigid : float
        Of the rigid body.
    friction : tuple of float
        Of each joint's friction; empty where it is that of the rigid body.
    """

    rigid: float = 1.0
    friction: tuple[float, ...] = ()

    def of(self, joint: int) -> float:
        """Return by how much friction of a joint may move."""
        return self.friction[joint] if self.friction else self.rigid

    def alternatives(
        self, number: int, joints: int, loosest: float = SCALES[-1]
    ) -> Iterator[PriorScale]:
        """Yield scales that differ in the rigid body (0), or one joint's friction.

        Parameters
        ----------
        number : int
            0 for the rigid body, from 1 on for the friction of a joint.
        joints : int
            Number of joints.
        loosest : float
            The largest scale that is yielded.
        """
        friction = [self.of(joint) for joint in range(joints)]
        scale_now = [self.rigid, *friction][number]
        for scale in SCALES:
            if scale > loosest or scale == scale_now:
                continue
            if number == 0:
                yield replace(self, rigid=scale, friction=tuple(friction))
            else:
                changed = [*friction[: number - 1], scale, *friction[number:]]
                yield replace(self, friction=tuple(changed))

    def capped(self, most: float) -> PriorScale:
        """Return the scale where nothing may move by more than so many errors."""
        friction = tuple(min(scale, most) for scale in self.friction)
        return replace(self, rigid=min(self.rigid, most), friction=friction)

    def doubt(self, joints: int, *, spread: float = 0.8) -> float:
        """Return the log odds against standard errors that are so many times too small.

        The logarithm of each scale is normal, with `spread`. They are zero where all is
        held as the file says.
        """
        scales = (self.rigid, *map(self.of, range(joints)))
        squares = sum(np.log(max(scale, 1.0)) ** 2 for scale in scales)
        return float(squares) / (2.0 * spread**2)


HELD = PriorScale()
FREE = PriorScale(max(SCALES))
FIRM = PriorScale(0.1)


@dataclass(frozen=True, kw_only=True)
class SelectionProblem:
    """The problem of a selection: what does not change while terms are taken.

    Attributes
    ----------
    stage : CandidateColumns
        The data sets, and the columns of candidates on their rows.
    base : Base
        What is free to take up the residual before any effect is blamed.
    rows : Observations
        Rows of all joints below and above the cut-off, of drives and of links.
    size : (channels,) array
        RMS that the file leaves [N m; N where prismatic].
    options : Options
        What decides.
    """

    stage: CandidateColumns
    base: Base
    rows: Observations
    size: Array
    options: Options = field(default_factory=Options)
    _smooth: dict[tuple[int, bool], list[Term]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, kept_rows: Rows, stages: Stages, options: Options | None = None
    ) -> SelectionProblem:
        """Set the problem of a selection.

        Parameters
        ----------
        kept_rows : Rows
            The rows of all logs below the cut-off.
        stages : Stages
            The parameter file's.
        options : Options, optional
            What decides.
        """
        base = base_of(kept_rows, stages)
        stage = CandidateColumns(
            kept_rows, FileTrials(kept_rows.scenes[0], base, stages)
        )
        n = kept_rows.n
        of_links = stage.links.y
        of_drives = stage.drive.y
        if of_links and not of_drives:
            of_drives = tuple(np.zeros(0) for _ in of_links)
        y = (*base.y, *stage.high.y, *of_drives, *of_links)

        # A drive, or a link, has the rows of its joint below the cut-off, or none.
        blocks_below = [kept_rows.blocks_of(joint) for joint in range(n)]
        blocks_of_drive = [
            block[: len(of_drive)]
            for block, of_drive in zip(blocks_below, of_drives, strict=False)
        ]
        blocks_of_links = [
            block[: len(of_link)]
            for block, of_link in zip(blocks_below, of_links, strict=False)
        ]
        rows = Observations(
            y=y,
            block=(
                *blocks_below,
                *stage.high.block,
                *blocks_of_drive,
                *blocks_of_links,
            ),
            blocks=len(kept_rows.fold),
            views=tuple(_views(channel, n, stage.drive) for channel in range(len(y))),
            log_of_block=kept_rows.log_of_block,
            part_of_block=kept_rows.group,
        )
        rms_left = [
            np.sqrt(np.mean(of_channel**2)) if len(of_channel) else 1.0
            for of_channel in y
        ]
        return cls(
            stage=stage,
            base=base,
            rows=rows,
            size=np.maximum(np.array(rms_left), 1e-12),
            options=options or Options(),
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.stage.rows.n

    def forget_search(self, *, but_at: Collection[int | None] = ()) -> None:
        """Let go of what a finished search has worked out, and a fit does not need.

        Parameters
        ----------
        but_at : collection of int or None
            Joints that may still be asked about (None: the whole arm).
        """
        self.stage.forget(but_at=but_at)
        for key in [*self._smooth]:
            joint, _ = key
            if joint not in but_at:
                del self._smooth[key]

    def tuner(self, linear: LinearModel) -> Tuner:
        """Return where settings of effects are searched beside a model."""
        return Tuner(self.stage, linear, self.size, self.options)

    @cached_property
    def torque(self) -> tuple[Array, ...]:
        """Torque (M_j,) N m of the file's model at each joint's rows."""
        rows = self.stage.rows
        torque_by_scene = [scene.modelled_filtered for scene in rows.scenes]
        torque = []
        for joint in range(rows.n):
            of_joint = [tau[:, joint] for tau in torque_by_scene]
            torque.append(rows.torque(joint, of_joint))
        return tuple(torque)

    def smooth_terms(self, joint: int, *, products: bool = False) -> list[Term]:
        """Return smooth functions of everything measured for one joint.

        With `products` they are functions of two quantities instead of one.
        """
        key = (joint, products)
        if key not in self._smooth:
            self._smooth[key] = self._new_smooth_terms(joint, products=products)
        return self._smooth[key]

    def absorbed_terms(self, terms: Sequence[Term]) -> list[Term]:
        """Return smooth functions as they are if they were there in the file's trials.

        Only of those that steady motion shows, at joints with trials.
        """
        scene = self.stage.scenes[0]
        absorbed = []
        for term in terms:
            function = term.what
            if not isinstance(function, SmoothFunction) or function.absorbed:
                continue
            if function.steady and has_trials(scene, function.joint):
                in_trials = replace(function, absorbed=True)
                absorbed.append(smooth_term(self.stage, in_trials, self.size))
        return absorbed

    def _new_smooth_terms(self, joint: int, *, products: bool) -> list[Term]:
        if not self.stage.rows.count(joint):
            return []
        make = smooth_products if products else smooth_functions
        return [
            smooth_term(self.stage, function, self.size)
            for function in make(self.stage.rows, joint)
        ]

    def precision(self, hold: PriorScale, number: int) -> Array:
        """Return the precision (k, k) beforehand of a part of the base.

        The part is the rigid body (0), or the friction of a joint (from 1).
        """
        scale = hold.of(number - 1) if number else hold.rigid
        rows = np.vstack(
            [self.base.prior[number] / scale, np.diag(self.base.bounds[number])]
        )
        return rows.T @ rows

    def parts(self, hold: PriorScale, free: Sequence[bool]) -> list[ColumnGroup]:
        """Return the base as groups of columns.

        They are the rigid body, the friction of each joint, the nuisance terms, which
        have columns where they are `free`, and what is free of each drive.
        """
        base = self.base
        stage = self.stage
        rigid = ColumnGroup(
            columns=dict(enumerate(base.rigid)),
            precision=self.precision(hold, 0),
            precision_without_file=np.diag(base.bounds[0] ** 2),
        )
        friction = [
            ColumnGroup(
                columns=stage.with_drive({joint: base.friction[joint]}),
                precision=self.precision(hold, 1 + joint),
                precision_without_file=np.diag(base.bounds[1 + joint] ** 2),
            )
            for joint in range(self.n)
        ]
        nuisances = [
            ColumnGroup(
                columns=dict(of_term.columns) if is_free else {},
                precision=base.nuisance_precision(of_term),
            )
            for of_term, is_free in zip(base.nuisances, free, strict=True)
        ]
        drives = []
        for joint in range(self.n):
            if stage.drive.of(joint):
                channel = 2 * self.n + joint
                drives.append(stage.drive.part(joint, channel, self.size[channel]))
        return [rigid, *friction, *nuisances, *drives]


def _views(channel: int, n: int, drive: DriveRows) -> int:
    """Return how many channels show what one does: two where a drive has its rows."""
    shows_torque = channel // n in (0, 2)
    if shows_torque and drive.of(channel % n):
        return 2
    return 1


class Model:
    """Base and terms, fitted together with the noise that they leave.

    Parameters
    ----------
    ground : SelectionProblem
        The problem.
    hold : PriorScale
        How loosely the base is held to the file.
    candidates : sequence of Candidate, optional
        Effects to begin with.

    Attributes
    ----------
    terms : list of Term
        May be changed; `settle` fits all anew.
    free : tuple of bool
        Which of the nuisance terms belong to the base.
    linear : LinearModel
        The fit.
    noise : Noise
        What it leaves.
    """

    def __init__(
        self,
        ground: SelectionProblem,
        hold: PriorScale,
        candidates: Sequence[Candidate] = (),
    ) -> None:
        self.ground = ground
        self.hold = hold
        self.terms: list[Term] = []
        self.free = (True,) * len(ground.base.nuisances)
        self.settle()
        if candidates:
            self.add(candidates)

    def held_otherwise(self, hold: PriorScale, terms: Sequence[Term]) -> Model:
        """Fit another model of the same problem, with some terms and another hold."""
        other = Model(self.ground, hold)
        other.terms = list(terms)
        other.settle()
        return other

    # ---- fitting

    def settle(self) -> None:
        """Fit all anew; a nuisance larger than any drive has it is left to effects."""
        ground = self.ground
        self._base = ground.parts(self.hold, self.free)
        parts = [*self._base, *(term.part for term in self.terms)]
        self.linear, self.noise = settled(ground.stage, ground.rows, ground.size, parts)
        self._fitted = tuple(self.terms)
        self.__dict__.pop("deviation", None)  # of the model before

        free = []
        for was_free, size, of_term in zip(
            self.free, self.nuisance_sizes, ground.base.nuisances, strict=True
        ):
            free.append(was_free and abs(size) <= of_term.term.largest)
        if tuple(free) != self.free:
            self.free = tuple(free)
            self.settle()

    def rescale(self) -> bool:
        """Hold the base as loosely as the evidence says; return whether that is new."""
        hold_before = self.hold
        best, _ = self._best_hold(self.linear)
        self.hold = best if best.doubt(self.ground.n) else HELD
        self.settle()
        return best is not hold_before

    def margin(self, without: LinearModel, loosest: float = SCALES[-1]) -> float:
        """Return the log evidence against the model without a term.

        The base of that model is held as explains it best.

        Parameters
        ----------
        without : LinearModel
            The model without the term.
        loosest : float
            By how many of the file's errors its base may leave the file.
        """
        evidence = self.linear.evidence - self.hold.doubt(self.ground.n)
        _, evidence_without = self._best_hold(without, loosest)
        return evidence - evidence_without

    def _best_hold(
        self, linear: LinearModel, loosest: float = SCALES[-1]
    ) -> tuple[PriorScale, float]:
        """Return the scale that the evidence prefers, and its evidence less its doubt.

        The parts of the base are loosened one after the other.
        """
        n = self.ground.n
        best = self.hold
        best_worth = linear.evidence - self.hold.doubt(n)
        evidence = best_worth + self.hold.doubt(n)
        update = PriorUpdate(linear)
        for number, at in enumerate(linear.where[: 1 + n]):
            hold_before = best
            precision_before = self.ground.precision(hold_before, number)
            gains = {hold_before: 0.0}
            for hold in hold_before.alternatives(number, n, loosest):
                gains[hold] = update.evidence_gain(
                    at, precision_before, self.ground.precision(hold, number)
                )
                worth = evidence + gains[hold] - hold.doubt(n)
                if worth > best_worth:
                    best = hold
                    best_worth = worth
            if best is not hold_before:
                update.hold(at, precision_before, self.ground.precision(best, number))
                evidence += gains[best]
        return best, best_worth

    def under(self, noise: Noise, terms: Sequence[Term] | None = None) -> LinearModel:
        """Return the model, or the base and some terms, under another noise."""
        chosen = self.terms if terms is None else terms
        parts = [*self._base, *(term.part for term in chosen)]
        slow_noise = noise.slow(self.ground.stage)
        return LinearModel(
            self.ground.rows, parts, noise.weight, slow_noise, recurring=noise.recurring
        )

    def beside(self, *terms: Term) -> LinearModel:
        """Return the model without some terms, the noise as it is."""
        remaining = [term for term in self.terms if term not in terms]
        if not set(remaining) <= set(self._fitted):
            return self.under(self.noise, remaining)
        removed = [term.part for term in self._fitted if term not in remaining]
        return self.linear.without(*removed)

    def add(self, candidates: Sequence[Candidate]) -> None:
        """Take in effects, and search their settings once more."""
        self.terms += effects(self.ground.stage, candidates, self.ground.size)
        self.settle()
        self.polish()

    def polish(self) -> None:
        """Search the settings of all effects again, with all others in place."""
        for number, term in enumerate(self.terms):
            if not isinstance(term.what, Candidate):
                continue
            polished = self._polished(term, term.what)
            self.terms[number] = polished
            # Coefficients of the others stand elsewhere then.
            if polished.part.size != term.part.size:
                self.settle()
        self.settle()

    def _polished(self, term: Term, candidate: Candidate) -> Term:
        """Return an effect of the model at its best settings.

        The whole grid is tried again: much noise was left when the term was taken, and
        less of its shape was seen. Of a line in time or a ripple what is left without
        it says where it is.
        """
        tuner = self.ground.tuner(self.beside(term))
        of_grid = candidates_of(
            tuner.stage.scenes,
            [candidate.effect],
            self.left(without=term),
            {candidate.joint},
        )
        starts = [candidate]
        starts += [other for other in of_grid if other.may_replace(candidate)]
        fitted = tuner.tried(starts)
        if not fitted:
            return term
        best = max(fitted, key=lambda each: each.evidence)
        return tuner.tuned(best, NEAR).term

    # ---- what is known of the base and the terms

    @property
    def nuisance_sizes(self) -> list[float]:
        """Deviation of each nuisance term from what was known, in its own unit."""
        return self._nuisances_in(self.linear.theta)

    def _nuisances_in(self, theta: Array) -> list[float]:
        """Return the nuisance terms' part of parameters (p,)."""
        first = 1 + self.ground.n
        where = self.linear.where[first : first + len(self.free)]
        return [float(theta[at][0]) for at in where]

    @property
    def delays(self) -> dict[int, float]:
        """Time [s] by which a joint's torque is late, where it is the joint's own."""
        delays: dict[int, float] = {}
        for size, is_free, of_term in zip(
            self.nuisance_sizes, self.free, self.ground.base.nuisances, strict=True
        ):
            term = of_term.term
            if is_free and term.name == DELAY and term.joint is not None:
                delays[term.joint] = size
        return delays

    @property
    def candidates(self) -> list[Candidate]:
        """The effects among the terms."""
        return [term.what for term in self.terms if isinstance(term.what, Candidate)]

    def where(self, term: Term) -> slice:
        """Return where a term's coefficients stand in the solution."""
        return self.linear.where[len(self._base) + self.terms.index(term)]

    def coefficients(self, term: Term) -> Array:
        """Return a term's coefficients (k,), of two sets those below the cut-off.

        Those of an effect are within its bounds, where their errors allow it.
        """
        coefficients = self.linear.theta[self.where(term)][: term.what.size]
        if not isinstance(term.what, Candidate):
            return coefficients
        first = self.where(term).start
        of_effect = slice(first, first + term.what.size)
        return within_bounds(
            term.what,
            coefficients,
            self.linear.covariance[of_effect, of_effect],
            term.part.precision[: term.what.size, : term.what.size],
            negligible_share=self.ground.options.negligible_share,
        )

    def variances(self, term: Term) -> Array:
        """Return the variance (k,) of these coefficients by the noise alone."""
        first = self.where(term).start
        return np.asarray(
            np.diag(self.linear.covariance)[first : first + term.what.size]
        )

    def covariance(self, term: Term) -> Array:
        """Return the covariance (k, k) of these coefficients.

        It is no narrower than they scatter over blocks. Where size and shape of an
        effect disagree, that is an error as well.
        """
        first = self.where(term).start
        at = slice(first, first + term.what.size)
        by_noise = self.linear.covariance[at, at]
        scatter = np.diag(self.linear.jackknife(at))
        ratio = scatter / np.maximum(np.diag(by_noise), 1e-300)
        widening = np.sqrt(np.maximum(ratio, 1.0))
        covariance = np.asarray(by_noise * np.outer(widening, widening))
        if isinstance(term.what, Candidate):
            size = float(self.linear.theta[at][0])
            covariance[0, 0] += (size * self._shape_error(term, term.what, size)) ** 2
        return covariance

    def _shape_error(self, term: Term, candidate: Candidate, size: float) -> float:
        """Return by which share a first coefficient is off, as its shape has another.

        The coefficient c depends on the size s by which its columns are shaped. Both
        are the same where log c(s) = log s: to first order that is, with the slope k of
        log c over log s, at log c + k / (1 - k) log(c / s).
        """
        in_shape = candidate.effect.size_in(candidate.settings)
        if in_shape is None or size <= 0.0:
            return 0.0
        apart = float(np.log(size / in_shape))

        # The shape may be so wrong that it tells nothing: then all of it is an error.
        tuner = self.ground.tuner(self.beside(term))
        logarithms = []
        for step in (-SHAPE_STEP, SHAPE_STEP):
            settings = candidate.effect.with_size(
                candidate.settings, in_shape * float(np.exp(step))
            )
            moved = tuner.tried([replace(candidate, settings=settings)])
            if not moved:
                return abs(apart)
            logarithms.append(np.log(float(moved[0].fit.coefficients[0])))
        slope = float(logarithms[1] - logarithms[0]) / (2.0 * SHAPE_STEP)
        share = slope / max(abs(1.0 - slope), 1e-3)
        return min(abs(share), 1.0) * abs(apart)

    def squares(self, term: Term, channels: frozenset[int]) -> float:
        """Return the weighted square of a term's torque beside the file at channels."""
        total = 0.0
        for channel in term.channels & channels:
            torque = self.linear.torque_beside_file(term.part, channel)
            total += float(self.noise.weight[channel] @ torque**2)
        return total

    def is_detail(self, term: Term) -> bool:
        """Return whether a term is small beside the torque of the model.

        That torque ends at the cut-off, and is none of links against their motors: a
        term that shows there is no detail.
        """
        n = self.ground.n
        if any(channel // n in (1, LINKS) for channel in term.channels):
            return False
        square_of_model = 0.0
        for channel in term.channels:
            torque = self.ground.torque[channel % n]
            square_of_model += float(self.noise.weight[channel] @ torque**2)
        return self.squares(term, term.channels) < DETAIL**2 * square_of_model

    # ---- what the model adds and leaves

    def beyond(self, before: Sequence[Array], channels: frozenset[int]) -> float:
        """Return the share of the squared error that goes where it was not fitted.

        Of what the file leaves: a model of a log that is too short takes off what its
        own freedom has added.

        Parameters
        ----------
        before : sequence of (M_c,) arrays
            By channel, the residual without the model [N m; N where prismatic].
        channels : frozenset of int
            Those that count.
        """
        sigma = self.noise.sigma

        def scaled_square(residual: Sequence[Array]) -> float:
            total = 0.0
            for channel in channels:
                r = residual[channel]
                total += float(r @ r) / float(sigma[channel]) ** 2
            return total

        square_left = scaled_square(self.linear.left_out)
        square_before = scaled_square(before)
        return float(1.0 - square_left / max(square_before, 1e-300))

    @cached_property
    def deviation(self) -> list[Array]:
        """What the base adds to the file's torque (N, n) N m, at all samples."""
        return self._deviation(self.linear.held)

    def _deviation(self, theta: Array) -> list[Array]:
        """Return the torque (N, n) N m of the base's part of parameters (p,)."""
        rigid, *friction = [theta[at] for at in self.linear.where[: 1 + self.ground.n]]
        return self.ground.base.deviation(rigid, friction, self._nuisances_in(theta))

    def shown(self, without: Term | None = None) -> list[Array]:
        """Return the torque (N, n) N m of all terms but one, by data set.

        It is what they are beside the file, which may have absorbed a part of them.
        """
        scenes = self.ground.stage.scenes
        total = [np.zeros_like(scene.motion.q) for scene in scenes]
        absorbed = np.zeros(self.linear.size)
        for term in self.terms:
            if term is without:
                continue
            for torque, scene in zip(total, scenes, strict=True):
                of_term = term.what.torques(scene, self.coefficients(term))
                for joint, of_joint in of_term.items():
                    torque[:, joint] += of_joint
            R = self.linear.in_file(term.part)
            absorbed += R @ self.linear.theta[self.where(term)]

        if not np.any(absorbed):
            return total
        in_file = self._deviation(absorbed)
        return [torque - part for torque, part in zip(total, in_file, strict=True)]

    def left(self, without: Term | None = None) -> list[Array]:
        """Return what is left (N, n) N m without a term, by data set.

        It is zero where a joint may stick.
        """
        residuals = []
        for of_scene, deviation, of_terms in zip(
            self.ground.base.scene_bases,
            self.deviation,
            self.shown(without),
            strict=True,
        ):
            residual = of_scene.residual - deviation - of_terms
            residuals.append(np.where(of_scene.scene.slides, residual, 0.0))
        return residuals

    def rms(self) -> Array:
        """Return the RMS (n,) N m of each joint's residual where it was not fitted."""
        below_cutoff = self.linear.left_out[: self.ground.n]
        return np.array([rms(residual) for residual in below_cutoff])


class PriorUpdate:
    """A solved model while parts of what is held get other precisions, one by one.

    With C the covariance of some of it, t their values and D what their precision P
    grows by, all by those of before, the log evidence grows by

        (log det(P + D) - log det P - log det(1 + D C) - t' (1 + D C)^-1 D t) / 2.
    """

    def __init__(self, linear: LinearModel) -> None:
        self.theta = linear.held
        self.covariance = linear.held_covariance
        self._rows_diagonal = np.diag(linear.sums[0])

    def evidence_gain(self, at: slice, before: Array, after: Array) -> float:
        """Return the log evidence that another precision of some parameters gains.

        Parameters
        ----------
        at : slice
            The k parameters.
        before, after : (k, k) arrays
            Their precisions.
        """
        t = self.theta[at]
        change, log_det = self._change(at, after - before)
        prior_gain = self._half_log_det(at, after) - self._half_log_det(at, before)
        return prior_gain - 0.5 * float(log_det + t @ change @ t)

    def hold(self, at: slice, before: Array, after: Array) -> None:
        """Give some parameters another precision (k, k) from now on."""
        C = self.covariance[:, at]
        change, _ = self._change(at, after - before)
        self.theta -= C @ (change @ self.theta[at])
        self.covariance -= C @ change @ C.T

    def _half_log_det(self, at: slice, precision: Array) -> float:
        """Return half the log determinant of a precision (k, k)."""
        scale = scale_of(np.diag(precision) + self._rows_diagonal[at])
        factor = factored(precision * np.outer(scale, scale))
        return half_log_det(factor) - float(np.log(scale).sum())

    def _change(self, at: slice, growth: Array) -> tuple[Array, float]:
        """Return (1 + D C)^-1 D, and the logarithm of the determinant of 1 + D C."""
        M = np.eye(len(growth)) + growth @ self.covariance[at, at]
        log_det = float(np.linalg.slogdet(M)[1])
        return np.asarray(np.linalg.solve(M, growth)), log_det
