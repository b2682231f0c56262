"""ROS 2 parameters of an arm at work, read by a reader of the YAML they are in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from seqid_cli.export.written.arm import FrictionalArm, check_joints
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class ParameterArm(FrictionalArm):
    """ROS 2 parameters: a body, an armature and friction for each joint."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(robot.n)
        document = _parameters(path.read_text(encoding="utf-8"))
        parameters = document["/**"]["ros__parameters"]
        check_joints(list(parameters), robot)
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
    """Split a line at the colon behind its key.

    The key may be a quoted name with colons.
    """
    if line.startswith('"'):
        key, end = json.JSONDecoder().raw_decode(line)
        return key, ":", line[end:].lstrip()[1:].strip()
    key, mark, value = line.partition(":")
    return key, mark, value.strip()


def _value(text: str) -> Any:
    """Return a number, a quoted text or a list; what is none of them as it stands."""
    try:
        return json.loads(text)
    except ValueError:
        return text
