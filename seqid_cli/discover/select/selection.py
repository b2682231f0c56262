"""Forward and backward selection of what a model lacks.

docs/explanation/discovery.md says which conditions admit a term, and how the base is
held to the file.

References: J. Piironen, A. Vehtari, "Comparison of Bayesian predictive methods for
model selection", Statistics and Computing 27, 2017; R. E. Kass, A. E. Raftery, "Bayes
factors", JASA 90, 1995.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from seqid_cli.discover.base import has_trials
from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.select.changes import MOST_ERRORS, value_changes
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import FREE, HELD, Ground, Model, PriorScale
from seqid_cli.discover.select.naming import TOLD, probable_names, reality
from seqid_cli.discover.select.noise import Noise
from seqid_cli.discover.select.options import Options
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
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.select.tuning import FittedTerm, Tuner
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.registry import catalogue_of
from seqid_cli.model.effects.scene import Scene
from seqid_cli.typing import Array


def select(
    ground: Ground,
    options: Options | None = None,
    catalogue: Sequence[Effect] | None = None,
) -> Selection:
    """Select what the model lacks.

    Friction trials tell what a file has taken up of an effect. Without them the base is
    held in both ways at first, and the evidence chooses. A loose base takes up friction
    that has changed: terms of such a model are tried with the base held as the file
    says, too.
    """
    catalogue = _known(ground) if catalogue is None else catalogue
    options = options or Options()
    first = Selection(Model(ground, HELD), options, catalogue)
    first.finish()
    if has_trials(ground.stage.scenes[0], None):
        return _best_of_all([first]).merged()
    other = Selection(Model(ground, FREE), options, catalogue)
    other.run()
    changes = other.model.rescale()
    best = _best_of_all([first, other])
    if other.keys == first.keys and best is first:
        return best.merged()
    if changes:
        other.eliminate()
        other.run()
        best = _best_of_all([first, other])
    if best.model.hold.doubt(ground.n) and best.keys != first.keys:
        held = Selection(Model(ground, HELD), options, catalogue)
        held.model.terms, held._tied = list(best.model.terms), dict(best._tied)
        held.model.settle()
        held.finish()
        best = _best_of_all([held, first, other])
    return best.merged()


def _best_of_all(every: Sequence[Selection]) -> Selection:
    """The selection of the best model, all under the noise of the one that leaves least."""
    below = every[0].model.ground.n  # channels below the cut-off
    noises = [one.model.noise for one in every]
    least = min(noises, key=lambda noise: float(np.mean(np.log(noise.sigma[:below]))))
    worth = [one.worth(least) for one in every]
    number = int(np.argmax(worth))
    best, behind = every[number], (worth[number] - value for value in worth)
    best.others = [
        (max(b, 0.0), tuple(x.model.terms)) for b, x in zip(behind, every, strict=True)
    ]
    return best


def select_among(
    ground: Ground, hold: PriorScale, candidates: Sequence[Candidate]
) -> Selection:
    """Begin with effects, and take back those that the model does not need."""
    among = Selection(Model(ground, hold, candidates), Options(), _known(ground))
    among.eliminate()
    return among


def _known(ground: Ground) -> tuple[Effect, ...]:
    return tuple(catalogue_of(ground.stage.scenes[0].robot).values())


class Selection:
    """Terms are taken and taken back, one by one; the model may have some to begin with."""

    def __init__(
        self, model: Model, options: Options, catalogue: Sequence[Effect]
    ) -> None:
        self.model, self.options, self.catalogue = model, options, catalogue
        self._search = Search(model, catalogue)
        self._tried: list[FittedTerm] = []
        self._tied: dict[Key, list[Term]] = {}
        # Terms of other finished models, and the log evidence by which these are
        # behind.
        self.others: list[tuple[float, tuple[Term, ...]]] = []
        # terms that are told whatever stands beside
        self._value_changes: dict[Term, TermResult] = {}
        self._stood_for: set[Key] = set()  # what they are told in place of

    def worth(self, noise: Noise) -> float:
        """Evidence under a noise, less what simpler models are granted.

        Every term must be better than chance, a smooth function better than effects by
        what is a tie, and standard errors of the file are not likely to be far too
        small.
        """
        model, options = self.model, self.options
        gained = [again(term, model).score.total for term in model.terms if term.smooth]
        granted = options.small * sum(gained) + options.chance * len(model.terms)
        return model.under(noise).evidence - (
            granted + model.hold.doubt(model.ground.n)
        )

    @property
    def keys(self) -> set[Key]:
        """What the model has."""
        return {term.key for term in self.model.terms}

    def finish(self) -> None:
        """Select, hold the base as the evidence says, and go on."""
        self.run()
        if self.model.rescale():
            self.eliminate()
            self.run()

    def merged(self) -> Selection:
        """Put one term in the place of two at one joint where it explains as much."""
        model = self.model
        for a, b in combinations(model.terms, 2):
            there = a in model.terms and b in model.terms
            one = self._instead(a, b) if there and a.channels & b.channels else None
            if one is not None:
                self._search.changed(a)
                model.terms[model.terms.index(a)] = one
                model.terms.remove(b)
                model.settle()
                model.polish()
        return self

    def _instead(self, a: Term, b: Term) -> Term | None:
        """What was as good as one of two terms, and explains as much as both."""
        tied = [
            c
            for one in (a, b)
            for c in self._tied.get(one.key, ())
            if c.key not in self.keys
        ]
        linear = self.model.beside(a, b)
        least = self.model.linear.evidence - linear.evidence - self.options.chance
        gained = linear.fits([c.part for c in tied])
        able = [
            c for c, g in zip(tied, gained, strict=True) if g.log_bayes_factor >= least
        ]
        return min(able, key=lambda term: term.freedom, default=None)

    def run(self) -> None:
        """Forward, and backward after each step."""
        refused: set[Key] = set()
        while len(self.model.terms) < self.options.most:
            best = self._best(refused)
            if best is None:
                return
            self._search.changed(best)
            self.model.terms.append(best)
            self.model.settle()
            self.model.polish()
            refused |= self.eliminate()

    def _best(self, refused: set[Key]) -> Term | None:
        """The term to take next; none where none is worth it."""
        every = [one for one in self._search.everywhere() if one.evidence > 0.0]
        self._tried = [one for one in every if one.term.key not in refused]
        likely = [one for one in self._tried if one.evidence > self.options.chance]
        able = [one for one in _ranked(self.model.linear, likely) if self._passes(one)]
        best = self._simplest(able)
        if best is None:
            return None
        tied = [one.term for one in able if self.as_good(one, able[0])]
        self._tied[best.term.key] = [term for term in tied if not term.smooth]
        return best.term

    def _simplest(self, ranked: Sequence[ScoredTerm]) -> ScoredTerm | None:
        """Of the best and those that are as good the one with the fewest parameters."""
        near = [one for one in ranked if self.as_good(one, ranked[0])]
        return min(
            near,
            key=lambda one: (one.term.freedom, -one.fit.log_bayes_factor),
            default=None,
        )

    def _passes(self, one: ScoredTerm) -> bool:
        """Whether a term is worth it."""
        options, told = self.options, one.score
        sure = one.fit.log_bayes_factor > options.chance and told.doubt < options.doubt
        return sure and told.share > options.improvement

    def as_good(self, one: ScoredTerm, best: ScoredTerm) -> bool:
        """Whether a term at one of the same channels is not clearly behind the best."""
        options, first, own = self.options, best.score, one.score
        # standard ones, by which doubt is no more than that
        errors = -float(ndtri(options.doubt))
        chance = errors * scatter(first.block_gains - own.block_gains)
        near = first.total - own.total <= max(chance, options.small * first.total, 1.0)
        return near and bool(one.term.channels & best.term.channels)

    def eliminate(self) -> set[Key]:
        """Take back, the weakest first, what is not worth it beside all others."""
        model, gone = self.model, set[Key]()
        while model.terms:
            every = [again(term, model) for term in model.terms]
            weak = [one for one in every if not self._passes(one)]
            if not weak:
                break
            weakest = min(weak, key=lambda one: one.score.total)
            self._search.changed(weakest.term)
            model.terms.remove(weakest.term)
            gone.add(weakest.term.key)
            model.settle()
        return gone

    def told(self, least: float = TOLD) -> SelectionResult:
        """What was taken, each term with its rivals.

        Without what is less likely than `least` to be there. What may be the error of
        another term's law stays in the model, for that term's sake, and is not told. A
        simpler rival that does as well takes a term's place. A change of the file's
        values stands for what hides it.
        """
        tried = _ranked(self.model.linear, self._tried)
        told = self._with_value_changes(self._all_taken(least), least)
        hidden = {
            k: share for k, share in self._search.visible.items() if k not in self.keys
        }
        left = tuple(one for one in tried if one.term.key not in self.keys)
        return SelectionResult(self.model, told, hidden, left)

    def _with_value_changes(
        self, told: tuple[TermResult, ...], least: float
    ) -> tuple[TermResult, ...]:
        """Tell changes of the file's values in place of the terms that hide them.

        These stay in the model, for the sake of the other terms.
        """
        found = value_changes(self, told, least)
        if not found:
            return told
        model = self.model
        for change in found:
            term = change.taken.term
            keys = [one.key for one in model.terms]
            if term.key in keys:
                model.terms[keys.index(term.key)] = term
            else:
                model.terms.append(term)
            self._value_changes[term] = change.taken
            self._stood_for |= {one.key for one in change.instead_of}
            self._search.changed(term)
        # what made it leave the file is a term now
        model.hold = model.hold.capped(MOST_ERRORS)
        model.settle()
        model.rescale()
        return tuple(self._told_now(least).values())

    def alone_at(self, joint: int | None, bare: Model) -> list[ScoredTerm]:
        """What may be at a joint (None: the whole arm) beside a model, the largest gain first."""
        return _ranked(bare.linear, self._search.at(joint, bare))

    def largest(self) -> SelectionResult:
        """Return the effect of the largest gain, with its rivals, and the same at other joints."""
        weighed = [
            TermInModel(term, self.model)
            for term in self.model.terms
            if not term.smooth
        ]
        told = [own for own in weighed if self.is_told(own, 0.0)]
        told.sort(key=lambda own: _by_gain(own.scored))
        alike = [own for own in told if own.term.name == told[0].term.name]
        return SelectionResult(self.model, tuple(map(self.taken_of, alike)), {})

    def is_told(self, own: TermInModel, least: float) -> bool:
        """Whether a term is worth it beside all others, likely, and by itself."""
        model, one = own.model, own.scored
        worth = self._passes(one) and own.share > self.options.improvement
        if not (worth and reality(own.share, own.evidence) >= least):
            return False
        # Not the error of a law either: the model's, or a term's that gains more.
        hidden = any(self._hides(other, one, model) for other in model.terms)
        return not (hidden or model.is_detail(one.term))

    def _all_taken(self, least: float) -> tuple[TermResult, ...]:
        """Terms that are told, with their rivals; they give way to simpler ones."""
        model, told, better = self.model, self._told_now(least), dict[Term, Term]()
        for term, one in told.items():
            law = self._law_of(term, told) if term.smooth else None
            better[term] = law or self._better(
                one, {other.key for other in better.values()}
            )
        if all(best is term for term, best in better.items()):
            return tuple(told.values())
        anew = {best.key for term, best in better.items() if best is not term}
        kept = [term for term in model.terms if term in told or term.key not in anew]
        model.terms = [better.get(term, term) for term in kept]
        model.settle()
        return tuple(self._told_now(least).values())

    def _told_now(self, least: float) -> dict[Term, TermResult]:
        told = dict[Term, TermResult]()
        for term in self.model.terms:  # one at a time: memory
            if term in self._value_changes:
                told[term] = self._value_changes[term]
                continue
            weighed = TermInModel(term, self.model)
            if term.key not in self._stood_for and self.is_told(weighed, least):
                told[term] = self.taken_of(weighed)
        return told

    def _law_of(self, smooth: Term, told: Collection[Term]) -> Term | None:
        """An effect that a function hides, though it alone explains as much: its law errs."""
        model, found = self.model, list[FittedTerm]()
        for term in model.terms:
            what, beside = term.what, term.channels & smooth.channels
            if isinstance(what, Candidate) and beside and term not in told:
                neither = model.beside(smooth, term)
                least = (1.0 - self.options.small) * (
                    model.linear.evidence - neither.evidence
                )
                tuner = Tuner(model.ground.stage, neither, model.ground.size)
                alone = [tuner.tuned(one) for one in tuner.tried([what])]
                found += [one for one in alone if one.evidence >= least]
        return max(found, key=lambda one: one.evidence).term if found else None

    def _better(self, taken: TermResult, gone: set[Key]) -> Term:
        """The simplest of a term and of its rivals that do as well."""
        terms = self.model.terms
        keys = gone | {
            one.key for one in terms if one is not taken.term and not is_wide(one)
        }
        probable = probable_names(taken)
        free = [
            rival
            for rival in taken.rivals
            if rival.term.key not in keys
            and self._passes(rival)
            and (rival.term.smooth or rival.term.name in probable)
        ]
        return (self._simplest(free) or taken.scored).term

    def taken_of(self, own: TermInModel) -> TermResult:
        """A term and its rivals."""
        term, linear, one = own.term, own.linear, own.scored
        near = [
            x
            for x in self._search.near(term, linear)
            if x.term.channels & term.channels
        ]
        rivals = [x for x in near if x.evidence > 0.0 and x.term.key != term.key]
        ranked = tuple(sorted([one, *_ranked(linear, rivals)], key=_by_gain))
        instead = self._instead_of(term) | self._as_share(own)
        return TermResult(
            scored=one,
            rivals=ranked,
            left_without=linear.left_out,
            evidence=own.evidence,
            share=own.share,
            model=own.model,
            alternatives=instead,
            log_evidence_of_variation=own.model.linear.varied(term.part),
            untried=self._untried(term, own.model),
        )

    def _instead_of(self, term: Term) -> dict[str, float]:
        """Effects that other finished models have instead; how far these are behind, by name."""
        found = dict[str, float]()
        for behind, terms in self.others:
            other = term.key not in {one.key for one in terms}
            for one in (
                x for x in terms if other and not x.smooth and x.key not in self.keys
            ):
                if one.channels & term.channels:
                    found[one.name] = min(behind, found.get(one.name, np.inf))
        return found

    def _as_share(self, own: TermInModel) -> dict[str, float]:
        """Effects that may be a share of another term of the joint; how far these are behind.

        In log evidence, by name. What differs between the directions goes with friction
        over the position, which a file without friction trials does not have.
        """
        model, j, found = own.model, own.term.joint, dict[str, float]()
        for effect in (one for one in self.catalogue if own.term.name in one.alike):
            whole = [one for one in model.terms if one.key == (effect.share_of, j)]
            if whole and j is not None:
                share = own.linear.scores([self._share_of(whole[0], effect, j, model)])[
                    0
                ]
                found[effect.name] = own.scored.score.total - share.total
        return found

    def _share_of(
        self, whole: Term, effect: Effect, j: int, model: Model
    ) -> ColumnGroup:
        """An effect of a joint as shares of a term, of the file's friction, and of the speed."""
        what = whole.what
        assert isinstance(what, Candidate)

        def columns(scene: Scene) -> dict[int, Array]:
            own, friction = (
                what.columns(scene)[j] @ model.coefficients(whole),
                scene.friction[:, j],
            )
            speed = scene.motion.dq[:, j]
            speed = (
                speed * np.linalg.norm(friction) / max(np.linalg.norm(speed), 1e-300)
            )
            return {j: scene.sign[:, [j]] * np.stack([own, friction, speed], axis=1)}

        rows = model.ground.stage.rows
        return ColumnGroup(
            rows.columns(map(columns, rows.scenes), effect.passes), np.eye(3)
        )

    def _untried(self, term: Term, model: Model) -> tuple[str, ...]:
        """Effects like a term that cannot be looked for there, or stand beside it as its error."""
        scenes = model.ground.stage.scenes
        alike = term.what.effect.alike if isinstance(term.what, Candidate) else ()
        likely = (one for one in self.catalogue if one.name in alike)
        names = [one.name for one in likely if one.possible(scenes, term.joint)]
        beside = [
            one for one in model.terms if one.name in alike and one.joint == term.joint
        ]
        names += [
            one.name for one in beside if self._hides(term, again(one, model), model)
        ]
        return tuple(dict.fromkeys(names))

    def _hides(self, term: Term, one: ScoredTerm, model: Model) -> bool:
        """Whether a smaller one may be the error of the law of a model's term."""
        channels, gain = one.term.channels, one.score.total
        if term is one.term or not term.channels & channels:
            return False
        law = self._known_to(term, one.term) ** 2 * model.squares(term, channels)
        return bool(2.0 * gain < law and again(term, model).score.total > gain)

    def _known_to(self, term: Term, beside: Term) -> float:
        """Share of a term's torque to which its law is known; less well beside a like term."""
        what, other, small = term.what, beside.what, self.options.small
        if not isinstance(what, Candidate):
            return small
        if isinstance(other, Candidate):
            elsewhere = term.name == beside.name and term.joint != beside.joint
            alike = beside.name in what.effect.alike or term.name in other.effect.alike
            if elsewhere or alike:
                return (
                    self.options.apart if what.effect.apart else float(np.sqrt(small))
                )
        return 0.0 if what.effect.exact else small


def _ranked(linear: LinearModel, tried: Sequence[FittedTerm]) -> list[ScoredTerm]:
    """What was tried, the largest gain on blocks that were left out first."""
    told = linear.scores([t.term.part for t in tried])
    ranked = [ScoredTerm(t.term, t.fit, f) for t, f in zip(tried, told, strict=True)]
    return sorted(ranked, key=_by_gain)


def _by_gain(one: ScoredTerm) -> float:
    return -one.score.total
