"""Planned moves against the floor, by forward kinematics of the study's own.

Arms are drawn anew, with shapes on their links or without, and published ones are taken
as their URDFs have them, whose meshes are not there. Each gets moves planned, and the
tables that a controller would play are read back. The height of the lowest point is
computed from the URDF's text alone: with every joint's placement (R_k, p_k) and axis
a_k in its parent

    T_k = T_{k-1} (R_k, p_k) exp(a_k q_k),

a cylinder of radius r and half length h along the unit vector d through c reaches down
to u'c - h |u'd| - r sqrt(1 - (u'd)^2), a ball to u'c - r, with u the way up.
"""

import csv
import itertools
import json
import tempfile
import warnings
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.plan.functions import plan
from seqid_cli.plan.options import PlanOptions, What
from tests import Array
from tests.studies.outside.arms import PUBLISHED
from tests.studies.records import results
from tests.studies.tables import number, table

ARMS = 200
SEED = 6500
# A short session: what is drawn, refined and checked is the same as in a long one.
OPTIONS = PlanOptions(duration_s=8.0, move_s=4.0, pool=20, sweeps=1, seed=SEED)
# Sweeps of single joints cost most: of drawn arms every so many get them.
FRICTION_EVERY = 5
GRAVITY_EVERY = 20
RATE_HZ = 200.0  # at which the tables are looked at, along straight lines
WAY_POINTS = 50  # on the straight way from the end of a move to the next one's start

# KUKA LBR iiwa 14 R820: places (m) and turns (rad) of the joints as the URDFs derived
# from the manufacturer's model have them, limits (degrees) of its data sheet.
_Q = 1.5707963267948966
IIWA = (
    ((0.0, 0.0, 0.1575), (0.0, 0.0, 0.0), 170.0),
    ((0.0, 0.0, 0.2025), (_Q, 0.0, 2.0 * _Q), 120.0),
    ((0.0, 0.2045, 0.0), (_Q, 0.0, 2.0 * _Q), 170.0),
    ((0.0, 0.0, 0.2155), (_Q, 0.0, 0.0), 120.0),
    ((0.0, 0.1845, 0.0), (_Q, 0.0, 2.0 * _Q), 170.0),
    ((0.0, 0.0, 0.2155), (_Q, 0.0, 0.0), 120.0),
    ((0.0, 0.081, 0.0), (_Q, 0.0, 2.0 * _Q), 175.0),
)


@dataclass(frozen=True)
class Planned:
    """What a session of one arm came to; heights in m over the base plane.

    `refused` is why there is no plan. `free` is the lowest point of the plan without a
    floor, looked at for published arms; `way` that of straight ways between the moves
    of the plan with one.
    """

    moves: int = 0
    lowest: float | None = None
    free: float | None = None
    way: float | None = None
    refused: str = ""


def study(chosen: Namespace) -> str:
    """Return a table of drawn and published arms."""
    cases = {f"drawn {seed}": f"drawn {seed}" for seed in range(ARMS)}
    names = ["iiwa14", *json.loads(PUBLISHED.read_text(encoding="utf-8"))["arms"]]
    cases |= {name: name for name in names}
    path = chosen.cache / "floor.jsonl"
    found = results(
        cases,
        planned,
        Planned,
        path,
        processes=chosen.processes,
        told=lambda x: x.refused or x.lowest,
    )
    rows = []
    for shapes, kind in ((True, "with shapes"), (False, "without shapes")):
        seeds = [seed for seed in range(ARMS) if has_shapes(seed) == shapes]
        drawn = [found[f"drawn {s}"] for s in seeds if f"drawn {s}" in found]
        rows.append(_row(f"{len(drawn)} drawn arms {kind}", drawn))
    rows += [_row(name, [found[name]]) for name in names if name in found]
    header = [
        "arms",
        "moves",
        "lowest point, m",
        "arms below the plane",
        "lowest without a floor, m",
        "on straight ways between moves, m",
        "refused",
    ]
    return table(header, rows)


def _row(name: str, arms: Sequence[Planned]) -> list[str]:
    """Return the row of some arms."""
    with_plan = [arm for arm in arms if not arm.refused]
    cells = []
    for quantity in ("lowest", "free", "way"):
        heights = [getattr(arm, quantity) for arm in with_plan]
        least = min((x for x in heights if x is not None), default=np.nan)
        cells.append(number(least, 3))
    below = sum(arm.lowest is not None and arm.lowest < 0.0 for arm in with_plan)
    return [
        name,
        str(sum(arm.moves for arm in with_plan)),
        cells[0],
        str(below),
        cells[1],
        cells[2],
        str(len(arms) - len(with_plan)),
    ]


def has_shapes(seed: int) -> bool:
    """Return whether the links of a drawn arm have collision shapes."""
    return seed % 2 == 0


def stages_of(case: str) -> tuple[What, ...]:
    """Return for which stages an arm gets a plan."""
    kind, _, seed = case.partition(" ")
    stages: list[What] = []
    # Of two arms one has shapes: both get them.
    if kind != "drawn" or int(seed) // 2 % FRICTION_EVERY == 0:
        stages.append("friction")
    if kind != "drawn" or int(seed) // 2 % GRAVITY_EVERY == 0:
        stages.append("gravity")
    return (*stages, "inertia", "validation")


def planned(case: str) -> Planned:
    """Plan a session for an arm, and measure its moves and the ways between them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kind, _, seed = case.partition(" ")
        text = drawn_urdf(int(seed)) if kind == "drawn" else published_urdf(case)
        (folder / "arm.urdf").write_text(text)
        arm = OwnArm.of(text)
        joints = "".join(f'[[joint]]\nname = "{joint}"\n' for joint in arm.names)
        head = 'schema = "seqid/robot@1"\nname = "arm"\nurdf = "arm.urdf"\n'
        (folder / "robot.toml").write_text(
            f"{head}gravity = [0.0, 0.0, -9.81]\n{joints}"
        )

        try:
            tables = _session(folder, case, arm, OPTIONS)
            free = []
            if kind != "drawn":
                free = _session(folder, case, arm, replace(OPTIONS, floor=False))
        except SeqidError as error:
            return Planned(refused=error.message)

    ways = [
        np.linspace(before[-1], after[0], WAY_POINTS)
        for before, after in itertools.pairwise(tables)
    ]
    return Planned(
        moves=len(tables),
        lowest=_lowest(arm, tables),
        free=_lowest(arm, free),
        way=_lowest(arm, ways),
    )


def _session(
    folder: Path, case: str, arm: "OwnArm", options: PlanOptions
) -> list[Array]:
    """Plan the stages of an arm, and return the positions of all moves in order."""
    tables = []
    for what in stages_of(case):
        target = folder / f"{what}_{options.floor}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = plan(
                what, folder / "robot.toml", options=options, trajectories=target
            )
        tables += [played(target / move.file, arm) for move in file.moves]
    return tables


def _lowest(arm: "OwnArm", motions: Sequence[Array]) -> float | None:
    """Return the height [m] of the lowest point of some motions (N, n)."""
    return min((float(arm.lowest(q).min()) for q in motions), default=None)


def played(path: Path, arm: "OwnArm") -> Array:
    """Return the positions (N, n) of a table, on straight lines between its rows."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    t = np.array([float(row["time"]) for row in rows])
    grid = np.union1d(t, np.arange(t[0], t[-1], 1.0 / RATE_HZ))
    columns = [
        np.interp(grid, t, [float(row[f"position_{name}"]) for row in rows])
        for name in arm.names
    ]
    return np.column_stack(columns)


# ---- kinematics of the study's own


@dataclass(frozen=True)
class Solid:
    """A ball or a cylinder along `axis`, in the frame of a link, or a mere point."""

    centre: Array
    radius: float = 0.0
    half_length: float = 0.0
    axis: Array | None = None


@dataclass(frozen=True)
class OwnArm:
    """A serial chain as its URDF has it: joints in order, solids of each link."""

    names: tuple[str, ...]
    turns: tuple[Array, ...]
    places: tuple[Array, ...]
    axes: tuple[Array, ...]
    solids: tuple[tuple[Solid, ...], ...]

    @classmethod
    def of(cls, text: str) -> "OwnArm":
        """Read a URDF of one chain; its last link may carry a fixed frame."""
        root = ElementTree.fromstring(text)
        links = {each.get("name"): each for each in root.findall("link")}
        joints = {
            each.find("parent").get("link"): each for each in root.findall("joint")
        }
        children = {each.find("child").get("link") for each in root.findall("joint")}
        (link,) = set(links) - children
        names, turns, places, axes, solids = [], [], [], [], []
        while link in joints:
            joint = joints[link]
            link = joint.find("child").get("link")
            turn, place = _origin(joint)
            if joint.get("type") == "fixed":
                solids[-1].append(Solid(centre=place))
                continue
            names.append(joint.get("name"))
            turns.append(turn)
            places.append(place)
            axes.append(_numbers(joint.find("axis").get("xyz")))
            own = [Solid(centre=np.zeros(3))]
            own += [
                _solid(each)
                for each in links[link].findall("collision")
                if each.find("geometry/mesh") is None
            ]
            solids.append(own)
        return cls(
            tuple(names),
            tuple(turns),
            tuple(places),
            tuple(axes),
            tuple(map(tuple, solids)),
        )

    def lowest(self, q: Array) -> Array:
        """Return the height (N,) [m] of the lowest point at postures q (N, n).

        The first joint's own origin stands where it stands and does not count.
        """
        count = len(q)
        R = np.broadcast_to(np.eye(3), (count, 3, 3))
        p = np.zeros((count, 3))
        lowest = np.full(count, np.inf)
        for k in range(len(self.names)):
            p = p + R @ self.places[k]
            R = R @ self.turns[k] @ rotation(self.axes[k], q[:, k])
            for solid in self.solids[k]:
                if k == 0 and not solid.centre.any() and solid.radius == 0.0:
                    continue
                height = (p + R @ solid.centre)[:, 2]
                if solid.axis is not None:
                    up = (R @ solid.axis)[:, 2]
                    height = height - solid.half_length * np.abs(up)
                    across = np.sqrt(np.clip(1.0 - up**2, 0.0, None))
                    height = height - solid.radius * across
                else:
                    height = height - solid.radius
                lowest = np.minimum(lowest, height)
        return lowest


def rotation(axis: Array, angle: Array) -> Array:
    """Return rotations (N, 3, 3) about an axis by angles (N,) [rad] (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine = np.sin(angle)[:, None, None]
    cosine = np.cos(angle)[:, None, None]
    return np.eye(3) + sine * K + (1.0 - cosine) * (K @ K)


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    """Return rotation and place of the <origin> of an element."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"))
    turn = np.eye(3)
    for axis, angle in zip(np.eye(3)[::-1], (yaw, pitch, roll), strict=True):
        turn = turn @ rotation(axis, np.array([angle]))[0]
    return turn, _numbers(origin.get("xyz", "0 0 0"))


def _solid(collision: ElementTree.Element) -> Solid:
    """Return the solid of a <collision> with a sphere or a cylinder."""
    turn, place = _origin(collision)
    sphere = collision.find("geometry/sphere")
    if sphere is not None:
        return Solid(centre=place, radius=float(sphere.get("radius")))
    cylinder = collision.find("geometry/cylinder")
    return Solid(
        centre=place,
        radius=float(cylinder.get("radius")),
        half_length=0.5 * float(cylinder.get("length")),
        axis=turn[:, 2],
    )


# ---- arms


def drawn_urdf(seed: int) -> str:
    """Return a drawn arm: three to seven joints, drawn axes, lengths, limits."""
    rng = np.random.default_rng([SEED, seed])
    n = int(rng.integers(3, 8))
    size = float(rng.uniform(0.3, 1.2))
    lengths = size * rng.uniform(0.2, 1.0, n) / np.sqrt(n)
    parts = ['<robot name="drawn"><link name="base"/>']
    place = np.array([0.0, 0.0, rng.uniform(0.1, 0.5)])
    for k in range(n):
        axis = np.eye(3)[2 if k == 0 and rng.random() < 0.7 else rng.integers(0, 3)]
        middle = float(rng.uniform(-0.5, 0.5))
        reach = float(rng.uniform(1.2, 3.0))
        parts.append(
            _link_text(k, float(lengths[k]), rng, shapes=has_shapes(seed))
            + _joint_text(
                k,
                place,
                rng.uniform(-0.6, 0.6, 3) if k else np.zeros(3),
                axis,
                (middle - reach, middle + reach),
            )
        )
        place = np.array([*rng.uniform(-0.05, 0.05, 2), lengths[k]])
    parts.append(_tool_text(n, place))
    return "".join(parts)


def published_urdf(name: str) -> str:
    """Return a published arm; its meshes are named and are not there."""
    if name == "iiwa14":
        rows = [
            {
                "place": place,
                "turn": turn,
                "axis": (0.0, 0.0, 1.0),
                "limits": (-np.radians(limit), np.radians(limit)),
            }
            for place, turn, limit in IIWA
        ]
    else:
        rows = json.loads(PUBLISHED.read_text(encoding="utf-8"))["arms"][name]
    parts = [f'<robot name="{name}"><link name="base"/>']
    for k, row in enumerate(rows):
        mesh = f'<mesh filename="package://{name}/meshes/link_{k}.stl"/>'
        parts.append(
            f'<link name="l{k}">{_inertial(2.0)}<collision><geometry>{mesh}</geometry>'
            "</collision></link>"
        )
        limits = (float(row["limits"][0]), float(row["limits"][1]))
        parts.append(
            _joint_text(
                k,
                np.array(row["place"]),
                np.array(row["turn"]),
                np.array(row["axis"]),
                limits,
            )
        )
    parts.append(_tool_text(len(rows), np.array([0.0, 0.0, 0.1])))
    return "".join(parts)


def _inertial(mass: float) -> str:
    """Return a body of a mass [kg]."""
    moments = " ".join(f'{key}="{0.01 * mass}"' for key in ("ixx", "iyy", "izz"))
    return (
        f'<inertial><origin xyz="0.01 0.02 0.1"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _link_text(k: int, length: float, rng: np.random.Generator, *, shapes: bool) -> str:
    """Return a link along z, with a cylinder and a ball at its end, or without."""
    solids = ""
    radius = float(rng.uniform(0.02, 0.06))
    if shapes:
        cylinder = f'<cylinder radius="{radius}" length="{length}"/>'
        ball = f'<sphere radius="{1.2 * radius}"/>'
        for place, shape in ((0.5 * length, cylinder), (length, ball)):
            solids += (
                f'<collision><origin xyz="0 0 {place}"/><geometry>{shape}</geometry>'
                "</collision>"
            )
    return f'<link name="l{k}">{_inertial(float(rng.uniform(0.5, 5.0)))}{solids}</link>'


def _joint_text(
    k: int, place: Array, turn: Array, axis: Array, limits: tuple[float, float]
) -> str:
    """Return a revolute joint from the link before to link k."""
    parent = f"l{k - 1}" if k else "base"
    return (
        f'<joint name="j{k + 1}" type="revolute"><parent link="{parent}"/>'
        f'<child link="l{k}"/><origin xyz="{_text(place)}" rpy="{_text(turn)}"/>'
        f'<axis xyz="{_text(axis)}"/><limit lower="{limits[0]}" upper="{limits[1]}"'
        ' velocity="2.0" effort="10000"/></joint>'
    )


def _tool_text(n: int, place: Array) -> str:
    """Return a fixed frame on the last link, and the end of the file."""
    return (
        f'<link name="tool"/><joint name="tool" type="fixed"><parent link="l{n - 1}"/>'
        f'<child link="tool"/><origin xyz="{_text(place)}"/></joint></robot>'
    )


def _text(values: Array) -> str:
    return " ".join(f"{float(x)!r}" for x in values)
