"""The motions that a form is fitted to and checked on, and the file's torque on them.

A parameter file names the logs that it was identified from, with their digests. Where
they are still there, their motion says which torques matter: a form that cannot hold
the whole model is fitted on it (`reduced`). Where they are gone, motions are made
within the positions and speeds at which friction was identified.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from msgspec import structs

from seqid_cli.effects.apply import placed, scene_of_log
from seqid_cli.effects.fitted import Fitted, fitted_effects
from seqid_cli.effects.scene import Scene
from seqid_cli.errors import SeqidError
from seqid_cli.identify.common_cutoff import inherited
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import Predictor
from seqid_cli.identify.regression.equations import torque_motion
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.storage.files import sha256_of
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.motion import Motion, thinned
from seqid_cli.params.schema import InputLog, ParameterFile, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# Stages whose logs move as the arm will, the one nearest to its work first. The others'
# move a joint at a time, or the first one alone.
_LIKE_WORK = ("effects", "inertia")
_SAMPLES_PER_CUTOFF = 10  # as many as an identification keeps
_MADE_SECONDS = 60.0  # of made motion: as long as a usual excitation
_MADE_LOGS = 3
_HARMONICS = 5
_USUAL_REACH = 1.0  # rad to either side, of joints without friction and limits
_USUAL_SPEED = 1.0  # rad/s, of joints whose friction is not known
_USUAL_CUTOFF_HZ = 10.0  # of files that tell none


@dataclass(frozen=True, kw_only=True)
class FoundLogs:
    """The logs of a parameter file that are still there.

    Attributes
    ----------
    files : tuple of Path
        The logs.
    lost : tuple of str
        A sentence on each that is gone, or has another content now.
    """

    files: tuple[Path, ...]
    lost: tuple[str, ...]


def find_logs(entries: Sequence[InputLog], folders: Sequence[Path]) -> FoundLogs:
    """Look for logs where their entries say, and then in `folders`.

    Digests are checked: a log of the right name and another content is another log, and
    is not taken.
    """
    files: list[Path] = []
    lost: list[str] = []
    by_digest = {entry.sha256: entry for entry in entries}
    for entry in by_digest.values():
        path = Path(entry.path)
        places = [path]
        for folder in folders:
            places += [folder / path, folder / path.name]
        candidates = [place for place in dict.fromkeys(places) if place.is_file()]

        log = next(
            (place for place in candidates if sha256_of(place) == entry.sha256), None
        )
        if log is not None:
            files.append(log)
        elif candidates:
            lost.append(f"{entry.path} has another content than when it was used")
        else:
            lost.append(f"{entry.path} is not there")
    return FoundLogs(files=tuple(files), lost=tuple(lost))


def logs_like_work(entries: Sequence[InputLog]) -> list[InputLog]:
    """Return the logs in which the arm moves most like at work; all where none does."""
    for stage in _LIKE_WORK:
        chosen = [entry for entry in entries if entry.stage == stage]
        if chosen:
            return chosen
    return list(entries)


@dataclass(frozen=True, kw_only=True)
class FullModel:
    """The whole model of a parameter file.

    `seqid predict --with-unexplained` takes as much.

    Attributes
    ----------
    robot, stages : Robot, Stages
        The arm, and what was identified of it.
    model : TorqueModel
        The model without effects.
    effects : tuple of FittedEffect or SmoothTerm
        All effects, those of no known cause among them.
    options : InertiaOptions
        How the logs are filtered.
    reading : Reading
        Which part of each log is used.
    """

    robot: Robot
    stages: Stages
    model: TorqueModel
    effects: tuple[Fitted, ...]
    options: InertiaOptions
    reading: Reading = HEADER_STAMPS

    @classmethod
    def of(cls, robot: Robot, stages: Stages, reading: Reading = HEADER_STAMPS) -> Self:
        """Return the model of a file, whose logs are filtered as when it was made.

        Parameters
        ----------
        robot : Robot
            The arm.
        stages : Stages
            Those of the file.
        reading : Reading
            Which part of each log is used.

        Raises
        ------
        ConfigError
            An effect is not known, or has not the numbers that it takes.
        """
        return cls(
            robot=robot,
            stages=stages,
            model=TorqueModel.from_stages(stages, robot),
            effects=tuple(fitted_effects(stages, robot, unexplained=True)),
            options=InertiaOptions(motion=inherited(stages, None)),
            reading=reading,
        )

    def motion(self, log: Recording) -> Motion:
        """Return a log's motion at its own rate, filtered as `seqid predict` does."""
        unthinned = replace(self.options.motion, samples_per_cutoff=float("inf"))
        return torque_motion(
            log,
            self.robot,
            unthinned,
            imu=self.stages.imu,
            source=self.options.source,
        )

    def predicted(
        self,
        log: Recording,
        motion: Motion,
        *,
        effects: Sequence[Fitted] | None = None,
        late: bool = True,
    ) -> tuple[Array, Mask]:
        """Predict the torque of a log.

        Parameters
        ----------
        motion : Motion
            That of the log, at its own rate.
        effects : sequence, optional
            The effects that take part; all of the file where left out.
        late : bool
            Whether torque comes as late as it is logged.

        Returns
        -------
        torque : (N, n) array
            N m (N where prismatic), low-passed like `motion.tau`.
        sliding : (N, n) array of bool
            Samples at which a joint certainly slides, where the torque has one value.
        """
        model = self.model if late else replace(self.model, delays_s=None)
        taking_part = self.effects if effects is None else tuple(effects)
        predictor = Predictor(
            model=model,
            stages=self.stages,
            options=self.options,
            effects=taking_part,
            sliding_only=True,
        )
        part = predictor.part(motion, log, slice(None))
        return part.predicted, part.sliding

    def scene(self, log: Recording, motion: Motion) -> Scene:
        """Return a log as effects see it, on the clock of the first one's session."""
        scene = scene_of_log(log, self.robot, self.model, motion)
        session = self.effects[0].session if self.effects else None
        return placed(scene, log, session)


@dataclass(frozen=True, kw_only=True)
class TorqueSamples:
    """A thinned motion (N samples), and torques (N, n) N m (N where prismatic) on it.

    Attributes
    ----------
    motion : Motion
        Thinned to a few samples per period of the cut-off.
    torque : (N, n) array
        The file's own, without the effects that the form holds as they are, not late.
    measured : (N, n) array
        What was measured of it: `torque` and what the whole file leaves of the log; the
        same as `torque` where nothing was measured.
    sliding : (N, n) array of bool
        Samples at which a joint certainly slides.
    held : (N, n) array
        What the held effects add.
    left_out : (N, n) array
        What they add besides, as far as the form's static torque lacks it.
    """

    motion: Motion
    torque: Array
    measured: Array
    sliding: Mask
    held: Array
    left_out: Array

    @property
    def of_model(self) -> Array:
        """Torque (N, n) N m that the rest of a form is to have, by the file's model."""
        return self.torque + self.left_out


@dataclass(frozen=True, kw_only=True)
class Motions:
    """The motions of logs, or made ones within the identified ranges.

    Attributes
    ----------
    recordings : tuple of Recording
        Forms are fitted to these alone.
    are_made : bool
        Whether these are no logs.
    held_out : tuple of Recording
        On these, what a form loses is looked at as well.
    notes : tuple of str
        What the reader of the file has to know of them.
    """

    recordings: tuple[Recording, ...]
    are_made: bool
    held_out: tuple[Recording, ...] = ()
    notes: tuple[str, ...] = ()

    def samples(
        self,
        full: FullModel,
        *,
        held: Sequence[Fitted] = (),
        unseen: Sequence[Fitted] = (),
        held_out: bool = False,
    ) -> Iterator[TorqueSamples]:
        """Yield the motions with the file's torque.

        Parameters
        ----------
        full : FullModel
            That of the file.
        held : sequence of FittedEffect or SmoothTerm
            Effects that the form holds as they are.
        unseen : sequence of FittedEffect or SmoothTerm
            Held effects that no static torque shows (backlash).
        held_out : bool
            Whether the held-out logs are wanted.
        """
        for log in self.held_out if held_out else self.recordings:
            yield _torque_samples(full, log, held, unseen)


def _torque_samples(
    full: FullModel, log: Recording, held: Sequence[Fitted], unseen: Sequence[Fitted]
) -> TorqueSamples:
    """Return the torque of a log, with and without effects that a form holds."""
    motion = full.motion(log)
    without_held = _without(full.effects, held)
    without_both = _without(full.effects, [*held, *unseen])
    torque, sliding = full.predicted(log, motion, effects=without_both, late=False)

    left_out = np.zeros_like(torque)
    if unseen:
        with_unseen, _ = full.predicted(log, motion, effects=without_held, late=False)
        left_out = with_unseen - torque

    of_held = np.zeros_like(torque)
    if held:
        with_all, _ = full.predicted(log, motion, late=False)
        not_held, _ = full.predicted(log, motion, effects=without_held, late=False)
        of_held = with_all - not_held

    measured = torque
    if motion.tau is not None and log.tau is not None and log.tau.any():
        as_logged, _ = full.predicted(log, motion)
        measured = torque + motion.tau - as_logged

    step = 1
    if motion.lowpass.active:
        samples_per_period = motion.rate_hz / motion.lowpass.cutoff_hz
        step = max(1, int(samples_per_period / _SAMPLES_PER_CUTOFF))
    return TorqueSamples(
        motion=thinned(motion, step) if step > 1 else motion,
        torque=torque[::step],
        measured=measured[::step],
        sliding=sliding[::step],
        held=of_held[::step],
        left_out=left_out[::step],
    )


def is_among(item: Fitted, effects: Sequence[Fitted]) -> bool:
    """Return whether an effect is one of these very objects.

    Effects hold arrays, which have no truth value when they are compared.
    """
    return any(item is effect for effect in effects)


def _without(effects: Sequence[Fitted], removed: Sequence[Fitted]) -> list[Fitted]:
    """Return the effects that are none of the removed ones."""
    return [item for item in effects if not is_among(item, removed)]


def motions_of(
    full: FullModel,
    entries: Sequence[InputLog],
    held_out: Sequence[Path],
    folders: Sequence[Path],
    *,
    held_out_reading: Reading | None = None,
) -> Motions:
    """Return the motions of the logs that a file names, or made ones if none is there.

    Parameters
    ----------
    full : FullModel
        That of the file.
    entries : sequence of InputLog
        The logs that the file was identified from.
    held_out : sequence of Path
        Logs that no number was fitted to.
    folders : sequence of Path
        Where logs are looked for besides.
    held_out_reading : Reading, optional
        Which part of the logs of `held_out` is used; as of the others by default.
    """
    logs = find_logs(logs_like_work(entries), folders)
    recordings, unreadable = _readable(full, logs.files)
    held_out_full = replace(full, reading=held_out_reading or full.reading)
    held_out_recordings, _ = _readable(held_out_full, held_out)
    if recordings:
        reasons = [*logs.lost, *unreadable]
        return Motions(
            recordings=recordings,
            are_made=False,
            held_out=held_out_recordings,
            notes=tuple(f"{reason}: its motion is left out" for reason in reasons),
        )

    reason = "none of the file's logs is there" if entries else "the file names no logs"
    return Motions(
        recordings=tuple(made_motions(full)),
        are_made=True,
        held_out=held_out_recordings,
        notes=(
            f"{reason}: motions made within the identified positions and speeds stand"
            " for the logs, so that what is lost is known less well",
        ),
    )


@dataclass(frozen=True, kw_only=True)
class Unrefined:
    """The file as it came into its refinement.

    Attributes
    ----------
    stages : Stages
        Its stages; where they are not known, those of the refined file without effects.
    is_known : bool
        Whether the refined file holds them.
    entries : tuple of InputLog
        The logs that it named.
    folders : tuple of Path
        Where these are looked for.
    """

    stages: Stages
    is_known: bool
    entries: tuple[InputLog, ...] = ()
    folders: tuple[Path, ...] = ()

    @classmethod
    def of(cls, file: ParameterFile, folders: Sequence[Path]) -> Self:
        """Return what a refined file says of it.

        Parameters
        ----------
        file : ParameterFile
            The refined file.
        folders : sequence of Path
            Where logs are looked for besides.
        """
        closed_loop = file.closed_loop
        incoming = None if closed_loop is None else closed_loop.incoming
        stages = incoming
        if stages is None:
            stages = structs.replace(file.stages, effects=None)
        return cls(
            stages=stages,
            is_known=incoming is not None,
            entries=tuple(entry for entry in file.inputs if entry.stage != "effects"),
            folders=tuple(folders),
        )

    def samples(self, robot: Robot) -> list[TorqueSamples]:
        """Return the motions that its forms were fitted to, with their torque."""
        full = FullModel.of(robot, self.stages)
        motions = motions_of(full, self.entries, (), self.folders)
        return list(motions.samples(full))


def _readable(
    full: FullModel, paths: Sequence[Path]
) -> tuple[tuple[Recording, ...], list[str]]:
    """Return the logs whose motion can be had, and why that of the others cannot."""
    reasons: list[str] = []
    recordings: list[Recording] = []
    for path in paths:
        try:
            log = _with_torque(read_recording(path, full.robot, reading=full.reading))
            full.motion(log)
        except SeqidError as error:
            reasons.append(str(error))
            continue
        recordings.append(log)
    return tuple(recordings), reasons


def _with_torque(log: Recording) -> Recording:
    """Return a log with a torque channel: here only the motion of it is used."""
    return replace(log, tau=np.zeros_like(log.q)) if log.tau is None else log


def made_motions(full: FullModel) -> Iterable[Recording]:
    """Make motions of all joints that reach the identified positions and speeds.

    Each joint moves by a sum of harmonics with random phases, as excitation motions do.
    """
    n_joints = full.robot.n
    ranges = _ranges(full)
    cutoff_hz = full.options.motion.cutoff_hz or _USUAL_CUTOFF_HZ
    # Samples enough for the effects, which need some two dozen per period of the
    # cut-off.
    rate_hz = 30.0 * cutoff_hz
    t = np.arange(int(_MADE_SECONDS * rate_hz)) / rate_hz

    for number in range(_MADE_LOGS):
        rng = np.random.default_rng(number)
        q = np.empty((len(t), n_joints))
        for j in range(n_joints):
            q[:, j] = _excitation(
                rng,
                t,
                centre=ranges.centres[j],
                reach=ranges.reaches[j],
                speed=ranges.speeds[j],
                # So the fifth harmonic stays at half of the cut-off.
                fastest_hz=0.1 * cutoff_hz,
            )
        yield Recording(
            path=Path(f"made motion {number + 1}"),
            sha256="",
            format="made",
            t=t,
            q=q,
            valid=np.ones(len(t), dtype=np.bool_),
            health=Health(rate_hz, 0.0),
            tau=np.zeros_like(q),
        )


def _excitation(
    rng: np.random.Generator,
    t: Array,
    *,
    centre: float,
    reach: float,
    speed: float,
    fastest_hz: float,
) -> Array:
    """Return a sum of harmonics with random phases and sizes.

    Parameters
    ----------
    rng : Generator
        Where phases and sizes come from.
    t : (N,) array
        Time, s.
    centre, reach : float
        Middle and half range of the positions, rad (m).
    speed : float
        Speed to be reached, rad/s (m/s).
    fastest_hz : float
        Largest base frequency, Hz.

    Returns
    -------
    (N,) array
        Positions, rad (m).
    """
    orders = np.arange(1, _HARMONICS + 1)
    phases = rng.uniform(0.0, 2.0 * np.pi, size=_HARMONICS)
    sizes = rng.uniform(0.5, 1.0, size=_HARMONICS) / orders

    # The base period follows from the speed that a motion of this reach must have.
    turn = np.linspace(0.0, 2.0 * np.pi, 720)
    shape = np.sin(np.outer(turn, orders) + phases) @ sizes
    scale = reach / np.abs(shape).max()
    steepest = np.abs(np.gradient(shape, turn)).max() * scale

    # Incommensurate periods, so that joints meet in all combinations.
    omega = speed / max(steepest, 1e-9) * rng.uniform(0.8, 1.0)
    omega = min(omega, 2.0 * np.pi * fastest_hz)
    angle = np.outer(omega * t, orders) + phases
    return np.asarray(centre + scale * (np.sin(angle) @ sizes))


@dataclass(frozen=True, kw_only=True)
class _Ranges:
    """Centres and half ranges (n,) rad of positions, and top speeds (n,) rad/s."""

    centres: Array
    reaches: Array
    speeds: Array


def _ranges(full: FullModel) -> _Ranges:
    """Return where and how fast friction was identified.

    A joint without friction gets its position limits and a usual speed.
    """
    lowest = []
    highest = []
    speeds = []
    for joint, surface in zip(full.robot.joints, full.model.surfaces, strict=True):
        if surface is None:
            low, high = joint.position_limits or (-_USUAL_REACH, _USUAL_REACH)
            speed = _USUAL_SPEED
        else:
            low, high = surface.scaling.position
            speed = surface.scaling.speed[1]
        lowest.append(low)
        highest.append(high)
        speeds.append(speed)

    bottom = np.array(lowest)
    top = np.array(highest)
    return _Ranges(
        centres=0.5 * (bottom + top),
        reaches=np.maximum(0.5 * (top - bottom), 1e-3),
        speeds=np.array(speeds),
    )
