"""Every command as a function: the same names, the same files, the result as a typed document.

    from seqid_cli import api

    friction = api.friction(["logs/friction"], "robot.toml", output="friction.json")
    print(friction.stages.friction.joints["elbow"].rmse)

Paths are files, folders or globs, logs also URLs of object storage, as on the command line.
Nothing is printed; what a command would warn of comes as `SeqidWarning`. Every function raises a
subclass of `SeqidError` (see `seqid_cli.errors`) where the command would exit with 2, and writes
`output`, where given, atomically. Documents are the structures of `seqid_cli.params`:
`document.stages`, `.joints`, ...
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from seqid_cli.commands.app import call
from seqid_cli.commands.render import Screen
from seqid_cli.params.diagnosis_schema import DiagnosisFile
from seqid_cli.params.inspection_schema import InspectionFile
from seqid_cli.params.plan_schema import PlanFile
from seqid_cli.params.prediction_schema import PredictionFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.scale.options import EngineName

PathLike = str | os.PathLike[str]
Paths = PathLike | Sequence[PathLike]
Clock = Literal["header", "log"]
Source = Literal["auto", "encoder", "imu", "fused"]


class SeqidWarning(UserWarning):
    """What a command would have warned of on the screen."""


@dataclass(frozen=True)
class _Collected(Screen):
    """A screen that shows nothing and keeps the document."""

    documents: list[Any] = field(default_factory=list)

    def document(self, document: object) -> None:
        """Keep the result."""
        self.documents.append(document)

    def warn(self, message: str) -> None:
        """Warn as Python does, at the caller of the function."""
        warnings.warn(f"seqid {self.command}: {message}", SeqidWarning, stacklevel=2)

    def note(self, message: str) -> None:
        """Leave out what is only good to know."""


def friction(
    logs: Paths,
    robot: PathLike,
    *,
    output: PathLike | None = None,
    position_order: int | None = None,
    velocity_order: int | None = None,
    beta: float | None = None,
    cutoff: float | None = None,
    time: Clock = "header",
    jobs: int | None = 1,
    engine: EngineName = "local",
    scheduler: str | None = None,
    skip_failed: bool = False,
) -> ParameterFile:
    """Identify joint friction over position and velocity (Eq. 7-11).

    Parameters
    ----------
    logs : path or sequence of paths
        Moves of one joint at a time at constant velocity.
    robot : path
        The robot file.
    output : path, optional
        Where the parameter file goes.
    position_order, velocity_order : int, optional
        Orders of the surface; found when left out.
    beta : float, optional
        Threshold of Eq. 11, at which the search for orders ends.
    cutoff : float, optional
        Cut-off of the low-pass in Hz; chosen from the data when left out.
    time : {"header", "log"}
        Which stamps of MCAP messages count.
    jobs : int or None
        Processes to read logs with; None for all cores where the logs are large enough. A script
        that asks for more than one must guard its main part with `if __name__ == "__main__":`.
    engine : {"local", "dask"}
        Processes of this machine, or Dask.
    scheduler : str, optional
        Address of a running Dask scheduler.
    skip_failed : bool
        Whether to go on without logs that cannot be used; they come as warnings.
    """
    orders = {"position_order": position_order, "velocity_order": velocity_order, "beta": beta}
    who = _workers(jobs, engine, scheduler, skip_failed)
    return _parameters("friction", logs, robot, output, cutoff=cutoff, time=time, **orders, **who)


def gravity(
    logs: Paths,
    robot: PathLike,
    parameters: Paths,
    *,
    output: PathLike | None = None,
    cutoff: float | None = None,
    time: Clock = "header",
    jobs: int | None = 1,
    engine: EngineName = "local",
    scheduler: str | None = None,
    skip_failed: bool = False,
) -> ParameterFile:
    """Identify the gravity parameters, given the friction (Eq. 12-19); see `friction`."""
    own = {"parameters": _paths(parameters), "cutoff": cutoff, "time": time}
    who = _workers(jobs, engine, scheduler, skip_failed)
    return _parameters("gravity", logs, robot, output, **own, **who)


def imu_calib(
    logs: Paths,
    robot: PathLike,
    parameters: Paths = (),
    *,
    output: PathLike | None = None,
    cutoff: float | None = None,
    time: Clock = "header",
    jobs: int | None = 1,
    engine: EngineName = "local",
    scheduler: str | None = None,
    skip_failed: bool = False,
) -> ParameterFile:
    """Find how IMUs sit on their links and what they are like (Eq. 29-38); see `friction`."""
    own = {"parameters": _paths(parameters), "cutoff": cutoff, "time": time}
    who = _workers(jobs, engine, scheduler, skip_failed)
    return _parameters("imu-calib", logs, robot, output, **own, **who)


def inertia(
    logs: Paths,
    robot: PathLike,
    parameters: Paths,
    *,
    output: PathLike | None = None,
    motion: Source = "auto",
    consistent: bool = False,
    cutoff: float | None = None,
    time: Clock = "header",
    jobs: int | None = 1,
    engine: EngineName = "local",
    scheduler: str | None = None,
    skip_failed: bool = False,
) -> ParameterFile:
    """Identify the inertia parameters (Eq. 22-26); `motion` says which sensors tell it.

    `consistent` allows only parameters that bodies can have.
    """
    own = {"parameters": _paths(parameters), "motion": motion, "cutoff": cutoff, "time": time}
    own["consistent"] = consistent
    who = _workers(jobs, engine, scheduler, skip_failed)
    return _parameters("inertia", logs, robot, output, **own, **who)


def simultaneous(
    logs: Paths,
    robot: PathLike,
    parameters: Paths = (),
    *,
    output: PathLike | None = None,
    offset: bool = False,
    motion: Source = "auto",
    consistent: bool = False,
    cutoff: float | None = None,
    time: Clock = "header",
) -> ParameterFile:
    """Identify everything in one classical least squares (Eq. 5-6); see `inertia`."""
    own = {"parameters": _paths(parameters), "motion": motion, "cutoff": cutoff, "time": time}
    own["consistent"] = consistent
    return _parameters("simultaneous", logs, robot, output, offset=offset, **own)


def predict(
    logs: Paths,
    robot: PathLike,
    parameters: Paths,
    *,
    output: PathLike | None = None,
    torques: PathLike | None = None,
    motion: Source = "auto",
    cutoff: float | None = None,
    time: Clock = "header",
    jobs: int | None = 1,
    engine: EngineName = "local",
    scheduler: str | None = None,
    skip_failed: bool = False,
    with_unexplained: bool = False,
) -> PredictionFile:
    """Predict joint torques and compare them with the measured ones.

    Parameters
    ----------
    logs, robot, output, motion, cutoff, time, jobs, engine, scheduler, skip_failed
        As in `friction` and `inertia`.
    parameters : path or sequence of paths
        Parameter files of different stages.
    torques : path, optional
        Where the torques themselves go (.parquet or .mcap).
    with_unexplained : bool
        Whether smooth terms without a known cause count.
    """
    found = _run(
        "predict",
        logs=_names(logs),
        robot=Path(robot),
        parameters=_paths(parameters),
        output=_optional(output),
        torques=_optional(torques),
        motion=motion,
        cutoff=cutoff,
        time=time,
        with_unexplained=with_unexplained,
        **_workers(jobs, engine, scheduler, skip_failed),
    )
    assert isinstance(found, PredictionFile)
    return found


def diagnose(
    logs: Paths,
    robot: PathLike,
    parameters: Paths,
    *,
    output: PathLike | None = None,
    motion: Source = "auto",
    cutoff: float | None = None,
    time: Clock = "header",
) -> DiagnosisFile:
    """Find out which physical effects a model lacks; arguments as in `predict`."""
    found = _run(
        "diagnose",
        logs=_names(logs),
        robot=Path(robot),
        parameters=_paths(parameters),
        output=_optional(output),
        motion=motion,
        cutoff=cutoff,
        time=time,
    )
    assert isinstance(found, DiagnosisFile)
    return found


def refine(
    logs: Paths,
    holdout: Paths,
    robot: PathLike,
    parameters: Paths,
    *,
    output: PathLike | None = None,
    rounds: int = 4,
    with_unexplained: bool = False,
    motion: Source = "auto",
    cutoff: float | None = None,
    time: Clock = "header",
) -> ParameterFile:
    """Add the effects that a model lacks, each proved on `holdout` logs that are never fitted.

    `rounds` is how many effects are added at most; the other arguments are as in `predict`.
    """
    own: dict[str, Any] = {"motion": motion, "cutoff": cutoff, "time": time}
    own["parameters"] = _paths(parameters)
    own |= {"holdout": [str(path) for path in _paths(holdout)], "rounds": rounds}
    return _parameters("refine", logs, robot, output, with_unexplained=with_unexplained, **own)


def inspect(
    logs: Paths,
    robot: PathLike | None = None,
    *,
    output: PathLike | None = None,
    time: Clock = "header",
) -> InspectionFile:
    """Tell what is in logs and what is wrong with them; the document has `findings`."""
    own = {"robot": _optional(robot), "output": _optional(output), "time": time}
    found = _run("inspect", logs=_names(logs), **own)
    assert isinstance(found, InspectionFile)
    return found


def plan(
    what: Literal["friction", "gravity", "imu-calib", "inertia", "validation", "all"],
    robot: PathLike,
    parameters: Paths = (),
    *,
    have: Paths = (),
    output: PathLike | None = None,
    trajectories: PathLike | None = None,
    duration: float = 150.0,
    move_duration: float | None = None,
    together: bool = False,
    ramp: float = 0.5,
    share: float = 0.95,
    lock: Sequence[str] = (),
    speed_scale: float = 1.0,
    seed: int = 0,
) -> PlanFile:
    """Plan the moves to record next, and the standard errors that they will give.

    Parameters
    ----------
    what : {"friction", "gravity", "imu-calib", "inertia", "validation", "all"}
        The stage to record for, or a whole session.
    robot : path
        The robot file; limits are the tighter of its own and its URDF's.
    parameters : path or sequence of paths
        What is identified already.
    have : path or sequence of paths
        Logs that the inertia stage will get as well.
    output, trajectories : path, optional
        Where the plan goes, and the folder for a CSV file of each move.
    duration, move_duration : float
        Time in s that the moves may take, and of each (20 ramps when left out).
    together : bool
        Whether all joints move at once.
    ramp : float
        Time in s from rest to the largest speed.
    share : float
        Share of all limits to use.
    lock : sequence of str
        Joints that are kept still.
    speed_scale : float
        Slows the files down, for the first run on the robot.
    seed : int
        Of the moves that are drawn.
    """
    found = _run(
        "plan",
        what=what,
        robot=Path(robot),
        parameters=_paths(parameters),
        have=_names(have),
        output=_optional(output),
        trajectories=_optional(trajectories),
        duration=duration,
        move_duration=move_duration,
        together=together,
        ramp=ramp,
        share=share,
        lock=list(lock),
        speed_scale=speed_scale,
        seed=seed,
    )
    assert isinstance(found, PlanFile)
    return found


def export(files: Paths, robot: PathLike, output: PathLike) -> dict[str, Any]:
    """Write a model as URDF, MJCF, ROS 2 parameters or C header, by the suffix of `output`."""
    found: dict[str, Any] = _run(
        "export", files=_paths(files), robot=Path(robot), output=Path(output)
    )
    return found


def report(
    files: Paths, output: PathLike, *, torques: PathLike | None = None, title: str = ""
) -> dict[str, Any]:
    """Write one HTML page about parameter, prediction and diagnosis files."""
    own = {"output": Path(output), "torques": _optional(torques), "title": title}
    found: dict[str, Any] = _run("report", files=_paths(files), **own)
    return found


def compare(
    first: PathLike, second: PathLike, *, rtol: float | None = None, sigma: float | None = None
) -> dict[str, Any]:
    """Compare two files of one robot; the document tells what changed, and whether any did."""
    found: dict[str, Any] = _run(
        "compare", first=Path(first), second=Path(second), rtol=rtol, sigma=sigma
    )
    return found


def _parameters(
    name: str, logs: Paths, robot: PathLike, output: PathLike | None, **own: Any
) -> ParameterFile:
    found = _run(name, logs=_names(logs), robot=Path(robot), output=_optional(output), **own)
    assert isinstance(found, ParameterFile)
    return found


def _workers(
    jobs: int | None, engine: str, scheduler: str | None, skip_failed: bool
) -> dict[str, Any]:
    return {"jobs": jobs, "engine": engine, "scheduler": scheduler, "skip_failed": skip_failed}


def _run(name: str, **arguments: Any) -> Any:
    """Run a command's own function on a screen that only keeps the document."""
    screen = _Collected(command=name, quiet=True, json=True)
    call(name, screen, **arguments)
    return screen.documents[-1]


def _paths(paths: Paths) -> list[Path]:
    if isinstance(paths, str | os.PathLike):
        return [Path(paths)]
    return [Path(path) for path in paths]


def _names(paths: Paths) -> list[str]:
    """Logs as they were given: a URL is no path."""
    if isinstance(paths, str | os.PathLike):
        return [os.fspath(paths)]
    return [os.fspath(path) for path in paths]


def _optional(path: PathLike | None) -> Path | None:
    return None if path is None else Path(path)
