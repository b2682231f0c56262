"""What a seed stands for: an arm, its imperfections with their sizes, and how it is
logged.

Sizes are SI units; angles are rad, shares are relative.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tests.studies.outside.arms import Arm, drawn_arm
from tests.studies.outside.plan import RESERVED as RESERVED
from tests.studies.truth.tolerances import TOLERANCES

Sizes = dict[str, Any]
Generator = np.random.Generator
STREAM = 610
HUNTING_COUNTS = 600  # of the encoder, a turn of the joint
MOST_FRICTION = 3.0  # times that of the other study's arms
COARSE_COUNTS = (2000, 4096, 8192)


@dataclass(frozen=True)
class Imperfection:
    """One thing that is not as the model has it; `declared` says that the robot file
    names it.
    """

    kind: str
    sizes: Sizes = field(default_factory=dict)
    declared: bool = False

    @property
    def label(self) -> str:
        return self.kind + ", declared" * self.declared


@dataclass(frozen=True, kw_only=True)
class Case:
    """One arm as it is; `seed` draws its motions and noise."""

    label: str
    seed: int
    arm: Arm
    imperfections: tuple[Imperfection, ...] = ()

    def sizes(self, kind: str) -> Sizes | None:
        """Return the sizes of an imperfection,
        or None where the arm does not have it.
        """
        return next((x.sizes for x in self.imperfections if x.kind == kind), None)

    @property
    def left_out(self) -> int | None:
        """Return the joint that the robot file lacks."""
        sizes = self.sizes("left_out")
        return None if sizes is None else int(sizes["joint"])

    @property
    def joints(self) -> list[int]:
        """Return the joints of the arm that the robot file has."""
        return [j for j in range(self.arm.n) if j != self.left_out]


def _side(rng: Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _joint(arm: Arm, rng: Generator) -> int:
    return int(rng.integers(arm.n))


def _unit(rng: Generator) -> list[float]:
    way = rng.normal(size=3)
    return [float(x) for x in way / np.linalg.norm(way)]


def delay(arm: Arm, rng: Generator) -> Sizes:
    """Torque that is logged late (or 1 ms early), all joints alike but for a small own
    part.
    """
    common = -1e-3 if rng.random() < 0.2 else float(rng.uniform(0.5e-3, 4e-3))
    return {"seconds": [common + float(x) for x in rng.normal(0.0, 0.2e-3, arm.n)]}


def current_filter(arm: Arm, rng: Generator) -> Sizes:
    """The drive's low-pass filter before the current is logged."""
    return {"hertz": float(rng.uniform(20.0, 60.0)), "order": int(rng.integers(1, 3))}


def _at_one_or_all(arm: Arm, rng: Generator) -> list[float]:
    shares = [_side(rng) * float(rng.uniform(0.05, 0.15)) for _ in range(arm.n)]
    if rng.random() < 0.5:
        chosen = _joint(arm, rng)
        shares = [share if j == chosen else 0.0 for j, share in enumerate(shares)]
    return shares


def offset(arm: Arm, rng: Generator) -> Sizes:
    """A current sensor's offset, as shares of each joint's Coulomb friction."""
    return {"shares": _at_one_or_all(arm, rng)}


def asymmetry(arm: Arm, rng: Generator) -> Sizes:
    """Friction that is larger (or smaller) by a share on the way up."""
    return {"shares": _at_one_or_all(arm, rng)}


def warmth(arm: Arm, rng: Generator) -> Sizes:
    """Friction that falls with the temperature, while the joints warm up during the
    session.
    """
    per_kelvin = [-float(x) for x in rng.uniform(0.01, 0.03, arm.n)]
    rise = [float(x) for x in rng.uniform(6.0, 12.0, arm.n)]
    return {"per_kelvin": per_kelvin, "rise": rise, "logged": bool(rng.random() < 0.5)}


def geometry(arm: Arm, rng: Generator) -> Sizes:
    """A URDF whose joints' frames are beside the true ones, and turned."""
    metres, degrees = float(rng.uniform(1e-3, 5e-3)), float(rng.uniform(0.2, 1.0))
    count = len(arm.links)
    places = [[metres * x for x in _unit(rng)] for _ in range(count)]
    turns = [[float(np.radians(degrees)) * x for x in _unit(rng)] for _ in range(count)]
    return {"metres": metres, "degrees": degrees, "places": places, "turns": turns}


def gravity(arm: Arm, rng: Generator) -> Sizes:
    """A base that is off level."""
    return {
        "degrees": float(rng.uniform(0.5, 2.0)),
        "azimuth": float(rng.uniform(0.0, 6.28)),
    }


def zero(arm: Arm, rng: Generator) -> Sizes:
    """One encoder whose zero is not where the robot file has it."""
    return {
        "joint": _joint(arm, rng),
        "radians": _side(rng) * float(rng.uniform(0.05, 0.3)),
    }


def constant(arm: Arm, rng: Generator) -> Sizes:
    """Torque constants that are not those of the robot file."""
    shares = [_side(rng) * float(rng.uniform(0.02, 0.05)) for _ in range(arm.n)]
    return {"shares": shares}


def hunting(arm: Arm, rng: Generator) -> Sizes:
    """A coarse encoder's joint that goes back and forth about its motion while that is
    slow.
    """
    counts, hertz = float(rng.uniform(1.0, 2.0)), float(rng.uniform(1.5, 4.0))
    return {"joint": _joint(arm, rng), "counts": counts, "hertz": hertz}


def noisy_velocity(arm: Arm, rng: Generator) -> Sizes:
    """A velocity channel with noise, of joints that stand as well."""
    return {"rad_s": float(rng.uniform(0.005, 0.05))}


def second_publisher(arm: Arm, rng: Generator) -> Sizes:
    """Zeros that another program publishes on the same topic."""
    return {"hertz": float(rng.choice([10.0, 50.0]))}


def left_out(arm: Arm, rng: Generator) -> Sizes:
    """A joint of the chain that the robot file lacks: it stands somewhere, or moves as
    well.
    """
    moves = bool(rng.random() < 0.5)
    angle = 0.0 if moves else _side(rng) * float(rng.uniform(0.3, 1.0))
    return {"joint": _joint(arm, rng), "moves": moves, "radians": angle}


def tool(arm: Arm, rng: Generator) -> Sizes:
    """A tool at the last link in one of the three inertia logs."""
    return {"share": float(rng.uniform(0.05, 0.2)), "log": int(rng.integers(3))}


def coloured(arm: Arm, rng: Generator) -> Sizes:
    """Torque noise a part of which is 1/f, as shares of the variance."""
    return {"share": float(rng.uniform(0.3, 0.8))}


Draw = Callable[[Arm, Generator], Sizes]
KINDS: Mapping[str, Draw] = {
    "delay": delay,
    "filter": current_filter,
    "offset": offset,
    "asymmetry": asymmetry,
    "warmth": warmth,
    "geometry": geometry,
    "gravity": gravity,
    "zero": zero,
    "constant": constant,
    "hunting": hunting,
    "noisy_velocity": noisy_velocity,
    "second_publisher": second_publisher,
    "left_out": left_out,
    "tool": tool,
    "coloured": coloured,
}
CLEAN = "clean"  # stands for no imperfection among the kinds that a user names


def kinds_of(
    seed: int, kinds: Sequence[str] = (), *, alone: bool = False
) -> tuple[str, ...]:
    """Return a seed's imperfections: of ten seeds three are clean, three have one, four
    three.

    Parameters
    ----------
    seed : int
        Seeds in a row go through the kinds in turn.
    kinds : sequence of str
        Those to draw from; all where none is named. `CLEAN` is none.
    alone : bool
        Every seed has one.
    """
    pool = list(kinds or KINDS)
    first = pool[seed % len(pool)]
    if alone:
        return () if first == CLEAN else (first,)
    rng = np.random.default_rng([STREAM, seed, 1])
    pool = [kind for kind in pool if kind != CLEAN]
    count = min((0, 1, 3, 0, 3, 1, 3, 0, 1, 3)[seed % 10], len(pool))
    # Every seed that has any begins with the next kind, so that all of them come
    # equally often.
    turn = seed - 3 * (seed // 10)
    first = pool[turn % len(pool)] if pool else CLEAN
    rest = [str(x) for x in rng.permutation([kind for kind in pool if kind != first])]
    return tuple([first, *rest][:count])


def drawn(seed: int, kinds: Sequence[str] = (), *, alone: bool = False) -> Case:
    """Draw a case: the arm of a seed is the same with any imperfections of those it can
    have.
    """
    chosen = kinds_of(seed, kinds, alone=alone)
    rng = np.random.default_rng([STREAM, seed, 2])
    n = 6 if seed % 12 == 11 else int(rng.choice([1, 2, 2, 2, 3]))
    imus = bool(rng.random() < 0.4) and n < 4
    coarse, counts = bool(rng.random() < 0.3), float(rng.choice(COARSE_COUNTS))
    if "left_out" in chosen:
        n, imus = max(n, 2), False
    label = "ur5" if n == 6 and rng.random() < 0.5 else "drawn"
    arm = rubbing(
        drawn_arm(rng, label, n, imus), float(rng.uniform(1.0, MOST_FRICTION))
    )
    if coarse:
        step = 2.0 * np.pi / counts
        arm = replace(
            arm, drives=tuple(replace(drive, count=step) for drive in arm.drives)
        )

    imperfections = []
    for number, kind in enumerate(chosen):
        sizes = KINDS[kind](arm, np.random.default_rng([STREAM, seed, 3, number]))
        declared = kind in TOLERANCES and bool(rng.random() < 0.5)
        imperfections.append(Imperfection(kind, sizes, declared))
    label = ":".join([str(seed), "+".join(x.label for x in imperfections) or CLEAN])
    return Case(
        label=label,
        seed=seed,
        arm=fitted(arm, imperfections),
        imperfections=tuple(imperfections),
    )


LEAST_FRICTION = 0.02  # of that of the joint that rubs most, Coulomb and viscous
LEAST_ROTOR = 0.002  # of the heaviest rotor's inertia at its joint


def rubbing(arm: Arm, times: float) -> Arm:
    """Return the arm with more friction: strain wave gears rub by a quarter of the
    weight.

    The other study scales friction and rotors by the weight that a joint carries, which
    is nothing at a last joint whose link is balanced. No gear is without friction, and
    no motor without rotor.
    """
    most_coulomb, most_viscous, most_rotor = (
        float(arm.of(name).max()) for name in ("coulomb", "viscous", "rotor")
    )
    drives = [
        replace(
            x,
            coulomb=times * max(x.coulomb, LEAST_FRICTION * most_coulomb),
            viscous=times * max(x.viscous, LEAST_FRICTION * most_viscous),
            rotor=max(x.rotor, LEAST_ROTOR * most_rotor),
        )
        for x in arm.drives
    ]
    return replace(arm, drives=tuple(drives))


def fitted(arm: Arm, imperfections: Sequence[Imperfection]) -> Arm:
    """Return the arm with what imperfections say of its drives and its logging."""
    sizes = {x.kind: x.sizes for x in imperfections}
    drives = list(arm.drives)
    if hunts := sizes.get("hunting"):
        joint = hunts["joint"]
        drives[joint] = replace(drives[joint], count=2.0 * np.pi / HUNTING_COUNTS)
    if heat := sizes.get("warmth"):
        drives = [
            replace(drive, rise=rise, warm_s=250.0)
            for drive, rise in zip(drives, heat["rise"], strict=True)
        ]
        arm = replace(arm, temperatures=heat["logged"])
    return replace(arm, drives=tuple(drives))
