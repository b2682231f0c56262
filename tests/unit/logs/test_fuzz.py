"""Hostile files: whatever the bytes, a Recording or an InputError."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import ARRAY, GYRO, JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import rewrite, write_mcap, write_parquet

ROBOT = make_robot(imus=(ARRAY, GYRO), constants=0.1)
KINDS = ("parquet", "cdr-zstd", "cdr-lz4", "cdr-none", "cdr-plain", "json-none", "json-plain")
Edit = Callable[[bytearray], bytearray]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("logs")
    motion = make_motion(grid(150))
    written: dict[str, bytes] = {}
    for kind in KINDS:
        path = folder / kind
        if kind == "parquet":
            write_parquet(
                path,
                motion.t,
                JOINTS,
                motion.q,
                current=motion.tau,
                accelerometers=motion.accelerometers,
                gyros=motion.gyros,
            )
        else:
            encoding, storage = kind.split("-")
            write_mcap(
                path,
                motion.t,
                JOINTS,
                motion.q,
                encoding=encoding,  # type: ignore[arg-type]
                effort=motion.tau,
                accelerometers=motion.accelerometers,
                gyros=motion.gyros,
                compression="none" if storage == "plain" else storage,
                chunk_size=8192,
            )
            # Without checksums, so that damage reaches the decoders.
            path = rewrite(
                path,
                folder / f"{kind}.mcap",
                chunking=storage != "plain",
                crc=False,
                compression="none" if storage == "plain" else storage,
                chunk_size=8192,
            )
        written[kind] = path.read_bytes()
    return written


def check(path: Path) -> None:
    try:
        recording = read_recording(path, ROBOT)
    except InputError as error:
        told = error
    else:
        told = None
    if told is not None:
        assert told.message
        assert told.where == str(path)
        return
    count = len(recording.t)
    assert count >= 20
    assert recording.q.shape == (count, 3)
    assert recording.valid.shape == (count,)
    assert (np.diff(recording.t) > 0).all()
    values = [recording.t, recording.q, *recording.accelerometers.values()]
    values += [each for each in (recording.dq, recording.tau) if each is not None]
    for each in (*values, *recording.gyros.values()):
        assert len(each) == count
        assert np.isfinite(each).all()


fuzz = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.mark.parametrize("kind", KINDS)
@fuzz
@given(edits=st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=12))
def test_flipped_bytes(
    kind: str, edits: list[tuple[float, int]], logs: dict[str, bytes], tmp_path: Path
) -> None:
    data = bytearray(logs[kind])
    for place, mask in edits:
        data[int(place * (len(data) - 1))] ^= mask
    path = tmp_path / "log"
    path.write_bytes(data)
    check(path)


@pytest.mark.parametrize("kind", KINDS)
@fuzz
@given(cut=st.floats(0, 1), tail=st.binary(max_size=12))
def test_cut_files(
    kind: str, cut: float, tail: bytes, logs: dict[str, bytes], tmp_path: Path
) -> None:
    data = logs[kind]
    path = tmp_path / "log"
    path.write_bytes(data[: int(cut * len(data))] + tail)
    check(path)


@pytest.mark.parametrize("kind", KINDS)
@fuzz
@given(start=st.floats(0, 1), length=st.integers(0, 400), junk=st.binary(max_size=60))
def test_replaced_pieces(
    kind: str, start: float, length: int, junk: bytes, logs: dict[str, bytes], tmp_path: Path
) -> None:
    data = logs[kind]
    at = int(start * len(data))
    path = tmp_path / "log"
    path.write_bytes(data[:at] + junk + data[at + length :])
    check(path)


@fuzz
@given(junk=st.binary(max_size=300), kind=st.sampled_from([b"\x89MCAP0\r\n", b"PAR1", b""]))
def test_junk_behind_the_magic(junk: bytes, kind: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(kind + junk + kind)
    check(path)
