"""Damaged logs give a recording or an error of seqid's own, and no row that nobody
logged.
"""

import traceback
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs import samples
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import rewrite, write_parquet

ROBOT = make_robot(imus=(ARRAY, GYRO), constants=0.1)


def sound_logs(folder: Path) -> tuple[Mapping[str, bytes], np.ndarray]:
    """Sound logs of every encoding and storage by their kind, and the positions (N, n)
    in them.
    """
    motion, found = make_motion(grid(300)), {}
    for encoding in ("cdr", "json"):
        source = samples.write_motion(
            folder / f"{encoding}.mcap", motion, encoding=encoding
        )
        for compression, crc in product(("none", "lz4", "zstd"), (True, False)):
            name = f"{encoding}-{compression}-{'crc' if crc else 'no_crc'}"
            stored = {
                "compression": compression,
                "crc": crc,
                "summary": crc,
                "chunk_size": 8192,
            }
            found[name] = rewrite(source, folder / name, **stored)
        name = f"{encoding}-unchunked"
        found[name] = rewrite(source, folder / name, chunking=False)
    own = (motion.t, JOINTS, motion.q)
    found["parquet"] = write_parquet(folder / "parquet", *own, current=motion.tau)
    return {
        kind: path.read_bytes() for kind, path in found.items()
    }, np.ascontiguousarray(motion.q)


def problem(kind: str, data: bytes, path: Path, sound: np.ndarray) -> str:
    path.write_bytes(data)
    checked = "crc" in kind.split("-") and "none" not in kind
    try:
        return _unusable(path) or (_made_up(path, sound) if checked else "")
    except InputError as error:
        return (
            "" if error.message and error.where == str(path) else f"no place: {error}"
        )
    except Exception:
        return traceback.format_exc()


def _unusable(path: Path) -> str:
    recording = read_recording(path, ROBOT)
    values = [recording.t, recording.q, recording.dq, recording.tau]
    values += [*recording.accelerometers.values(), *recording.gyros.values()]
    there = [each for each in values if each is not None]
    if any(
        len(each) != len(recording.t) or not np.isfinite(each).all() for each in there
    ):
        return "channels of another length, or that are not numbers"
    return "" if (np.diff(recording.t) > 0).all() else "time goes back"


def _made_up(path: Path, sound: np.ndarray) -> str:
    rows = np.ascontiguousarray(
        samples.read_raw(path, ROBOT).joints.channels["position"]
    )
    known = {row.tobytes() for row in sound}
    strange = sum(row.tobytes() not in known for row in rows)
    return f"{strange} of {len(rows)} rows are made up" if strange else ""
