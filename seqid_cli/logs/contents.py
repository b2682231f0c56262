"""What a log holds, told without a robot file."""

import re
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.being_read import being_read
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.tables.csv_form import read_form
from seqid_cli.logs.tables.naming_schemes import LEROBOT_STATE

# What LeRobot writes behind the name of a motor: `shoulder_pan.pos`.
_STATE_ENDING = re.compile("(?:[._]pos(?:ition)?|[.]q)$")


@dataclass(frozen=True, kw_only=True)
class LogContents:
    """The content of one log."""

    format: str
    channels: tuple[str, ...]  # columns of a table, or topics
    joints: tuple[str, ...]  # that messages, rows or a LeRobot data set name, in order
    named: bool = True  # whether they are names; else the joints are only counted
    columns: tuple[str, ...] = ()  # of a table, elements of its lists as `column[k]`
    # that may carry joint states, where none does for sure; the first has `joints`
    state_topics: tuple[str, ...] = ()
    complete: bool = True  # whether all joint states were looked at for their names


def contents_of(path: Path, *, glance: bool = False) -> LogContents:
    """Look through a log; raises InputError if it is none or cannot be read at all.

    At a `glance` joints are those of the first messages alone, where that can be.
    """
    with being_read(path):
        return _contents_of(LogFile.at(path), glance=glance)


def _contents_of(log: LogFile, *, glance: bool) -> LogContents:
    kind = log.format
    file = log.file
    if kind == "parquet":
        from seqid_cli.logs.tables import parquet

        table = parquet.open_joined(file)
        joints = tuple(table.entries) or _lerobot_joints(file, table.names)
        return LogContents(
            format=kind,
            channels=parquet.list_columns(file),
            joints=joints or _counted(table.names),
            named=bool(joints),
            columns=table.names,
        )
    if kind == "csv":
        from seqid_cli.logs.tables import csv_file

        csv = csv_file.open_table(file)
        return LogContents(
            format=kind,
            channels=read_form(file).names,
            joints=tuple(csv.entries),
            columns=csv.names,
        )

    if kind == "mcap":
        from seqid_cli.logs.mcap.reader import list_topics
    else:
        from seqid_cli.logs.mcap.rosbags import list_topics
    contents = list_topics(file, glance=glance)
    return LogContents(
        format=kind,
        channels=tuple(topic.topic for topic in contents.topics),
        joints=contents.joints,
        state_topics=contents.state_topics,
        complete=contents.complete,
    )


def robot_descriptions(path: Path) -> dict[str, str]:
    """Return the URDFs that a log holds, by their topics; empty for a table.

    Raises InputError if it cannot be read at all.
    """
    log = LogFile.at(path)
    if log.format in ("parquet", "csv"):
        return {}
    from seqid_cli.logs.mcap import descriptions
    from seqid_cli.logs.mcap.records import Scan
    from seqid_cli.logs.mcap.rosbags import BagScan

    with being_read(log.file):
        return descriptions.read(log.file, Scan if log.format == "mcap" else BagScan)


def _lerobot_joints(path: Path, columns: tuple[str, ...]) -> tuple[str, ...]:
    """Name the joints of a LeRobot state as its data set does; empty if it does not."""
    from seqid_cli.logs.tables.parquet import lerobot_names

    size = len(_counted(columns))
    motors = lerobot_names(path) if size else []
    if len(motors) != size:
        return ()
    return tuple(_STATE_ENDING.sub("", motor) for motor in motors)


def _counted(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Number the joints of a LeRobot state."""
    size = sum(name.startswith(f"{LEROBOT_STATE}[") for name in columns)
    return tuple(f"joint_{k + 1}" for k in range(size))
