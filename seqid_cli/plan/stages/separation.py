"""How well moves tell two effects apart: the residual that the rival cannot imitate (T-optimality).

The rows of a move at joint j, in units of the noise, hold the columns of the rigid base parameters
and of the joint's friction (both known to a few standard errors), and those of both effects at
several settings. Their Gram matrices add up over moves. With S_ab the Schur complement of effect A
at settings a when the base and the rival B at settings b are free, and N_a the mean square of A's
columns at the joint, an effect of mean square torque s^2 in any direction leaves

    T_a = s^2 min_b tr(N_a^-1 S_ab) / k

unexplained by the rival; T is its mean over settings, the smaller one of both ways round. The two
hypotheses lie sqrt(T) apart: a test of level alpha has the power Phi(sqrt(T) - z_(1 - alpha)).

References
----------
Atkinson, Fedorov, "The design of experiments for discriminating between two rival models",
Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from seqid_cli.model.effects.effect import Effect, Setting
from seqid_cli.model.effects.scene import Scene, sign_widths
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import NOISE_HZ, Belief
from seqid_cli.plan.moves.trajectories import RATE_HZ, sampled
from seqid_cli.plan.stages.choose import Goal
from seqid_cli.robot.base_parameters import base_regressor
from seqid_cli.robot.types import Array

NESTED = 0.999  # share that the rival imitates on all moves of the pool, from which it always does


@dataclass(frozen=True)
class Question:
    """Two effects at a joint (None: of the whole arm), each with the settings that are tried."""

    effects: tuple[Effect, Effect]
    joint: int | None
    settings: tuple[Sequence[dict[str, float]], Sequence[dict[str, float]]]

    @classmethod
    def of(
        cls, effects: tuple[Effect, Effect], joint: int | None, scenes: Sequence[Scene]
    ) -> Question:
        """Take settings from the effects' grids over some data sets."""
        found = [_settings(effect, joint, scenes) for effect in effects]
        return cls(effects, joint, (found[0], found[1]))


def _settings(
    effect: Effect, joint: int | None, scenes: Sequence[Scene], *, most: int = 8
) -> list[dict[str, float]]:
    """At most so many settings of the grid, evenly; shapes are looked for in white noise.

    A diagnosis refines a continuous setting between the grid's values. Of an effect that has this
    setting alone, twice as many values between its bounds are taken, at which it is plausible.
    """
    if len(effect.settings) == 1 and _evenly_continuous(one := effect.settings[0]):
        fine = [{one.name: float(x)} for x in np.linspace(one.low, one.high, 2 * most)]
        ones = np.ones(len(effect.coefficients(fine[0])))
        if plausible := [x for x in fine if effect.plausible(scenes, joint, x, ones)]:
            return plausible
    rng = np.random.default_rng(0)
    white = [rng.normal(size=scene.motion.q.shape) for scene in scenes]
    grid = list(effect.grid(scenes, joint, white))
    return [grid[k] for k in np.unique(np.linspace(0, len(grid) - 1, most).round().astype(int))]


def _evenly_continuous(setting: Setting) -> bool:
    """Whether a setting is searched between two bounds, and not by ratio."""
    bounded = np.isfinite([setting.low, setting.high]).all()
    return bool(setting.continuous and not setting.logarithmic and bounded)


@dataclass(frozen=True)
class Separation:
    """Gram matrices of moves: `of` (M, K, K) of both effects' columns, the base eliminated last.

    Columns are base (`base` many), then those of each setting in `slots`, by effect.
    """

    base: int
    slots: tuple[list[slice], list[slice]]
    prior: Array  # (K, K)
    of: Array
    size: list[dict[int, Array]]  # by effect: N_a of every setting

    def effects(self, total: Array) -> Array:
        """Gram matrix of the effects' columns with the base free, (..., k, k)."""
        G, b = total + self.prior, self.base
        gain = np.linalg.solve(G[..., :b, :b], G[..., :b, b:])
        return np.asarray(G[..., b:, b:] - np.swapaxes(G[..., :b, b:], -1, -2) @ gain)

    def leaves(self, total: Array, true: int) -> tuple[Array, Array]:
        """T_a per unit of mean square torque with and without the rival, settings last."""
        E = self.effects(total)
        found = [self._left(E, true, number) for number in range(len(self.slots[true]))]
        return np.stack([x for x, _ in found], axis=-1), np.stack([x for _, x in found], axis=-1)

    def _left(self, E: Array, true: int, number: int) -> tuple[Array, Array]:
        a = self.slots[true][number]
        inverse = np.asarray(np.linalg.pinv(self.size[true][number], hermitian=True), float)
        alone = E[..., a, a]
        own = _trace(inverse, alone)
        rest = [own]
        for b in self.slots[1 - true]:
            cross = E[..., a, b]
            rival = E[..., b, b]
            ridge = 1e-9 * np.trace(rival, axis1=-2, axis2=-1)[..., None, None] + 1e-12
            gain = np.linalg.solve(
                rival + ridge * np.eye(rival.shape[-1]), np.swapaxes(cross, -1, -2)
            )
            rest.append(_trace(inverse, alone - cross @ gain))
        return np.maximum(np.min(rest, axis=0), 0.0), own

    @cached_property
    def ways(self) -> list[int]:
        """Which of the effects the other one cannot imitate on every move."""
        total = self.of.sum(axis=0)
        found = [self.leaves(total, true) for true in (0, 1)]
        return [k for k, (left, own) in enumerate(found) if left.mean() > (1 - NESTED) * own.mean()]

    def value(self, total: Array) -> Array:
        """T (...) per unit of mean square torque, the smaller of both ways round."""
        return np.asarray(
            np.min([self.leaves(total, k)[0].mean(axis=-1) for k in self.ways], axis=0)
        )

    def imitated(self, total: Array) -> float:
        """Largest share of an effect that its rival imitates, over both ways round."""
        pairs = [self.leaves(total, k) for k in self.ways]
        return max(float(1.0 - np.mean(left) / np.mean(own)) for left, own in pairs)


def _trace(inverse: Array, S: Array) -> Array:
    return np.asarray(np.einsum("ab,...ba->...", inverse, S) / len(inverse))


def scenes_of(belief: Belief, stages: Stages, moves: Sequence[PlannedMove]) -> list[Scene]:
    """Planned moves as the effects see logs: motion as it is planned, the model's own torque."""
    model = TorqueModel.from_stages(stages, belief.robot)
    width = sign_widths(model, belief.limits.speed)
    n = belief.robot.n
    cutoff = Cutoff(NOISE_HZ, np.zeros(n), 0.0, False, np.zeros(n))
    scenes = []
    for number, move in enumerate(moves):
        t, q, dq, ddq = sampled(move, belief.robot.joint_names, RATE_HZ)
        every = np.ones(len(t), dtype=bool)
        motion = Motion(
            t, q, dq, ddq, None, np.abs(dq) > 1e-6, every, every, RATE_HZ,
            Lowpass(NOISE_HZ, RATE_HZ), cutoff,
        )  # fmt: skip
        blank = Scene(belief.robot, motion, model, width, log=number, period=1.0 / RATE_HZ)
        scenes.append(replace(blank, motion=replace(motion, tau=blank.modelled)))
    return scenes


@dataclass(frozen=True)
class _Layout:
    """Where columns stand: rigid ones, friction of the joints that count, settings of effects."""

    friction: list[slice]
    base: int
    slots: list[slice]  # from the base on

    @classmethod
    def of(cls, rigid: int, friction: Sequence[Array], widths: Sequence[int]) -> _Layout:
        starts = rigid + np.cumsum([0, *map(len, friction)])
        ends = np.cumsum([0, *widths])
        return cls(_between(starts), int(starts[-1]), _between(ends))

    @property
    def effects(self) -> int:
        """Number of columns of all settings."""
        return int(self.slots[-1].stop)


def _between(ends: Array) -> list[slice]:
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def separation_of(belief: Belief, question: Question, scenes: Sequence[Scene]) -> Separation:
    """Gram matrices of all moves."""
    joint, n = question.joint, belief.robot.n
    friction = [_friction(belief, scenes[0], j)[1] for j in range(n)]
    if joint is not None:  # the other joints' friction tells nothing of this one's effects
        friction = [x if j == joint else np.zeros((0, 0)) for j, x in enumerate(friction)]
    widths = [
        len(effect.coefficients(s))
        for effect, settings in zip(question.effects, question.settings, strict=True)
        for s in settings
    ]
    place = _Layout.of(belief.basis.size, friction, widths)
    K = place.base + place.effects
    prior, grams = np.zeros((K, K)), np.zeros((len(scenes), K, K))
    squares = np.zeros((place.effects, place.effects))
    prior[: belief.basis.size, : belief.basis.size] = _rigid_prior(belief)
    for part, known in zip(place.friction, friction, strict=True):
        prior[part, part] = known
    for m, scene in enumerate(scenes):
        for j, X in enumerate(_rows(belief, question, scene, place)):
            if joint in (None, j):
                squares += X[:, place.base :].T @ X[:, place.base :]
            X *= np.sqrt(belief.density[j] * scene.slides[:, j] / RATE_HZ)[:, None]
            grams[m] += X.T @ X
    squares /= sum(scene.samples for scene in scenes)
    first = len(question.settings[0])
    slots = place.slots[:first], place.slots[first:]
    sizes = [{k: squares[s, s] for k, s in enumerate(own)} for own in slots]
    return Separation(place.base, slots, prior, grams, sizes)


def _rows(belief: Belief, question: Question, scene: Scene, place: _Layout) -> Iterator[Array]:
    """Columns (N, K) of each joint."""
    motion = scene.motion
    H = base_regressor(belief.robot, belief.basis, motion.q, motion.dq, motion.ddq)
    made = _columns(question, scene)
    for j, part in enumerate(place.friction):
        X = np.zeros((scene.samples, place.base + place.effects))
        X[:, : belief.basis.size] = H[:, j]
        if part.stop > part.start:
            X[:, part] = _friction(belief, scene, j)[0]
        for slot, columns in zip(place.slots, made, strict=True):
            if j in columns:
                X[:, place.base + slot.start : place.base + slot.stop] = columns[j]
        yield X


def _columns(question: Question, scene: Scene) -> list[dict[int, Array]]:
    """Columns of all settings of the first effect, then of the second, by joint."""
    found = []
    for effect, settings in zip(question.effects, question.settings, strict=True):
        for one in settings:
            made = effect.columns(scene, question.joint, one)
            found.append({j: scene.motion.filtered(X) for j, X in made.items()})
    return found


def _friction(belief: Belief, scene: Scene, j: int) -> tuple[Array, Array]:
    """Columns (N, k) of a joint's friction, and what is known of their coefficients (k, k)."""
    motion, surface = scene.motion, belief.surfaces[j]
    if surface is None:
        return np.stack([scene.sign[:, j], motion.dq[:, j]], axis=1), np.zeros((2, 2))
    columns = surface.columns(motion.q[:, j], motion.dq[:, j])
    return columns, _known(surface.covariance, np.mean(columns**2, axis=0))


def _rigid_prior(belief: Belief) -> Array:
    """Information (b, b) of the stages on the base parameters."""
    scale = Goal.of(belief, 0).scale
    return _known(belief.root @ belief.root.T, scale**2)


def _known(covariance: Array, square: Array, *, inflation: float = 10.0) -> Array:
    """Inverse of an inflated covariance; a column of mean square 1 has a doubt of 1e-3 at least."""
    floor = 1e-6 / np.maximum(square, 1e-12 * square.max(initial=1e-300))
    return np.asarray(np.linalg.inv(inflation**2 * (covariance + np.diag(floor))))
