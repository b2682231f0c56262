"""A URDF as text, without Pinocchio: its checks, its joints and their chains.

Meshes, visuals and transmissions play no part in the dynamics and are neither read nor
required.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from seqid_cli.errors import ConfigError
from seqid_cli.robot.toml import LARGEST, LEAST_AXIS, URDF_LIMIT, nearest, read_limited
from seqid_cli.robot.toml_schema import JointEntry

MOVABLE = frozenset({"revolute", "continuous", "prismatic"})
_ANY, _SIZED = (-math.inf, math.inf), (-LARGEST, LARGEST)
# How many numbers an attribute of a link or joint has, and between what they are.
_VECTORS = (
    "origin/xyz",
    "origin/rpy",
    "inertial/origin/xyz",
    "inertial/origin/rpy",
    "axis/xyz",
)
_NUMBERS = {
    **dict.fromkeys(_VECTORS, (3, _SIZED)),
    **{
        f"inertial/inertia/i{axes}": (1, _SIZED)
        for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    },
    "inertial/mass/value": (1, (0.0, LARGEST)),
    **{f"limit/{key}": (1, _ANY) for key in ("lower", "upper", "velocity", "effort")},
}


@dataclass(frozen=True)
class UrdfJoint:
    """A joint between two links; limits are None where not given."""

    name: str
    kind: str
    parent: str
    child: str
    follows: str  # the joint that it mimics; empty where it moves by itself
    axis: tuple[float, ...]  # (3,) in its own frame
    lower: float | None  # rad (m)
    upper: float | None
    velocity: float | None  # rad/s (m/s)
    effort: float | None  # N m (N)


@dataclass(frozen=True)
class UrdfText:
    """A URDF file that passed its checks: its links hang in one tree by the `joints`, by name."""

    path: Path
    raw: bytes
    root: ElementTree.Element
    joints: dict[str, UrdfJoint]

    @property
    def movable(self) -> tuple[str, ...]:
        """Joints that can move, in the order of the file."""
        return tuple(
            joint.name for joint in self.joints.values() if joint.kind in MOVABLE
        )


def read_urdf_text(path: Path) -> UrdfText:
    """Read a URDF file and check it; raises ConfigError if there is none, and as `parse_urdf`."""
    return parse_urdf(read_limited(path, "URDF", URDF_LIMIT), path)


def parse_urdf(raw: bytes, path: Path) -> UrdfText:
    """Check the bytes of a URDF file.

    Raises ConfigError naming the file, the joint or link: it is a xacro file, no
    well-formed XML or no URDF, has numbers that are none, names twice, or links that
    are no tree.
    """
    text = re.sub(rb"<!--.*?-->", b"", raw, flags=re.DOTALL)
    problem, hint = "", ""
    try:
        root = ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError, LookupError) as fault:
        root, problem = ElementTree.Element(""), f"not well-formed XML: {fault}"
    if path.suffix == ".xacro" or re.search(rb"<\s*xacro:", text):
        problem = "this is a xacro file, not a URDF"
        hint = "Run `xacro robot.urdf.xacro > robot.urdf` and name the result."
    elif re.search(rb"<!\s*(DOCTYPE|ENTITY)", raw, re.IGNORECASE):
        problem, hint = (
            "the URDF declares XML entities",
            "Remove the DOCTYPE declaration.",
        )
    elif not problem and root.tag != "robot":
        problem = f"not a URDF: its outermost element is <{root.tag}>, not <robot>"
        hint = "SDF and MJCF files have to be converted to URDF."
    if problem:
        raise ConfigError(problem, where=str(path), hint=hint)
    joints = [_joint(element) for element in root.findall("joint")]
    for problem, hint in (*_wrong_numbers(root), *_faults_of_the_tree(root, joints)):
        raise ConfigError(problem, where=str(path), hint=hint)
    return UrdfText(path, raw, root, {joint.name: joint for joint in joints})


def numbers(text: str) -> list[float]:
    """Return the numbers of an attribute; empty where a word is no finite one."""
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        return []
    return found if all(map(math.isfinite, found)) else []


def link_of(joint: ElementTree.Element, which: str) -> str:
    """Return the parent or child link of a joint; empty where it names none."""
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _joint(element: ElementTree.Element) -> UrdfJoint:
    kind, mimic, limit = (
        element.get("type", ""),
        element.find("mimic"),
        element.find("limit"),
    )
    along = next(element.iterfind("axis"), element)
    given = {} if limit is None else {key: numbers(text) for key, text in limit.items()}
    known = {key: found[0] for key, found in given.items() if len(found) == 1}
    limited = kind != "continuous" and {"lower", "upper"} <= known.keys()
    limited = limited and known["lower"] < known["upper"]
    return UrdfJoint(
        name=element.get("name", ""),
        kind=kind,
        parent=link_of(element, "parent"),
        child=link_of(element, "child"),
        follows="" if mimic is None else mimic.get("joint", ""),
        axis=tuple(numbers(along.get("xyz", ""))) or (1.0, 0.0, 0.0),
        lower=known["lower"] if limited else None,
        upper=known["upper"] if limited else None,
        velocity=max(known.get("velocity", 0.0), 0.0) or None,
        effort=max(known.get("effort", 0.0), 0.0) or None,
    )


def _wrong_numbers(root: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Numbers that Pinocchio takes as they are, or refuses without naming the place."""
    for owner in root:
        named, moves = (
            f"{owner.tag} {owner.get('name')!r}",
            owner.get("type") in MOVABLE,
        )
        for place, (count, (low, high)) in _NUMBERS.items():
            path, _, key = place.rpartition("/")
            for text in (
                part.attrib[key] for part in owner.iterfind(path) if key in part.attrib
            ):
                found, attribute = numbers(text), f"<{path} {key}={text!r}>"
                if len(found) != count or not low <= min(found) <= max(found) <= high:
                    wanted = (
                        f"{count} finite number{'s' * (count > 1)} of {low:g} to"
                        f" {high:g}"
                    )
                    yield (
                        f"{named}: {attribute} is not {wanted}",
                        "Correct it in the URDF.",
                    )
                elif path == "axis" and moves and math.hypot(*found) <= LEAST_AXIS:
                    yield (
                        f"{named}: {attribute} has no direction",
                        "Correct it in the URDF.",
                    )


def _faults_of_the_tree(
    root: ElementTree.Element, joints: list[UrdfJoint]
) -> Iterator[tuple[str, str]]:
    """What keeps links and joints from being one tree."""
    links, names = (
        [link.get("name", "") for link in root.findall("link")],
        [j.name for j in joints],
    )
    for kind, own in (("joint", names), ("link", links)):
        for name in dict.fromkeys(name for name in own if own.count(name) > 1):
            yield f"two {kind}s are named {name!r}", "Rename or remove one of them."
    moved: dict[str, str] = {}
    for joint in joints:
        for which, end in (("parent", joint.parent), ("child", joint.child)):
            if end not in links:
                text = (
                    f"joint {joint.name!r}: its {which} link {end!r} is not in the URDF"
                )
                yield text, "Add the link, or correct its name."
        first = moved.setdefault(joint.child, joint.name)
        if first != joint.name:
            text = (
                f"link {joint.child!r} is the child of two joints, {first!r} and"
                f" {joint.name!r}"
            )
            yield (
                text,
                (
                    "Links must form a tree: cut loops open, and model the closing"
                    " joint apart."
                ),
            )
    roots = [name for name in links if name not in moved]
    if len(roots) != 1:
        found = (
            f"{len(roots)} root links ({', '.join(roots[:5])})"
            if roots
            else "a loop, no root"
        )
        yield f"it has {found}", "All links must hang in one tree from one root."


def check_joints(urdf: UrdfText, joints: Sequence[JointEntry], source: Path) -> None:
    """Check that joints of a robot file move by themselves in the URDF; raises ConfigError."""
    file = urdf.path.name
    known = f"Movable joints of {file}: {', '.join(urdf.movable) or 'none'}."
    for k, entry in enumerate(joints):
        name, joint = entry.name, urdf.joints.get(entry.name)
        key = f"joint[{k}].name {name!r}"
        if joint is None:
            fault, hint = (
                f"is no joint of {file}",
                f"{nearest(name, urdf.movable)}{known}",
            )
        elif joint.kind not in MOVABLE:
            fault = f"is a {joint.kind or 'typeless'} joint in {file}"
            hint = (
                f"Only revolute, continuous and prismatic joints can be driven. {known}"
            )
        elif joint.follows:
            fault = f"follows joint {joint.follows!r} (mimic) in {file}"
            hint = (
                "Leave it out, it is then locked at zero; or remove <mimic> from the"
                " URDF."
            )
        elif entry.prismatic and joint.kind != "prismatic":
            key = f"joint[{k}].prismatic (joint {name!r})"
            fault = f"is true, but {file} has a {joint.kind} joint"
            hint = "Leave prismatic out: with a URDF it is the URDF that says so."
        else:
            continue
        raise ConfigError(f"{key} {fault}", where=str(source), hint=hint)


def left_out(urdf: UrdfText, names: Sequence[str]) -> list[tuple[UrdfJoint, str]]:
    """List joints that carry the last of `names` and are none of them, each with its place."""
    by_child = {joint.child: joint for joint in urdf.joints.values()}
    chain, link = [], urdf.joints[names[-1]].child
    while link in by_child:
        chain.append(by_child[link])
        link = by_child[link].parent
    found, before = [], ""
    for joint in reversed(chain):
        if joint.name in names:
            before = joint.name
        elif joint.kind in MOVABLE and not joint.follows:
            after = names[names.index(before) + 1] if before else names[0]
            place = (
                f"between {before!r} and {after!r}" if before else f"before {after!r}"
            )
            found.append((joint, f"{place} in {urdf.path.name}"))
    return found


def best_chain(
    urdf: UrdfText, worth: Callable[[UrdfJoint], float] = lambda joint: 1.0
) -> tuple[UrdfJoint, ...]:
    """Driven joints from the root to a tip, of the largest worth; of equals the first, if any."""
    by_child = {joint.child: joint for joint in urdf.joints.values()}
    inner = {joint.parent for joint in urdf.joints.values()}
    chains = []
    for tip in (link for link in by_child if link not in inner):
        at, chain = tip, []
        while at in by_child:
            chain.append(by_child[at])
            at = by_child[at].parent
        driven = (
            each
            for each in reversed(chain)
            if each.kind in MOVABLE and not each.follows
        )
        chains.append(tuple(driven))
    return max(chains, key=lambda chain: sum(map(worth, chain)), default=())
