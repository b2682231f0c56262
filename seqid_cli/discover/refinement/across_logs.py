"""What an effect predicts on whole logs that it was not fitted on.

Blocks of one log are no other logs: they share its postures, its warmth, its load and
its start. An effect that stands for one of these gains on all of its blocks, and
nothing on the next log. So what the selection has found is judged once more, where
there are several logs: the model is fitted to all logs but one, with the effect and
without it, and both predict that one. With squared errors o_l and n_l of log l,

    gain = 1 - sum n / sum o,

its interval over drawn weights of the logs (D. B. Rubin, "The Bayesian bootstrap",
Annals of Statistics 9, 1981). Only samples count at positions that the other logs reach
as well: a law is not asked about places that no log has shown it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.refinement.held_out import Gain
from seqid_cli.discover.select.linear import LinearModel
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import ScoredTerm, TermInModel, TermResult
from seqid_cli.discover.select.rows import joints_below, weights_of
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.logs.recording import Recording, by_log
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.typing import Array, Index, Mask

# Logs: with two, what one of them has by itself cannot be told from the effect.
FEWEST_LOGS = 3
# of the rows of a joint, from which a log tells something by itself
LEAST_OF_LOG = 0.02
MOST_LOSING = 0.25  # of the logs in which an effect matters: none of three
# of a term's gain on left-out blocks, from which a rival is asked about whole logs
NEAR_RIVAL = 0.5
MOST_RIVALS = 4


@dataclass(frozen=True, kw_only=True)
class AcrossLogs:
    """Squared errors of whole logs by fits to all others, without an effect and with.

    Attributes
    ----------
    names : tuple of str
        The logs that show the effect's joints.
    before, after : (L,) arrays
        By log, without the effect and with it, in units of the mean before of each
        joint.
    predicted : (L,) array
        By log, the square of what the effect adds to the prediction, likewise.
    """

    names: tuple[str, ...]
    before: Array
    after: Array
    predicted: Array

    @property
    def is_enough(self) -> bool:
        """Whether there are enough logs to prove an effect."""
        return len(self.names) >= FEWEST_LOGS

    def is_disproved(self, min_gain: float) -> bool:
        """Return whether the logs speak against the effect.

        Two of them prove nothing, but disprove what neither predicts of the other.

        Parameters
        ----------
        min_gain : float
            The least that counts.
        """
        if self.is_enough:
            return not self.is_proven(min_gain)
        return len(self.names) > 1 and self.gain.value < min_gain

    @cached_property
    def gain(self) -> Gain:
        """The gain of all logs together, with its 95 % interval."""
        total = max(float(self.before.sum()), 1e-300)
        weights = weights_of(len(self.names))
        of_before = np.maximum(weights @ self.before, 1e-300)
        drawn = 1.0 - (weights @ self.after) / of_before
        low, high = np.quantile(drawn, (0.5 - LEVEL / 2, 0.5 + LEVEL / 2))
        return Gain(
            value=1.0 - float(self.after.sum()) / total,
            low=float(low),
            high=float(high),
        )

    @cached_property
    def of_another_log(self) -> Gain:
        """The gain to expect of one log more, with its 95 % interval.

        Logs differ in it, and two or three of them say little of how much: Student's t
        with one degree of freedom less than logs. Of one log alone the interval is
        everything.
        """
        count = len(self.names)
        total = max(float(self.before.sum()), 1e-300)
        ratio = float(self.after.sum()) / total
        half_width = np.inf
        if count > 1:
            # the spread of logs about the ratio, and the error of the ratio itself
            difference = (self.after - ratio * self.before) / (total / count)
            spread = np.sqrt(np.sum(difference**2) / (count - 1))
            quantile = stdtrit(count - 1, 0.5 + LEVEL / 2)
            half_width = quantile * spread * np.sqrt(1.0 + 1.0 / count)
        value = 1.0 - ratio
        return Gain(
            value=value,
            low=float(value - half_width),
            high=float(min(value + half_width, 1.0)),
        )

    @property
    def is_promised(self) -> bool:
        """Whether one log more is expected to gain, and not by chance."""
        return self.of_another_log.certain

    @property
    def of_each(self) -> dict[str, float]:
        """The gain of each log by itself."""
        each = 1.0 - self.after / np.maximum(self.before, 1e-300)
        return dict(zip(self.names, each.tolist(), strict=True))

    @property
    def worst(self) -> str:
        """The log that speaks most against the effect."""
        return min(self.of_each, key=lambda name: self.of_each[name])

    def is_as_good_as(self, best: AcrossLogs, negligible_share: float) -> bool:
        """Return whether the logs are predicted no worse than with another effect.

        Parameters
        ----------
        best : AcrossLogs
            The same logs with the other one.
        negligible_share : float
            Share of the other one's gain that does not matter.
        """
        lag = float((self.after - best.after).sum())
        return lag <= negligible_share * float((best.before - best.after).sum())

    def is_proven(self, min_gain: float) -> bool:
        """Return whether the logs predict one another better with the effect.

        Of the logs in which it matters hardly any may lose: a log of fast moves says
        nothing of a ripple, but one that shows an effect must not speak against it.

        Parameters
        ----------
        min_gain : float
            The least that counts.
        """
        is_gained = self.gain.value >= min_gain and self.gain.certain
        matters = self.predicted >= min_gain * self.before
        if not (self.is_enough and is_gained and matters.any()):
            return False
        loses = self.after[matters] >= self.before[matters]
        return bool(np.mean(loses) <= MOST_LOSING)


@dataclass(frozen=True, kw_only=True)
class ResultAcrossLogs(TermResult):
    """A term of the selection, and what whole logs that were left out say of it.

    Attributes
    ----------
    across : AcrossLogs
        Their errors.
    instead_of : Term
        What the selection took; the term itself where no rival stands in its place.
    """

    across: AcrossLogs
    instead_of: Term


class NamesAcrossLogs:
    """A finding of the selection, and the names that whole logs leave to it.

    Blocks that lie between others tell a law from waves that follow it there by little.
    Logs of other motions do: so rivals that explain half as much are asked as well. A
    smooth function is no name: where it follows the residual a little better than all
    effects do, its names are those of the effects.

    Parameters
    ----------
    result : TermResult
        A term of the selection in its model.
    recordings : sequence of Recording
        The logs, in the order of the model's data sets; pieces of one are one log.
    options : Options
        What decides.
    """

    def __init__(
        self, result: TermResult, recordings: Sequence[Recording], options: Options
    ) -> None:
        self.result = result
        self._recordings = recordings
        self._options = options
        self._across: dict[Term, AcrossLogs] = {}
        self._named: dict[Term, ResultAcrossLogs] = {}

    @cached_property
    def _without(self) -> LinearModel:
        return self.result.model.beside(self.result.term)

    def across(self, scored: ScoredTerm) -> AcrossLogs:
        """Return what whole logs say of the term, or of a rival in its place."""
        term = scored.term
        if term not in self._across:
            model = self.result.model
            linear = model.linear
            if term is not self.result.term:
                linear = model.under(model.noise, _terms_with(self.result, term))
            self._across[term] = _compared(
                model,
                self.result.term.channels,
                self._without,
                linear,
                self._recordings,
            )
        return self._across[term]

    def likeliest(
        self, is_refused: Callable[[Candidate], bool] = lambda _: False
    ) -> ResultAcrossLogs | None:
        """Return the finding by its most probable name that is not refused.

        Where whole logs can prove a name, it is the one that they prove. One that is
        clearly better than what the selection took stands in its place; of several the
        one with the fewest parameters. A name that follows a refused one must not be
        disproved.

        Parameters
        ----------
        is_refused : callable
            Whether an effect was tried and refused.

        Returns
        -------
        ResultAcrossLogs or None
            None where every name that explains half as much is refused or disproved.
        """
        first = self.result.scored
        min_gain = self._options.improvement
        names = [first, *_near_rivals(self.result, is_refused)]
        if _is_smooth_or(is_refused, first):
            names = [each for each in names[1:] if not self._is_disproved(each)]
            if not names:
                return None
        if not self.across(names[0]).is_enough:
            # What blocks say is all that there is: the largest gain comes first.
            return self._by_name(names[0])

        proven = [each for each in names if self.across(each).is_proven(min_gain)]
        if not proven:
            return self._by_name(names[0])
        best = min(proven, key=lambda each: float(self.across(each).after.sum()))
        near = [
            each
            for each in proven
            if self.across(each).is_as_good_as(
                self.across(best), self._options.negligible_share
            )
        ]
        # What the selection took stands unless another one is clearly better.
        if first in near:
            return self._by_name(first)
        return self._by_name(min(near, key=lambda each: each.term.freedom))

    def following(
        self, result: TermResult, is_refused: Callable[[Candidate], bool]
    ) -> list[ScoredTerm]:
        """Return the names to go on with if this one is refused, in their order.

        Whole logs do not disprove them.

        Parameters
        ----------
        result : TermResult
            The finding by one of its names.
        is_refused : callable
            Whether an effect was tried and refused.
        """
        following: list[ScoredTerm] = []
        taken = [result.term]
        for each in (self.result.scored, *_near_rivals(self.result, is_refused)):
            # The same effect, also apart above the cut-off, is one name.
            is_new = each.term.key not in {term.key for term in taken}
            if not is_new or _is_smooth_or(is_refused, each):
                continue
            taken.append(each.term)
            if not self._is_disproved(each):
                following.append(each)
        return following

    def _is_disproved(self, scored: ScoredTerm) -> bool:
        return self.across(scored).is_disproved(self._options.improvement)

    def _by_name(self, scored: ScoredTerm) -> ResultAcrossLogs:
        """Return the finding as one of its names says."""
        term = scored.term
        if term not in self._named:
            result = self.result
            named = result if term is result.term else _in_place(result, scored)
            self._named[term] = _with_logs(named, self.across(scored), result.term)
        return self._named[term]


def across_logs(
    result: TermResult, recordings: Sequence[Recording], options: Options
) -> ResultAcrossLogs:
    """Return the term, or the rival of it that predicts whole logs best.

    A smooth function is tried where no effect explains, and has no rivals then.

    Parameters
    ----------
    result : TermResult
        A term of the selection in its model.
    recordings : sequence of Recording
        The logs, in the order of the model's data sets; pieces of one are one log.
    options : Options
        What decides.
    """
    names = NamesAcrossLogs(result, recordings, options)
    if result.term.smooth:
        return _with_logs(result, names.across(result.scored), result.term)
    likeliest = names.likeliest()
    assert likeliest is not None  # nothing is refused
    return likeliest


def _with_logs(
    result: TermResult, across: AcrossLogs, instead_of: Term
) -> ResultAcrossLogs:
    """Return a term with what whole logs say of it."""
    of_result = {each.name: getattr(result, each.name) for each in fields(result)}
    return ResultAcrossLogs(**of_result, across=across, instead_of=instead_of)


def _is_smooth_or(is_refused: Callable[[Candidate], bool], scored: ScoredTerm) -> bool:
    """Return whether a term is no effect, or a refused one."""
    what = scored.term.what
    return not isinstance(what, Candidate) or is_refused(what)


def _near_rivals(
    result: TermResult, is_refused: Callable[[Candidate], bool]
) -> list[ScoredTerm]:
    """Return the first effects at the term's joint that explain half of it.

    Those that were refused make room for others.
    """
    least = NEAR_RIVAL * result.scored.score.total
    rivals = [
        rival
        for rival in result.rivals
        if rival.term is not result.term
        and rival.term.joint == result.term.joint
        and rival.score.total >= least
        and not _is_smooth_or(is_refused, rival)
    ]
    return rivals[:MOST_RIVALS]


def _terms_with(result: TermResult, rival: Term) -> list[Term]:
    """Return the terms of the model with a rival in the place of one."""
    return [rival if each is result.term else each for each in result.model.terms]


def _in_place(result: TermResult, rival: ScoredTerm) -> TermResult:
    """Return a rival as a term of the model, in the place of the one that was taken."""
    model = copy(result.model)
    model.terms = _terms_with(result, rival.term)
    model.settle()
    judged = TermInModel(rival.term, model)
    return replace(
        result,
        scored=judged.scored,
        left_without=judged.linear.left_out,
        evidence=judged.evidence,
        share=judged.share,
        model=model,
        log_evidence_of_variation=model.linear.varied(rival.term.part),
    )


def _compared(
    model: Model,
    channels: frozenset[int],
    without: LinearModel,
    having: LinearModel,
    recordings: Sequence[Recording],
) -> AcrossLogs:
    """Compare the errors of two models on whole logs that are left out."""
    rows = model.ground.stage.rows
    logs = by_log(recordings)
    names = [str(pieces[0].path) for pieces in logs]
    number_of = {
        id(piece): number for number, pieces in enumerate(logs) for piece in pieces
    }
    log_of_scene = np.array([number_of[id(recording)] for recording in recordings])

    before = np.zeros(len(names))
    after = np.zeros(len(names))
    predicted = np.zeros(len(names))
    share_of_rows = np.zeros(len(names))
    left_without = without.left_out_of(log_of_scene)
    left_with = having.left_out_of(log_of_scene)
    for joint in joints_below(channels, rows.n):
        log = _log_of_rows(rows, joint, log_of_scene)
        counts = _is_covered(rows, joint, log)
        by_effect = left_without[joint] - left_with[joint]
        squares_before = _by_log(left_without[joint] ** 2, log, counts, len(names))
        squares_after = _by_log(left_with[joint] ** 2, log, counts, len(names))
        squares_of_effect = _by_log(by_effect**2, log, counts, len(names))
        samples = np.bincount(log[counts], minlength=len(names))
        mean = squares_before.sum() / max(float(samples.sum()), 1.0)
        if mean > 0.0:
            before += squares_before / mean
            after += squares_after / mean
            predicted += squares_of_effect / mean
            share = samples / max(int(samples.sum()), 1)
            share_of_rows = np.maximum(share_of_rows, share)

    tells = share_of_rows > LEAST_OF_LOG
    return AcrossLogs(
        names=tuple(name for name, told in zip(names, tells, strict=True) if told),
        before=before[tells],
        after=after[tells],
        predicted=predicted[tells],
    )


def _log_of_rows(rows: Rows, joint: int, log_of_scene: Index) -> Index:
    """Return the log (M_j,) of every row of a joint."""
    of_scene = [
        np.full(scene.samples, log)
        for scene, log in zip(rows.scenes, log_of_scene, strict=True)
    ]
    return rows.of(joint, of_scene).astype(np.intp)


def _is_covered(rows: Rows, joint: int, log: Index) -> Mask:
    """Return which rows (M_j,) lie at positions that other logs reach as well."""
    q = rows.of(joint, [scene.motion.q[:, joint] for scene in rows.scenes])
    is_covered = np.zeros(len(q), dtype=bool)
    for number in np.unique(log):
        others = q[log != number]
        if len(others):
            inside = (q >= others.min()) & (q <= others.max())
            is_covered |= (log == number) & inside
    return is_covered


def _by_log(squares: Array, log: Index, counts: Mask, n_logs: int) -> Array:
    """Return the sums (L,) of squares (M_j,) that count, log by log."""
    sums = np.bincount(log[counts], weights=squares[counts], minlength=n_logs)
    return np.asarray(sums, dtype=np.float64)
