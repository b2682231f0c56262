"""One two-joint arm with a fine encoder, one imperfection at a time, of the same sizes
always.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tests.studies.outside.arms import drawn_arm
from tests.studies.truth.plan import STREAM, Case, Imperfection, fitted, rubbing

SPEED = 4.0  # rad/s, limit of both joints
COUNTS = 2**18  # of the fine encoder, a turn of the joint
GEOMETRY = Imperfection(
    "geometry",
    {
        "metres": 5e-3,
        "degrees": 1.0,
        "places": [[0.0, 3e-3, 4e-3], [3e-3, 0.0, 4e-3]],
        "turns": [[0.0, 0.0105, 0.0140], [0.0105, 0.0140, 0.0]],
    },
)
GRAVITY = Imperfection("gravity", {"degrees": 2.0, "azimuth": 0.6})
ZERO = Imperfection("zero", {"joint": 1, "radians": 0.1})
ROWS: Mapping[str, tuple[Imperfection, ...]] = {
    "none": (),
    "early 1 ms": (Imperfection("delay", {"seconds": [-1e-3, -1e-3]}),),
    "late 2 ms": (Imperfection("delay", {"seconds": [2e-3, 2e-3]}),),
    "filter 30 Hz": (Imperfection("filter", {"hertz": 30.0, "order": 1}),),
    "offset 10 %": (Imperfection("offset", {"shares": [0.1, 0.1]}),),
    "asymmetry 10 %": (Imperfection("asymmetry", {"shares": [0.1, 0.1]}),),
    "warmth -2.5 %/K": (
        Imperfection(
            "warmth", {"per_kelvin": [-0.025] * 2, "rise": [6.0] * 2, "logged": True}
        ),
    ),
    "warmth -2.5 %/K, not logged": (
        Imperfection(
            "warmth", {"per_kelvin": [-0.025] * 2, "rise": [6.0] * 2, "logged": False}
        ),
    ),
    "geometry 5 mm, 1 deg": (GEOMETRY,),
    "geometry 5 mm, 1 deg, declared": (replace(GEOMETRY, declared=True),),
    "gravity 2 deg": (GRAVITY,),
    "gravity 2 deg, declared": (replace(GRAVITY, declared=True),),
    "zero 0.1 rad": (ZERO,),
    "zero 0.1 rad, declared": (replace(ZERO, declared=True),),
    "constant 5 %": (Imperfection("constant", {"shares": [0.05, -0.05]}),),
    "constant 5 %, declared": (
        Imperfection("constant", {"shares": [0.05, -0.05]}, declared=True),
    ),
    "hunting, 600 counts": (
        Imperfection("hunting", {"joint": 0, "counts": 1.5, "hertz": 3.0}),
    ),
    "noisy velocity": (Imperfection("noisy_velocity", {"rad_s": 0.02}),),
    "second publisher": (Imperfection("second_publisher", {"hertz": 50.0}),),
    "left out, standing": (
        Imperfection("left_out", {"joint": 1, "moves": False, "radians": 0.6}),
    ),
    "left out, moving": (
        Imperfection("left_out", {"joint": 1, "moves": True, "radians": 0.0}),
    ),
    "tool 10 %": (Imperfection("tool", {"share": 0.1, "log": 1}),),
    "coloured noise": (Imperfection("coloured", {"share": 0.5}),),
}


def fixed_case(name: str, seed: int = 0) -> Case:
    """Return a row's case; another seed has other motions and noise on the same arm."""
    arm = drawn_arm(np.random.default_rng([STREAM, 4]), "drawn", 2, imus=False)
    # Two parallel axes across gravity, as fast as small arms are: inertia shows well.
    across = np.array([0.0, 1.0, 0.0])
    links = tuple(replace(link, axis=across, speed=SPEED) for link in arm.links)
    step = 2.0 * np.pi / COUNTS
    drives = tuple(replace(drive, count=step) for drive in arm.drives)
    arm = rubbing(replace(arm, links=links, drives=drives), 2.0)
    arm = replace(arm, rate_hz=250.0, noise=0.05, currents=True)
    items = ROWS[name]
    return Case(
        label=f"fixed {seed}:{name}",
        seed=seed,
        arm=fitted(arm, items),
        imperfections=items,
    )
