"""Hostile files: whatever the bytes, a Recording or an InputError."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.studies.fuzz.mutations import BYTES, mutated
from tests.unit.logs.made_up import problem, sound_logs

Sound = tuple[Mapping[str, bytes], np.ndarray]
FILES = 20  # of each seed


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    return sound_logs(tmp_path_factory.mktemp("sound"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 10))],
)
def test_damaged_logs_are_read_in_part_or_refused(
    seed: int, sound: Sound, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    logs, positions = sound
    for number in range(FILES):
        kind = list(logs)[int(rng.integers(len(logs)))]
        data, damage = mutated(logs[kind], BYTES, rng, most=1)
        found = problem(kind, data, tmp_path / "damaged", positions)
        assert not found, f"file {number}, {kind}, {damage}: {found}"


@pytest.mark.parametrize("magic", [b"\x89MCAP0\r\n", b"PAR1", b""])
def test_junk_behind_the_magic_is_refused(magic: bytes, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for length in (0, 1, 7, 40, 300):
        data = magic + rng.bytes(length) + magic
        assert not problem("junk", data, tmp_path / "junk", np.zeros((0, 3)))
