"""What a log holds, told without a robot file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.logs import mcap, parquet
from seqid_cli.logs.open import check_log
from seqid_cli.robot.types import Channels


@dataclass(frozen=True)
class Channel:
    """One column of a Parquet file or one topic of an MCAP file, with its type and samples."""

    name: str
    kind: str
    samples: int


@dataclass(frozen=True)
class Survey:
    """The content of one log.

    `joints` are the joints that it seems to hold, in its order, and `names` the `[channels]` that
    a robot file with these joints needs to read it.
    """

    path: Path
    format: str
    channels: tuple[Channel, ...]
    joints: tuple[str, ...]
    names: Channels


def survey(path: Path) -> Survey:
    """Look through a log.

    Raises
    ------
    InputError
        It is no log or cannot be read at all.
    """
    kind = check_log(path)
    return _parquet(path) if kind == "parquet" else _mcap(path)


def _parquet(path: Path) -> Survey:
    columns = parquet.list_columns(path)
    channels = tuple(Channel(*column) for column in columns)
    names = [channel.name for channel in channels]
    joints = tuple(name.removesuffix(".position") for name in names if name.endswith(".position"))
    if joints:
        return Survey(path, "parquet", channels, joints, Channels())
    for pattern, first in (("actual_q_", 0), ("q_", 0), ("q_", 1)):
        joints = _numbered(names, pattern, first)
        if joints:
            index = "{index0}" if first == 0 else "{index}"
            return Survey(path, "parquet", channels, joints, Channels(position=pattern + index))
    return Survey(path, "parquet", channels, (), Channels())


def _numbered(names: list[str], prefix: str, first: int) -> tuple[str, ...]:
    """Return the joints prefix<first>, prefix<first + 1> ... without a hole."""
    numbers = {int(m[1]) for name in names if (m := re.fullmatch(rf"{prefix}([0-9]{{1,3}})", name))}
    count = 0
    while first + count in numbers:
        count += 1
    return tuple(f"joint_{i + 1}" for i in range(count))


def _mcap(path: Path) -> Survey:
    topics, joints = mcap.list_topics(path)
    channels = tuple(
        Channel(info.topic, f"{info.schema} ({info.encoding})", info.messages) for info in topics
    )
    return Survey(path, "mcap", channels, joints, Channels())
