"""Forward and backward selection of what a model lacks.

docs/explanation/discovery.md says which conditions admit a term, and how the base is
held to the file.

References: J. Piironen, A. Vehtari, "Comparison of Bayesian predictive methods for
model selection", Statistics and Computing 27, 2017; R. E. Kass, A. E. Raftery, "Bayes
factors", JASA 90, 1995.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from seqid_cli.discover.base import has_trials
from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.select.changes import MOST_ERRORS, value_changes
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import (
    FREE,
    HELD,
    Model,
    PriorScale,
    SelectionProblem,
)
from seqid_cli.discover.select.naming import reality, tied_names
from seqid_cli.discover.select.noise import Noise
from seqid_cli.discover.select.results import (
    Key,
    ScoredTerm,
    SelectionResult,
    TermInModel,
    TermResult,
    again,
)
from seqid_cli.discover.select.rows import ColumnGroup, scatter
from seqid_cli.discover.select.search import Search, is_wide
from seqid_cli.discover.select.seconds import worth_beside_larger
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.select.tuning import FittedTerm
from seqid_cli.effects.effect import FROM_LOG, Effect, Mirrored
from seqid_cli.effects.registry import catalogue_of
from seqid_cli.effects.scene import Scene
from seqid_cli.typing import Array

# Waves of a ripple over a joint's travel, up to which it is as smooth as what a law of
# the position gets wrong: the splines by which laws are looked for follow four.
FEW_WAVES = 4.0


def select(
    ground: SelectionProblem, catalogue: Sequence[Effect] | None = None
) -> Selection:
    """Select what the model lacks.

    Friction trials tell what a file has taken up of an effect. Without them the base is
    held in both ways at first, and the evidence chooses. A loose base takes up friction
    that has changed: terms of such a model are tried with the base held as the file
    says, too.

    Parameters
    ----------
    ground : SelectionProblem
        The problem.
    catalogue : sequence of Effect, optional
        What the model may lack; by default all effects.
    """
    catalogue = _known_effects(ground) if catalogue is None else catalogue
    held = Selection(Model(ground, HELD), catalogue)
    held.finish()
    if has_trials(ground.stage.scenes[0], None):
        return _best_of_all([held]).merged()

    free = Selection(Model(ground, FREE), catalogue)
    free.run()
    is_rescaled = free.model.rescale()
    best = _best_of_all([held, free])
    if free.keys == held.keys and best is held:
        return best.merged()

    if is_rescaled:
        free.eliminate()
        free.run()
        best = _best_of_all([held, free])
    if best.model.hold.doubt(ground.n) and best.keys != held.keys:
        held_model = best.model.held_otherwise(HELD, best.model.terms)
        again_held = Selection(held_model, catalogue)
        again_held.tied = dict(best.tied)
        again_held.finish()
        best = _best_of_all([again_held, held, free])
    return best.merged()


def _best_of_all(selections: Sequence[Selection]) -> Selection:
    """Return the selection of the best model.

    All are compared under the noise of the one that leaves least. The best one learns
    what the others have, and how far they are behind.
    """
    below = selections[0].model.ground.n  # channels below the cut-off
    noises = [selection.model.noise for selection in selections]
    least = min(noises, key=lambda noise: float(np.mean(np.log(noise.sigma[:below]))))
    worth = [selection.worth(least) for selection in selections]
    number = int(np.argmax(worth))
    best = selections[number]
    best.others = [
        _OtherModel(
            lag=max(worth[number] - worth_of_other, 0.0),
            terms=tuple(other.model.terms),
        )
        for other, worth_of_other in zip(selections, worth, strict=True)
        if other is not best
    ]
    return best


def select_among(
    ground: SelectionProblem, hold: PriorScale, candidates: Sequence[Candidate]
) -> Selection:
    """Begin with effects, and remove those that the model does not need.

    Parameters
    ----------
    ground : SelectionProblem
        The problem.
    hold : PriorScale
        How loosely the base is held to the file.
    candidates : sequence of Candidate
        The effects.
    """
    model = Model(ground, hold, candidates)
    selection = Selection(model, _known_effects(ground))
    selection.eliminate()
    return selection


def _known_effects(ground: SelectionProblem) -> tuple[Effect, ...]:
    return tuple(catalogue_of(ground.stage.scenes[0].robot).values())


class _OtherModel(NamedTuple):
    """Terms of another finished model, and the log evidence by which it is behind."""

    lag: float
    terms: tuple[Term, ...]


class Selection:
    """A model whose terms are added and removed, one by one.

    Parameters
    ----------
    model : Model
        It may have some terms to begin with.
    catalogue : sequence of Effect
        What the model may lack.

    Attributes
    ----------
    tied : dict of Key to list of Term
        By a term that was taken, the effects that were as good as it then.
    others : list of _OtherModel
        Other finished models.
    """

    def __init__(self, model: Model, catalogue: Sequence[Effect]) -> None:
        self.model = model
        self.options = model.ground.options
        self.catalogue = catalogue
        self.tied: dict[Key, list[Term]] = {}
        self.others: list[_OtherModel] = []
        self._search = Search(model, catalogue)
        self._last_tried: list[FittedTerm] = []
        # Changes of the file's values are told whatever stands beside, and some terms
        # of the model are not told because of them.
        self._value_changes: dict[Term, TermResult] = {}
        self._replaced_keys: set[Key] = set()

    def worth(self, noise: Noise) -> float:
        """Return the evidence under a noise, less what simpler models are granted.

        Every term must be better than chance, a smooth function better than effects by
        what is a tie, and standard errors of the file are not likely to be far too
        small.
        """
        model = self.model
        smooth_gain = sum(
            again(term, model).score.total for term in model.terms if term.smooth
        )
        granted = (
            self.options.negligible_share * smooth_gain
            + self.options.min_log_bayes_factor * len(model.terms)
        )
        doubt = model.hold.doubt(model.ground.n)
        return model.under(noise).evidence - (granted + doubt)

    @property
    def keys(self) -> set[Key]:
        """Names and joints of the model's terms."""
        return {term.key for term in self.model.terms}

    # ---- forward and backward

    def finish(self) -> None:
        """Select, hold the base as the evidence says, and go on."""
        self.run()
        if self.model.rescale():
            self.eliminate()
            self.run()

    def run(self) -> None:
        """Add terms, and after each step remove those that are not needed."""
        refused: set[Key] = set()
        while len(self.model.terms) < self.options.max_terms:
            terms = self._next_terms(refused)
            if not terms:
                return
            for term in terms:
                self._search.changed(term)
                self.model.terms.append(term)
            self.model.settle()
            self.model.polish()
            refused |= self.eliminate()

    def _next_terms(self, refused: set[Key]) -> list[Term]:
        """Return the term to take next, none where none is worth it.

        What a model lacks it often lacks at many joints: the same effect is taken at
        all of those at which it is the next one as well.
        """
        gaining = [
            fitted for fitted in self._search.everywhere() if fitted.evidence > 0.0
        ]
        self._last_tried = [
            fitted for fitted in gaining if fitted.term.key not in refused
        ]
        # Only these are scored: no fewer are worth it, and a score takes its time.
        likely = [
            fitted
            for fitted in self._last_tried
            if fitted.evidence > self.options.min_log_bayes_factor
        ]
        scored = _scored(self.model.linear, likely)
        passing = [candidate for candidate in scored if self._passes(candidate)]
        first = self._simplest(passing)
        if first is None:
            return []

        terms = [self._taken(first, passing)]
        room = self.options.max_terms - len(self.model.terms)
        for candidate in passing:
            is_same = candidate.term.name == first.term.name and not first.term.smooth
            channels = frozenset[int]().union(*(term.channels for term in terms))
            if not is_same or candidate.term.channels & channels or len(terms) == room:
                continue
            at_its_channels = [
                rival
                for rival in passing
                if rival.term.channels & candidate.term.channels
            ]
            if self._simplest(at_its_channels) is candidate:
                terms.append(self._taken(candidate, at_its_channels))
        return terms

    def _taken(self, chosen: ScoredTerm, passing: Sequence[ScoredTerm]) -> Term:
        """Return a term that is taken, and keep what ties with the best there."""
        self.tied[chosen.term.key] = [
            candidate.term
            for candidate in passing
            if self.as_good(candidate, passing[0]) and not candidate.term.smooth
        ]
        return chosen.term

    def _simplest(self, scored: Sequence[ScoredTerm]) -> ScoredTerm | None:
        """Return the term with the fewest parameters among those as good as the first.

        Of two with as many the one of the larger Bayes factor is taken.
        """
        near = [candidate for candidate in scored if self.as_good(candidate, scored[0])]
        return min(
            near,
            key=lambda each: (each.term.freedom, -each.fit.log_bayes_factor),
            default=None,
        )

    def _passes(self, candidate: ScoredTerm) -> bool:
        """Return whether a term is worth it."""
        options = self.options
        score = candidate.score
        is_sure = (
            candidate.fit.log_bayes_factor > options.min_log_bayes_factor
            and score.doubt < options.alpha
        )
        return is_sure and score.share > options.improvement

    def as_good(self, candidate: ScoredTerm, best: ScoredTerm) -> bool:
        """Return whether a term at one of the same channels is not clearly behind."""
        lag = best.score.total - candidate.score.total
        negligible = self.options.negligible_share * best.score.total
        is_near = lag <= negligible or self._is_behind_by_chance(candidate, best)
        return is_near and bool(candidate.term.channels & best.term.channels)

    def _is_behind_by_chance(self, candidate: ScoredTerm, best: ScoredTerm) -> bool:
        """Return whether a term is behind by no more than noise may make it."""
        lag = best.score.total - candidate.score.total
        # Standard errors by which the doubt is no more than that.
        n_errors = -float(ndtri(self.options.alpha))
        difference = best.score.part_gains - candidate.score.part_gains
        return lag <= max(n_errors * scatter(difference), 1.0)

    def eliminate(self) -> set[Key]:
        """Remove, the weakest first, what is not worth it beside all others."""
        model = self.model
        removed: set[Key] = set()
        while model.terms:
            scored = [again(term, model) for term in model.terms]
            failing = [each for each in scored if not self._passes(each)]
            if not failing:
                break
            weakest = min(failing, key=lambda each: each.score.total)
            self._search.changed(weakest.term)
            model.terms.remove(weakest.term)
            removed.add(weakest.term.key)
            model.settle()
        return removed

    # ---- one term in the place of two

    def merged(self) -> Selection:
        """Put one term in the place of two at one joint where it explains as much."""
        model = self.model
        for a, b in combinations(model.terms, 2):
            both_stay = a in model.terms and b in model.terms
            if not both_stay or not a.channels & b.channels:
                continue
            replacement = self._replacement_of(a, b)
            if replacement is not None:
                self._search.changed(a)
                model.terms[model.terms.index(a)] = replacement
                model.terms.remove(b)
                model.settle()
                model.polish()
        return self

    def _replacement_of(self, a: Term, b: Term) -> Term | None:
        """Return a tied alternative that explains as much as both terms, or None."""
        alternatives = []
        for taken in (a, b):
            for term in self.tied.get(taken.key, ()):
                if term.key not in self.keys:
                    alternatives.append(term)

        without_both = self.model.beside(a, b)
        gain_of_both = self.model.linear.evidence - without_both.evidence
        least = gain_of_both - self.options.min_log_bayes_factor
        fits = without_both.fits([term.part for term in alternatives])
        able = [
            term
            for term, fit in zip(alternatives, fits, strict=True)
            if fit.log_bayes_factor >= least
        ]
        return min(able, key=lambda term: term.freedom, default=None)

    # ---- what is told

    def told(self, least: float | None = None) -> SelectionResult:
        """Return what was taken, each term with its rivals.

        What may be the error of another term's law stays in the model, for that term's
        sake, and is not told. A simpler rival that does as well takes a term's place. A
        change of the file's values stands for what hides it.

        Parameters
        ----------
        least : float, optional
            Probability to be there from which a term is told; by default that of the
            options.
        """
        if least is None:
            least = self.options.min_confidence
        # Rivals are asked for at the terms' joints alone.
        n = self.model.ground.n
        channels = frozenset[int]().union(*(term.channels for term in self.model.terms))
        joints = {None, *(channel % n for channel in channels)}
        self.model.ground.forget_search(but_at=joints)
        scored = _scored(self.model.linear, self._last_tried)
        self._name_at_joints()
        by_simplest = self._results_by_simplest(least)
        with_changes = self._with_value_changes(by_simplest, least)
        judged = worth_beside_larger(
            self.model,
            {result.term: result for result in with_changes},
            self.options.min_confidence,
        )
        return SelectionResult(
            model=self.model,
            terms=tuple(judged.values()),
            visible_shares={
                key: share
                for key, share in self._search.visible.items()
                if key not in self.keys
            },
            untaken=tuple(each for each in scored if each.term.key not in self.keys),
        )

    def largest(self) -> SelectionResult:
        """Return the effect of the largest gain, and the same at other joints."""
        judged = [
            TermInModel(term, self.model)
            for term in self.model.terms
            if not term.smooth
        ]
        told = [each for each in judged if self.is_told(each, 0.0)]
        told.sort(key=lambda each: _by_gain(each.scored))
        same = [each for each in told if each.term.name == told[0].term.name]
        return SelectionResult(
            model=self.model,
            terms=tuple(self.result_of(each) for each in same),
            visible_shares={},
        )

    def alone_at(self, joint: int | None, bare: Model) -> list[ScoredTerm]:
        """Return what may be at a joint (None: the whole arm) beside a bare model.

        The largest gain comes first.
        """
        return _scored(bare.linear, self._search.at(joint, bare))

    def is_told(self, judged: TermInModel, least: float) -> bool:
        """Return whether a term is worth it beside all others, likely, and by itself.

        Parameters
        ----------
        judged : TermInModel
            The term in its model.
        least : float
            Probability to be there from which it is likely.
        """
        model = judged.model
        scored = judged.scored
        is_worth_it = self._passes(scored) and judged.share > self.options.improvement
        if not is_worth_it:
            return False
        is_likely = reality(judged.share, judged.evidence) >= least
        if not is_likely:
            return False

        # Not the error of a law either: the model's, or a term's that gains more.
        is_hidden = any(self._hides(other, scored, model) for other in model.terms)
        return not (is_hidden or model.is_detail(scored.term))

    def _with_value_changes(
        self, told: tuple[TermResult, ...], least: float
    ) -> tuple[TermResult, ...]:
        """Tell changes of the file's values in place of the terms that hide them.

        These stay in the model, for the sake of the other terms.
        """
        changes = value_changes(self, told, least)
        if not changes:
            return told

        model = self.model
        for change in changes:
            term = change.result.term
            keys = [term_of_model.key for term_of_model in model.terms]
            if term.key in keys:
                model.terms[keys.index(term.key)] = term
            else:
                model.terms.append(term)
            self._value_changes[term] = change.result
            self._replaced_keys |= {other.key for other in change.instead_of}
            self._search.changed(term)

        # What made the base leave the file is a term now.
        model.hold = model.hold.capped(MOST_ERRORS)
        model.settle()
        model.rescale()
        return tuple(self._results(least).values())

    def _results_by_simplest(self, least: float) -> tuple[TermResult, ...]:
        """Return the terms that are told, after they have given way to simpler ones."""
        model = self.model
        results = self._results(least)
        laws: dict[Term, Term] = {}
        for term in results:
            law = self._law_behind(term, results) if term.smooth else None
            if law is not None:
                laws[term] = law
        law_keys = {law.key for law in laws.values()}

        better: dict[Term, Term] = {}
        for term, result in results.items():
            if term in laws:
                better[term] = laws[term]
            elif term.key not in law_keys:  # else the law stands where the function did
                taken_keys = {other.key for other in better.values()}
                better[term] = self._heading(result, taken_keys)
        if all(best is term for term, best in better.items()):
            return tuple(results.values())

        new_keys = {best.key for term, best in better.items() if best is not term}
        staying = [
            term for term in model.terms if term in better or term.key not in new_keys
        ]
        model.terms = [better.get(term, term) for term in staying]
        model.settle()
        return tuple(self._results(least).values())

    def _results(self, least: float) -> dict[Term, TermResult]:
        """Return the result of every term of the model that is told."""
        results: dict[Term, TermResult] = {}
        for term in self.model.terms:  # one at a time: memory
            if term in self._value_changes:
                results[term] = self._value_changes[term]
                continue
            judged = TermInModel(term, self.model)
            if term.key not in self._replaced_keys and self.is_told(judged, least):
                results[term] = self.result_of(judged)
        return results

    def _law_behind(self, smooth: Term, told: Mapping[Term, TermResult]) -> Term | None:
        """Return an effect that a function hides, though it alone explains as much.

        Its law errs a little then, as no law is exactly the catalogue's. An effect that
        is told beside it and gains more is not hidden by it. None where there is no
        such effect.
        """
        model = self.model
        of_function = told[smooth].scored.score.total
        able: list[FittedTerm] = []
        for term in model.terms:
            is_beside = bool(term.channels & smooth.channels)
            if not isinstance(term.what, Candidate) or not is_beside:
                continue
            if term in told and told[term].scored.score.total >= of_function:
                continue
            neither = model.beside(smooth, term)
            gain_of_both = model.linear.evidence - neither.evidence
            least = (1.0 - self.options.negligible_share) * gain_of_both
            tuner = model.ground.tuner(neither)
            for start in tuner.tried([term.what]):
                alone = tuner.tuned(start)
                if alone.evidence >= least:
                    able.append(alone)
        if not able:
            return None
        return max(able, key=lambda fitted: fitted.evidence).term

    def _name_at_joints(self) -> None:
        """Name an effect of two joints at the one whose residual it explains most.

        Where both of its names do as well, the residual decides, and not noise. They
        differ in whose own friction turns with both joints: a name that is surely
        behind leaves that friction for another term to explain.
        """
        model = self.model
        for number, term in enumerate(model.terms):
            mirrored = _mirrored(term)
            if mirrored is None or (term.name, mirrored.joint) in self.keys:
                continue

            candidate = term.what
            assert isinstance(candidate, Candidate)
            assert candidate.joint is not None
            squares_here = model.squares(term, frozenset({candidate.joint}))
            squares_there = model.squares(term, frozenset({mirrored.joint}))
            if squares_there <= squares_here:
                continue
            without = model.beside(term)
            other = replace(candidate, joint=mirrored.joint, settings=mirrored.settings)
            tuner = model.ground.tuner(without)
            fitted = [tuner.tuned(start) for start in tuner.tried([other])]
            as_good = [
                scored
                for scored in _scored(without, fitted)
                if self._is_behind_by_chance(scored, again(term, model))
            ]
            if as_good:
                self._search.changed(term)
                model.terms[number] = as_good[0].term
                model.settle()

    def _heading(self, result: TermResult, taken_keys: set[Key]) -> Term:
        """Return the term that heads a finding, among it and rivals that do as well.

        The most probable name does. Of names that are tied with it one that says that
        the file's values have changed goes first, where logs show that they have: such
        a change adds no law. Then the one with the fewest parameters does.
        """
        keys = set(taken_keys)
        for term in self.model.terms:
            if term is not result.term and not is_wide(term):
                keys.add(term.key)
            # An effect of two joints has its joint already (see `_name_at_joints`):
            # at the other one it is no second effect.
            mirrored = _mirrored(term)
            if mirrored is not None:
                keys.add((term.name, mirrored.joint))

        free = [
            rival
            for rival in result.rivals
            if rival.term.key not in keys and self._passes(rival)
        ]
        near = [rival for rival in free if self.as_good(rival, free[0])]
        names = {rival.term.name for rival in near if not rival.term.smooth}
        tied = tied_names(result, names) if names else names
        heading = min(
            (each for each in near if each.term.smooth or each.term.name in tied),
            key=lambda each: (
                not self._has_changed(each.term),
                each.term.freedom,
                -each.fit.log_bayes_factor,
            ),
            default=result.scored,
        )
        return heading.term

    def _has_changed(self, term: Term) -> bool:
        """Return whether a term is a change of values that logs show.

        They do where the file's own trials tell what the values were, or where the
        change came between two logs.
        """
        if not isinstance(term.what, Candidate) or not term.change:
            return False
        scene = self.model.ground.stage.scenes[0]
        has_own_trials = term.joint is not None and has_trials(scene, term.joint)
        since_a_log = term.what.settings.get(FROM_LOG, 0.0) > 0.0
        return has_own_trials or since_a_log

    def result_of(self, judged: TermInModel) -> TermResult:
        """Return a term with its rivals."""
        term = judged.term
        rivals = [
            fitted
            for fitted in self._search.near(term, judged.linear)
            if fitted.term.channels & term.channels
            and fitted.evidence > 0.0
            and fitted.term.key != term.key
        ]
        scored_rivals = _scored(judged.linear, rivals)
        in_place = sorted([judged.scored, *scored_rivals], key=_by_gain)
        return TermResult(
            scored=judged.scored,
            rivals=tuple(in_place),
            left_without=judged.linear.left_out,
            evidence=judged.evidence,
            share=judged.share,
            model=judged.model,
            alternatives=self._in_other_models(term) | self._as_shares(judged),
            log_evidence_of_variation=judged.model.linear.varied(term.part),
            untried=self._untried(term, judged.model),
        )

    def _in_other_models(self, term: Term) -> dict[str, float]:
        """Return effects that other finished models have in a term's place.

        By name, with the log evidence by which these models are behind.
        """
        lags: dict[str, float] = {}
        for lag, other_terms in self.others:
            if term.key in {other.key for other in other_terms}:
                continue
            for other in other_terms:
                is_new = not other.smooth and other.key not in self.keys
                if is_new and other.channels & term.channels:
                    lags[other.name] = min(lag, lags.get(other.name, np.inf))
        return lags

    def _as_shares(self, judged: TermInModel) -> dict[str, float]:
        """Return effects that may be a share of another term of the joint.

        By name, with the log evidence by which they are behind. What differs between
        the directions goes with friction over the position, which a file without
        friction trials does not have.
        """
        model = judged.model
        joint = judged.term.joint
        lags: dict[str, float] = {}
        for effect in self.catalogue:
            if judged.term.name not in effect.alike or joint is None:
                continue
            key = (effect.share_of, joint)
            whole = next((term for term in model.terms if term.key == key), None)
            if whole is not None:
                part = self._shares_of(whole, effect, joint, model)
                (score,) = judged.linear.scores([part])
                lags[effect.name] = judged.scored.score.total - score.total
        return lags

    def _shares_of(
        self, whole: Term, effect: Effect, joint: int, model: Model
    ) -> ColumnGroup:
        """Return an effect as shares of a term, of friction, and of speed."""
        candidate = whole.what
        assert isinstance(candidate, Candidate)

        def columns(scene: Scene) -> dict[int, Array]:
            of_term = candidate.columns(scene)[joint] @ model.coefficients(whole)
            friction = scene.friction[:, joint]
            speed = scene.motion.dq[:, joint]
            # in the size of friction
            scaled_speed = (
                speed * np.linalg.norm(friction) / max(np.linalg.norm(speed), 1e-300)
            )
            along = np.stack([of_term, friction, scaled_speed], axis=1)
            return {joint: scene.sign[:, [joint]] * along}

        rows = model.ground.stage.rows
        return ColumnGroup(
            columns=rows.columns(map(columns, rows.scenes), effect.passes),
            precision=np.eye(3),
        )

    def _untried(self, term: Term, model: Model) -> tuple[str, ...]:
        """Return effects like a term that are no rivals and cannot be ruled out.

        These logs lack the channels to look for them, or they stand beside the term as
        the error of its law.
        """
        if not isinstance(term.what, Candidate):
            return ()
        scenes = model.ground.stage.scenes
        alike = term.what.effect.alike
        names = [
            effect.name
            for effect in self.catalogue
            if effect.name in alike and effect.possible(scenes, term.joint)
        ]
        beside = [
            other
            for other in model.terms
            if other.name in alike and other.joint == term.joint
        ]
        for other in beside:
            if self._hides(term, again(other, model), model):
                names.append(other.name)
        return tuple(dict.fromkeys(names))

    def _hides(self, term: Term, smaller: ScoredTerm, model: Model) -> bool:
        """Return whether a smaller term may be the error of a term's law."""
        channels = smaller.term.channels
        gain = smaller.score.total
        if term is smaller.term or not term.channels & channels:
            return False
        relative_error = self._error_of_law(term, smaller.term)
        square_of_error = relative_error**2 * model.squares(term, channels)
        # A gain of g nats stands for squares of 2 g.
        is_within_error = bool(2.0 * gain < square_of_error)
        return is_within_error and again(term, model).score.total > gain

    def _error_of_law(self, term: Term, beside: Term) -> float:
        """Return the share of a term's torque to which its law is known.

        It is known less well beside a term that looks like it.
        """
        small = self.options.negligible_share
        if not isinstance(term.what, Candidate):
            return small
        effect = term.what.effect
        if effect.exact:
            return 0.0
        if isinstance(beside.what, Candidate):
            is_elsewhere = term.name == beside.name and term.joint != beside.joint
            is_alike = (
                beside.name in effect.alike
                or term.name in beside.what.effect.alike
                or self._are_of_position(term, beside)
            )
            # Where motor and link move apart no column of the rigid body is where it
            # seems: a change of the body is alike as well.
            if effect.apart and (is_elsewhere or is_alike or beside.change):
                return self.options.apart
            if is_elsewhere or is_alike:
                return float(np.sqrt(small))
        return small

    def _are_of_position(self, term: Term, beside: Term) -> bool:
        """Return whether one is a function of position, the other a few waves over it.

        Such waves bend with what the function's law gets wrong.
        """
        function = term.what
        ripple = beside.what
        if not isinstance(function, Candidate) or not isinstance(ripple, Candidate):
            return False
        joint = function.joint
        if joint is None or joint != ripple.joint or function.effect.sided:
            return False
        scenes = self.model.ground.stage.scenes
        waves = ripple.effect.waves(scenes, joint, ripple.settings)
        return function.effect.over == "position" and waves <= FEW_WAVES


def _mirrored(term: Term) -> Mirrored | None:
    """Return how another joint may say the same as an effect of one joint."""
    candidate = term.what
    if not isinstance(candidate, Candidate) or candidate.joint is None:
        return None
    return candidate.effect.mirrored(candidate.joint, candidate.settings)


def _scored(
    linear: LinearModel, fitted_terms: Sequence[FittedTerm]
) -> list[ScoredTerm]:
    """Score terms, the largest gain on blocks that were left out first."""
    scores = linear.scores([fitted.term.part for fitted in fitted_terms])
    scored = [
        ScoredTerm(term=fitted.term, fit=fitted.fit, score=score)
        for fitted, score in zip(fitted_terms, scores, strict=True)
    ]
    return sorted(scored, key=_by_gain)


def _by_gain(scored: ScoredTerm) -> float:
    return -scored.score.total
