"""Written forms brought back to life by what others run them with.

A C header is compiled by the C compiler that is there, a numpy module imported from its
file; a URDF is read by Pinocchio, MJCF by MuJoCo where it is installed and else by
Pinocchio, ROS 2 parameters by a YAML reader.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from seqid_cli.errors import QualityError
from seqid_cli.export.code import identifier
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")
_COMPILE_SECONDS = 120.0
# Python takes some milliseconds for six joints: that is a quarter of a minute a log.
MOST_IN_PYTHON = 4_000


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What a form with a state is stepped with: (N, n) arrays, times (N,) s, period s."""

    q: Array
    dq: Array
    ddq: Array
    time: Array
    temperature: Array | None
    period: float


class WrittenArm(ABC):
    """A written form of an arm of `joints` joints, ready to run."""

    def __init__(
        self, joints: int, *, steps: bool = False, most_samples: int | None = None
    ) -> None:
        self.joints = joints
        # Whether it has more than `rigid` and `friction`, delays of the logged torque
        # included.
        self.steps = steps
        self.most_samples = most_samples  # of a log that are run; None: all

    @abstractmethod
    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""

    @abstractmethod
    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque (N, n) N m."""

    def stepped(self, steps: Steps) -> Array:
        """Return the whole torque (N, n) N m as it is logged, sample by sample.

        Raises
        ------
        NotImplementedError
            The form has no more than `rigid` and `friction`.
        """
        raise NotImplementedError


class UnreadableFormError(QualityError):
    """A written file cannot be run."""


class NoCompilerError(QualityError):
    """There is no C compiler on this machine."""


@contextlib.contextmanager
def read_written(path: Path, kind: str, robot: Robot) -> Iterator[WrittenArm]:
    """Read a written file as its users do; what that needs is gone after the block.

    Parameters
    ----------
    kind : str
        The title of its form.

    Raises
    ------
    UnreadableFormError
        The file does not compile, cannot be imported or parsed, or lacks a joint.
    NoCompilerError
        It is a C header, and there is no C compiler.
    """
    with contextlib.ExitStack() as stack:
        try:
            if kind == "C header":
                folder = stack.enter_context(tempfile.TemporaryDirectory())
                yield CompiledArm(path, robot, Path(folder))
            elif kind == "numpy module":
                yield ImportedArm(path, robot)
            elif kind == "URDF":
                yield UrdfArm(path, robot)
            elif kind.startswith("MJCF"):
                yield _mjcf_arm(path, robot)
            else:
                yield ParameterArm(path, robot)
        except QualityError:
            raise
        except Exception as error:
            # Whatever a reader of the file raises: to its users it is not readable.
            message = f"the written {kind} cannot be run: {error}"
            hint = "Export it again; if it was edited by hand, undo that."
            raise UnreadableFormError(message, where=str(path), hint=hint) from error


_WRAPPER = """
#include "{header}"
#define N {n}
void seqid_rigid(long count, const double *q, const double *dq, const double *ddq, double *tau)
{{
    for (long k = 0; k < count * N; k += N) {name}_rigid_torque(q + k, dq + k, ddq + k, tau + k);
}}
void seqid_friction(long count, const double *q, const double *dq, double *tau)
{{
    for (long k = 0; k < count * N; k += N) {name}_friction_torque(q + k, dq + k, tau + k);
}}
void seqid_total(long count, const double *q, const double *dq, const double *ddq,
    const double *celsius, const double *time, double dt, double *tau)
{{
    static {name}_state s;
    {name}_start(&s, q);
    for (long k = 0; k < count; ++k)
        {name}_step(&s, q + k * N, dq + k * N, ddq + k * N, celsius ? celsius + k * N : 0,
            time[k], dt, tau + k * N);
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
        """Return the whole torque (N, n) N m, sample by sample."""
        q, dq, ddq, time = map(
            np.ascontiguousarray, (steps.q, steps.dq, steps.ddq, steps.time)
        )
        celsius = steps.temperature
        if celsius is not None:
            celsius = np.ascontiguousarray(celsius)
        tau = np.empty_like(q)
        self._library.seqid_total(
            ctypes.c_long(len(q)),
            *map(_pointer, (q, dq, ddq)),
            None if celsius is None else _pointer(celsius),
            _pointer(time),
            ctypes.c_double(steps.period),
            _pointer(tau),
        )
        return tau

    def _run(self, function: str, states: Sequence[Array]) -> Array:
        held = [np.ascontiguousarray(state) for state in states]
        tau = np.empty_like(held[0])
        count = ctypes.c_long(len(tau))
        getattr(self._library, function)(count, *map(_pointer, held), _pointer(tau))
        return tau


def _pointer(values: Array) -> Any:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def compiler() -> str | None:
    """Return the C compiler that is there."""
    return next((found for name in COMPILERS if (found := shutil.which(name))), None)


def _compile(source: Path, library: Path, header: Path) -> None:
    program = compiler()
    if program is None:
        message = f"no C compiler is here ({', '.join(COMPILERS)})"
        hint = "Install one, or export with --no-replay."
        raise NoCompilerError(message, where=str(header), hint=hint)
    command = [program, *_FLAGS, "-o", str(library), str(source), "-lm"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=_COMPILE_SECONDS, check=False
    )
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line]
        first = (lines or done.stderr.splitlines() or ["no message"])[0]
        said = first.replace(str(source.parent), ".")
        hint = "Export it again; if it was edited by hand, undo that."
        raise UnreadableFormError(
            f"does not compile: {said}", where=str(header), hint=hint
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
        """Return the whole torque (N, n) N m, sample by sample."""
        rows = zip(steps.q, steps.dq, steps.ddq, strict=True)
        model = self._module.Model()
        model.start(steps.q[0])
        torques = []
        for k, row in enumerate(rows):
            celsius = None if steps.temperature is None else steps.temperature[k]
            torques.append(
                model.step(*row, steps.period, time=steps.time[k], temperature=celsius)
            )
        return np.array(torques)


def _imported(path: Path) -> ModuleType:
    """Import a module from its path, without leaving compiled files or a name behind."""
    spec = importlib.util.spec_from_file_location("seqid_exported_arm", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


class _FrictionalArm(WrittenArm):
    """A form whose friction is Coulomb and viscous, with an offset where it has one."""

    def __init__(self, joints: int) -> None:
        super().__init__(joints)
        self.coulomb, self.viscous, self.offset = np.zeros((3, joints))

    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque (N, n) N m."""
        return self.coulomb * np.sign(dq) + self.viscous * dq + self.offset


class _PinocchioArm(_FrictionalArm):
    """Links in Pinocchio; joints that are not the arm's are locked at zero."""

    def __init__(self, model: pin.Model, robot: Robot) -> None:
        super().__init__(robot.n)
        names = list(model.names)
        _check_joints(names, robot)
        others = [
            k for k in range(1, model.njoints) if names[k] not in robot.joint_names
        ]
        reduced = pin.buildReducedModel(model, others, pin.neutral(model))
        places = [
            reduced.joints[reduced.getJointId(name)] for name in robot.joint_names
        ]
        self.velocity_at = [place.idx_v for place in places]
        self.springs: list[Array] = [np.zeros(1)] * robot.n
        self.armature = np.zeros(robot.n)
        reduced.gravity.linear = robot.gravity
        self._model, self._data = reduced, reduced.createData()

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        model, data = self._model, self._data
        start, order = pin.neutral(model), self.velocity_at
        model.armature = np.zeros(model.nv)
        tau = np.empty_like(q)
        states = np.zeros((3, model.nv))
        for k, row in enumerate(zip(q, dq, ddq, strict=True)):
            states[:, order] = row
            configuration = pin.integrate(model, start, states[0])
            tau[k] = pin.rnea(model, data, configuration, states[1], states[2])[order]
        tau += self.armature * ddq
        for j, law in enumerate(self.springs):
            tau[:, j] += np.polynomial.Polynomial(law)(q[:, j])
        return tau


class UrdfArm(_PinocchioArm):
    """A URDF: `dynamics` of its joints, and rotors from the transmissions."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(pin.buildModelFromXML(path.read_text(encoding="utf-8")), robot)
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
        joints = {joint.get("name"): joint for joint in root.findall("joint")}
        for j, name in enumerate(robot.joint_names):
            dynamics = joints[name].find("dynamics")
            if dynamics is not None:
                self.coulomb[j] = float(dynamics.get("friction", 0.0))
                self.viscous[j] = float(dynamics.get("damping", 0.0))
        for transmission in root.findall("transmission"):
            moved = [joint.get("name") for joint in transmission.findall("joint")]
            if len(moved) == 1 and moved[0] in robot.joint_names:
                self.armature[robot.joint_names.index(moved[0])] = _reflected(
                    transmission
                )


def _reflected(transmission: ElementTree.Element) -> float:
    """Return the rotor inertia of a transmission as its joint feels it, kg m^2."""
    drake = "{http://drake.mit.edu}"
    rotor = transmission.find(f"actuator/{drake}rotor_inertia")
    ratio = transmission.find(f"actuator/{drake}gear_ratio")
    if rotor is None or ratio is None:
        return 0.0
    return float(rotor.get("value", 0.0)) * float(ratio.get("value", 1.0)) ** 2


def _check_joints(names: Sequence[str], robot: Robot) -> None:
    missing = [name for name in robot.joint_names if name not in names]
    if missing:
        hint = "Export it again; if it was edited by hand, undo that."
        raise UnreadableFormError(f"has no joint {', '.join(missing)}", hint=hint)


def _mjcf_arm(path: Path, robot: Robot) -> WrittenArm:
    """Return MJCF as MuJoCo reads it, or as Pinocchio does where MuJoCo is not installed."""
    if importlib.util.find_spec("mujoco") is not None:
        return MujocoArm(path, robot)
    return PinocchioMjcfArm(path, robot)


class MujocoArm(_FrictionalArm):
    """MJCF in MuJoCo: its inverse dynamics, limits and contacts apart."""

    def __init__(self, path: Path, robot: Robot) -> None:
        import mujoco

        super().__init__(robot.n)
        self._mujoco = mujoco
        model = mujoco.MjModel.from_xml_path(str(path))
        _check_joints([model.joint(k).name for k in range(model.njnt)], robot)
        joints = [model.joint(name) for name in robot.joint_names]
        self._at = [int(joint.dofadr[0]) for joint in joints]
        self._position_at = [int(joint.qposadr[0]) for joint in joints]
        # Later versions give damping as several numbers, by powers of the speed.
        damping = np.asarray(model.dof_damping).reshape(model.nv, -1)
        self.viscous = damping[self._at, 0].copy()
        self.coulomb = np.asarray(model.dof_frictionloss)[self._at].copy()
        model.dof_damping[:] = 0.0
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self._model, self._data = model, mujoco.MjData(model)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        data, tau = self._data, np.empty_like(q)
        for k, (x, v, a) in enumerate(zip(q, dq, ddq, strict=True)):
            data.qpos[self._position_at] = x
            data.qvel[self._at] = v
            data.qacc[self._at] = a
            self._mujoco.mj_inverse(self._model, data)
            tau[k] = data.qfrc_inverse[self._at]
        return tau


class PinocchioMjcfArm(_PinocchioArm):
    """MJCF in Pinocchio, with what Pinocchio leaves out read from the file."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(pin.buildModelFromMJCF(str(path)), robot)
        found = {
            joint.get("name"): joint
            for joint in ElementTree.parse(path).getroot().iter("joint")
        }
        for j, name in enumerate(robot.joint_names):
            joint = found[name]
            self.armature[j] = float(joint.get("armature", 0.0))
            self.viscous[j] = float(joint.get("damping", 0.0))
            self.coulomb[j] = float(joint.get("frictionloss", 0.0))
            stiffness = [float(x) for x in joint.get("stiffness", "0").split()]
            slack = np.polynomial.Polynomial([-float(joint.get("springref", 0.0)), 1.0])
            law = np.polynomial.Polynomial([0.0, *stiffness])(slack)
            self.springs[j] = np.asarray(law.coef, dtype=np.float64)


class ParameterArm(_FrictionalArm):
    """ROS 2 parameters: a body, an armature and friction for each joint."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(robot.n)
        document = _parameters(path.read_text(encoding="utf-8"))
        parameters = document["/**"]["ros__parameters"]
        _check_joints(list(parameters), robot)
        self._robot = robot
        self._phi = np.empty((robot.n, 10))
        self._armature = np.empty(robot.n)
        for j, name in enumerate(robot.joint_names):
            group = parameters[name]
            inertia = np.zeros((3, 3))
            inertia[np.triu_indices(3)] = group["inertia"]
            inertia = inertia + np.triu(inertia, 1).T
            body = pin.Inertia(
                group["mass"], np.array(group["center_of_mass"]), inertia
            )
            self._phi[j] = body.toDynamicParameters()
            self._armature[j] = group["armature"]
            friction = group.get("friction", {})
            self.coulomb[j] = friction.get("coulomb", 0.0)
            self.viscous[j] = friction.get("viscous", 0.0)
            self.offset[j] = friction.get("offset", 0.0)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity and rotors."""
        robot = self._robot
        links = inverse_dynamics(robot.chain, robot.gravity, self._phi, q, dq, ddq)
        return links + self._armature * ddq


def _parameters(text: str) -> dict[str, Any]:
    """Return a ROS 2 parameter file as nested objects.

    It reads the part of YAML that such files are written in: one key a line, deeper
    ones indented, values that are numbers, texts or lists in brackets.
    """
    root: dict[str, Any] = {}
    levels = [(-1, root)]
    for line in text.splitlines():
        stripped = line.split(" #")[0].strip()
        if not stripped or stripped.startswith("#"):
            continue
        indent = len(line) - len(line.lstrip())
        key, _, value = _key_and_value(stripped)
        while levels[-1][0] >= indent:
            levels.pop()
        inside = levels[-1][1]
        if value:
            inside[key] = _value(value)
        else:
            inside[key] = {}
            levels.append((indent, inside[key]))
    return root


def _key_and_value(line: str) -> tuple[str, str, str]:
    """Split a line at the colon behind its key, which may be a quoted name with colons."""
    if line.startswith('"'):
        key, end = json.JSONDecoder().raw_decode(line)
        return key, ":", line[end:].lstrip()[1:].strip()
    key, mark, value = line.partition(":")
    return key, mark, value.strip()


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
