"""Damaged logs give a recording or an error of seqid's own, and no row that nobody logged.

What a damaged MCAP file still gives must be rows of the sound one, as long as checksums are on.
"""

import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from tests.studies.fuzz.mutations import BYTES, mutated
from tests.unit.logs.samples import (
    ARRAY,
    GYRO,
    JOINTS,
    grid,
    make_motion,
    make_robot,
    read_raw,
    write_motion,
)
from tests.unit.logs.writers import rewrite, write_parquet

ROBOT = make_robot(imus=(ARRAY, GYRO), constants=0.1)


def samples(folder: Path) -> Mapping[str, Path]:
    """Sound logs of every encoding and storage."""
    motion = make_motion(grid(300))
    found = {}
    for encoding in ("cdr", "json"):
        source = write_motion(folder / f"{encoding}.mcap", motion, encoding=encoding)
        for compression in ("none", "lz4", "zstd"):
            for crc in (True, False):
                name = f"{encoding}-{compression}-{'crc' if crc else 'no_crc'}"
                found[name] = rewrite(
                    source,
                    folder / name,
                    compression=compression,
                    crc=crc,
                    summary=crc,
                    chunk_size=8192,
                )
        name = f"{encoding}-unchunked"
        found[name] = rewrite(source, folder / name, chunking=False)
    found["parquet"] = write_parquet(
        folder / "parquet", motion.t, JOINTS, motion.q, current=motion.tau
    )
    return found


@dataclass(frozen=True)
class Damaged:
    """A log with one damage: of which kind it was, and its bytes."""

    kind: str
    damage: str
    data: bytes


def damaged(logs: Mapping[str, bytes], rng: np.random.Generator) -> Damaged:
    """Damage one of the logs."""
    kind = list(logs)[int(rng.integers(len(logs)))]
    data, damage = mutated(logs[kind], BYTES, rng, most=1)
    return Damaged(kind, damage, data)


def problem(log: Damaged, path: Path, sound: np.ndarray) -> str:
    """Read a damaged log; returns what went wrong, empty if nothing."""
    path.write_bytes(log.data)
    checked = "crc" in log.kind.split("-") and "none" not in log.kind
    try:
        wrong = _unusable(read_recording(path, ROBOT))
        return wrong or (_made_up(path, sound) if checked else "")
    except InputError as error:
        return "" if error.message and error.where == str(path) else f"no place: {error}"
    except Exception:
        return traceback.format_exc()


def _unusable(recording: Recording) -> str:
    """What a recording may not be, whatever the file."""
    count = len(recording.t)
    values = [recording.t, recording.q, recording.dq, recording.tau]
    values += [*recording.accelerometers.values(), *recording.gyros.values()]
    there = [each for each in values if each is not None]
    if any(len(each) != count or not np.isfinite(each).all() for each in there):
        return "channels of another length, or that are not numbers"
    return "" if (np.diff(recording.t) > 0).all() else "time goes back"


def _made_up(path: Path, sound: np.ndarray) -> str:
    """Rows that the sound log has not."""
    rows = np.ascontiguousarray(read_raw(path, ROBOT).joints.channels["position"])
    known = {row.tobytes() for row in sound}
    strange = sum(row.tobytes() not in known for row in rows)
    return f"{strange} of {len(rows)} rows are made up" if strange else ""


def sound_logs(folder: Path) -> tuple[Mapping[str, bytes], np.ndarray]:
    """Bytes of sound logs by their kind, and the positions (N, n) rad in them."""
    logs = {kind: path.read_bytes() for kind, path in samples(folder).items()}
    return logs, np.ascontiguousarray(make_motion(grid(300)).q)
