"""Exported C headers, compiled without a warning and run."""

import subprocess
from pathlib import Path

import numpy as np

from seqid_cli.export.code import identifier
from seqid_cli.robot.types import Array, Robot


def run_c(folder: Path, robot: Robot, text: str, body: str, rows: Array) -> Array:
    """Compile the header with a `body` that turns a row of numbers x into y, and run
    it.
    """
    name = identifier(robot.name)
    (folder / "arm.h").write_text(text)
    (folder / "main.c").write_text(
        f'#include <stdio.h>\n#include "arm.h"\n'
        f"enum {{ N = {robot.n}, WIDTH = {rows.shape[1]} }};\n"
        f"int main(void) {{ double x[WIDTH], y[N]; int i, row; {name}_observer o;\n"
        f"for (i = 0; i < N; ++i) y[i] = 0.0;\n"
        f"{name}_observer_start(&o, y, y);\n"
        "for (row = 0;; ++row) {\n"
        'for (i = 0; i < WIDTH; ++i) if (scanf("%lf", &x[i]) != 1) return 0;\n'
        f"{body.replace('ARM', name)}\n"
        'for (i = 0; i < N; ++i) printf("%.17g ", y[i]);\nprintf("\\n"); } }\n'
    )
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    command = ["cc", *flags, "-o", str(folder / "main"), str(folder / "main.c"), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    typed = "\n".join(" ".join(f"{x!r}" for x in row) for row in rows.tolist())
    ran = subprocess.run(
        [str(folder / "main")], input=typed, capture_output=True, text=True, check=True
    )
    return np.array(
        [[float(word) for word in line.split()] for line in ran.stdout.splitlines()]
    )
