"""The SQLite file of a ROS 2 bag, read within what its size allows.

A database may compute what it seems to hold, and its pages may stand for each other, so
that a few bytes are endless rows. What SQLite itself says of tables is therefore asked
before any row, and two budgets grow with the file alone: the bytes of rows, of which a
file cannot have more than its own, and the steps that SQLite takes.

Tables and columns are those of rosbag2_storage_sqlite3, versions 1 to 4 of its schema:
https://github.com/ros2/rosbag2 (`sqlite_storage.cpp`).
"""

import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard

from seqid_cli.logs.mcap.bags import (
    KEPT_TYPES,
    MESSAGE_LIMIT,
    Bag,
    Message,
    Topic,
    Wanted,
    made_topic,
)

_ZSTD = b"\x28\xb5\x2f\xfd"
_TOPICS = ("id", "name", "type", "serialization_format")
_MESSAGES = ("id", "topic_id", "timestamp", "data")
_DEFINITIONS = ("topic_type", "encoding", "encoded_message_definition")
# Columns that SQLite computes: of a virtual table 1, generated 2 and 3; a stored one 0.
_STORED = 0
_ROW_BYTES = 12  # that a row takes at least beside its values, of four columns
_HEAD_BYTES = 1 << 16  # of a database beside its rows: some pages
# Steps of SQLite's machine: some 15 for a row, some 40 for a word of a definition.
_STEPS = 1 << 22
_STEPS_PER_BYTE = 1  # a row that a recorder writes has at least 60
_STEPS_BETWEEN_LOOKS = 1000
_MOST_COLUMNS = 64  # recorders write up to 6
_MOST_TOPICS = 10_000


@dataclass
class _Steps:
    """Counts the steps of SQLite; it stops where `count` passes `most`."""

    most: int
    count: int = 0

    def __call__(self) -> bool:
        """Tell SQLite whether to stop."""
        self.count += _STEPS_BETWEEN_LOOKS
        return self.is_exceeded

    @property
    def is_exceeded(self) -> bool:
        return self.count > self.most


@dataclass(frozen=True)
class _Database:
    """An opened SQLite file of `size` bytes."""

    connection: sqlite3.Connection
    size: int
    steps: _Steps

    def rows(self, query: str, values: Sequence[object] = ()) -> Iterator[Any]:
        """Yield rows; their first column is the bytes that they take in the file.

        Raises
        ------
        ValueError
            Where they take more bytes, or steps, than a file of this size has.
        sqlite3.Error
            At a damaged page.
        """
        self.steps.count = 0
        n_bytes = 0
        try:
            for row in self.connection.execute(query, values):
                n_bytes += _ROW_BYTES + (row[0] or 0)
                if n_bytes > self.size + _HEAD_BYTES:
                    raise ValueError(
                        f"its rows take more than its {self.size} bytes: pages or"
                        " values are used again and again"
                    )
                yield row
        except sqlite3.Error as error:
            if self.steps.is_exceeded:
                raise ValueError(
                    f"a query takes more steps than {self.size} bytes are worth"
                ) from error
            raise

    def columns(self, table: str) -> list[str]:
        """Name the columns of a table in their order; none where there is no table.

        Raises ValueError where a column, or the whole table, is computed.
        """
        # A view or a virtual table has no page of its own where its rows begin.
        kinds = self.rows(
            "SELECT 0, type, rootpage FROM sqlite_master"
            " WHERE type IN ('table', 'view') AND name = ? COLLATE NOCASE",
            (table,),
        )
        for _, kind, root_page in kinds:
            if kind != "table" or not root_page:
                raise ValueError(f"its {table} are a {kind} that computes values")
        names = []
        for _, name, hidden in self.rows(
            "SELECT 0, name, hidden FROM pragma_table_xinfo(?)", (table,)
        ):
            if hidden != _STORED:
                raise ValueError(
                    f"column {name!r} of its {table} computes values, which no recorder"
                    " writes"
                )
            names.append(name)
        return names


@contextmanager
def open_bag(path: Path, wanted: Wanted) -> Iterator[Bag]:
    """Open the SQLite file of a ROS 2 bag.

    Raises ValueError or sqlite3.Error where it is damaged or no bag.
    """
    with closing(_connected(path)) as connection:
        size = path.stat().st_size
        steps = _Steps(_STEPS + _STEPS_PER_BYTE * size)
        connection.set_progress_handler(steps, _STEPS_BETWEEN_LOOKS)
        # A value longer than the file is none of it.
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, size + _HEAD_BYTES)
        connection.setlimit(sqlite3.SQLITE_LIMIT_COLUMN, _MOST_COLUMNS)
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.execute("PRAGMA cell_size_check = ON")
        database = _Database(connection, size, steps)
        topics = _topics(database)

        def messages() -> Iterator[Message]:
            # Some topics are wanted for their type, which is known by now.
            links = [
                each.channel.id
                for each in topics
                if each.schema.name in KEPT_TYPES and wanted(each.channel.topic)
            ]
            return _messages(database, links)

        yield Bag(topics, messages)


def _connected(path: Path) -> sqlite3.Connection:
    """Open a database as it is: nothing is written, no journal is merged."""
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    return sqlite3.connect(address, uri=True)


def _topics(database: _Database) -> list[Topic]:
    """Read what a bag has of each topic.

    Messages are counted up to a damaged page.
    """
    if not set(_TOPICS) <= set(database.columns("topics")):
        raise ValueError("it has no table of topics as ROS 2 bags have")
    # What stands behind a message's data is read through the data, once for each row.
    if tuple(database.columns("messages")) != _MESSAGES:
        raise ValueError("it has no table of messages as ROS 2 bags have")

    definitions = _definitions(database)
    counts = _counts(database)
    topics: list[Topic] = []
    for _, number, name, kind, serialization in database.rows(
        "SELECT length(name) + length(type), id, name, type, serialization_format"
        " FROM topics"
    ):
        _check_type(number, int)
        _check_type(name, str)
        _check_type(kind, str)
        if serialization != "cdr":
            raise ValueError(f"its serialization is {serialization}, not cdr")
        if len(topics) == _MOST_TOPICS:
            raise ValueError(f"it has more than {_MOST_TOPICS} topics")
        text = definitions.get(kind, "")
        topics.append(made_topic(number, name, kind, text, counts[number]))
    return topics


def _definitions(database: _Database) -> dict[str, str]:
    """Read the definitions of kept types; bags from before 2023 have none."""
    if not set(_DEFINITIONS) <= set(database.columns("message_definitions")):
        return {}
    marks = ", ".join("?" * len(KEPT_TYPES))
    rows = database.rows(
        "SELECT length(encoded_message_definition), topic_type,"
        " encoded_message_definition FROM message_definitions"
        f" WHERE encoding = 'ros2msg' AND topic_type IN ({marks})",
        KEPT_TYPES,
    )
    texts: dict[str, str] = {}
    for _, kind, text in rows:
        _check_type(text, str)
        texts.setdefault(kind, text)
    return texts


def _counts(database: _Database) -> Counter[int]:
    """Count the messages of each topic, up to a damaged page."""
    counts: Counter[int] = Counter()
    # The length of data is told without reading them.
    rows = database.rows(
        "SELECT length(data), topic_id FROM messages NOT INDEXED"
        " WHERE typeof(topic_id) = 'integer'"
    )
    try:
        for _, number in rows:
            counts[number] += 1
    except sqlite3.Error:  # whoever reads the messages meets it again, and says so
        pass
    return counts


def _messages(database: _Database, topics: Sequence[int]) -> Iterator[Message]:
    """Yield the messages of some topics in the order in which they were recorded."""
    zstd = zstandard.ZstdDecompressor()
    marks = ", ".join("?" * len(topics))
    # Without the index of times, which may be damaged, and without sorting, which holds
    # all data: whoever gathers messages puts them in order by their stamps.
    rows = database.rows(
        "SELECT length(data), topic_id, timestamp,"
        f" CASE WHEN length(data) <= {MESSAGE_LIMIT} THEN data END"
        " FROM messages NOT INDEXED"
        " WHERE typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer'"
        f" AND topic_id IN ({marks})",
        topics,
    )
    for n_bytes, number, time_ns, data in rows:
        if n_bytes is not None and n_bytes > MESSAGE_LIMIT:
            raise ValueError(f"a message has {n_bytes} bytes")
        _check_type(data, bytes)
        # Some recorders compress one by one.
        if data[:4] == _ZSTD:
            data = zstd.decompress(data, max_output_size=MESSAGE_LIMIT)
        yield Message(number, time_ns, data)


def _check_type(value: object, kind: type) -> None:
    """Raise ValueError where a column, which may hold any type, holds another."""
    if not isinstance(value, kind):
        raise ValueError(
            f"a column holds {type(value).__name__} instead of {kind.__name__}"
        )
