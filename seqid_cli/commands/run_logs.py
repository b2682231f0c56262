"""Which logs of a folder serve which stage of a run, and which are held out.

A folder may be sorted: it has folders named as the stages, and `validation/` is held
out. Any other is sorted by what `seqid inspect` finds that each log serves.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import InputError
from seqid_cli.logs.storage.files import expand
from seqid_cli.params.results.inspection import InspectedLog

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

VALIDATION = "validation"
# Each command that identifies a stage, and the folder and the file that are named after
# it.
STAGES = {
    "friction": "friction",
    "gravity": "gravity",
    "imu-calib": "imu",
    "inertia": "inertia",
}
FOLDERS = (*STAGES.values(), VALIDATION)
NAMED_FOLDERS = ", ".join(f"{name}/" for name in FOLDERS)


@dataclass(frozen=True, kw_only=True)
class RunLogs:
    """Logs of a run, as files or folders, by command, and those that are held out."""

    of_command: Mapping[str, Sequence[Path]]
    held_out: Sequence[Path]


def logs_of_run(
    folder: Path, output: Path, robot: "Robot", say: Callable[[str], None]
) -> RunLogs:
    """Return the logs of a folder, sorted as its folders are, or as `inspect` says.

    Parameters
    ----------
    folder : Path
        Has folders named as the stages, or logs in any order at any depth.
    output : Path
        Folder of the results: torques that lie there are no logs.
    robot : Robot
        Without IMUs there is nothing to calibrate.
    say : callable
        Told how an unsorted folder was sorted.

    Raises
    ------
    InputError
        There is no such folder, or no log in it with which a run can start.
    """
    if not folder.is_dir():
        raise InputError(
            "is no folder", hint="Name the folder of the logs.", where=str(folder)
        )
    stage_folders = {
        name: folder / name for name in FOLDERS if (folder / name).is_dir()
    }
    if stage_folders:
        logs = _sorted_by_folders(stage_folders)
    else:
        logs = _sorted_by_inspection(folder, output, robot, say)

    if not logs.of_command.get("friction"):
        lacking = "has no log of friction trials"
        if stage_folders:
            lacking = "has no folder friction/"
        hint = (
            f"Sort the logs into {NAMED_FOLDERS}; without trials of single joints use"
            " seqid simultaneous."
        )
        raise InputError(
            f"{lacking}; a run starts with friction trials",
            hint=hint,
            where=str(folder),
        )

    if robot.imus:
        return logs
    without_imus = dict(logs.of_command)
    without_imus.pop("imu-calib", None)
    return RunLogs(of_command=without_imus, held_out=logs.held_out)


def _sorted_by_folders(stage_folders: Mapping[str, Path]) -> RunLogs:
    """Return the folders of the stages by the commands that they are for."""
    of_stage: dict[str, list[Path]] = {command: [] for command in STAGES}
    for command, stage in STAGES.items():
        if stage in stage_folders:
            of_stage[command].append(stage_folders[stage])
    held_out = [stage_folders[VALIDATION]] if VALIDATION in stage_folders else []
    return RunLogs(of_command=_with_friction_for_gravity(of_stage), held_out=held_out)


def _with_friction_for_gravity(
    of_stage: Mapping[str, Sequence[Path]],
) -> dict[str, list[Path]]:
    """Return the logs of the commands that have any; friction trials serve gravity too.

    Gravity is asked for wherever there are friction trials: on a planar arm it is an
    empty stage, which the stages after it need.
    """
    of_command = {command: list(logs) for command, logs in of_stage.items()}
    for path in of_command["friction"]:
        if path not in of_command["gravity"]:
            of_command["gravity"].append(path)
    return {command: logs for command, logs in of_command.items() if logs}


def _sorted_by_inspection(
    folder: Path, output: Path, robot: "Robot", say: Callable[[str], None]
) -> RunLogs:
    """Return the logs of a folder by what each of them serves, and say so."""
    from seqid_cli.inspect import inspect

    results = output.resolve()
    paths = [
        path
        for path in expand([str(folder)])
        if not path.resolve().is_relative_to(results)
    ]
    inspected = inspect([str(path) for path in paths], robot).logs
    held_out = held_out_of(inspected)

    of_stage: dict[str, list[Path]] = {command: [] for command in STAGES}
    for log in inspected:
        if log not in held_out:
            for command in STAGES:
                if command in log.serves:
                    of_stage[command].append(Path(log.path))
    of_command = _with_friction_for_gravity(of_stage)

    say(
        f"{folder} has none of {NAMED_FOLDERS}: its logs are sorted by what inspect"
        " finds"
    )
    for command, logs in of_command.items():
        say(f"{command}: {_listed(logs)}")
    held_out_paths = [Path(log.path) for log in held_out]
    if held_out:
        say(f"held out, for predict, diagnose and refine: {_listed(held_out_paths)}")
    else:
        say(
            "nothing is held out: without each log of several joints, joints that move"
            " together would be lost; record one more in which all joints move"
        )
    useless = [Path(log.path) for log in inspected if not log.serves]
    if useless:
        say(f"serve no stage: {_listed(useless)} (seqid inspect says why)")
    return RunLogs(of_command=of_command, held_out=held_out_paths)


def held_out_of(logs: Sequence[InspectedLog]) -> list[InspectedLog]:
    """Return the logs to hold out: a quarter of those that inertia is identified from.

    A log is held out only if all pairs of joints that move together in it do so in
    others that stay: inertia would lose rank otherwise. Trials of friction and gravity
    always stay. Logs with the most joints come first, for they are most like what the
    model is for; of equal ones the last recorded.
    """
    for_inertia = [
        log
        for log in logs
        if "inertia" in log.serves and not {"friction", "gravity"} & set(log.serves)
    ]
    if len(for_inertia) < 2:  # there is no other to identify from
        return []
    largest_count = max(len(for_inertia) // 4, 1)

    in_order = sorted(
        enumerate(for_inertia),
        key=lambda item: (-len(item[1].moving_together), -item[0]),
    )
    held_out: list[InspectedLog] = []
    for _, log in in_order:
        if len(held_out) == largest_count:
            break
        staying = [x for x in for_inertia if x is not log and x not in held_out]
        pairs_that_stay: set[tuple[str, str]] = set()
        for staying_log in staying:
            pairs_that_stay.update(_pairs(staying_log))
        if staying and pairs_that_stay.issuperset(_pairs(log)):
            held_out.append(log)
    return held_out


def _pairs(log: InspectedLog) -> Iterator[tuple[str, str]]:
    """Yield the pairs of joints that move together in a log, in chain order."""
    return combinations(log.moving_together, 2)


def _listed(paths: Sequence[Path], *, shown_count: int = 6) -> str:
    """Return paths with commas between them; of many the first and how many more."""
    words = [str(path) for path in paths[:shown_count]]
    if len(paths) > shown_count:
        words.append(f"{len(paths) - shown_count} more")
    return ", ".join(words)
