"""Candidates: an effect at a joint with its settings, and its columns on the rows."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.rows import Rows
from seqid_cli.discover.system import Joints, System, Trial
from seqid_cli.discover.wide import both_bands, full_residual, high_band
from seqid_cli.model.effects.effect import Effect, Setting
from seqid_cli.model.effects.scene import Scene

Array = NDArray[np.float64]

GOLDEN = 0.381966
SEARCH_STEPS = 9
SHARPENED = 3  # times that settings are moved to where the coefficients say
CLOSE = 0.8  # of the best grid point's gain, from which another shape is searched as well
NEAR = 1.5  # ratio by which a setting may move when another one takes its next value
AS_USUAL = 0.98  # of the best gain, from which a setting's usual value is taken
TOGETHER = 64  # candidates whose columns are low-passed at once


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint (None: the whole arm) with its settings.

    A `below` one is told by the rows below the cut-off alone, though it would show above it: what
    is faster than the position loop moves the arm, and the measured torque does not follow.
    """

    effect: Effect
    joint: int | None
    settings: dict[str, float]
    below: bool = False

    @property
    def key(self) -> tuple[str, int | None]:
        """What it is, whatever the settings."""
        return self.effect.name, self.joint

    @property
    def kind(self) -> tuple[float, ...]:
        """Its settings that are not searched between the grid's values."""
        specs = self.effect.settings
        return tuple(self.settings[s.name] for s in specs if not s.continuous and not s.then)

    @property
    def freedom(self) -> int:
        """Number of parameters that are fitted: coefficients and what is searched."""
        coefficients = self.effect.coefficients(self.settings)
        return len(coefficients) + self.effect.searched(self.settings)


@dataclass(frozen=True)
class Tried:
    """A candidate and what it does."""

    candidate: Candidate
    columns: Joints
    trial: Trial

    @property
    def above_too(self) -> bool:
        """Whether the rows above the cut-off tell of it as well."""
        return self.candidate.effect.wide and not self.candidate.below

    def joints(self, n: int) -> set[int]:
        """Those of the `n` joints whose torque below the cut-off it explains."""
        return {j for j, X in self.columns.items() if j < n and X.any()}


class Stage:
    """Where candidates are played: rows and scenes, with the columns made so far kept."""

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self.high = high_band(rows)
        self._made: dict[tuple[object, ...], Joints] = {}

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes of the rows."""
        return self.rows.scenes

    def columns(self, candidates: Sequence[Candidate]) -> list[Joints]:
        """Columns of candidates on the rows of the joints that they touch."""
        keys = [_key(candidate) for candidate in candidates]
        missing = {k: c for k, c in zip(keys, candidates, strict=True) if k not in self._made}
        for key, candidate in missing.items():
            if candidate.effect.wide:
                self._made[key] = self._wide(candidate)
        for passes in (1, 2):
            narrow = [(k, c) for k, c in missing.items() if not c.effect.wide]
            some = {k: c for k, c in narrow if c.effect.passes == passes}
            for first in range(0, len(some), TOGETHER):
                part = list(some.items())[first : first + TOGETHER]
                made = self._computed([c for _, c in part], passes)
                self._made.update(zip([k for k, _ in part], made, strict=True))
        return [self._made[key] for key in keys]

    def _wide(self, candidate: Candidate) -> Joints:
        """Columns below and above the cut-off."""
        if candidate.below:
            both = self.columns([replace(candidate, below=False)])[0]
            return {joint: X for joint, X in both.items() if joint < self.rows.n}
        effect = candidate.effect
        per_scene = [
            effect.columns(scene.full or scene, candidate.joint, candidate.settings)
            for scene in self.scenes
        ]
        return both_bands(self.rows, self.high, per_scene)

    def _computed(self, candidates: Sequence[Candidate], passes: int) -> list[Joints]:
        """Columns of candidates that are low-passed alike, all in one go."""
        per_scene = []
        for number, scene in enumerate(self.scenes):
            raw = [c.effect.columns(scene, c.joint, c.settings) for c in candidates]
            places = [(i, j) for i, columns in enumerate(raw) for j in columns]
            if not places:
                continue
            widths = [raw[i][j].shape[1] for i, j in places]
            every = np.hstack([raw[i][j] for i, j in places])
            both = self.rows.sieve(number, passes) @ every
            pieces = np.split(both, np.cumsum(widths)[:-1], axis=1)
            per_scene.append(dict(zip(places, pieces, strict=True)))
        if not per_scene:
            return [{} for _ in candidates]
        result: list[dict[int, Array]] = [{} for _ in candidates]
        for i, j in per_scene[0]:
            kept = zip(per_scene, self.rows.used, strict=True)
            whole = np.concatenate([pieces[i, j][used[:, j]] for pieces, used in kept])
            result[i][j] = self.rows.whitened(j, whole)
        return list(result)

    def try_all(self, system: System, candidates: Sequence[Candidate]) -> list[Tried]:
        """Try candidates by themselves; those without columns are left out."""
        columns = self.columns(candidates)
        there = [i for i, c in enumerate(columns) if c and next(iter(c.values())).shape[1]]
        trials = system.tried([columns[i] for i in there])
        return [
            Tried(candidates[i], columns[i], trial) for i, trial in zip(there, trials, strict=True)
        ]

    def plausible(self, tried: Tried) -> bool:
        """Whether the coefficients are physical."""
        c = tried.candidate
        return c.effect.plausible(self.scenes, c.joint, c.settings, tried.trial.coefficients)


def _key(candidate: Candidate) -> tuple[object, ...]:
    return (*candidate.key, candidate.below, *sorted(candidate.settings.items()))


def candidates_of(
    narrow: Sequence[Scene],
    effects: Sequence[Effect],
    left: Sequence[Array],
    near: Collection[int] | None = None,
) -> Iterator[Candidate]:
    """Yield every effect at every joint with every setting of its grid.

    `left` (N, n) per scene is the low-passed residual, which guides effects that look for shapes;
    those that show above the cut-off as well get it at the logs' own rates. With `near`, effects of
    other joints than these are left out.
    """
    n = narrow[0].robot.n
    full = [scene.full or scene for scene in narrow]
    whole = [full_residual(scene, r) for scene, r in zip(narrow, left, strict=True)]
    for effect in effects:
        scenes, residual = (full, whole) if effect.wide else (narrow, left)
        own = [j for j in range(n) if near is None or j in near]
        joints: list[int | None] = [None] if effect.arm else list(own)
        if effect.shared and n > 1:
            joints.append(None)
        for joint in joints:
            if effect.available(scenes, joint):
                for settings in effect.grid(scenes, joint, residual):
                    yield Candidate(effect, joint, settings)
                    if effect.wide:
                        yield Candidate(effect, joint, settings, below=True)


def shapes(tried: Tried, others: Sequence[Tried]) -> list[Tried]:
    """Best points of an effect, one for each of its discrete settings that may come out first.

    Between the grid's values the order of, say, two exponents can change.
    """
    specs = tried.candidate.effect.settings
    discrete = [setting.name for setting in specs if not setting.continuous]
    if len(discrete) in {0, len(specs)} or tried.trial.total <= 0.0:
        return [tried]
    best = {}
    least = CLOSE * tried.trial.total
    for other in sorted(others, key=lambda t: t.trial.total):
        if other.candidate.key == tried.candidate.key and other.trial.total >= least:
            best[tuple(other.candidate.settings[name] for name in discrete)] = other
    return list(best.values())


def refined(stage: Stage, system: System, tried: Tried, spacing: float = 2.5) -> Tried:
    """Search the continuous settings of a candidate near its grid point for the largest gain.

    Of effects that are looked for to first order the first sharpening stands though it gains less:
    a lag would pass for a delay.
    """
    best = tried
    for setting in tried.candidate.effect.settings:
        if setting.continuous:
            best = _searched(stage, system, best, setting, spacing)
            best = _as_usual(stage, system, best, setting)
    best = _followed(stage, system, best)
    for number in range(SHARPENED):
        candidate = best.candidate
        settings = candidate.effect.sharpened(candidate.settings, best.trial.coefficients)
        if settings is None:
            break
        found = stage.try_all(system, [replace(candidate, settings=settings)])
        if not found or not stage.plausible(found[0]):
            break
        stands = number == 0 and candidate.effect.first_order
        if not stands and found[0].trial.total <= best.trial.total:
            break
        best = found[0]
    return best


def _searched(
    stage: Stage, system: System, tried: Tried, setting: Setting, spacing: float
) -> Tried:
    """Golden-section search over one setting, by ratio where it is logarithmic."""
    value = tried.candidate.settings[setting.name]
    low, high = _bracket(setting, value, spacing)
    best = tried

    def gain(x: float) -> float:
        nonlocal best
        at = float(np.exp(x)) if setting.logarithmic else float(x)
        settings = {**tried.candidate.settings, setting.name: at}
        found = stage.try_all(system, [replace(tried.candidate, settings=settings)])
        if not found:
            return -np.inf
        if found[0].trial.total > best.trial.total and stage.plausible(found[0]):
            best = found[0]
        return found[0].trial.total

    a, b = low, high
    x, y = a + GOLDEN * (b - a), b - GOLDEN * (b - a)
    gx, gy = gain(x), gain(y)
    for _ in range(SEARCH_STEPS):
        if gx > gy:
            b, y, gy = y, x, gx
            x = a + GOLDEN * (b - a)
            gx = gain(x)
        else:
            a, x, gx = x, y, gy
            y = b - GOLDEN * (b - a)
            gy = gain(y)
    return best


def _followed(stage: Stage, system: System, tried: Tried) -> Tried:
    """Take the next values of settings that have some while the gain grows."""
    best = tried
    specs = tried.candidate.effect.settings
    for setting in specs:
        now = tried.candidate.settings.get(setting.name)
        ahead = setting.then[setting.then.index(now) + 1 :] if now in setting.then else setting.then
        for value in ahead:
            settings = {**best.candidate.settings, setting.name: value}
            found = stage.try_all(system, [replace(best.candidate, settings=settings)])
            for other in specs if found else ():
                if other.continuous:
                    found = [_searched(stage, system, found[0], other, NEAR)]
            if not found or found[0].trial.total <= best.trial.total:
                break
            best = found[0]
    return best


def _as_usual(stage: Stage, system: System, tried: Tried, setting: Setting) -> Tried:
    """The candidate with a usual value of a setting, where that gains nearly as much."""
    c = tried.candidate
    usual = [replace(c, settings={**c.settings, setting.name: x}) for x in setting.usual]
    near = [
        t
        for t in stage.try_all(system, usual)
        if t.trial.total >= AS_USUAL * tried.trial.total and stage.plausible(t)
    ]
    return max(near, key=lambda t: t.trial.total, default=tried)


def _bracket(setting: Setting, value: float, spacing: float) -> tuple[float, float]:
    """Interval about a grid value; in logarithms where the setting is searched by ratio."""
    if setting.logarithmic:
        low, high = value / spacing, value * spacing
        bounded = max(low, setting.low, 1e-12), min(high, setting.high)
        return float(np.log(bounded[0])), float(np.log(bounded[1]))
    reach = 0.5 * max(abs(value), 1e-3)
    return max(value - reach, setting.low), min(value + reach, setting.high)


def again(tried: Tried, accepted: Tried) -> bool:
    """Whether it is the accepted effect once more, and not another line of it.

    A line that is told by the rows below the cut-off has its shaken arm above it.
    """
    one, other = tried.candidate, accepted.candidate
    if one.key != other.key:
        return False
    above = other.below and not one.below
    return not one.effect.wide or (above and one.effect.one_line(one.settings, other.settings))


def apart(tried: Tried, other: Tried) -> bool:
    """Whether a candidate lives above the cut-off, where the other's shape has no error."""
    return tried.above_too and not other.candidate.effect.wide


def best_of_each(tried: Sequence[Tried]) -> list[Tried]:
    """The best setting of every effect and joint, the largest gain first.

    Of what shows above the cut-off as well, that one too: below it alone more may be gained, of
    fewer rows, and the gate is another.
    """
    best: dict[tuple[str, int | None, bool], Tried] = {}
    for t in tried:
        key = (*t.candidate.key, t.candidate.below)
        if key not in best or t.trial.total > best[key].trial.total:
            best[key] = t
    return sorted(best.values(), key=by_gain)


def by_gain(tried: Tried) -> float:
    """Sort key: the largest gain comes first."""
    return -tried.trial.total
