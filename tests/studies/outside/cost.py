"""What a diagnosis costs over joints, length and logs: `python -m
tests.studies.outside.cost`.

One arm of the second simulator with a loss in a gear that came after its file; the
command runs as a process of its own, imports included.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from seqid_cli.errors import SeqidWarning
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry
from tests import Array
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm, drawn_arm, published_links
from tests.studies.outside.cases import Recorder
from tests.studies.outside.effects import KINDS
from tests.studies.outside.plan import Case, Outline
from tests.studies.outside.simulate import Effect
from tests.studies.tables import show, table

RATE_HZ = 500.0
SEED = 7
HEADER = (
    "joints",
    "IMUs",
    "logs",
    "s",
    "samples",
    "largest effect",
    "effects found",
    "CPU, s",
    "peak, MiB",
)


class Load(NamedTuple):
    """What is diagnosed: so many logs of so many seconds each.

    Attributes
    ----------
    alone : bool
        Whether the gear's loss is all that the file lacks: friction is the same at all
        positions.
    """

    arm: str
    joints: int
    imus: bool
    logs: int
    seconds: float
    alone: bool = False


LOADS = (
    Load("drawn", 2, True, 1, 30.0),
    Load("drawn", 2, True, 1, 120.0),
    Load("ur10", 6, True, 1, 120.0, alone=True),
    Load("ur10", 6, True, 1, 120.0),
    Load("panda", 7, False, 1, 30.0),
    Load("panda", 7, False, 1, 120.0),
    Load("panda", 7, False, 8, 15.0),
    Load("panda", 7, True, 1, 30.0),
    Load("panda", 7, True, 1, 60.0),
    Load("panda", 7, True, 1, 120.0, alone=True),
    Load("panda", 7, True, 1, 120.0),
    Load("panda", 7, True, 8, 15.0),
)


def case_of(load: Load) -> Case:
    """Return an arm at 500 Hz whose gear loses at its second joint."""
    rng = np.random.default_rng(SEED)
    n = load.joints if load.arm == "drawn" else len(published_links(load.arm))
    arm = replace(drawn_arm(rng, load.arm, n, load.imus), rate_hz=RATE_HZ)
    if load.alone:
        even = tuple(replace(drive, waviness=0.0) for drive in arm.drives)
        arm = replace(arm, drives=even)
    kinds = ("load_dependent_friction",)
    outline = Outline(SEED, kinds, "step_late", load.arm, n, load.imus, False, False)
    effect = replace(
        KINDS[kinds[0]](arm, 1, rng), name="load_dependent_friction", scale=2.0
    )
    return Case(outline, arm, (effect,), (0.0,), "cost")


def recorded(
    recorder: Recorder, effects: Sequence[Effect], *, logs: int, seconds: float
) -> list[Path]:
    """Record logs of multisines."""
    arm: Arm = recorder.case.arm
    make: Callable[[Arm, np.random.Generator, float], Array] = motions.multisine
    return [
        recorder.record(make(arm, recorder.rng, seconds), effects) for _ in range(logs)
    ]


def measured(load: Load, folder: Path) -> tuple[str, ...]:
    """Diagnose one load; returns a row of the table."""
    case = case_of(load)
    recorder = Recorder(case, folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        file = recorder.one_step(recorded(recorder, (), logs=3, seconds=20.0))
    logs = recorded(recorder, case.effects, logs=load.logs, seconds=load.seconds)
    output = folder / "diagnosis.json"
    command = [sys.executable, "-m", "seqid_cli", "diagnose", *map(str, logs)]
    command += ["-r", str(recorder.robot), "-p", str(file), "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"diagnose ended with {status}")
    found = found_in(output)
    largest = f"{found[0].effect} at {found[0].joint}" if found else "nothing"
    samples = round(load.logs * load.seconds * RATE_HZ)
    return (
        str(case.arm.n),
        str(len(case.arm.imus)),
        str(load.logs),
        f"{load.seconds:.0f}",
        f"{samples:,}",
        largest,
        str(len(found)),
        f"{usage.ru_utime + usage.ru_stime:.1f}",
        f"{usage.ru_maxrss / 1024:.0f}",
    )


def found_in(path: Path) -> list[FindingEntry]:
    """Return the findings of a diagnosis file, the surest first."""
    return msgspec.json.decode(path.read_bytes(), type=DiagnosisFile).findings


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.outside.cost")
    parser.add_argument("--write", action="store_true", help="into the document")
    chosen = parser.parse_args()
    rows = []
    for load in LOADS:
        with tempfile.TemporaryDirectory() as name:
            rows.append(measured(load, Path(name)))
        sys.stderr.write(f"{rows[-1]}\n")
    show(
        "evidence/benchmarks.md",
        "cost_of_diagnosis",
        table(HEADER, rows),
        kept=chosen.write,
    )


if __name__ == "__main__":
    main()
