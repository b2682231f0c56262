"""What a log holds, told without a robot file."""

import re
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.logs.mcap import reader, rosbags
from seqid_cli.logs.storage.files import check_log, storage_file
from seqid_cli.logs.tables import parquet
from seqid_cli.logs.tables.csv_form import read_form
from seqid_cli.logs.tables.naming_schemes import LEROBOT_STATE


@dataclass(frozen=True)
class Survey:
    """The content of one log."""

    format: str
    channels: tuple[str, ...]  # columns of a table, or topics
    joints: tuple[str, ...]  # that messages or a LeRobot data set name, in its order
    columns: tuple[str, ...] = ()  # of a table, elements of its lists as `column[k]`


def survey(path: Path) -> Survey:
    """Look through a log; raises InputError if it is none or cannot be read at all."""
    kind = check_log(path)
    path = storage_file(path)
    if kind not in ("parquet", "csv"):
        topics, joints = (reader if kind == "mcap" else rosbags).list_topics(path)
        return Survey(kind, tuple(each.topic for each in topics), joints)
    if kind == "parquet":
        channels, names = parquet.list_columns(path), parquet.open_table(path).names
    else:
        channels = names = read_form(path).names
    count = sum(name.startswith(f"{LEROBOT_STATE}[") for name in names)
    plain = re.compile("(?:[._]pos(?:ition)?|[.]q)$")  # motors by their names as joints
    joints = tuple(
        plain.sub("", name) for name in (parquet.lerobot_names(path) if count else ())
    )
    if len(joints) != count:
        joints = tuple(f"joint_{k + 1}" for k in range(count))
    return Survey(kind, channels, joints, names)
