"""What a model may lack next: effects at their best settings and smooth functions, joint by joint.

Where a term was taken or taken back all is searched anew. Elsewhere what came first
stays, and only what it gains is another now.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from seqid_cli.discover.candidates import Candidate, candidates_of
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.results import Key
from seqid_cli.discover.select.rows import joints_below
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.select.tuning import FittedTerm, Tuner, best_of, shape_of
from seqid_cli.model.effects.effect import Effect

LEAST_VISIBLE = 4e-4  # share of a term's square that the base leaves
SHORTLIST = 14  # effects, of which settings are searched and blocks are left out
SMOOTH_SHORTLIST = 3  # smooth functions per joint


@dataclass
class _Shape:
    """An effect at a joint with settings of one kind; whether the others have been searched."""

    term: Term
    searched: bool = False


class Search:
    """Candidates for a model's next term; `visible` is the largest share of each effect."""

    def __init__(self, model: Model, catalogue: Sequence[Effect]) -> None:
        self.model, self.catalogue = model, catalogue
        self.visible: dict[Key, float] = {}
        self._shapes: dict[int | None, list[_Shape]] = {}
        self._smooth: dict[int | None, list[Term]] = {}

    def changed(self, term: Term) -> None:
        """Forget the candidates at joints of which a term is taken or taken back."""
        for joint in self._joints_of(term):
            self._shapes.pop(joint, None)
            self._smooth.pop(joint, None)

    def _joints_of(self, term: Term) -> set[int | None]:
        return {None, *(c % self.model.ground.n for c in term.channels)}

    def everywhere(self) -> list[FittedTerm]:
        """What may be taken next at all joints; nothing that the model has."""
        terms = self.model.terms
        effects = self._effects({term.key for term in terms if not is_wide(term)})
        return [*effects, *self._functions({term.key for term in terms})]

    def near(self, term: Term, linear: LinearModel) -> list[FittedTerm]:
        """What may be at the place of a term, beside a model without it."""
        candidates = self._candidates(self._joints_of(term), but=term)
        return [
            *self._best_of(candidates, linear),
            *self._first_functions(linear, term.channels),
        ]

    def at(self, joint: int | None, bare: Model) -> list[FittedTerm]:
        """What may be at a joint (None: of the whole arm) beside a model that has nothing there."""
        joints = range(bare.ground.n) if joint is None else (joint,)
        functions = self._first_functions(bare.linear, frozenset(joints))
        return [*self.effects_at(joint, bare), *functions]

    def effects_at(self, joint: int | None, bare: Model) -> list[FittedTerm]:
        """The effects among these."""
        scenes = bare.ground.stage.scenes
        candidates = list(candidates_of(scenes, self.catalogue, bare.left(), {joint}))
        return self._best_of(candidates, bare.linear)

    def _best_of(
        self, candidates: Sequence[Candidate], linear: LinearModel
    ) -> list[FittedTerm]:
        """Effects at their best settings beside a model."""
        tuner = self._tuner(linear)
        first, reach = _shortlist(best_of(tuner.tried(candidates), shape_of))
        found = [tuner.tuned(one) if one.evidence > reach else one for one in first]
        return _best_settings(found)

    def _effects(self, had: Collection[Key]) -> list[FittedTerm]:
        """Effects, each at its best settings."""
        tuner, n = self._tuner(self.model.linear), self.model.ground.n
        known = {shape.term: shape for some in self._shapes.values() for shape in some}
        now = tuner.fitted(known)
        joints = {j for j in (None, *range(n)) if j not in self._shapes}
        if joints:
            tried = tuner.tried(self._candidates(joints))
            visible = dict[Key, float]()
            for one in (one for one in tried if not one.candidate.absorbed):
                visible[one.term.key] = max(
                    visible.get(one.term.key, 0.0), one.fit.visible_share
                )
            self.visible |= visible
            self._shapes |= {joint: [] for joint in joints}
            for one in best_of(tried, shape_of):
                known[one.term] = _Shape(one.term)
                self._shapes[one.term.joint].append(known[one.term])
                now.append(one)
        first, reach = _shortlist([one for one in now if one.term.key not in had])
        for number, one in enumerate(first):
            shape = known[one.term]
            if not shape.searched and one.evidence > reach:
                first[number] = tuner.tuned(one)
                shape.term, shape.searched = first[number].term, True
        return _best_settings(first)

    def _functions(self, had: Collection[Key]) -> list[FittedTerm]:
        """Smooth functions, the first ones of every joint."""
        linear, n = self.model.linear, self.model.ground.n
        changed = frozenset(j for j in range(n) if j not in self._smooth)
        anew = self._first_functions(linear, changed, had)
        same = [t for some in self._smooth.values() for t in some if t.key not in had]
        for j in changed:
            self._smooth[j] = [one.term for one in anew if one.term.joint == j]
        return [*anew, *_tried(linear, same)]

    def _first_functions(
        self, linear: LinearModel, channels: frozenset[int], had: Collection[Key] = ()
    ) -> list[FittedTerm]:
        """The smooth functions of the largest evidence at some joints.

        Functions of two quantities are asked for where one of a single quantity
        explains anything (marginality: J. A. Nelder, Journal of the Royal Statistical
        Society A 140, 1977).
        """
        ground, found = self.model.ground, list[FittedTerm]()
        for j in joints_below(channels, ground.n):
            own = list[FittedTerm]()
            for products in (False, True):
                if not products or any(one.evidence > 0.0 for one in own):
                    terms = ground.smooth_terms(j, products=products)
                    own += _tried(
                        linear, [term for term in terms if term.key not in had]
                    )
            found += sorted(own, key=lambda one: -one.evidence)[:SMOOTH_SHORTLIST]
        return found

    def _tuner(self, linear: LinearModel) -> Tuner:
        return Tuner(self.model.ground.stage, linear, self.model.ground.size)

    def _candidates(
        self, joints: Collection[int | None], but: Term | None = None
    ) -> list[Candidate]:
        left, scenes = self.model.left(without=but), self.model.ground.stage.scenes
        return list(candidates_of(scenes, self.catalogue, left, joints))


def _tried(linear: LinearModel, terms: Sequence[Term]) -> list[FittedTerm]:
    return list(map(FittedTerm, terms, linear.fits([term.part for term in terms])))


def _best_settings(tried: Sequence[FittedTerm]) -> list[FittedTerm]:
    return best_of(tried, lambda t: (*t.term.key, t.candidate.apart))


def _shortlist(
    tried: Iterable[FittedTerm], *, close: float = 0.5
) -> tuple[list[FittedTerm], float]:
    """Those of the largest evidence that are seen, and the evidence from which one is `close`."""
    seen = [t for t in tried if t.fit.visible_share > LEAST_VISIBLE]
    first = sorted(seen, key=lambda t: -t.evidence)[:SHORTLIST]
    return first, close * max((t.evidence for t in first), default=0.0)


def is_wide(term: Term) -> bool:
    """Whether it is an effect of which a joint may have several: a ripple, a line in time."""
    return isinstance(term.what, Candidate) and term.what.effect.wide
