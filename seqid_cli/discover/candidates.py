"""Candidates: an effect at a joint with its settings, and its columns on the rows."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seqid_cli.discover.absorbed import FileTrials
from seqid_cli.discover.base import LIKELY, has_trials, residual_of
from seqid_cli.discover.link_rows import link_rows
from seqid_cli.discover.select.rows import Channels, ColumnGroup
from seqid_cli.discover.survey.high_band import both_bands, full_residual, high_band
from seqid_cli.discover.survey.rows import TOGETHER, Rows
from seqid_cli.effects.effect import (
    FROM_LOG,
    SINCE_LOG,
    AnyJoint,
    Columns,
    Effect,
    Settings,
    acts_in_log,
)
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.butterworth import single
from seqid_cli.typing import Array


@dataclass(frozen=True)
class DriveRows:
    """Rows of each joint's drive, where a torque sensor stands behind the gear.

    The motor's torque less the sensor's is what the drive takes,

        tau_m - tau_l = k tau_l + I ddq + f(dq, q, tau_l) + c,

    friction f and the rotor's inertia I, with an error k by which motor and sensor
    disagree about a torque and a zero c of the sensor. What a model gets wrong of the
    link, and what else acts on it, is not in these rows: it does not hide an effect of
    the drive there, nor pass for one.

    Attributes
    ----------
    y : tuple of (M_j,) arrays
        What the file leaves of motor less sensor [N m; N where prismatic], by joint.
        Empty where logs have no sensor.
    columns : tuple of (M_j, 3) arrays
        The sensor's torque, the rotor's acceleration, a constant.
    """

    y: tuple[Array, ...] = ()
    columns: tuple[Array, ...] = ()

    def of(self, joint: int) -> bool:
        """Return whether a joint has such rows."""
        return bool(self.y) and len(self.y[joint]) > 0

    def part(
        self, joint: int, channel: int, size: float, *, disagree: float = 0.05
    ) -> ColumnGroup:
        """Return what is free beside friction.

        Parameters
        ----------
        joint : int
            Index of the joint.
        channel : int
            Its drive's channel.
        size : float
            What the file leaves there [N m; N where prismatic].
        disagree : float
            Share of a torque by which motor and sensor may disagree. The robot file
            says so, by its torque constants, and what leaves it tells against the file.
        """
        X = self.columns[joint]
        precision = np.diag(np.mean(X**2, axis=0) / (LIKELY * size) ** 2)
        precision[0, 0] = 0.0
        of_file = np.diag([disagree**-2.0, 0.0, 0.0])
        return ColumnGroup(
            columns={channel: X},
            precision=precision + of_file,
            precision_without_file=precision,
        )


def drive_rows(rows: Rows) -> DriveRows:
    """Take the rows of drives whose joints have a torque sensor in all logs."""
    if any(scene.sensor is None for scene in rows.scenes):
        return DriveRows()

    # By data set (N, n, 4), low-passed: what the file leaves of the drive's torque, and
    # its columns.
    values_by_scene = []
    for scene in rows.scenes:
        motion = scene.motion
        assert scene.sensor is not None
        sensor = motion.filtered(scene.sensor)
        modelled_load = motion.filtered(scene.modelled_load)
        residual = residual_of(scene) - sensor + modelled_load
        rotor_acceleration = motion.filtered(motion.ddq)
        values = [residual, sensor, rotor_acceleration, np.ones_like(residual)]
        values_by_scene.append(np.stack(values, axis=-1))

    y = []
    columns = []
    for joint in range(rows.n):
        of_joint = rows.torque(joint, [values[:, joint] for values in values_by_scene])
        if not np.isfinite(of_joint).all():
            of_joint = of_joint[:0]  # the sensor of this joint has gaps
        y.append(of_joint[:, 0])
        columns.append(of_joint[:, 1:])
    return DriveRows(y=tuple(y), columns=tuple(columns))


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint (None: the whole arm) with its settings.

    Attributes
    ----------
    effect : Effect
        The effect.
    joint : int or None
        Where it is.
    settings : dict of str to float
        Its settings.
    apart : bool
        It has coefficients of its own above the cut-off: what is faster than the
        position loop moves the arm, and the measured torque does not follow.
    absorbed : {"", "friction", "all", "torque"}
        It was there in the trials of the file's friction and gravity, which have
        absorbed a part of it (see `FileTrials`): all of them, or friction alone, where
        gravity is known from other joints' trials. Or it was there in all logs of the
        file, whose parameters have its torque: then only rows of links show it.
    late : bool
        It came after the file was identified, whose logs do not have it.
    """

    effect: Effect
    joint: int | None
    settings: dict[str, float]
    apart: bool = False
    absorbed: Literal["", "friction", "all", "torque"] = ""
    late: bool = False

    @property
    def size(self) -> int:
        """Number of its coefficients; one apart has as many more."""
        return len(self.effect.coefficients(self.settings))

    @property
    def key(self) -> tuple[str, int | None]:
        """Name and joint, whatever the settings."""
        return self.effect.name, self.joint

    @property
    def address(self) -> tuple[object, ...]:
        """All that tells it from other candidates."""
        return (*self.key, self.apart, self.absorbed, *sorted(self.settings.items()))

    def is_same_as(self, other: Candidate, *, tolerance: float = 0.01) -> bool:
        """Return whether two are one effect.

        A joint may have several lines and ripples. These are one where orders and
        frequencies differ by a share of `tolerance` at most. Of what is looked for to
        first order the settings say about which size.
        """
        if self.key != other.key:
            return False
        if self.effect.first_order:
            return True
        for setting in self.effect.settings:
            if setting.continuous and not self.effect.wide:
                continue  # of the same law: only how it is shaped
            value, other_value = (
                settings.get(setting.name, 0.0)
                for settings in (self.settings, other.settings)
            )
            if not math.isclose(value, other_value, rel_tol=tolerance):
                return False
        return True

    def may_replace(self, other: Candidate) -> bool:
        """Return whether it is another one's effect, with any settings.

        The logs in which it is and what the file has of it are the same. Of several
        lines or ripples it is the same one; what is looked for to first order has its
        settings from its own size.
        """
        is_where_other_is = (self.apart, self.absorbed, self.late) == (
            other.apart,
            other.absorbed,
            other.late,
        ) and self.settings.get(FROM_LOG) == other.settings.get(FROM_LOG)
        if self.key != other.key or not is_where_other_is:
            return False
        if self.effect.wide:
            return self.is_same_as(other)
        return not self.effect.first_order

    def columns(self, scene: Scene) -> Columns:
        """Return the torque (N, k) per unit coefficient by joint, unfiltered."""
        return self.effect.columns_in_log(scene, self.joint, self.settings)

    def torques(self, scene: Scene, c: Array) -> dict[int, Array]:
        """Return the low-passed torque (N,) N m of coefficients c (k,), by joint.

        There is none where the file has absorbed it.
        """
        if self.absorbed == "torque":
            return {}
        # A wide effect is worked out at the log's own rate: it would be aliased.
        full = (scene.full or scene) if self.effect.wide else scene
        stride = round(full.motion.rate_hz / scene.motion.rate_hz)
        torques = {}
        for joint, X in self.columns(full).items():
            filtered = full.motion.filtered(X @ c, times=self.effect.passes)
            torques[joint] = filtered[::stride]
        return torques


# of the largest singular value: what the logs do not show of a change
OPEN = 1e-9
# every how many samples are enough for what is low-passed at 24 of them or more
THINNED = 6
# candidates times samples that are worked out together: memory
MOST_COLUMNS = 2_000_000


class CandidateColumns:
    """Columns of candidates on the rows of data sets, and what the file has of them.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets below the cut-off.
    file : FileTrials, optional
        The trials from which the file was identified.

    Attributes
    ----------
    high : HighBand
        Rows above the cut-off.
    drive : DriveRows
        Rows of drives.
    links : LinkRows
        Rows of links against their motors.
    known : dict
        By a candidate's address, the precision of its coefficients and what the file
        has absorbed (see `select.terms.effects`).
    """

    def __init__(self, rows: Rows, file: FileTrials | None = None) -> None:
        self.rows = rows
        self.scenes = rows.scenes
        self.file = file
        self.high = high_band(rows)
        self.drive = drive_rows(rows)
        self.links = link_rows(rows)
        self.known: dict[tuple[object, ...], tuple[Array, dict[int, Array]]] = {}
        self._computed: dict[tuple[object, ...], Channels] = {}
        self._computed_on_links: dict[tuple[object, ...], Channels] = {}

    def forget(self, *, but_at: Collection[AnyJoint] = ()) -> None:
        """Let go of the columns of candidates: a search leaves thousands of them.

        What is asked for again is worked out again.

        Parameters
        ----------
        but_at : collection of int or None
            Joints whose candidates stay (None: those of the whole arm).
        """
        for columns in (self._computed, self._computed_on_links, self.known):
            for address in [*columns]:
                if address[1] not in but_at:
                    del columns[address]
        for scene in self.scenes:
            scene.forget(but_at=but_at)

    def columns(self, candidates: Sequence[Candidate]) -> list[Channels]:
        """Return columns of candidates on the rows of the joints that they touch."""
        # What the file has absorbed makes no difference to the columns.
        keys = [replace(candidate, absorbed="").address for candidate in candidates]
        missing: dict[tuple[object, ...], Candidate] = {}
        for key, candidate in zip(keys, candidates, strict=True):
            if key not in self._computed:
                missing[key] = candidate
        self._compute(missing)

        result: list[Channels] = []
        for key, candidate in zip(keys, candidates, strict=True):
            columns = self._computed[key]
            if candidate.effect.drive:
                columns = self.with_drive(columns)
            on_links = self._on_links(candidate, key)
            if candidate.absorbed == "torque":
                columns = {}
            result.append({**columns, **on_links})
        return result

    def _compute(self, missing: Mapping[tuple[object, ...], Candidate]) -> None:
        """Work out columns that are not known yet."""
        for key, candidate in missing.items():
            # Kept at once: another setting of it may stand on these.
            if candidate.effect.wide:
                self._computed[key] = self._wide(candidate)

        longest = max(scene.samples for scene in self.scenes)
        batch = max(1, min(TOGETHER, MOST_COLUMNS // longest))
        for passes in (1, 2):
            narrow_keys = [
                key
                for key, candidate in missing.items()
                if candidate.effect.passes == passes and not candidate.effect.wide
            ]
            for first in range(0, len(narrow_keys), batch):
                batch_keys = narrow_keys[first : first + batch]
                computed = self._narrow([missing[key] for key in batch_keys], passes)
                self._computed.update(zip(batch_keys, computed, strict=True))

    def _on_links(self, candidate: Candidate, key: tuple[object, ...]) -> Channels:
        """Return columns on the rows of links, of effects that turn a link."""
        if not self.links.y or candidate.joint is None:
            return {}
        if key not in self._computed_on_links:
            angles = [
                candidate.effect.link_angle(scene, candidate.joint, candidate.settings)
                for scene in self.scenes
            ]
            # Readings are low-passed, and so is the motion that an angle follows from.
            # An angle with steps is finer than that motion: unfiltered, a landing that
            # is a little early or late would look like no play.
            is_finer = candidate.effect.passes > 1
            turned = [
                scene.motion.filtered(angle) if is_finer else angle
                for scene, angle in zip(self.scenes, angles, strict=True)
                if angle is not None
            ]
            self._computed_on_links[key] = (
                self.links.columns(candidate.joint, turned) if turned else {}
            )
        return self._computed_on_links[key]

    def came_since(self, candidate: Candidate) -> bool:
        """Return whether friction trials would have shown a candidate, and did not."""
        has_file_trials = self.file is not None and has_trials(
            self.scenes[0], candidate.joint
        )
        return has_file_trials and candidate.effect.steady and not candidate.absorbed

    def with_drive(self, columns: Channels) -> dict[int, Array]:
        """Add the same columns on the rows of drives, where there are some."""
        n = self.rows.n
        on_drives = {
            2 * n + channel: X
            for channel, X in columns.items()
            if channel < n and self.drive.of(channel)
        }
        return {**columns, **on_drives}

    def _wide(self, candidate: Candidate) -> Channels:
        """Return columns below and above the cut-off; none apart if all is above."""
        if not candidate.apart:
            per_scene = [
                candidate.columns(scene.full or scene) for scene in self.scenes
            ]
            return both_bands(self.rows, self.high, per_scene)

        # Coefficients of its own above are nothing new where it has none below.
        together = self.columns([replace(candidate, apart=False)])[0]
        for channel, X in together.items():
            if channel < self.rows.n and np.any(X, axis=0).all():
                return together
        return {}

    def _narrow(self, candidates: Sequence[Candidate], passes: int) -> list[Channels]:
        """Return columns of candidates that are low-passed alike, all in one go."""
        # By joint: the candidates that touch it, and their numbers of columns.
        n_columns: dict[int, dict[int, int]] = {}

        def side_by_side(scene: Scene) -> dict[int, Array]:
            of_candidates = _columns_in_log(candidates, scene)
            joints = {joint for columns in of_candidates for joint in columns}
            stacked = {}
            for joint in sorted(joints):
                at_joint = {
                    number: columns[joint]
                    for number, columns in enumerate(of_candidates)
                    if joint in columns
                }
                n_columns[joint] = {i: X.shape[1] for i, X in at_joint.items()}
                stacked[joint] = np.hstack([single(X) for X in at_joint.values()])
            return stacked

        by_candidate: list[dict[int, Array]] = [{} for _ in candidates]
        on_rows = self.rows.columns(map(side_by_side, self.scenes), passes)
        for joint, X in on_rows.items():
            ends = np.cumsum([*n_columns[joint].values()])
            parts = np.split(X, ends[:-1], axis=1)
            for number, part in zip(n_columns[joint], parts, strict=True):
                by_candidate[number][joint] = np.ascontiguousarray(part)
        return list(by_candidate)

    def in_file(
        self, candidate: Candidate, columns: Channels
    ) -> tuple[dict[int, Array], Channels]:
        """Return what the file has absorbed of a candidate, and its columns less that.

        Parameters
        ----------
        candidate : Candidate
            An effect at a joint.
        columns : mapping of channel to (M_c, k) array
            Its columns.

        Returns
        -------
        dict of int to (., k) array
            Coefficients of the rigid body and friction, as `FileTrials.absorbed` has
            them.
        mapping of channel to (M_c, k) array
            The columns less what these explain.
        """
        file = self.file
        if candidate.absorbed in ("", "torque") or file is None:
            return {}, columns

        def steady_columns(scene: Scene) -> Columns:
            effect, joint = candidate.effect, candidate.joint
            return effect.steady_columns(scene, joint, candidate.settings)

        absorbed = file.absorbed(candidate.joint, steady_columns)
        if candidate.absorbed == "friction":
            absorbed = {number: a for number, a in absorbed.items() if number}
        return absorbed, self.beside_file(columns, absorbed)

    def beside_file(
        self, columns: Channels, absorbed: Mapping[int, Array]
    ) -> dict[int, Array]:
        """Return columns of a term less what the file has absorbed of it.

        Parameters
        ----------
        columns : mapping of channel to (M_c, k) array
            Columns of the term.
        absorbed : mapping of int to (., k) array
            Coefficients of the rigid body and friction, as `FileTrials.absorbed` has
            them.
        """
        assert self.file is not None
        beside_file = {
            joint: self.file.beside(X, joint, absorbed)
            for joint, X in columns.items()
            if joint < self.rows.n
        }
        return {**columns, **beside_file}


def _columns_in_log(
    candidates: Sequence[Candidate], scene: Scene
) -> list[dict[int, Array]]:
    """Return the unfiltered columns of candidates in a log, by joint.

    Those that differ only in the log from which on they are there are worked out once.
    """
    columns_of: dict[tuple[object, ...], Columns] = {}
    in_log: list[dict[int, Array]] = []
    for candidate in candidates:
        settings = candidate.settings
        in_all_logs = {name: settings[name] for name in settings if name != FROM_LOG}
        key = replace(candidate, settings=in_all_logs, absorbed="").address
        if key not in columns_of:
            columns_of[key] = candidate.effect.columns(scene, candidate.joint, settings)
        columns = columns_of[key]
        if acts_in_log(scene.log, settings):
            in_log.append(dict(columns))
        else:
            in_log.append({joint: np.zeros_like(X) for joint, X in columns.items()})
    return in_log


def candidates_of(
    narrow: Sequence[Scene],
    effects: Sequence[Effect],
    residual: Sequence[Array],
    near: Collection[int | None] | None = None,
) -> Iterator[Candidate]:
    """Yield every effect at every joint with every setting of its grid.

    Parameters
    ----------
    narrow : sequence of Scene
        The data sets.
    effects : sequence of Effect
        What is looked for.
    residual : sequence of (N, n) arrays
        By data set, the low-passed residual [N m; N where prismatic]. It guides effects
        that look for shapes; those that show above the cut-off as well get it at the
        logs' own rates.
    near : collection of int or None, optional
        Joints whose effects are wanted, None for those of the whole arm; by default
        all.
    """
    full = [scene.full or scene for scene in narrow]
    full_residuals = [
        full_residual(scene, of_scene)
        for scene, of_scene in zip(narrow, residual, strict=True)
    ]
    for effect in effects:
        turns_links = type(effect).link_angle is not Effect.link_angle
        shows_on_links = turns_links and bool(narrow[0].links)
        scenes = full if effect.wide else narrow
        residuals = full_residuals if effect.wide else residual
        for joint in _joints_of(effect, narrow[0]):
            if near is not None and joint not in near:
                continue
            if not effect.available(scenes, joint):
                continue
            shows_in_trials = effect.steady and has_trials(narrow[0], joint)
            for settings in effect.grid(scenes, joint, residuals):
                yield Candidate(effect, joint, settings)
                if SINCE_LOG in effect.settings:
                    first_log = likeliest_log(
                        scenes, residuals, effect, joint, settings
                    )
                    if first_log is not None:
                        since = {**settings, FROM_LOG: float(first_log)}
                        yield Candidate(effect, joint, since)
                if effect.wide:
                    yield Candidate(effect, joint, settings, apart=True)
                if shows_in_trials:
                    yield Candidate(effect, joint, settings, absorbed="all")
                if shows_in_trials and effect.even:
                    yield Candidate(effect, joint, settings, absorbed="friction")
                if shows_on_links and joint is not None:
                    yield Candidate(effect, joint, settings, absorbed="torque")


def likeliest_log(
    scenes: Sequence[Scene],
    residuals: Sequence[Array],
    effect: Effect,
    joint: AnyJoint,
    settings: Settings,
) -> int | None:
    """Return the log from which on an effect explains a residual best.

    Parameters
    ----------
    scenes : sequence of Scene
        The data sets.
    residuals : sequence of (N, n) arrays
        By data set, the low-passed residual [N m; N where prismatic].
    effect : Effect
        A change of the file's values.
    joint : int or None
        Where it is; None for the whole arm.
    settings : Settings
        Its settings.

    Returns
    -------
    int, optional
        None where it explains as much if it is there in all logs.
    """
    numbers = sorted({scene.log for scene in scenes})
    if len(numbers) < 2:
        return None

    # Normal equations by log, every joint in units of what is left there.
    sizes = np.sqrt(
        sum(np.sum(residual**2, axis=0) for residual in residuals)
        / sum(len(residual) for residual in residuals)
    )
    count = len(effect.coefficients(settings))
    products = {number: np.zeros((count, count)) for number in numbers}
    moments = {number: np.zeros(count) for number in numbers}
    for scene, residual in zip(scenes, residuals, strict=True):
        thinned = residual[::THINNED]
        for j, columns in _thinned_columns(scene, effect, joint, settings).items():
            if sizes[j] == 0.0:
                continue
            X = np.where(thinned[:, [j]] != 0.0, columns, 0.0) / sizes[j]
            products[scene.log] += X.T @ X
            moments[scene.log] += X.T @ (thinned[:, j] / sizes[j])

    # What is explained by the columns of a log and all after it. Columns of one size:
    # those of a body are of a kilogram and of a kilogram metre squared.
    total = sum(products.values(), np.zeros((count, count)))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    explained = {}
    A = np.zeros((count, count))
    b = np.zeros(count)
    for number in reversed(numbers):
        A += products[number] * np.outer(scale, scale)
        b += moments[number] * scale
        inverse = np.linalg.pinv(A, rcond=OPEN, hermitian=True)
        explained[number] = float(b @ inverse @ b)
    first_log = max(numbers, key=lambda number: explained[number])
    return None if first_log == numbers[0] else first_log


def _thinned_columns(
    scene: Scene, effect: Effect, joint: AnyJoint, settings: Settings
) -> dict[int, Array]:
    """Return every few of the low-passed columns (N, k) of an effect, by joint.

    They are asked for again whenever the model has grown, and kept with the scene.
    """
    of_settings = " ".join(f"{name}={settings[name]}" for name in sorted(settings))
    key = (f"thinned {effect.name} {of_settings}", -1 if joint is None else joint)
    if key not in scene.memo:
        columns = effect.columns(scene, joint, settings)
        filtered = [
            scene.motion.filtered(X, times=effect.passes, every=THINNED)
            for X in columns.values()
        ]
        scene.memo[key] = (np.array([*columns]), *filtered)
    joints, *filtered = scene.memo[key]
    return dict(zip(joints.tolist(), filtered, strict=True))


def _joints_of(effect: Effect, scene: Scene) -> list[int | None]:
    """Return where an effect may be; the robot file may say at which joint it is."""
    n = scene.robot.n
    joints: list[int | None] = [None] if effect.arm else list(range(n))
    if effect.shared and n > 1:
        joints.append(None)

    declared = {
        own_effect.name: own_effect.joint
        for own_effect in scene.robot.effects
        if own_effect.joint is not None
    }
    if effect.name not in declared:
        return joints
    return [joint for joint in joints if joint == declared[effect.name]]
