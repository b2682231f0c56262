"""SQLite bags that compute what they seem to hold, or hold it many times."""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.mcap.rosbags import BagScan
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from tests.unit.logs.format_writers import Data, rosbag2_sqlite
from tests.unit.logs.mcap.test_rosbags import executed, outcome, storage
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot

MOTION = make_motion(grid())
DATA = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
ENDLESS = (
    "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x FROM c"
)
# Messages as in the bag, of which the column of data is made by what follows.
MESSAGES = """
CREATE TABLE kept AS SELECT * FROM messages;
DROP TABLE messages;
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
  timestamp INTEGER NOT NULL{data});
INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp FROM kept;
DROP TABLE kept;
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = storage(rosbag2_sqlite(tmp_path / "bag", DATA))
    assert isinstance(outcome(path), Recording)
    return path


CHANGES = {
    "": "cannot be read",  # the file is cut
    "UPDATE topics SET type = x'00ff'": "holds bytes instead of str",
    "DROP TABLE messages; DROP TABLE topics": "no table of topics",
    "ALTER TABLE messages ADD COLUMN more": "no table of messages",
    "UPDATE topics SET serialization_format = 'json'": "serialization is json",
    f"DROP TABLE messages; CREATE VIEW Messages AS {ENDLESS}": "computes values",
    "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(data)": (
        "computes values"
    ),
    MESSAGES.format(
        data=", data BLOB GENERATED ALWAYS AS/**/(zeroblob(900000000))"
    ): "column 'data' of its messages computes values",
    "ALTER TABLE topics ADD COLUMN a GENERATED ALWAYS AS ( hex(zeroblob(9000000)))": (
        "column 'a' of its topics computes values"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES, ids=range(len(CHANGES)))
def test_a_database_that_is_no_sound_bag_is_refused(change: str, bag: Path) -> None:
    if change:
        executed(bag, change)
    else:
        bag.write_bytes(bag.read_bytes()[:20_000])
    found = outcome(bag)
    assert isinstance(found, InputError)
    assert CHANGES[change] in found.message
    assert ".recover" in found.hint


@pytest.mark.parametrize(
    "change",
    [
        f"CREATE VIEW a AS {ENDLESS}",
        "CREATE TABLE a(a, b BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        "CREATE TRIGGER a AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    ],
)
def test_what_is_never_read_does_not_matter(change: str, bag: Path) -> None:
    executed(bag, change)
    np.testing.assert_array_equal(read_recording(bag, make_robot()).q, MOTION.q)


def test_messages_come_in_order_whatever_that_of_the_rows(bag: Path) -> None:
    executed(bag, "UPDATE messages SET id = 100000 - id")
    np.testing.assert_array_equal(read_recording(bag, make_robot()).q, MOTION.q)


def test_a_default_of_megabytes_is_not_repeated(bag: Path) -> None:
    """A column that was added later stands for its default in every row before."""
    default = "00" * (1 << 20)
    executed(bag, MESSAGES.format(data=""))
    executed(bag, f"ALTER TABLE messages ADD COLUMN data BLOB DEFAULT x'{default}'")
    found = outcome(bag)
    assert isinstance(found, InputError)
    assert "pages or values are used again and again" in found.message


def root_page(path: Path, table: str) -> int:
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        (page,) = database.execute(query, (table,)).fetchone()
    return int(page)


PAGE = 4096
FAN = 300  # children of a page


def with_towers(path: Path, root: int, leaf: int, depth: int) -> None:
    """Let a table's root stand for pages that each point to one child, many times."""
    data = bytearray(path.read_bytes())
    count = len(data) // PAGE
    pages = [root, *range(count + 1, count + depth)]
    children = [*pages[1:], leaf]
    data += bytes(PAGE * (depth - 1))
    for page, child in zip(pages, children, strict=True):
        cells = struct.pack(">IB", child, 1) * FAN
        start = PAGE - len(cells)
        pointers = struct.pack(f">{FAN}H", *range(start, PAGE, 5))
        head = struct.pack(">BHHHBI", 5, 0, FAN, start, 0, child)
        content = (head + pointers).ljust(start, b"\0") + cells
        data[PAGE * (page - 1) : PAGE * page] = content
    data[28:32] = struct.pack(">I", len(data) // PAGE)
    path.write_bytes(data)


def child_page(path: Path, page: int) -> int:
    """Return the first child of an interior page of a table."""
    data = path.read_bytes()[PAGE * (page - 1) : PAGE * page]
    assert data[0] == 5
    (at,) = struct.unpack_from(">H", data, 12)
    (child,) = struct.unpack_from(">I", data, at)
    return int(child)


@pytest.mark.parametrize("table", ["messages", "topics"])
def test_pages_that_point_to_one_child_again_and_again(table: str, bag: Path) -> None:
    root = root_page(bag, table)
    leaf = root
    if table == "messages":
        leaf = child_page(bag, root)
    else:  # its only page becomes the leaf, the root points to it
        data = bag.read_bytes()
        leaf = len(data) // PAGE + 1
        page = data[PAGE * (root - 1) : PAGE * root]
        bag.write_bytes(data + page)
    with_towers(bag, root, leaf, depth=8)
    found = outcome(bag)
    assert isinstance(found, InputError)
    assert "its rows take more than" in found.message


def test_rows_that_are_passed_over_cost_steps(bag: Path) -> None:
    """Messages of no topic are read by SQLite alone."""
    executed(bag, "UPDATE messages SET topic_id = 'x'")
    root = root_page(bag, "messages")
    with_towers(bag, root, child_page(bag, root), depth=8)
    found = outcome(bag)
    assert isinstance(found, InputError)
    assert "a query takes more steps than" in found.message


def test_a_message_of_megabytes_ends_the_reading(bag: Path) -> None:
    executed(bag, "UPDATE messages SET data = zeroblob(20000000) WHERE id = 100")
    scan = BagScan(bag, lambda topic: True)
    assert sum(len(batch.payloads) for batch in scan.batches()) == 99
    assert any("a message has 20000000 bytes" in loss for loss in scan.losses)
