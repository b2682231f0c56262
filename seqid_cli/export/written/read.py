"""Written forms brought back to life by what others run them with.

A C header is compiled by the C compiler that is there, a numpy module imported from its
file; a URDF is read by Pinocchio, MJCF by MuJoCo where it is installed and else by
Pinocchio, ROS 2 parameters by a YAML reader.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from seqid_cli.errors import QualityError
from seqid_cli.export.written.arm import EDITED_HINT, UnreadableFormError, WrittenArm
from seqid_cli.export.written.code import CompiledArm, ImportedArm
from seqid_cli.export.written.model_files import UrdfArm, mjcf_arm
from seqid_cli.export.written.parameters import ParameterArm
from seqid_cli.robot.types import Robot


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
                yield mjcf_arm(path, robot)
            else:
                yield ParameterArm(path, robot)
        except QualityError:
            raise
        except Exception as error:
            # Whatever a reader of the file raises: to its users it is not readable.
            message = f"the written {kind} cannot be run: {error}"
            raise UnreadableFormError(
                message, where=str(path), hint=EDITED_HINT
            ) from error
