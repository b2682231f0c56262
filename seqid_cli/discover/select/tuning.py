"""Settings of an effect between the grid's values: those of the largest evidence."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.candidates import Candidate, CandidateColumns
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.rows import TermFit
from seqid_cli.discover.select.terms import Term, effects
from seqid_cli.model.effects.effect import SPACING, Setting
from seqid_cli.typing import Array

GOLDEN = 0.381966
STEPS = 8
NEAR = 1.5  # ratio by which a setting may move when another one takes its next value
SHARPENED = 3  # times that settings are moved to where the coefficients say


@dataclass(frozen=True)
class FittedTerm:
    """A term and what it gains."""

    term: Term
    fit: TermFit

    @property
    def evidence(self) -> float:
        """Log Bayes factor."""
        return self.fit.log_bayes_factor

    @property
    def candidate(self) -> Candidate:
        """The effect and its settings."""
        assert isinstance(self.term.what, Candidate)
        return self.term.what


@dataclass(frozen=True)
class Tuner:
    """Where settings are searched: a model that has all other terms."""

    stage: CandidateColumns
    linear: LinearModel
    size: Array

    def tried(self, candidates: Sequence[Candidate]) -> list[FittedTerm]:
        """Try candidates; those whose coefficients are not physical are left out."""
        return self.fitted(effects(self.stage, candidates, self.size))

    def fitted(self, terms: Iterable[Term]) -> list[FittedTerm]:
        """Try terms; those whose coefficients are not physical are left out."""
        terms, found = list(terms), list[FittedTerm]()
        for one in map(
            FittedTerm, terms, self.linear.fits([term.part for term in terms])
        ):
            c, values = one.candidate, one.fit.coefficients[: one.candidate.size]
            if c.effect.plausible(self.stage.scenes, c.joint, c.settings, values):
                found.append(one)
        return found

    def tuned(self, tried: FittedTerm, spacing: float = SPACING) -> FittedTerm:
        """Search the continuous settings, then follow those that have more values."""
        best = self._opened(tried)
        for setting in best.candidate.effect.between(best.candidate.settings):
            best = self._usual(self._searched(best, setting, spacing), setting)
        return self._sharpened(self._followed(best))

    def _opened(self, tried: FittedTerm) -> FittedTerm:
        """The same with a setting that it lacks, at the best of its first values."""
        c = tried.candidate
        more = [
            s
            for s in c.effect.beyond(self.stage.scenes, c.joint)
            if not s.keys() & c.settings
        ]
        lacking = [replace(c, settings={**c.settings, **s}) for s in more]
        return max([tried, *self.tried(lacking)], key=lambda one: one.evidence)

    def _moved(
        self, tried: FittedTerm, but: str = "", /, **settings: float
    ) -> FittedTerm | None:
        """The same with other values of some settings, and without one."""
        now = {name: x for name, x in tried.candidate.settings.items() if name != but}
        found = self.tried([replace(tried.candidate, settings={**now, **settings})])
        return found[0] if found else None

    def _searched(
        self, tried: FittedTerm, setting: Setting, spacing: float
    ) -> FittedTerm:
        """Golden-section search over one setting, by ratio where it is logarithmic."""
        best = tried

        def gain(x: float) -> float:
            nonlocal best
            found = self._moved(tried, **{setting.name: setting.at(x)})
            if found is None:
                return -np.inf
            best = max(best, found, key=lambda one: one.evidence)
            return found.evidence

        a, b = setting.bracket(tried.candidate.settings[setting.name], spacing)
        x, y = a + GOLDEN * (b - a), b - GOLDEN * (b - a)
        at_x, at_y = gain(x), gain(y)
        for _ in range(STEPS):
            if at_x > at_y:
                b, y, at_y = y, x, at_x
                x = a + GOLDEN * (b - a)
                at_x = gain(x)
            else:
                a, x, at_x = x, y, at_y
                y = b - GOLDEN * (b - a)
                at_y = gain(y)
        return best

    def _usual(self, tried: FittedTerm, setting: Setting) -> FittedTerm:
        """The same with a usual value of a setting, or none, where no other does clearly better."""
        every = [self._moved(tried, **{setting.name: value}) for value in setting.usual]
        least = (1.0 - Options.small) * tried.evidence
        near = [one for one in every if one and one.evidence > least]
        bare = None if setting.asked else self._moved(tried, setting.name)
        if bare is not None and bare.evidence > tried.evidence - Options.chance:
            return bare
        return max(near, key=lambda one: one.evidence, default=tried)

    def _followed(self, tried: FittedTerm) -> FittedTerm:
        """Take the next values of settings that have some while the evidence grows."""
        best, effect = tried, tried.candidate.effect
        for setting in effect.settings:
            now = tried.candidate.settings.get(setting.name)
            first = setting.then.index(now) + 1 if now in setting.then else 0
            for value in setting.then[first:]:
                found = self._moved(best, **{setting.name: value})
                for other in effect.between(found.candidate.settings) if found else ():
                    found = found and self._searched(found, other, NEAR)
                if found is None or found.evidence <= best.evidence:
                    break
                best = found
        return best

    def _sharpened(self, tried: FittedTerm) -> FittedTerm:
        """Move settings to where the coefficients say.

        Of effects that are looked for to first order the first step stands though it
        gains less: a lag would pass for a delay.
        """
        best = tried
        for number in range(SHARPENED):
            c = best.candidate
            settings = c.effect.sharpened(c.settings, best.fit.coefficients[: c.size])
            found = None if settings is None else self._moved(best, **settings)
            stands = number == 0 and c.effect.first_order
            if found is None or (found.evidence <= best.evidence and not stands):
                return best
            best = found
        return best


def best_of(
    tried: Sequence[FittedTerm], key: Callable[[FittedTerm], Hashable]
) -> list[FittedTerm]:
    """The one of the largest evidence for each key, the largest first."""
    best: dict[Hashable, FittedTerm] = {}
    for one in sorted(tried, key=lambda t: -t.evidence):
        best.setdefault(key(one), one)
    return list(best.values())


def shape_of(tried: FittedTerm) -> Hashable:
    """An effect at a joint with settings that are not searched between the grid's values."""
    one = tried.candidate
    grid = [s.name for s in one.effect.settings if not s.continuous and not s.then]
    kind = tuple(one.settings.get(name, 0.0) for name in grid)
    return *tried.term.key, one.apart, one.absorbed, kind
