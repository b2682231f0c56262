"""A load at the flange in the words of robot controllers.

It comes from the result of `seqid payload`, or from the payload effect of a refined
file, as the nearest body that can exist. `payload.result` says what the words are.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seqid_cli.effects.fitted import FittedEffect, fitted_effects
from seqid_cli.errors import ConfigError
from seqid_cli.params.io import Document, Source, check_robot, read_any
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.types import Robot

# Of each form: the key under which a result of `seqid payload` has it.
_SETTING_KEYS = {"UR payload": "urscript", "Franka load": "libfranka"}


def read_load(paths: Sequence[Path]) -> Source[Document]:
    """Read the one file that says what the robot carries.

    Raises
    ------
    ConfigError
        There is more than one, or it is neither a payload result nor a parameter file.
    """
    sources = read_any(paths)
    kinds = (PayloadFile, ParameterFile)
    if len(sources) != 1 or not isinstance(sources[0].content, kinds):
        raise ConfigError(
            "a load comes from one file: of seqid payload, or a refined parameter file",
            where=", ".join(str(path) for path in paths),
            hint="Run seqid payload on logs with the load, and give its result.",
        )
    return sources[0]


def load_setting(source: Source[Document], robot: Robot, kind: str) -> str:
    """Return the line with which a controller is told of a load.

    Parameters
    ----------
    source : Source
        The result of `seqid payload`, or a refined parameter file.
    robot : Robot
        The robot that carries the load.
    kind : str
        The title of the form.

    Raises
    ------
    ConfigError
        The file knows of no load, or its logs do not determine mass and centre of mass.
    """
    content = source.content
    if isinstance(content, PayloadFile):
        check_robot(content, robot, where=source.path)
        settings = content.settings
    else:
        assert isinstance(content, ParameterFile)
        check_robot(content, robot, where=source.path)
        settings = _settings_of_effects(content, robot, source.path)

    key = _SETTING_KEYS[kind]
    if key not in settings:
        raise ConfigError(
            "mass and centre of mass of the load are not determined",
            where=source.path,
            hint="Record moves with the load in more poses, and run seqid payload.",
        )
    return settings[key] + "\n"


def _settings_of_effects(
    file: ParameterFile, robot: Robot, where: str
) -> dict[str, str]:
    """Return the settings of the payloads that a refined file found, all together."""
    from seqid_cli.payload.body import nearest_to
    from seqid_cli.payload.controllers import settings_of

    payloads = [
        item
        for item in fitted_effects(file.stages, robot)
        if isinstance(item, FittedEffect) and item.effect.name == "payload"
    ]
    if not payloads:
        raise ConfigError(
            "the file holds no payload effect",
            where=where,
            hint="Run seqid payload on logs with the load, and give its result.",
        )

    phi = np.sum([item.coefficients for item in payloads], axis=0)
    covariance = np.sum([item.covariance for item in payloads], axis=0)
    if phi[0] <= 0.0:
        # No body has such a mass, so that there is nothing to tell the controller.
        return {}

    body = nearest_to(phi, covariance)
    return settings_of(body.mass, body.center, body.inertia.tolist())
