"""What a model may lack next: effects at their best settings and smooth functions.

Where a term was added or removed all is searched anew. Elsewhere the terms that were
the best of their joint stay candidates, and only what they gain is worked out again.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from seqid_cli.discover.candidates import Candidate, candidates_of
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.results import Key
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.select.tuning import FittedTerm, Tuner, best_of, shape_of
from seqid_cli.effects.effect import Effect

LEAST_VISIBLE = 4e-4  # share of a term's square that the base leaves
SHORTLIST = 14  # effects, of which settings are searched and blocks are left out
SMOOTH_SHORTLIST = 3  # smooth functions per joint


@dataclass
class _Shape:
    """An effect at a joint with settings of one kind; whether others were searched."""

    term: Term
    is_searched: bool = False


class Search:
    """Candidates for a model's next term.

    Parameters
    ----------
    model : Model
        The model as it grows.
    catalogue : sequence of Effect
        What it may lack.

    Attributes
    ----------
    visible : dict of Key to float
        The largest share of each effect's square that the base does not absorb.
    """

    def __init__(self, model: Model, catalogue: Sequence[Effect]) -> None:
        self.model = model
        self.catalogue = catalogue
        self.visible: dict[Key, float] = {}
        self._shapes: dict[int | None, list[_Shape]] = {}
        self._smooth: dict[int | None, list[Term]] = {}

    def changed(self, term: Term) -> None:
        """Forget the candidates at joints of which a term is added or removed."""
        for joint in self._joints_of(term):
            self._shapes.pop(joint, None)
            self._smooth.pop(joint, None)

    def _joints_of(self, term: Term) -> set[int | None]:
        n = self.model.ground.n
        return {None, *(channel % n for channel in term.channels)}

    def everywhere(self) -> list[FittedTerm]:
        """Return what may be taken next at all joints; nothing that the model has."""
        # A joint may have several ripples, and lines in time: one more may be taken.
        keys = {term.key for term in self.model.terms}
        single_keys = {term.key for term in self.model.terms if not is_wide(term)}
        return [*self._effects(single_keys), *self._functions(keys)]

    def near(self, term: Term, linear: LinearModel) -> list[FittedTerm]:
        """Return what may be in the place of a term, beside a model without it."""
        candidates = self._candidates(self._joints_of(term), without=term)
        return [
            *self._best_of(candidates, linear),
            *self._first_functions(linear, term.channels),
        ]

    def at(self, joint: int | None, bare: Model) -> list[FittedTerm]:
        """Return what may be at a joint (None: the whole arm) beside a bare model."""
        joints = range(bare.ground.n) if joint is None else (joint,)
        functions = self._first_functions(bare.linear, frozenset(joints))
        return [*self.effects_at(joint, bare), *functions]

    def effects_at(self, joint: int | None, bare: Model) -> list[FittedTerm]:
        """Return the effects that may be at a joint beside a bare model."""
        scenes = bare.ground.stage.scenes
        candidates = list(candidates_of(scenes, self.catalogue, bare.left(), {joint}))
        return self._best_of(candidates, bare.linear)

    def _best_of(
        self, candidates: Sequence[Candidate], linear: LinearModel
    ) -> list[FittedTerm]:
        """Return the best candidates beside a model, each at its best settings."""
        tuner = self._tuner(linear)
        shortlist, reach = _shortlist(best_of(tuner.tried(candidates), shape_of))
        tuned = [
            tuner.tuned(fitted) if fitted.evidence > reach else fitted
            for fitted in shortlist
        ]
        return _best_settings(tuned)

    def _effects(self, excluded: Collection[Key]) -> list[FittedTerm]:
        """Return the best effects, each at its best settings."""
        tuner = self._tuner(self.model.linear)
        shape_of_term = {
            shape.term: shape for shapes in self._shapes.values() for shape in shapes
        }
        fitted = tuner.fitted(shape_of_term)

        # Joints at which something has changed are searched anew, over the whole grid.
        joints: set[int | None] = {None, *range(self.model.ground.n)}
        stale_joints = {joint for joint in joints if joint not in self._shapes}
        if stale_joints:
            tried = tuner.tried(self._candidates(stale_joints))
            self.visible |= _largest_visible_shares(tried)
            for joint in stale_joints:
                self._shapes[joint] = []
            for best in best_of(tried, shape_of):
                shape = _Shape(best.term)
                shape_of_term[best.term] = shape
                self._shapes[best.term.joint].append(shape)
                fitted.append(best)

        free = [each for each in fitted if each.term.key not in excluded]
        shortlist, reach = _shortlist(free)
        for number, each in enumerate(shortlist):
            shape = shape_of_term[each.term]
            if not shape.is_searched and each.evidence > reach:
                shortlist[number] = tuner.tuned(each)
                shape.term = shortlist[number].term
                shape.is_searched = True
        return _best_settings(shortlist)

    def _functions(self, excluded: Collection[Key]) -> list[FittedTerm]:
        """Return the best smooth functions of every joint."""
        linear = self.model.linear
        stale_joints = frozenset(
            joint for joint in range(self.model.ground.n) if joint not in self._smooth
        )
        new = self._first_functions(linear, stale_joints, excluded)
        earlier = [
            term
            for terms in self._smooth.values()
            for term in terms
            if term.key not in excluded
        ]
        for joint in stale_joints:
            self._smooth[joint] = [
                fitted.term for fitted in new if fitted.term.joint == joint
            ]
        return [*new, *_fitted(linear, earlier)]

    def _first_functions(
        self,
        linear: LinearModel,
        channels: frozenset[int],
        excluded: Collection[Key] = (),
    ) -> list[FittedTerm]:
        """Return the smooth functions of the largest evidence at some joints.

        Functions of two quantities are asked for where one of a single quantity
        explains anything (marginality: J. A. Nelder, Journal of the Royal Statistical
        Society A 140, 1977).
        """
        ground = self.model.ground
        best: list[FittedTerm] = []
        for joint in joints_below(channels, ground.n):
            at_joint: list[FittedTerm] = []
            for products in (False, True):
                if products and not any(each.evidence > 0.0 for each in at_joint):
                    continue
                terms = ground.smooth_terms(joint, products=products)
                free = [term for term in terms if term.key not in excluded]
                at_joint += _fitted(linear, free)
            at_joint.sort(key=lambda each: -each.evidence)
            shortlist = at_joint[:SMOOTH_SHORTLIST]
            absorbed = ground.absorbed_terms([each.term for each in shortlist])
            both_ways = [*shortlist, *_fitted(linear, absorbed)]
            best += best_of(both_ways, lambda each: each.term.key)
        return best

    def _tuner(self, linear: LinearModel) -> Tuner:
        return self.model.ground.tuner(linear)

    def _candidates(
        self, joints: Collection[int | None], without: Term | None = None
    ) -> list[Candidate]:
        residual = self.model.left(without=without)
        scenes = self.model.ground.stage.scenes
        return list(candidates_of(scenes, self.catalogue, residual, joints))


def _fitted(linear: LinearModel, terms: Sequence[Term]) -> list[FittedTerm]:
    """Fit terms beside a model."""
    fits = linear.fits([term.part for term in terms])
    return [FittedTerm(term, fit) for term, fit in zip(terms, fits, strict=True)]


def _largest_visible_shares(tried: Iterable[FittedTerm]) -> dict[Key, float]:
    """Return the largest visible share of each effect that no file has absorbed."""
    largest: dict[Key, float] = {}
    for fitted in tried:
        if not fitted.candidate.absorbed:
            key = fitted.term.key
            largest[key] = max(largest.get(key, 0.0), fitted.fit.visible_share)
    return largest


def _best_settings(fitted: Sequence[FittedTerm]) -> list[FittedTerm]:
    """Return each effect once at each joint, together with and apart from above."""
    return best_of(fitted, lambda each: (*each.term.key, each.candidate.apart))


class _Shortlist(NamedTuple):
    """The best effects, and the evidence above which settings are worth a search."""

    terms: list[FittedTerm]
    reach: float


def _shortlist(fitted: Iterable[FittedTerm], *, close: float = 0.5) -> _Shortlist:
    """Return the effects of the largest evidence that the base does not absorb.

    Settings of those are searched whose evidence is a share `close` of the best one's.
    """
    visible = [each for each in fitted if each.fit.visible_share > LEAST_VISIBLE]
    best = sorted(visible, key=lambda each: -each.evidence)[:SHORTLIST]
    largest = max((each.evidence for each in best), default=0.0)
    return _Shortlist(terms=best, reach=close * largest)


def is_wide(term: Term) -> bool:
    """Return whether a joint may have several of it: a ripple, a line in time."""
    return isinstance(term.what, Candidate) and term.what.effect.wide
