"""The page about the SO-101, from its made-up data set to MuJoCo."""

import contextlib
import io
import json
from pathlib import Path

import pytest

from seqid_cli.commands.app import run
from tests import ROOT
from tests.plants import so101
from tests.unit.docs.markdown import blocks, steps
from tests.unit.docs.test_docs import LONG

PAGE = ROOT / "docs" / "how-to" / "so101.md"


@pytest.mark.slow
@LONG
@pytest.mark.filterwarnings("ignore::seqid_cli.errors.SeqidWarning")
def test_the_page_leads_from_a_data_set_to_mujoco(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    so101.make(tmp_path / "so101")
    for step in steps(PAGE):
        if step.words[0] == "seqid":
            assert run(list(step.words[1:])) == 0, str(step)

    replay = json.loads((tmp_path / "replay.json").read_text(encoding="utf-8"))
    for name, joint in replay["joints"].items():
        guess = min(joint["delayed_command"]["rms"], joint["start_plus_change"]["rms"])
        assert joint["position"]["rms"] < 0.2 * guess, name

    (code,) = [block.text for block in blocks(PAGE) if block.language == "py"]
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(code, str(PAGE), "exec"), {})
    lines = said.getvalue().splitlines()
    assert len(lines) == len(so101.NAMES)
    for line in lines:
        name, rest = line.split(": ")
        error_mrad = float(rest.split()[0])
        guess = replay["joints"][name]["start_plus_change"]["rms"]
        assert error_mrad < 1e3 * guess, line
