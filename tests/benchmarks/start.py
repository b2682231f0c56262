"""What it costs to start: help, version and completion against importing typer.

Byte code is there beforehand, as it is once a package is installed.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from statistics import median

from tests.benchmarks.measure import child_cpu_s
from tests.studies.tables import table


def study(*, quick: bool = False) -> str:
    """Return the table."""
    seqid = [str(Path(sys.executable).with_name("seqid"))]
    subjects: list[tuple[str, list[str]]] = [
        ("python", [sys.executable, "-c", "pass"]),
        ("import typer", [sys.executable, "-c", "import typer"]),
        ("seqid --version", [*seqid, "--version"]),
        ("seqid --help", [*seqid, "--help"]),
        ("seqid inertia --help", [*seqid, "inertia", "--help"]),
        ("seqid completion bash", [*seqid, "completion", "bash"]),
    ]
    spent: list[list[float]] = [[] for _ in subjects]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": folder}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for _, command in subjects:
            child_cpu_s(command, environment)
        for _ in range(1 if quick else 11):
            for (_, command), times in zip(subjects, spent, strict=True):
                times.append(child_cpu_s(command, environment))
    typer = median(spent[1])
    rows = [
        [name, f"{1e3 * median(times):.0f}", f"{median(times) / typer:.2f}"]
        for (name, _), times in zip(subjects, spent, strict=True)
    ]
    return table(["", "CPU ms", "times import typer"], rows)
