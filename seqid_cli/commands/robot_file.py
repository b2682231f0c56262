"""The robot file that a command takes where -r is left out."""

from collections.abc import Sequence
from pathlib import Path

from seqid_cli.commands.screen.render import Screen
from seqid_cli.errors import UsageError

ROBOT_NAME = "robot.toml"


def found_robot(screen: Screen, logs: Sequence[str]) -> Path:
    """Return the robot file of the working folder, or else the one beside the logs.

    The screen says which it is.

    Raises
    ------
    UsageError
        There is none, or there are several beside the logs.
    """
    robot = found_robot_if_any(screen, logs)
    if robot is None:
        raise UsageError(
            f"-r is left out, and there is no {ROBOT_NAME} here or beside the logs",
            hint="Name the robot file with -r, or make one: seqid init LOG.",
        )
    return robot


def found_robot_if_any(screen: Screen, logs: Sequence[str]) -> Path | None:
    """Return the robot file as `found_robot` does, or None where there is none."""
    working_folder_file = Path(ROBOT_NAME)
    if working_folder_file.is_file():
        screen.note(f"robot file: {working_folder_file} (-r names another)")
        return working_folder_file

    # Several logs of one robot find the same file.
    beside = []
    for log in logs:
        robot = _robot_beside(log)
        if robot is not None and robot not in beside:
            beside.append(robot)

    if len(beside) > 1:
        names = ", ".join(map(str, beside))
        raise UsageError(
            f"-r is left out, and several robot files lie beside the logs: {names}",
            hint="Choose one with -r.",
        )
    if not beside:
        return None
    screen.note(f"robot file: {beside[0]} (beside the logs; -r names another)")
    return beside[0]


def _robot_beside(log: str) -> Path | None:
    """Return the robot file in a folder of logs, beside a log, or one folder above.

    One above, because the folders of the stages lie side by side in the robot's.
    """
    if "://" in log:  # on object storage
        return None
    place = Path(log)
    try:
        folder = place if place.is_dir() else place.parent
        for candidate in (folder / ROBOT_NAME, folder.parent / ROBOT_NAME):
            if candidate.is_file():
                return candidate
    # A name that no file can have; whoever opens the log says so.
    except (OSError, ValueError):
        return None
    return None
