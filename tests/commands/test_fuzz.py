"""What fuzzing has found stays answered, and a few fresh inputs of every kind are."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.studies.fuzz import run
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.targets import Target, targets

FOUND = sorted((Path(run.__file__).parent / "found").iterdir())
KINDS = {  # the first word of a name in the folder, and the target
    "mcap": "MCAP, CDR",
    "parameters": "parameters",
    "parquet": "Parquet",
    "payload": "payload",
    "plan": "plan",
    "sqlite": "ROS 2 bag: SQLite",
    "torques": "torques",
    "trend": "trend",
    "urdf": "URDF",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Target]:
    return {target.name: target for target in targets(tmp_path_factory.mktemp("sound"))}


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_what_was_found_is_answered(path: Path, made: Mapping[str, Target], tmp_path: Path) -> None:
    target = made[KINDS[path.name.partition("_")[0]]]
    run.lay_out(target, tmp_path)
    (tmp_path / target.file).write_bytes(path.read_bytes())
    for line in dict.fromkeys(map(tuple, target.lines)):
        _, said, why = answer(run.filled(line, target, tmp_path))
        assert not why, f"{' '.join(line)}: {said}"


@pytest.mark.slow
def test_fresh_inputs_are_answered(made: Mapping[str, Target], tmp_path: Path) -> None:
    for number, target in enumerate(made.values()):
        folder, tally = tmp_path / str(number), run.Tally()
        folder.mkdir()
        run.fuzz(target, folder, 25, 7, tally)
        assert not tally.finds, f"{target.name}: {tally.finds[0].line}: {tally.finds[0].said}"
        assert sum(tally.codes.values()) == 25
