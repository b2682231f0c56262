"""Code of an arm at work: a C header is compiled, a numpy module imported."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.export.code import identifier
from seqid_cli.export.written.arm import (
    EDITED_HINT,
    Steps,
    UnreadableFormError,
    WrittenArm,
)
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")
_COMPILE_SECONDS = 120.0
# Python takes some milliseconds for six joints: that is a quarter of a minute a log.
MOST_IN_PYTHON = 4_000


class NoCompilerError(QualityError):
    """There is no C compiler on this machine."""


_WRAPPER = """
#include "{header}"
#define N {n}
void seqid_rigid(long count, const double *q, const double *dq, const double *ddq,
    double *tau)
{{
    for (long k = 0; k < count * N; k += N)
        {name}_rigid_torque(q + k, dq + k, ddq + k, tau + k);
}}
void seqid_friction(long count, const double *q, const double *dq, double *tau)
{{
    for (long k = 0; k < count * N; k += N)
        {name}_friction_torque(q + k, dq + k, tau + k);
}}
void seqid_total(long count, const double *q, const double *dq, const double *ddq,
    const double *celsius, const double *time, double dt, double *tau)
{{
    static {name}_state s;
    {name}_start(&s, q);
    for (long k = 0; k < count; ++k)
        {name}_step(&s, q + k * N, dq + k * N, ddq + k * N,
            celsius ? celsius + k * N : 0, time[k], dt, tau + k * N);
}}
"""


class CompiledArm(WrittenArm):
    """A C header, compiled into a shared object in a temporary folder."""

    def __init__(self, path: Path, robot: Robot, folder: Path) -> None:
        name = identifier(robot.name)
        super().__init__(robot.n, steps=True)
        shutil.copy(path, folder / "arm.h")
        source = _WRAPPER.format(header="arm.h", name=name, n=robot.n)
        (folder / "arm.c").write_text(source, encoding="utf-8")
        library = folder / "arm.so"
        _compile(folder / "arm.c", library, path)
        self._library = ctypes.CDLL(str(library))

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        return self._run("seqid_rigid", [q, dq, ddq])

    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque (N, n) N m."""
        return self._run("seqid_friction", [q, dq])

    def stepped(self, steps: Steps) -> Array:
        """Return the whole torque (N, n) N m as it is logged, sample by sample."""
        q = np.ascontiguousarray(steps.q)
        dq = np.ascontiguousarray(steps.dq)
        ddq = np.ascontiguousarray(steps.ddq)
        time = np.ascontiguousarray(steps.time)
        celsius = None
        if steps.temperature is not None:
            celsius = np.ascontiguousarray(steps.temperature)

        tau = np.empty_like(q)
        self._library.seqid_total(
            ctypes.c_long(len(q)),
            _pointer(q),
            _pointer(dq),
            _pointer(ddq),
            None if celsius is None else _pointer(celsius),
            _pointer(time),
            ctypes.c_double(steps.period),
            _pointer(tau),
        )
        return tau

    def _run(self, function: str, states: Sequence[Array]) -> Array:
        """Call a function of states (N, n) that fills in a torque (N, n)."""
        # They are named, so that they live as long as the call takes.
        contiguous = [np.ascontiguousarray(state) for state in states]
        tau = np.empty_like(contiguous[0])
        pointers = [_pointer(values) for values in (*contiguous, tau)]
        getattr(self._library, function)(ctypes.c_long(len(tau)), *pointers)
        return tau


def _pointer(values: Array) -> Any:
    """Return where the numbers of a contiguous array begin."""
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def compiler() -> str | None:
    """Return the path of the C compiler that is there, or None."""
    for name in COMPILERS:
        path = shutil.which(name)
        if path is not None:
            return path
    return None


def _compile(source: Path, library: Path, header: Path) -> None:
    """Compile a source that includes a header into a shared library.

    Raises
    ------
    UnreadableFormError
        The header does not compile.
    NoCompilerError
        There is no C compiler.
    """
    program = compiler()
    if program is None:
        message = f"no C compiler is here ({', '.join(COMPILERS)})"
        hint = "Install one, or export with --no-replay."
        raise NoCompilerError(message, where=str(header), hint=hint)
    command = [program, *_FLAGS, "-o", str(library), str(source), "-lm"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=_COMPILE_SECONDS, check=False
    )
    if done.returncode == 0:
        return

    lines = done.stderr.splitlines()
    errors = [line for line in lines if "error" in line]
    first_line = (errors or lines or ["no message"])[0]
    reason = first_line.replace(str(source.parent), ".")
    raise UnreadableFormError(
        f"does not compile: {reason}", where=str(header), hint=EDITED_HINT
    )


class ImportedArm(WrittenArm):
    """A numpy module, imported from its file."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(robot.n, steps=True, most_samples=MOST_IN_PYTHON)
        self._module = _imported(path)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        rows = zip(q, dq, ddq, strict=True)
        return np.array([self._module.rigid_torque(*row) for row in rows])

    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque (N, n) N m."""
        rows = zip(q, dq, strict=True)
        return np.array([self._module.friction_torque(*row) for row in rows])

    def stepped(self, steps: Steps) -> Array:
        """Return the whole torque (N, n) N m as it is logged, sample by sample."""
        model = self._module.Model()
        model.start(steps.q[0])
        tau = np.empty_like(steps.q)
        for k in range(len(tau)):
            tau[k] = model.step(
                steps.q[k],
                steps.dq[k],
                steps.ddq[k],
                steps.period,
                time=steps.time[k],
                temperature=None if steps.temperature is None else steps.temperature[k],
            )
        return tau


def _imported(path: Path) -> ModuleType:
    """Import a module from its path; no compiled file and no name is left behind."""
    spec = importlib.util.spec_from_file_location("seqid_exported_arm", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    writes_none = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = writes_none
    return module
