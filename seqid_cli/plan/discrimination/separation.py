"""How well moves tell two effects apart, asked as the diagnosis asks (T-optimality).

The rows of a move, in units of the noise, hold the columns of the rigid base parameters
and of the joint's friction, which are held as the parameter file says, and those of
both effects at the settings that a search may reach. Their Gram matrices add up over
moves. Let S be the Schur complement of both effects when the base is free, and c the
coefficients of a true effect A:

    G = c' S_aa c / 2,        T = min_b c' (S_aa - S_ab S_bb^-1 S_ba) c

is the gain of A, and what the rival B leaves of it at its best plausible settings b.
The diagnosis drops a rival that lacks more than a required part of the gain, a small
share of G (see `tempered`). It lacks T / 2 on average, with a standard deviation of
sqrt(T), so that it is dropped with the probability Phi((T / 2 - required) / sqrt(T)).
No length of motion helps where T / 2 is less than that share: where the rival reaches
96 % of the gain.

Settings and coefficients of the true effect are drawn: of the grid and in all
directions, so that a mean trace does not hide the least favourable of them; and where
there are logs also from what those show, which is what both effects share where the
name was left open. The smaller chance counts: logs of which something else is wrong
show coefficients that are not the effect's. Rows at rest do not count, as they do not
in a diagnosis: what a joint at rest under control carries is anything within its
friction. Atkinson, Fedorov, "The design of experiments for discriminating between two
rival models", Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from seqid_cli.discover.select.naming import BEHIND, tempered
from seqid_cli.discover.select.options import Options
from seqid_cli.effects.scene import Scene, Scenes, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.planned import RATE_HZ, sampled
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import NOISE_HZ, Belief
from seqid_cli.plan.discrimination.question import Question, Slot, products_of
from seqid_cli.typing import Array

# share that the rival imitates on all moves of the pool, from which it always does
NESTED = 0.999

Reading = list[tuple[Slot, Array]]  # settings with coefficients (D, k) that may be true


@dataclass(frozen=True)
class Outcome:
    """Gains of a true effect and of its rival, for D settings and coefficients.

    Parameters
    ----------
    gain : (..., D) float
        G of the true effect.
    rival_leaves : (..., D) float
        T: what the rival leaves.
    """

    gain: Array
    rival_leaves: Array

    def longer(self, factor: float) -> Outcome:
        """Return the outcome of moves that last so many times as long."""
        return Outcome(factor * self.gain, factor * self.rival_leaves)

    @property
    def required_lack(self) -> Array:
        """Gain (..., D) that a rival must lack to be dropped."""
        return BEHIND * tempered(self.gain, Options())

    @property
    def power(self) -> Array:
        """Probability (...) that the rival is dropped, over all that may be true."""
        std_dev = np.sqrt(np.maximum(self.rival_leaves, 1e-12))
        margin = self.rival_leaves / 2.0 - self.required_lack
        return np.asarray(ndtr(margin / std_dev).mean(axis=-1))

    @property
    def merit(self) -> Array:
        """Smooth stand-in (...) for the power, which a search can climb.

        It is what the rival lacks, over that and the required lack together.
        """
        lack = self.rival_leaves / 2.0
        return np.asarray((lack / (lack + self.required_lack)).mean(axis=-1))

    @property
    def largest_imitation(self) -> float:
        """Largest share of the gain that the rival reaches."""
        share_left = self.rival_leaves / np.maximum(2.0 * self.gain, 1e-300)
        return float(np.max(1.0 - share_left))


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Gram matrices of moves, with the columns of a question.

    Parameters
    ----------
    question : Question
    prior : (K, K) float
        Information before any move; logs that there are count as such.
    grams : (M, K, K) float
        Of each move.
    readings : tuple of two lists of Reading
        What each effect may truly be.
    torque_size : float
        Root mean square torque of what may be true [N m].
    """

    question: Question
    prior: Array
    grams: Array
    readings: tuple[list[Reading], list[Reading]]
    torque_size: float

    def effects_gram(self, total: Array) -> Array:
        """Return the Gram matrices of the effects' columns with the base free.

        Parameters
        ----------
        total : (..., K, K) float
            Gram matrices of moves, without the prior.

        Returns
        -------
        (..., k, k) array
            The Schur complement S.
        """
        return _with_base_free(total + self.prior, self.question.n_base)

    def outcome(self, total: Array, true: int) -> Outcome:
        """Return the outcome of moves if one of the effects is the true one.

        Parameters
        ----------
        total : (..., K, K) float
            Gram matrices of moves, without the prior.
        true : {0, 1}
            Which of the effects is true.

        Returns
        -------
        Outcome
        """
        everything = []
        for reading in self.readings[true]:
            everything += reading
        return self._outcome_of(self.effects_gram(total), everything, true)

    def least_certain_outcome(self, total: Array, true: int) -> Outcome:
        """Return the outcome, on one matrix (K, K), of the reading of least power."""
        S = self.effects_gram(total)
        outcomes = [
            self._outcome_of(S, reading, true) for reading in self.readings[true]
        ]
        return min(outcomes, key=lambda outcome: float(outcome.power))

    def _outcome_of(self, S: Array, reading: Reading, true: int) -> Outcome:
        """Return G and T of coefficients, with rivals at all of their settings.

        `S` (..., k, k) are the Gram matrices of the effects' columns.
        """
        gains = []
        unexplained_by_rivals = []
        for slot, c in reading:
            S_aa = S[..., slot.at, slot.at]
            square = square_of(S_aa, c)
            least_unexplained = square
            for rival in self.question.slots[1 - true]:
                S_bb = S[..., rival.at, rival.at]
                S_ba_c = S[..., rival.at, slot.at] @ c.T
                trace = np.trace(S_bb, axis1=-2, axis2=-1)[..., None, None]
                ridge = 1e-9 * trace + 1e-12
                fitted = np.linalg.solve(S_bb + ridge * np.eye(S_bb.shape[-1]), S_ba_c)

                # A rival whose best coefficients are not physical explains nothing.
                unexplained = square - np.sum(S_ba_c * fitted, axis=-2)
                is_physical = rival.is_within_bounds(np.swapaxes(fitted, -1, -2))
                least_unexplained = np.where(
                    is_physical,
                    np.minimum(least_unexplained, unexplained),
                    least_unexplained,
                )
            gains.append(square / 2.0)
            unexplained_by_rivals.append(np.maximum(least_unexplained, 0.0))
        return Outcome(
            np.concatenate(gains, axis=-1),
            np.concatenate(unexplained_by_rivals, axis=-1),
        )

    def is_nested(self) -> list[bool]:
        """Return of each effect whether its rival always imitates it.

        It does where not even all moves of the pool together show a difference.
        """
        total = self.grams.sum(axis=0)
        nested = []
        for true in (0, 1):
            outcome = self.outcome(total, true)
            gain = 2.0 * outcome.gain.mean()
            nested.append(bool(outcome.rival_leaves.mean() < (1 - NESTED) * gain))
        return nested

    def merit(self, total: Array) -> Array:
        """Return the merit (...) of moves: the mean of both effects.

        `total` (..., K, K) are their Gram matrices, without the prior.
        """
        merits = [self.outcome(total, true).merit for true in (0, 1)]
        return np.asarray(np.mean(merits, axis=0))


def _with_base_free(G: Array, b: int, *, ridge: float = 1e-12) -> Array:
    """Return the Schur complements of Gram matrices G (..., K, K) without b columns.

    The ridge, of columns of unit length, is for parts of the base that no move shows.
    """
    squares = np.diagonal(G, axis1=-2, axis2=-1)[..., :b]
    length = np.sqrt(np.maximum(squares, 1e-300))[..., None]
    unit_base = G[..., :b, :b] / length / np.swapaxes(length, -1, -2)
    unit_base = unit_base + ridge * np.eye(b)

    base_to_effects = G[..., :b, b:]
    fitted = np.linalg.solve(unit_base, base_to_effects / length) / length
    return np.asarray(G[..., b:, b:] - np.swapaxes(base_to_effects, -1, -2) @ fitted)


def scenes_of(
    belief: Belief, stages: Stages, moves: Sequence[PlannedMove]
) -> list[Scene]:
    """Return planned moves as the effects see logs.

    Parameters
    ----------
    belief : Belief
    stages : Stages
        The model, whose own torque stands for the measured one.
    moves : sequence of PlannedMove

    Returns
    -------
    list of `Scene`
        The motion as it is planned, at 100 Hz.
    """
    model = TorqueModel.from_stages(stages, belief.robot)
    sign_width = sign_widths(model, belief.limits.speed)
    no_noise = np.zeros(belief.robot.n)
    cutoff = Cutoff(hz=NOISE_HZ, encoder_step=no_noise, noise_density=no_noise)
    lowpass = Lowpass(NOISE_HZ, RATE_HZ)

    scenes = []
    for number, move in enumerate(moves):
        t, q, dq, ddq = sampled(move, belief.robot.joint_names, RATE_HZ)
        all_samples = np.ones(len(t), dtype=bool)
        motion = Motion(
            t=t,
            q=q,
            dq=dq,
            ddq=ddq,
            tau=None,
            moving=np.abs(dq) > 1e-6,
            usable=all_samples,
            valid=all_samples,
            rate_hz=RATE_HZ,
            lowpass=lowpass,
            cutoff=cutoff,
        )
        without_torque = Scene(
            robot=belief.robot,
            motion=motion,
            model=model,
            sign_width=sign_width,
            log=number,
            period=1.0 / RATE_HZ,
        )
        with_torque = replace(motion, tau=without_torque.modelled)
        scenes.append(replace(without_torque, motion=with_torque))
    return scenes


def separation_of(
    belief: Belief, question: Question, scenes: Scenes, size: float, have: Scenes = ()
) -> Separation:
    """Collect the Gram matrices of all moves, and what both effects may truly be.

    Parameters
    ----------
    belief : Belief
    question : Question
    `scenes` : sequence of `Scene`
        Data sets of M planned moves.
    size : float
        Root mean square torque of a true effect [N m], where no logs tell it.
    have : sequence of `Scene`
        Logs that there are already: they count as known.

    Returns
    -------
    Separation
    """
    of_moves = [products_of(belief, question, scene) for scene in scenes]
    of_logs = [products_of(belief, question, scene) for scene in have]
    n_samples = sum(scene.samples for scene in (*scenes, *have))
    squares = np.sum([x.squares for x in (*of_moves, *of_logs)], axis=0) / n_samples
    prior = np.sum([question.prior, *(x.gram for x in of_logs)], axis=0)

    readings: tuple[list[Reading], list[Reading]] = ([], [])
    if have:
        b = question.n_base
        moment = np.sum([x.moment for x in of_logs], axis=0)
        base_solution = np.linalg.solve(prior[:b, :b], moment[:b])
        explained_by_base = prior[b:, :b] @ base_solution
        S = _with_base_free(prior, b)
        sizes = []
        for slots, readings_of_effect in zip(question.slots, readings, strict=True):
            reading = _reading_of_logs(slots, S, moment[b:] - explained_by_base)
            readings_of_effect.append(reading)
            mean_squares = [square_of(squares[x.at, x.at], c) for x, c in reading]
            sizes.append(float(np.sqrt(np.median(np.concatenate(mean_squares)))))
        size = max(sizes)

    for k, readings_of_effect in enumerate(readings):
        true_slots = question.slots[k][: question.n_true[k]]
        readings_of_effect.append(
            [(x, _drawn(x, squares[x.at, x.at], size)) for x in true_slots]
        )
    return Separation(
        question=question,
        prior=prior,
        grams=np.stack([x.gram for x in of_moves]),
        readings=readings,
        torque_size=size,
    )


def _reading_of_logs(
    slots: Sequence[Slot], S: Array, moment: Array, *, draws: int = 64
) -> Reading:
    """Return settings as likely as logs make them, with coefficients of their errors.

    Parameters
    ----------
    slots : sequence of Slot
        Settings of one effect.
    S : (k, k) float
        Products of the effects' columns, the base eliminated.
    moment : (k,) float
        Products with the residual, the base eliminated.
    draws : int
        Coefficients of all settings together. Likelihoods are tempered as those of
        names are, as the law is not exactly right.

    Returns
    -------
    Reading
    """
    rng = np.random.default_rng(0)
    best = []
    roots = []
    gains = np.zeros(len(slots))
    for k, slot in enumerate(slots):
        S_aa = S[slot.at, slot.at]
        ridge = 1e-9 * np.trace(S_aa) * np.eye(len(S_aa))
        values, vectors = np.linalg.eigh(S_aa + ridge + 1e-12)
        # The coefficients' covariance is root @ root.T.
        root = vectors / np.sqrt(np.maximum(values, 1e-300))
        white = root.T @ moment[slot.at]
        c = root @ white
        best.append(c)
        roots.append(root)
        if slot.is_within_bounds(c):
            gains[k] = white @ white / 2.0

    scale = float(tempered(gains.max(), Options()))
    likelihood = np.exp((gains - gains.max()) / scale)
    counts = rng.multinomial(draws, likelihood / likelihood.sum())
    reading = []
    for k, slot in enumerate(slots):
        if counts[k]:
            white = rng.normal(size=(counts[k], len(best[k])))
            drawn = best[k] + np.sqrt(scale) * white @ roots[k].T
            reading.append((slot, np.clip(drawn, slot.low, slot.high)))
    return reading


def _drawn(slot: Slot, square: Array, size: float, *, draws: int = 24) -> Array:
    """Return coefficients (D, k) of one root mean square torque, in all directions.

    `square` (k, k) are the mean products of the slot's columns; before they are scaled
    to the `size` [N m], each of them has the same share.
    """
    k = len(square)
    directions = np.array([[1.0], [-1.0]])
    if k > 1:
        directions = np.random.default_rng(0).normal(size=(draws, k))
    physical = np.where(slot.low >= 0.0, np.abs(directions), directions)
    c = np.unique(physical, axis=0)
    c /= np.sqrt(np.maximum(np.diag(square), 1e-300))
    rms = np.sqrt(np.maximum(square_of(square, c), 1e-300))
    return np.asarray(size * c / rms[:, None])


def square_of(S: Array, c: Array) -> Array:
    """Return c' S c (..., D) of coefficients c (D, k) and matrices S (..., k, k)."""
    return np.asarray(np.sum((S @ c.T) * c.T, axis=-2))
