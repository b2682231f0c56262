"""The motions that a form is fitted to and checked on, and the file's own torque on them.

A parameter file names the logs that it was identified from, with their digests. Where
they are still there, their motion says which torques matter: a form that cannot hold
the whole model is fitted on it (`reduced`). Where they are gone, motions are made
within the positions and speeds at which friction was identified.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
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


@dataclass(frozen=True, kw_only=True)
class FoundLogs:
    """The logs of a parameter file that are still there, and what happened to the others."""

    files: tuple[Path, ...]
    lost: tuple[str, ...]  # a sentence for each


def find_logs(entries: Sequence[InputLog], folders: Sequence[Path]) -> FoundLogs:
    """Look for logs where their entries say, and then in `folders`, and check their digests.

    A log of the right name and another content is another log: it is not taken.
    """
    files: list[Path] = []
    lost: list[str] = []
    for entry in {entry.sha256: entry for entry in entries}.values():
        given = Path(entry.path)
        beside = [
            folder / part for folder in folders for part in (given, Path(given.name))
        ]
        there = [path for path in dict.fromkeys([given, *beside]) if path.is_file()]
        same = next((path for path in there if sha256_of(path) == entry.sha256), None)
        if same is not None:
            files.append(same)
        elif there:
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
    """The whole model of a parameter file: `seqid predict --with-unexplained` takes as much."""

    robot: Robot
    stages: Stages
    model: TorqueModel
    effects: tuple[Fitted, ...]
    options: InertiaOptions

    @classmethod
    def of(cls, robot: Robot, stages: Stages) -> Self:
        """Return the model of a file's stages, filtered as they were identified."""
        return cls(
            robot=robot,
            stages=stages,
            model=TorqueModel.from_stages(stages, robot),
            effects=tuple(fitted_effects(stages, robot, unexplained=True)),
            options=InertiaOptions(inherited(stages, None)),
        )

    def motion(self, log: Recording) -> Motion:
        """Return a log's motion at its own rate, filtered as `seqid predict` does."""
        every = replace(self.options.motion, samples_per_cutoff=float("inf"))
        imu, source = self.stages.imu, self.options.source
        return torque_motion(log, self.robot, every, imu=imu, source=source)

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
        """Return a log as the effects see it, on the clock of the first effect's session."""
        scene = scene_of_log(log, self.robot, self.model, motion)
        session = self.effects[0].session if self.effects else None
        return placed(scene, log, session)


@dataclass(frozen=True, kw_only=True)
class TorqueSamples:
    """A thinned motion (N samples) and the file's own torque (N, n) N m on it.

    `torque` is without the effects that the form holds as they are, and not late;
    `measured` (N, n) N m is what was measured of it: the same plus what the whole file
    leaves of the log, and the same where nothing was measured. `held` (N, n) N m is
    what the held effects add, `left_out` (N, n) N m what they add besides as far as the
    form's static torque lacks it.
    """

    motion: Motion
    torque: Array
    measured: Array
    sliding: Mask
    held: Array
    left_out: Array

    @property
    def of_model(self) -> Array:
        """What a form without the held effects is to have (N, n) N m, by the model."""
        return self.torque + self.left_out


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Where motions come from: logs, or what is made within the identified ranges.

    Forms are fitted to the `recordings` alone. What they lose is looked at on the
    motion of the `held_out` logs as well.
    """

    recordings: tuple[Recording, ...]
    made: bool
    held_out: tuple[Recording, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def samples(
        self,
        full: FullModel,
        *,
        held: Sequence[Fitted] = (),
        unseen: Sequence[Fitted] = (),
        held_out: bool = False,
    ) -> Iterator[TorqueSamples]:
        """Yield the motions with the file's torque.

        `held`: effects that the form holds as they are, `unseen` those of them that no
        static torque shows (backlash). `held_out`: whether the held-out logs are
        wanted.
        """
        rest = _without(full.effects, [*held, *unseen])
        shown = _without(full.effects, held)
        for log in self.held_out if held_out else self.recordings:
            motion = full.motion(log)
            torque, sliding = full.predicted(log, motion, effects=rest, late=False)
            left_out = np.zeros_like(torque)
            if unseen:
                with_unseen, _ = full.predicted(log, motion, effects=shown, late=False)
                left_out = with_unseen - torque
            of_held = np.zeros_like(torque)
            if held:
                not_held = _without(full.effects, held)
                whole, _ = full.predicted(log, motion, late=False)
                alone, _ = full.predicted(log, motion, effects=not_held, late=False)
                of_held = whole - alone
            measured = torque
            if motion.tau is not None and log.tau is not None and log.tau.any():
                measured = torque + motion.tau - full.predicted(log, motion)[0]
            per_period = motion.rate_hz / motion.lowpass.cutoff_hz
            step = 1
            if motion.lowpass.active:
                step = max(1, int(per_period / _SAMPLES_PER_CUTOFF))
            yield TorqueSamples(
                motion=thinned(motion, step) if step > 1 else motion,
                torque=torque[::step],
                measured=measured[::step],
                sliding=sliding[::step],
                held=of_held[::step],
                left_out=left_out[::step],
            )


def _without(effects: Sequence[Fitted], others: Sequence[Fitted]) -> list[Fitted]:
    # By identity: effects hold arrays, which have no truth value when they are
    # compared.
    return [item for item in effects if not any(item is other for other in others)]


def motions_of(
    full: FullModel,
    entries: Sequence[InputLog],
    held_out: Sequence[Path],
    folders: Sequence[Path],
) -> Motions:
    """Return the motions of the logs that a file names, or made ones where none is there."""
    found = find_logs(logs_like_work(entries), folders)
    recordings, notes = _readable(full, found.files)
    notes = [*found.lost, *notes]
    others, _ = _readable(full, held_out)
    if recordings:
        return Motions(
            recordings=recordings,
            made=False,
            held_out=others,
            notes=tuple(f"{text}: its motion is left out" for text in notes),
        )

    made = "motions made within the identified positions and speeds stand for the logs"
    reason = "none of the file's logs is there" if entries else "the file names no logs"
    return Motions(
        recordings=tuple(made_motions(full)),
        made=True,
        held_out=others,
        notes=(f"{reason}: {made}, so that what is lost is known less well",),
    )


@dataclass(frozen=True, kw_only=True)
class Unrefined:
    """The file as it came into its refinement: its stages, and the logs that it named.

    `folders` are where these are looked for. Where it `is_known` the refined file holds
    it; else it is the file without its effects.
    """

    stages: Stages
    is_known: bool
    entries: tuple[InputLog, ...] = ()
    folders: tuple[Path, ...] = ()

    @classmethod
    def of(cls, file: ParameterFile, folders: Sequence[Path]) -> Self:
        """Return what a refined file says of it; else the file without its effects."""
        loop = file.closed_loop
        stages = structs.replace(file.stages, effects=None)
        is_known = loop is not None and loop.incoming is not None
        if loop is not None and loop.incoming is not None:
            stages = loop.incoming
        return cls(
            stages=stages,
            is_known=is_known,
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
    notes: list[str] = []
    recordings: list[Recording] = []
    for path in paths:
        try:
            log = _with_torque(read_recording(path, full.robot))
            full.motion(log)
        except SeqidError as error:
            notes.append(str(error))
            continue
        recordings.append(log)
    return tuple(recordings), notes


def _with_torque(log: Recording) -> Recording:
    """Return a log with a torque channel: here only the motion of it is used."""
    return replace(log, tau=np.zeros_like(log.q)) if log.tau is None else log


def made_motions(full: FullModel) -> Iterable[Recording]:
    """Make motions of all joints that reach the identified positions and speeds.

    Each joint moves by a sum of harmonics with random phases, as excitation motions do.
    """
    robot = full.robot
    centres, reaches, speeds = _ranges(full)
    hz = full.options.motion.cutoff_hz or 10.0
    # Samples enough for the effects, which need some two dozen per period of the
    # cut-off.
    rate_hz = 30.0 * hz
    t = np.arange(int(_MADE_SECONDS * rate_hz)) / rate_hz
    orders = np.arange(1, _HARMONICS + 1)
    for number in range(_MADE_LOGS):
        rng = np.random.default_rng(number)
        q = np.empty((len(t), robot.n))
        for j in range(robot.n):
            phases = rng.uniform(0.0, 2.0 * np.pi, size=_HARMONICS)
            sizes = rng.uniform(0.5, 1.0, size=_HARMONICS) / orders
            # The base period follows from the speed that a motion of this reach must
            # have.
            turn = np.linspace(0.0, 2.0 * np.pi, 720)
            unit = np.sin(np.outer(turn, orders) + phases) @ sizes
            scale = reaches[j] / np.abs(unit).max()
            rise = np.abs(np.gradient(unit, turn)).max() * scale
            # Incommensurate periods, so that joints meet in all combinations.
            omega = speeds[j] / max(rise, 1e-9) * rng.uniform(0.8, 1.0)
            omega = min(omega, 2.0 * np.pi * 0.1 * hz)
            angle = np.outer(omega * t, orders) + phases
            q[:, j] = centres[j] + scale * (np.sin(angle) @ sizes)
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


def _ranges(full: FullModel) -> tuple[Array, Array, Array]:
    """Return centres and half ranges (n,) rad of positions, and top speeds (n,) rad/s."""
    # rad and rad/s, of joints whose friction is not known
    usual_reach = 1.0
    usual_speed = 1.0
    low, high, speeds = [], [], []
    for joint, surface in zip(full.robot.joints, full.model.surfaces, strict=True):
        limits = joint.position_limits or (-usual_reach, usual_reach)
        low.append(limits[0] if surface is None else surface.scaling.position[0])
        high.append(limits[1] if surface is None else surface.scaling.position[1])
        speeds.append(usual_speed if surface is None else surface.scaling.speed[1])
    bottom, top = np.array(low), np.array(high)
    return (
        0.5 * (bottom + top),
        np.maximum(0.5 * (top - bottom), 1e-3),
        np.array(speeds),
    )
