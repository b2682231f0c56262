"""What a written form of an arm says, whatever runs it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

EDITED_HINT = "Export it again; if it was edited by hand, undo that."


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What a form with a state is stepped with.

    Attributes
    ----------
    q, dq, ddq : (N, n) array
        Positions [rad], velocities [rad/s], accelerations [rad/s^2].
    time : (N,) array
        Time on the clock of the effects' session [s].
    temperature : (N, n) array or None
        Temperatures of the joints [degC], where they were logged.
    period : float
        Time from sample to sample [s].
    """

    q: Array
    dq: Array
    ddq: Array
    time: Array
    temperature: Array | None
    period: float


class WrittenArm(ABC):
    """A written form of an arm, ready to run.

    Parameters
    ----------
    joints : int
        How many joints the arm has.
    steps : bool
        Whether the form says more than `rigid` and `friction`, delays of the logged
        torque included.
    most_samples : int, optional
        How many samples of a log are run; all of them by default.
    """

    def __init__(
        self, joints: int, *, steps: bool = False, most_samples: int | None = None
    ) -> None:
        self.joints = joints
        self.steps = steps
        self.most_samples = most_samples

    @abstractmethod
    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque of links, gravity, rotors and springs.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Positions [rad], velocities [rad/s], accelerations [rad/s^2] (m where
            prismatic).

        Returns
        -------
        (N, n) array
            N m (N where prismatic), not filtered.
        """

    @abstractmethod
    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque.

        Parameters
        ----------
        q, dq : (N, n) array
            Positions [rad] and velocities [rad/s] (m where prismatic).

        Returns
        -------
        (N, n) array
            N m (N where prismatic), not filtered.
        """

    def stepped(self, steps: Steps) -> Array:
        """Return the whole torque (N, n) N m as it is logged, sample by sample.

        Raises
        ------
        NotImplementedError
            The form has no more than `rigid` and `friction`.
        """
        raise NotImplementedError


class FrictionalArm(WrittenArm):
    """A form whose friction is Coulomb and viscous, with an offset where it has one."""

    def __init__(self, joints: int) -> None:
        super().__init__(joints)
        self.coulomb = np.zeros(joints)
        self.viscous = np.zeros(joints)
        self.offset = np.zeros(joints)

    def friction(self, q: Array, dq: Array) -> Array:
        """Return the friction torque (N, n) N m."""
        return self.coulomb * np.sign(dq) + self.viscous * dq + self.offset


class UnreadableFormError(QualityError):
    """A written file cannot be run."""


def check_joints(names: Sequence[str], robot: Robot) -> None:
    """Raise UnreadableFormError if a form lacks a joint of the robot."""
    missing = [name for name in robot.joint_names if name not in names]
    if missing:
        raise UnreadableFormError(
            f"has no joint {', '.join(missing)}", hint=EDITED_HINT
        )
