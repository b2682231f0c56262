"""Fuzzing reaches every place that reads a file, and holds results to their claims."""

import copy
import json
import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from typer.models import TyperPath

from seqid_cli.commands.app import COMMANDS, load_command
from seqid_cli.params.encode import encode
from tests.senseless import senseless
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.claims import broken, groundless
from tests.studies.fuzz.command_lines import (
    OTHER_WRITTEN,
    WRITTEN,
    lines_for,
    reading_places,
)
from tests.studies.fuzz.counts import FINDS, HEADER, OTHER, counted, row
from tests.studies.fuzz.mutations import flip
from tests.studies.fuzz.readers import READERS
from tests.studies.fuzz.run import Outcome, Tally, fuzz
from tests.studies.fuzz.shapes import json_shape, toml_shape, xml_shape
from tests.studies.fuzz.target import Target
from tests.unit.params.documents import full_file
from tests.unit.report.pages import prediction_file


@pytest.mark.parametrize("command", COMMANDS)
def test_every_path_of_a_command_is_read_or_written(command: str) -> None:
    for param in load_command(command).params:
        name = str(param.name)
        is_path = isinstance(param.type, TyperPath)
        is_known = name in reading_places(command) or name in WRITTEN
        is_known = is_known or (command, name) in OTHER_WRITTEN
        assert is_known or not is_path, f"{command}: nothing is known of {name}"


def test_every_place_that_reads_gets_a_damaged_file() -> None:
    kinds = {kind for command in COMMANDS for kind in reading_places(command).values()}
    lines = [line for kind in kinds for line in lines_for(kind)]
    places = [(c, place) for c in COMMANDS for place in reading_places(c)]
    damaged = [line for line in lines if "{}" in line or "{@}/folder" in line]
    assert len(damaged) >= len(places) > 50
    assert {line[0] for line in damaged} == set(COMMANDS) - {"completion"}
    parameters = {line[0] for line in lines_for("parameters")}
    assert {"plan", "drive", "export", "predict", "gravity"} <= parameters
    assert {line[0] for line in lines_for("drive")} == {"replay"}


def document(file: object) -> Any:
    return json.loads(encode(file))


def test_a_good_verdict_has_samples() -> None:
    sound = document(full_file())
    assert not list(groundless(sound))
    for log in sound["inputs"]:
        log["samples"] = 0
    assert "friction is good without a sample" in list(groundless(sound))
    predicted = document(prediction_file())
    assert not list(groundless(predicted))
    joint = next(v["joint"] for v in predicted["verdicts"] if v["good"])
    predicted["joints"][joint]["samples"] = 0
    assert list(groundless(predicted)) == [f"{joint} is good without a sample"]


def test_numbers_without_sense_are_told_by_their_places() -> None:
    sound = document(full_file())
    assert not list(senseless(sound))
    spoilt = copy.deepcopy(sound)
    (parameter, *_) = spoilt["stages"]["inertia"]["parameters"]
    parameter["std_error"] = 0.0
    assert list(senseless(spoilt)) == ["$.stages.inertia.parameters[0].std_error is 0"]
    for number in (1e29, float("nan"), float("-inf")):
        parameter["std_error"] = number
        assert len(list(senseless(spoilt))) == 1


def test_a_result_that_is_no_json_is_a_find(tmp_path: Path) -> None:
    assert not broken(["inspect"], tmp_path)
    (tmp_path / "out.json").write_text('{"schema": "seqid/plan@1", "value": NaN}')
    assert broken(["plan"], tmp_path) == "its result is no JSON: NaN is no number"


def test_shapes_are_deep_or_wide() -> None:
    rng = np.random.default_rng(0)
    sound = {
        json_shape: b'{"a": [1, 2]}',
        toml_shape: b'name = "a"\n[[joint]]\nname = "b"\n',
        xml_shape: b'<robot><link name="lower"/></robot>',
    }
    for damage, content in sound.items():
        sizes = []
        for _ in range(30):
            data = bytearray(content)
            damage(data, rng)
            sizes.append(len(data))
        assert max(sizes) > 20_000
        assert len(set(sizes)) > 5


def _bug(_: Sequence[str]) -> int:
    raise ZeroDivisionError


def _busy(_: Sequence[str]) -> int:
    while True:
        pass


@pytest.mark.parametrize(
    ("kind", "program"),
    [("tracebacks", _bug), ("over 10 s", _busy), ("exit 70", lambda _: 70)],
)
def test_what_is_wrong_with_an_answer_has_a_column(
    kind: str, program: Callable[[Sequence[str]], int]
) -> None:
    code, _, why = answer((), cpu_s=0.05, program=program)
    counts = counted([Outcome(why, (code, ""))])
    assert counts.finds == dict.fromkeys((*FINDS, OTHER), 0) | {kind: 1}


def _deadly(_: bytearray, __: np.random.Generator) -> None:
    """Leave the file alone, and make its reader kill the process."""
    dying = {"read_result": lambda _: os.kill(os.getpid(), signal.SIGSEGV)}
    mock.patch.dict(READERS, dying).start()


def test_a_reader_that_kills_its_child_is_counted(tmp_path: Path) -> None:
    target = Target(
        name="parameters",
        file="file.json",
        seeds=[encode(full_file()).encode()],
        damages=[flip, _deadly],
        lines=[("read_result", "{}")],
        alone=(),
    )
    tally = Tally()
    fuzz(target, tmp_path, count=12, seed=0, tally=tally)
    counts = counted(tally.outcomes)
    deadly = sum(outcome.answer == (-1, "") for outcome in tally.outcomes)
    assert counts.finds == dict.fromkeys((*FINDS, OTHER), 0) | {"signals": deadly}
    assert 0 < deadly < counts.inputs == 12
    assert counts.read + counts.refused + deadly == 12

    cells = dict(zip(HEADER, row("parameters", [counts, counts]), strict=True))
    assert (cells["inputs"], cells["signals"]) == ("24", str(2 * deadly))
    assert cells["answers"] == str(len(counts.answers))
