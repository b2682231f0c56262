"""Settings of an effect between the grid's values: those of the largest evidence."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.candidates import Candidate, CandidateColumns
from seqid_cli.discover.select.bounds import within_bounds
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.rows import TermFit
from seqid_cli.discover.select.terms import Term, effects
from seqid_cli.effects.effect import SPACING, Setting
from seqid_cli.typing import Array

GOLDEN = 0.381966
STEPS = 8
NEAR = 1.5  # ratio by which a setting may move when another one takes its next value
SHARPENED = 3  # times that settings are moved to where the coefficients say


@dataclass(frozen=True)
class FittedTerm:
    """A term and its fit beside a model that does not have it."""

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
    """Where settings are searched: a model that has all other terms.

    Attributes
    ----------
    stage : CandidateColumns
        The data sets.
    linear : LinearModel
        The model.
    size : (channels,) array
        What the file leaves [N m; N where prismatic].
    options : Options
        What decides.
    """

    stage: CandidateColumns
    linear: LinearModel
    size: Array
    options: Options

    def tried(self, candidates: Sequence[Candidate]) -> list[FittedTerm]:
        """Fit candidates; those whose coefficients are not physical are left out."""
        return self.fitted(effects(self.stage, candidates, self.size))

    def fitted(self, terms: Iterable[Term]) -> list[FittedTerm]:
        """Fit terms; those whose coefficients are not physical are left out."""
        terms = list(terms)
        fits = self.linear.fits([term.part for term in terms])
        plausible: list[FittedTerm] = []
        for term, fit in zip(terms, fits, strict=True):
            fitted_term = FittedTerm(term, fit)
            candidate = fitted_term.candidate
            of_effect = slice(candidate.size)
            coefficients = within_bounds(
                candidate,
                fit.coefficients[of_effect],
                fit.covariance[of_effect, of_effect],
                term.part.precision[of_effect, of_effect],
                negligible_share=self.options.negligible_share,
            )
            if candidate.effect.plausible(
                self.stage.scenes, candidate.joint, candidate.settings, coefficients
            ) and self._can_exist(fitted_term):
                plausible.append(fitted_term)
        return plausible

    def _can_exist(self, fitted: FittedTerm) -> bool:
        """Return whether what a term stands for can be, within its errors."""
        of_effect = slice(fitted.candidate.size)
        return fitted.candidate.effect.can_exist(
            self.stage.scenes,
            fitted.fit.coefficients[of_effect],
            fitted.fit.covariance[of_effect, of_effect],
        )

    def tuned(self, start: FittedTerm, spacing: float = SPACING) -> FittedTerm:
        """Search the continuous settings, then follow those that have more values.

        `spacing` is the ratio of neighbouring values of the grid.
        """
        best = self._with_lacking_setting(start)
        for setting in best.candidate.effect.between(best.candidate.settings):
            searched = self._searched(best, setting, spacing)
            best = self._with_usual_value(searched, setting)
        return self._sharpened(self._followed(best))

    def _with_lacking_setting(self, start: FittedTerm) -> FittedTerm:
        """Add a setting that the effect lacks, at the best of its first values."""
        candidate = start.candidate
        extended = [
            replace(candidate, settings={**candidate.settings, **more})
            for more in candidate.effect.beyond(self.stage.scenes, candidate.joint)
            if not more.keys() & candidate.settings
        ]
        return max([start, *self.tried(extended)], key=_by_evidence)

    def _moved(
        self, start: FittedTerm, removed: str = "", /, **settings: float
    ) -> FittedTerm | None:
        """Fit the effect with other values of some settings, and without one.

        Returns None where the coefficients are not physical.
        """
        remaining = {
            name: value
            for name, value in start.candidate.settings.items()
            if name != removed
        }
        moved = replace(start.candidate, settings={**remaining, **settings})
        fitted = self.tried([moved])
        return fitted[0] if fitted else None

    def _searched(
        self, start: FittedTerm, setting: Setting, spacing: float
    ) -> FittedTerm:
        """Search one setting by golden sections, by ratio where it is logarithmic."""
        best = start

        def evidence(x: float) -> float:
            nonlocal best
            moved = self._moved(start, **{setting.name: setting.at(x)})
            if moved is None:
                return -np.inf
            best = max(best, moved, key=_by_evidence)
            return moved.evidence

        low, high = setting.bracket(start.candidate.settings[setting.name], spacing)
        x = low + GOLDEN * (high - low)
        y = high - GOLDEN * (high - low)
        at_x = evidence(x)
        at_y = evidence(y)
        for _ in range(STEPS):
            if at_x > at_y:
                high = y
                y = x
                at_y = at_x
                x = low + GOLDEN * (high - low)
                at_x = evidence(x)
            else:
                low = x
                x = y
                at_x = at_y
                y = high - GOLDEN * (high - low)
                at_y = evidence(y)
        return best

    def _with_usual_value(self, start: FittedTerm, setting: Setting) -> FittedTerm:
        """Prefer a usual value of a setting, or none, where it does nearly as well.

        A setting that is not needed goes: it must gain as much as a term does by
        chance.
        """
        without = None if setting.asked else self._moved(start, setting.name)
        usual = [self._moved(start, **{setting.name: x}) for x in setting.usual]
        least = start.evidence - self.options.min_log_bayes_factor
        if without is not None and without.evidence > least:
            return without

        least = (1.0 - self.options.negligible_share) * start.evidence
        near = [
            moved for moved in usual if moved is not None and moved.evidence > least
        ]
        return max(near, key=_by_evidence, default=start)

    def _followed(self, start: FittedTerm) -> FittedTerm:
        """Take the next values of settings that have some while the evidence grows."""
        best = start
        effect = start.candidate.effect
        for setting in effect.settings:
            value_now = start.candidate.settings.get(setting.name)
            next_values = setting.then
            if value_now in next_values:
                next_values = next_values[next_values.index(value_now) + 1 :]
            for value in next_values:
                moved = self._moved_and_searched(best, setting.name, value)
                if moved is None or moved.evidence <= best.evidence:
                    break
                best = moved
        return best

    def _moved_and_searched(
        self, start: FittedTerm, name: str, value: float
    ) -> FittedTerm | None:
        """Give a setting another value, and search the others near by."""
        moved = self._moved(start, **{name: value})
        if moved is None:
            return None
        for setting in moved.candidate.effect.between(moved.candidate.settings):
            moved = self._searched(moved, setting, NEAR)
        return moved

    def _sharpened(self, start: FittedTerm) -> FittedTerm:
        """Move settings to where the coefficients say.

        Of effects that are looked for to first order the first step stands though it
        gains less: a lag would pass for a delay.
        """
        best = start
        for number in range(SHARPENED):
            candidate = best.candidate
            settings = candidate.effect.sharpened(
                candidate.settings, best.fit.coefficients[: candidate.size]
            )
            if settings is None:
                return best
            moved = self._moved(best, **settings)
            stands_anyway = number == 0 and candidate.effect.first_order
            if moved is None or (moved.evidence <= best.evidence and not stands_anyway):
                return best
            best = moved
        return best


def _by_evidence(fitted: FittedTerm) -> float:
    return fitted.evidence


def best_of(
    fitted: Sequence[FittedTerm], key: Callable[[FittedTerm], Hashable]
) -> list[FittedTerm]:
    """Return the term of the largest evidence for each key, the largest first."""
    best: dict[Hashable, FittedTerm] = {}
    for term in sorted(fitted, key=lambda each: -each.evidence):
        best.setdefault(key(term), term)
    return list(best.values())


def shape_of(fitted: FittedTerm) -> Hashable:
    """Return an effect at a joint with settings that only the grid has values of."""
    candidate = fitted.candidate
    of_grid = [
        setting.name
        for setting in candidate.effect.settings
        if not setting.continuous and not setting.then
    ]
    kind = tuple(candidate.settings.get(name, 0.0) for name in of_grid)
    return *fitted.term.key, candidate.apart, candidate.absorbed, kind
