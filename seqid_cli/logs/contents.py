"""What a log holds, told without a robot file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.logs.mcap import reader, rosbags
from seqid_cli.logs.storage.files import check_log, storage_file
from seqid_cli.logs.tables import csv_file, parquet
from seqid_cli.logs.tables.naming_schemes import LEROBOT_STATE
from seqid_cli.logs.tables.parquet import motors_of


@dataclass(frozen=True)
class Channel:
    """One column of a table or one topic of an MCAP file or a bag, with its type and samples."""

    name: str
    kind: str
    samples: int


@dataclass(frozen=True)
class Survey:
    """The content of one log."""

    path: Path
    format: str
    channels: tuple[Channel, ...]
    joints: tuple[str, ...]  # that messages or a LeRobot data set name, in its order
    columns: tuple[str, ...] = ()  # of a table, elements of its lists as `column[k]`


def survey(path: Path) -> Survey:
    """Look through a log.

    Raises InputError: it is no log or cannot be read at all.
    """
    kind = check_log(path)
    path = storage_file(path)
    if kind == "parquet":
        listed = [Channel(*column) for column in parquet.list_columns(path)]
        return _table(path, kind, listed, parquet.open_table(path).names)
    if kind == "csv":
        names, rows = csv_file.list_columns(path)
        return _table(path, kind, [Channel(name, "text", rows) for name in names], names)
    topics, joints = (reader if kind == "mcap" else rosbags).list_topics(path)
    found = [
        Channel(each.topic, f"{each.schema} ({each.encoding})", each.messages) for each in topics
    ]
    return Survey(path, kind, tuple(found), joints)


def _table(path: Path, kind: str, channels: Sequence[Channel], names: Sequence[str]) -> Survey:
    count = sum(name.startswith(f"{LEROBOT_STATE}[") for name in names)
    joints = motors_of(path) if count else ()
    if len(joints) != count:
        joints = tuple(f"joint_{k + 1}" for k in range(count))
    return Survey(path, kind, tuple(channels), joints, tuple(names))
