"""The program's readers and parsers alone, without a command around them.

A reader costs a hundredth of a second, and a command several: so many more inputs can
be tried. What a reader raises other than an error for the user is a find, as a command
would end by it with exit code 70.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from seqid_cli.errors import SeqidError
from seqid_cli.visible import visible
from tests.studies.fuzz.target import Line


def read_log(log: str, robot: str) -> None:
    """List what a log holds, then read all of it as a stage does."""
    from seqid_cli.logs.contents import contents_of, robot_descriptions
    from seqid_cli.logs.read import read_recording
    from seqid_cli.robot.file import load_robot

    contents_of(Path(log))
    robot_descriptions(Path(log))
    read_recording(Path(log), load_robot(Path(robot)))


def read_robot(robot: str) -> None:
    """Read a robot file with its URDF, effects and IMUs."""
    from seqid_cli.robot.file import load_robot

    load_robot(Path(robot))


def read_result(document: str) -> None:
    """Read a parameter file or a result, of whatever kind."""
    from seqid_cli.params.io import read_document

    read_document(Path(document))


def read_torques(torques: str, document: str) -> None:
    """Read the torques that belong to a prediction, joint by joint."""
    from seqid_cli.params.io import read_any
    from seqid_cli.report.collection import collect
    from seqid_cli.report.make import open_torques

    collection = collect(read_any([Path(document)]))
    tables, _ = open_torques([Path(torques)], collection)
    for table in tables:
        for joint in table.joints:
            list(table.series(joint))


READERS: Mapping[str, Callable[..., None]] = {
    "read_log": read_log,
    "read_robot": read_robot,
    "read_result": read_result,
    "read_torques": read_torques,
}
LOG: Line = ("read_log", "{}", "{@}/robot.toml")
ROBOT: Line = ("read_robot", "{}")
RESULT: Line = ("read_result", "{}")
TORQUES: Line = ("read_torques", "{}", "{@}/prediction.json")


def read_alone(words: Sequence[str]) -> int:
    """Run a reader on its files; returns the exit code that a command would have."""
    reader, *files = words
    try:
        READERS[reader](*files)
    except SeqidError as error:
        sys.stderr.write(f"error: {visible(str(error))}\n")
        return error.exit_code
    return 0
