"""Candidates: an effect at a joint with its settings, and its columns on the rows."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seqid_cli.discover.absorbed import FileTrials
from seqid_cli.discover.base import LIKELY, has_trials, residual_of
from seqid_cli.discover.select.rows import Channels, ColumnGroup
from seqid_cli.discover.survey.high_band import both_bands, full_residual, high_band
from seqid_cli.discover.survey.rows import TOGETHER, Rows
from seqid_cli.model.effects.effect import Columns, Effect
from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.butterworth import single
from seqid_cli.typing import Array


@dataclass(frozen=True)
class DriveRows:
    """Rows of each joint's drive, where a torque sensor behind the gear tells what the link takes.

    The motor's torque less the sensor's is what the drive takes,

        tau_m - tau_l = k tau_l + I ddq + f(dq, q, tau_l) + c,

    friction f and the rotor's inertia I, with an error k by which motor and sensor
    disagree about a torque and a zero c of the sensor. What a model gets wrong of the
    link, and what else acts on it, is not in these rows: it does not hide an effect of
    the drive there, nor pass for one.
    """

    # (M_j,) N m the file leaves of motor less sensor; empty without one
    y: tuple[Array, ...] = ()
    # (M_j, 3): the sensor's torque, rotor acceleration, constant
    columns: tuple[Array, ...] = ()

    def of(self, joint: int) -> bool:
        """Whether a joint has such rows."""
        return bool(self.y) and len(self.y[joint]) > 0

    def part(
        self, joint: int, channel: int, size: float, *, disagree: float = 0.05
    ) -> ColumnGroup:
        """What is free beside friction; `size` [N m] is what the file leaves.

        By `disagree` motor and sensor may tell another torque: the robot file says so,
        by its torque constants, and what leaves it tells against the file.
        """
        X = self.columns[joint]
        likely = np.mean(X**2, axis=0) / (LIKELY * size) ** 2
        own, of_file = np.diag(likely), np.diag([disagree**-2.0, 0.0, 0.0])
        own[0, 0] = 0.0
        return ColumnGroup(
            columns={channel: X}, precision=own + of_file, precision_without_file=own
        )


def drive_rows(rows: Rows) -> DriveRows:
    """Take the rows of drives whose joints have a torque sensor in all logs."""
    if any(scene.sensor is None for scene in rows.scenes):
        return DriveRows()
    # (N, n, 4), low-passed: what the file leaves of the drive's torque, its columns
    every = []
    for scene in rows.scenes:
        motion = scene.motion
        assert scene.sensor is not None
        sensor = motion.filtered(scene.sensor)
        left = residual_of(scene) - sensor + motion.filtered(scene.modelled_load)
        shown = [left, sensor, motion.filtered(motion.ddq), np.ones_like(left)]
        every.append(np.stack(shown, axis=-1))
    own = [rows.torque(j, [values[:, j] for values in every]) for j in range(rows.n)]
    known = [X if np.isfinite(X).all() else X[:0] for X in own]
    return DriveRows(tuple(X[:, 0] for X in known), tuple(X[:, 1:] for X in known))


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint (None: the whole arm) with its settings.

    One `apart` has coefficients of its own above the cut-off: what is faster than the
    position loop moves the arm, and the measured torque does not follow. One `absorbed`
    was there in the trials of the file's friction and gravity, which have absorbed a
    part of it (see `FileTrials`): "all" of them, or friction alone, where gravity is
    known from other joints' trials.
    """

    effect: Effect
    joint: int | None
    settings: dict[str, float]
    apart: bool = False
    absorbed: Literal["", "friction", "all"] = ""

    @property
    def size(self) -> int:
        """Number of its coefficients; one apart has as many more."""
        return len(self.effect.coefficients(self.settings))

    @property
    def key(self) -> tuple[str, int | None]:
        """What it is, whatever the settings."""
        return self.effect.name, self.joint

    @property
    def address(self) -> tuple[object, ...]:
        """What it is with its settings."""
        return (*self.key, self.apart, self.absorbed, *sorted(self.settings.items()))

    def is_same_as(self, other: Candidate, *, tolerance: float = 0.01) -> bool:
        """Whether two are one effect; a joint may have several lines and ripples.

        These are one where orders and frequencies differ by a share of `tolerance` at
        most. Of what is looked for to first order the settings say about which size.
        """
        if self.key != other.key:
            return False
        every = () if self.effect.first_order else self.effect.settings
        told = [s.name for s in every if self.effect.wide or not s.continuous]
        pairs = ((self.settings[name], other.settings[name]) for name in told)
        return all(math.isclose(*pair, rel_tol=tolerance) for pair in pairs)

    def columns(self, scene: Scene) -> Columns:
        """Torque (N, k) per unit coefficient by joint, unfiltered."""
        return self.effect.columns(scene, self.joint, self.settings)

    def torques(self, scene: Scene, c: Array) -> dict[int, Array]:
        """Torque (N,) N m of coefficients c (k,) by joint, low-passed."""
        at = (scene.full or scene) if self.effect.wide else scene
        every, passes = (
            round(at.motion.rate_hz / scene.motion.rate_hz),
            self.effect.passes,
        )
        shown = {
            j: at.motion.filtered(X @ c, times=passes)
            for j, X in self.columns(at).items()
        }
        return {j: torque[::every] for j, torque in shown.items()}


# candidates times samples that are worked out together: memory
MOST_COLUMNS = 2_000_000


class CandidateColumns:
    """Rows and data sets on which candidates are tried, and what the `file` has of these."""

    def __init__(self, rows: Rows, file: FileTrials | None = None) -> None:
        self.rows, self.scenes, self.file = rows, rows.scenes, file
        self.high, self.drive = high_band(rows), drive_rows(rows)
        self._made: dict[tuple[object, ...], Channels] = {}
        # see `effects`
        self.known: dict[tuple[object, ...], tuple[Array, dict[int, Array]]] = {}

    def columns(self, candidates: Sequence[Candidate]) -> list[Channels]:
        """Columns of candidates on the rows of the joints that they touch."""
        keys = [replace(candidate, absorbed="").address for candidate in candidates]
        missing = {
            k: c for k, c in zip(keys, candidates, strict=True) if k not in self._made
        }
        for key, candidate in missing.items():
            # kept at once: another setting of it may stand on these
            if candidate.effect.wide:
                self._made[key] = self._wide(candidate)
        longest = max(scene.samples for scene in self.scenes)
        together = max(1, min(TOGETHER, MOST_COLUMNS // longest))
        for passes in (1, 2):
            alike = {k: c for k, c in missing.items() if c.effect.passes == passes}
            some = [(k, c) for k, c in alike.items() if not c.effect.wide]
            for first in range(0, len(some), together):
                part = dict(some[first : first + together])
                made = self._computed([*part.values()], passes)
                self._made.update(zip(part, made, strict=True))
        pairs = [(c, self._made[key]) for key, c in zip(keys, candidates, strict=True)]
        return [self.with_drive(own) if c.effect.drive else own for c, own in pairs]

    def came_since(self, candidate: Candidate) -> bool:
        """Whether friction trials would have shown a candidate that was not there in them."""
        known = self.file is not None and has_trials(self.scenes[0], candidate.joint)
        return known and candidate.effect.steady and not candidate.absorbed

    def with_drive(self, columns: Channels) -> dict[int, Array]:
        """The same columns on the rows of the drive as well, where there are some."""
        n = self.rows.n
        seen = {2 * n + c: X for c, X in columns.items() if c < n and self.drive.of(c)}
        return {**columns, **seen}

    def _wide(self, candidate: Candidate) -> Channels:
        """Columns below and above the cut-off; none apart if all is above."""
        if candidate.apart:
            both = self.columns([replace(candidate, apart=False)])[0]
            below = [X for c, X in both.items() if c < self.rows.n]
            return both if any(np.any(X, axis=0).all() for X in below) else {}
        per_scene = [candidate.columns(scene.full or scene) for scene in self.scenes]
        return both_bands(self.rows, self.high, per_scene)

    def _computed(self, candidates: Sequence[Candidate], passes: int) -> list[Channels]:
        """Columns of candidates that are low-passed alike, all in one go."""
        # by joint: candidates, number of their columns
        owners: dict[int, dict[int, int]] = {}

        def together(scene: Scene) -> dict[int, Array]:
            raw = [c.columns(scene) for c in candidates]
            side_by_side = {}
            for j in sorted({joint for columns in raw for joint in columns}):
                own = {i: columns[j] for i, columns in enumerate(raw) if j in columns}
                owners[j] = {i: X.shape[1] for i, X in own.items()}
                side_by_side[j] = np.hstack([single(X) for X in own.values()])
            return side_by_side

        result: list[dict[int, Array]] = [{} for _ in candidates]
        for j, whole in self.rows.columns(map(together, self.scenes), passes).items():
            edges = np.cumsum([*owners[j].values()])
            for i, X in zip(
                owners[j], np.split(whole, edges[:-1], axis=1), strict=True
            ):
                result[i][j] = np.ascontiguousarray(X)
        return list(result)

    def in_file(
        self, candidate: Candidate, columns: Channels
    ) -> tuple[dict[int, Array], Channels]:
        """What the file has absorbed of a candidate (see `FileTrials`), and its columns less it."""
        file = self.file
        if not candidate.absorbed or file is None:
            return {}, columns
        found = file.absorbed(candidate.effect, candidate.joint, candidate.settings)
        own = {k: a for k, a in found.items() if k or candidate.absorbed == "all"}
        below = {
            j: file.beside(X, j, own) for j, X in columns.items() if j < self.rows.n
        }
        return own, {**columns, **below}


def candidates_of(
    narrow: Sequence[Scene],
    effects: Sequence[Effect],
    left: Sequence[Array],
    near: Collection[int | None] | None = None,
) -> Iterator[Candidate]:
    """Yield every effect at every joint with every setting of its grid.

    `left` (N, n) per data set is the low-passed residual, which guides effects that
    look for shapes; those that show above the cut-off as well get it at the logs' own
    rates. With `near`, effects of other joints than these are left out (None among
    them: those of the whole arm).
    """
    n = narrow[0].robot.n
    full = [scene.full or scene for scene in narrow]
    whole = [full_residual(scene, r) for scene, r in zip(narrow, left, strict=True)]
    asked = {x.name: x.joint for x in narrow[0].robot.effects if x.joint is not None}
    for effect in effects:
        scenes, residual = (full, whole) if effect.wide else (narrow, left)
        joints: list[int | None] = [None] if effect.arm else list(range(n))
        if effect.shared and n > 1:
            joints.append(None)
        for joint in (j for j in joints if j == asked.get(effect.name, j)):
            if (near is None or joint in near) and effect.available(scenes, joint):
                for settings in effect.grid(scenes, joint, residual):
                    yield Candidate(effect, joint, settings)
                    if effect.wide:
                        yield Candidate(effect, joint, settings, apart=True)
                    if effect.steady and has_trials(narrow[0], joint):
                        yield Candidate(effect, joint, settings, absorbed="all")
                        if effect.even:
                            yield Candidate(
                                effect, joint, settings, absorbed="friction"
                            )
