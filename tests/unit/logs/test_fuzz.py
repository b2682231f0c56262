"""Hostile files: whatever the bytes, a Recording or an InputError."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.studies.fuzz.made_up import Damaged, damaged, problem, sound_logs

Sound = tuple[Mapping[str, bytes], np.ndarray]
FILES = 20  # of each seed


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    return sound_logs(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 10))]
)
def test_damaged_logs_are_read_in_part_or_refused(seed: int, sound: Sound, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    logs, positions = sound
    for number in range(FILES):
        log = damaged(logs, rng)
        found = problem(log, tmp_path / "damaged", positions)
        assert not found, f"file {number}, {log.kind}, {log.damage}: {found}"


@pytest.mark.parametrize("magic", [b"\x89MCAP0\r\n", b"PAR1", b""])
def test_junk_behind_the_magic_is_refused(magic: bytes, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for length in (0, 1, 7, 40, 300):
        log = Damaged("junk", "junk", magic + rng.bytes(length) + magic)
        assert not problem(log, tmp_path / "junk", np.zeros((0, 3)))
