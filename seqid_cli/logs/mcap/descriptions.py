"""URDFs in a recording: what `robot_state_publisher` sends as `/robot_description`.

It is a `std_msgs/String`, which a bag holds once or a few times, in front.
"""

import struct
from pathlib import Path

from seqid_cli.logs.mcap.records import Scan
from seqid_cli.logs.mcap.topics import normal
from seqid_cli.logs.messages.parsers import parse_json
from seqid_cli.robot.toml import URDF_LIMIT

TOPIC = "/robot_description"  # behind a namespace, if any
_MOST = 64  # descriptions of one recording; a hostile one may have any number
_ENCAPSULATION = 4  # bytes in front of CDR
_BIG_ENDIAN = (b"\x00\x00", b"\x00\x06")


def read(path: Path, scan: type[Scan]) -> dict[str, str]:
    """Return the last text on each topic of a description, as far as there is one.

    Parameters
    ----------
    path : Path
        The file of a recording.
    scan : type of Scan
        The pass over a file of its format.
    """

    def is_description(topic: str) -> bool:
        return normal(topic).endswith(TOPIC)

    texts: dict[str, str] = {}
    for batch in scan(path, is_description).batches():
        topic = normal(batch.channel.topic)
        if not is_description(topic) or not len(batch.payloads):
            continue
        if len(texts) >= _MOST and topic not in texts:
            continue
        last = batch.payloads.take(slice(-1, None))
        if int(last.lengths[0]) > URDF_LIMIT:
            continue
        text = _text(next(iter(last)), batch.channel.message_encoding)
        if text is not None and "<robot" in text:
            texts[topic] = text
    return texts


def _text(data: bytes, encoding: str) -> str | None:
    """Return the text of a String message, None where it is damaged."""
    order = "<"
    if encoding == "json":
        try:
            message = parse_json(data)
        except ValueError:
            return None
        text = message.get("data") if isinstance(message, dict) else None
        return text if isinstance(text, str) else None
    if encoding == "cdr":
        order = ">" if data[:2] in _BIG_ENDIAN else "<"
        data = data[_ENCAPSULATION:]
    elif encoding != "ros1":
        return None

    if len(data) < struct.calcsize("I"):
        return None
    (length,) = struct.unpack_from(f"{order}I", data)
    content = data[struct.calcsize("I") :]
    if length > len(content):
        return None
    return content[:length].rstrip(b"\0").decode("utf-8", "replace")
