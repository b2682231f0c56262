"""What a model can lack, and how it acts on the simulated arm: by MuJoCo's own means."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tests import Array
from tests.studies.outside.arms import Arm


@dataclass
class State:
    """An arm at a moment: t (s, of the session) and (n,) per joint; `memory` belongs to effects."""

    t: float
    q: Array  # rad
    dq: Array  # rad/s
    load: Array  # N m that the gear passes to the link
    warmth: Array  # K above the cold arm
    memory: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """One thing that the model lacks; every part that is given acts.

    `xml` edits the arm in MuJoCo. At every step `dry` gives the dry friction (n,) from what it
    would be, `push` adds a torque (n,) at the joints, `flange` a force (3,) at the last body, and
    `drive` makes of the torque that is told (n,) the one that acts. `told` changes what is logged
    of the torques (N, n) at times (N,), `angle` what the encoders say of angles (..., n).
    `partner` is the other joint of a pair: either may give the name.
    """

    name: str
    joint: int | None
    xml: Callable[[ET.Element], None] | None = None
    dry: Callable[[Array, State], Array] | None = None
    push: Callable[[State], Array] | None = None
    flange: Callable[[float], Array] | None = None
    drive: Callable[[Array, State], Array] | None = None
    told: Callable[[Array, Array], Array] | None = None
    angle: Callable[[Array], Array] | None = None
    partner: int | None = None


@dataclass(frozen=True)
class Sized:
    """An effect whose size is still open: `make(scale)`, up to the scale `most`."""

    name: str
    joint: int | None
    make: Callable[[float], Effect]
    most: float = 20.0


Draw = Callable[[Arm, int, np.random.Generator], Sized]


def only(arm: Arm, joint: int, value: float) -> Array:
    """A value at one joint, zero at the others: (n,)."""
    found = np.zeros(arm.n)
    found[joint] = value
    return found


def found(root: ET.Element, path: str) -> ET.Element:
    """The element of an MJCF that must be there."""
    element = root.find(path)
    assert element is not None, path
    return element
