"""A URDF as text, without Pinocchio: its checks, its joints and their chains.

Meshes, visuals and transmissions play no part in the dynamics and are neither read nor
required.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from seqid_cli.errors import ConfigError
from seqid_cli.robot.checks import LARGEST, LEAST_AXIS, Problem, nearest
from seqid_cli.robot.toml import URDF_LIMIT, read_limited
from seqid_cli.robot.toml_schema import JointEntry
from seqid_cli.robot.xml import TooLargeError, parsed_xml

# Beyond so many links Pinocchio's recursion may end the process; humanoids with hands
# have some 150.
MOST_LINKS = 1000
MOVABLE = frozenset({"revolute", "continuous", "prismatic"})


class _Numbers(NamedTuple):
    """How many numbers an attribute has, and between which limits."""

    size: int
    low: float = -LARGEST
    high: float = LARGEST


# Numbers of a link or joint, by the path of the element and the attribute.
_NUMBERS = {
    **dict.fromkeys(
        (
            "origin/xyz",
            "origin/rpy",
            "inertial/origin/xyz",
            "inertial/origin/rpy",
            "axis/xyz",
        ),
        _Numbers(3),
    ),
    **dict.fromkeys(
        (
            "inertial/inertia/ixx",
            "inertial/inertia/ixy",
            "inertial/inertia/ixz",
            "inertial/inertia/iyy",
            "inertial/inertia/iyz",
            "inertial/inertia/izz",
        ),
        _Numbers(1),
    ),
    "inertial/mass/value": _Numbers(1, low=0.0),
    **dict.fromkeys(
        ("limit/lower", "limit/upper", "limit/velocity", "limit/effort"),
        _Numbers(1, low=-math.inf, high=math.inf),
    ),
}


@dataclass(frozen=True, kw_only=True)
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

    @property
    def is_driven(self) -> bool:
        """True for a joint that moves by itself."""
        return self.kind in MOVABLE and not self.follows


@dataclass(frozen=True)
class UrdfText:
    """A URDF file that passed its checks: its links hang in one tree by the joints."""

    path: Path
    raw: bytes
    root: ElementTree.Element
    joints: dict[str, UrdfJoint]  # by name, in the order of the file

    @property
    def movable(self) -> tuple[str, ...]:
        """Names of joints that can move, in the order of the file."""
        return tuple(
            joint.name for joint in self.joints.values() if joint.kind in MOVABLE
        )

    def chain_to(self, link: str) -> list[UrdfJoint]:
        """Return the joints from the root to a link."""
        by_child = {joint.child: joint for joint in self.joints.values()}
        chain = []
        while link in by_child:
            chain.append(by_child[link])
            link = by_child[link].parent
        return chain[::-1]


def read_urdf_text(path: Path) -> UrdfText:
    """Read a URDF file and check it; raises ConfigError as `parse_urdf` does."""
    return parse_urdf(read_limited(path, "URDF", URDF_LIMIT), path)


def parse_urdf(raw: bytes, path: Path) -> UrdfText:
    """Check the bytes of a URDF file.

    Raises ConfigError naming the file, the joint or link: it is a xacro file, no
    well-formed XML or no URDF, has numbers that are none, names twice, or links that
    are no tree.
    """
    root = _parsed(raw, path)
    joints = [_joint(element) for element in root.findall("joint")]
    problems = chain(
        _too_many(root), _wrong_numbers(root), _faults_of_the_tree(root, joints)
    )
    for message, hint in problems:
        raise ConfigError(message, where=str(path), hint=hint)
    return UrdfText(path, raw, root, {joint.name: joint for joint in joints})


def _parsed(raw: bytes, path: Path) -> ElementTree.Element:
    """Parse the XML of a URDF; raises ConfigError for anything else."""
    root: ElementTree.Element | None = None
    message = ""
    hint = ""
    try:
        root = parsed_xml(raw)
    except TooLargeError as fault:
        message = str(fault)
        hint = "No robot is so large: check what wrote the file."
    except (ElementTree.ParseError, ValueError, LookupError) as fault:
        message = f"not well-formed XML: {fault}"

    # What a file is says more than the place where it is no XML.
    without_comments = re.sub(rb"<!--.*?-->", b"", raw, flags=re.DOTALL)
    if path.suffix == ".xacro" or re.search(rb"<\s*xacro:", without_comments):
        message = "this is a xacro file, not a URDF"
        hint = "Run `xacro robot.urdf.xacro > robot.urdf` and name the result."
    elif re.search(rb"<!\s*(DOCTYPE|ENTITY)", raw, re.IGNORECASE):
        message = "the URDF declares XML entities"
        hint = "Remove the DOCTYPE declaration."
    elif root is not None and root.tag != "robot":
        message = f"not a URDF: its outermost element is <{root.tag}>, not <robot>"
        hint = "SDF and MJCF files have to be converted to URDF."
    if root is None or message:
        raise ConfigError(message, where=str(path), hint=hint)
    return root


def numbers(text: str) -> list[float]:
    """Return the numbers of an attribute; empty where a word is no finite one."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []


def link_of(joint: ElementTree.Element, which: str) -> str:
    """Return the parent or child link of a joint; empty where it names none."""
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _joint(element: ElementTree.Element) -> UrdfJoint:
    """Read a joint; what is wrong with it is found by the checks of its numbers."""
    kind = element.get("type", "")
    mimic = element.find("mimic")
    axis = element.find("axis")
    axis_text = "" if axis is None else axis.get("xyz", "")

    limit = element.find("limit")
    limits: dict[str, float] = {}
    if limit is not None:
        for key, text in limit.items():
            values = numbers(text)
            if len(values) == 1:
                limits[key] = values[0]
    has_range = (
        kind != "continuous"
        and {"lower", "upper"} <= limits.keys()
        and limits["lower"] < limits["upper"]
    )
    return UrdfJoint(
        name=element.get("name", ""),
        kind=kind,
        parent=link_of(element, "parent"),
        child=link_of(element, "child"),
        follows="" if mimic is None else mimic.get("joint", ""),
        axis=tuple(numbers(axis_text)) or (1.0, 0.0, 0.0),
        lower=limits["lower"] if has_range else None,
        upper=limits["upper"] if has_range else None,
        velocity=max(limits.get("velocity", 0.0), 0.0) or None,
        effort=max(limits.get("effort", 0.0), 0.0) or None,
    )


def _too_many(root: ElementTree.Element) -> Iterator[Problem]:
    """Yield that there are more joints or links than a robot has."""
    for kind in ("joint", "link"):
        count = len(root.findall(kind))
        if count > MOST_LINKS:
            yield Problem(
                f"it has {count} {kind}s, more than {MOST_LINKS}",
                "Cut it to the arm and what it carries.",
            )


def _wrong_numbers(root: ElementTree.Element) -> Iterator[Problem]:
    """Yield numbers that Pinocchio takes as they are, or refuses without a place."""
    for owner in root:
        named = f"{owner.tag} {owner.get('name')!r}"
        is_movable = owner.get("type") in MOVABLE
        for place, wanted in _NUMBERS.items():
            path, _, key = place.rpartition("/")
            for element in owner.iterfind(path):
                if key not in element.attrib:
                    continue
                text = element.attrib[key]
                fault = _fault_of(numbers(text), wanted)
                if not fault and path == "axis" and is_movable:
                    fault = _fault_of_axis(numbers(text))
                if fault:
                    yield Problem(
                        f"{named}: <{path} {key}={text!r}> {fault}",
                        "Correct it in the URDF.",
                    )


def _fault_of(values: list[float], wanted: _Numbers) -> str:
    """Say what is wrong with the numbers of an attribute; empty where nothing is."""
    has_size = len(values) == wanted.size
    if has_size and wanted.low <= min(values) <= max(values) <= wanted.high:
        return ""
    plural = "s" if wanted.size > 1 else ""
    return (
        f"is not {wanted.size} finite number{plural} of {wanted.low:g} to"
        f" {wanted.high:g}"
    )


def _fault_of_axis(axis: list[float]) -> str:
    """Say that an axis has no direction; empty where it has one."""
    return "has no direction" if math.hypot(*axis) <= LEAST_AXIS else ""


def _faults_of_the_tree(
    root: ElementTree.Element, joints: list[UrdfJoint]
) -> Iterator[Problem]:
    """Yield what keeps links and joints from being one tree."""
    links = [link.get("name", "") for link in root.findall("link")]
    yield from _repeated("joint", [joint.name for joint in joints])
    yield from _repeated("link", links)

    mover_of: dict[str, str] = {}  # the joint of each link that has one
    for joint in joints:
        for which, end in (("parent", joint.parent), ("child", joint.child)):
            if end not in links:
                yield Problem(
                    f"joint {joint.name!r}: its {which} link {end!r} is not in the"
                    " URDF",
                    "Add the link, or correct its name.",
                )
        first = mover_of.setdefault(joint.child, joint.name)
        if first != joint.name:
            yield Problem(
                f"link {joint.child!r} is the child of two joints, {first!r} and"
                f" {joint.name!r}",
                "Links must form a tree: cut loops open, and model the closing joint"
                " apart.",
            )

    roots = [name for name in links if name not in mover_of]
    hanging = _hanging_from(roots, joints)
    loose = [name for name in links if name not in hanging]
    fault = ""
    if not roots:
        fault = "a loop, no root"
    elif len(roots) > 1:
        fault = f"{len(roots)} root links ({', '.join(roots[:5])})"
    elif loose:
        fault = f"a loop of links beside its tree ({', '.join(loose[:5])})"
    if fault:
        yield Problem(
            f"it has {fault}", "All links must hang in one tree from one root."
        )


def _hanging_from(roots: Sequence[str], joints: Sequence[UrdfJoint]) -> set[str]:
    """Return the roots, and all links that joints hang from them."""
    children_of: dict[str, list[str]] = {}
    for joint in joints:
        children_of.setdefault(joint.parent, []).append(joint.child)

    hanging: set[str] = set()
    waiting = list(roots)
    while waiting:
        link = waiting.pop()
        if link not in hanging:
            hanging.add(link)
            waiting += children_of.get(link, ())
    return hanging


def _repeated(kind: str, names: list[str]) -> Iterator[Problem]:
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            yield Problem(
                f"two {kind}s are named {name!r}", "Rename or remove one of them."
            )


def followers(urdf: UrdfText, names: Sequence[str]) -> list[UrdfJoint]:
    """Return the joints of a robot file that mimic another and carry none of the rest.

    They have no drive, and without them the others are a whole arm: a gripper's second
    finger, say.
    """
    listed = [urdf.joints[name] for name in names if name in urdf.joints]
    driven = [joint for joint in listed if not joint.follows]
    carrying = {
        carrier.name for joint in driven for carrier in urdf.chain_to(joint.child)
    }
    if not driven:
        return []
    return [joint for joint in listed if joint.follows and joint.name not in carrying]


def check_joints(urdf: UrdfText, joints: Sequence[JointEntry], source: Path) -> None:
    """Check that the joints of a robot file move by themselves in the URDF.

    Raises ConfigError, which names the key in the robot file `source`.
    """
    file = urdf.path.name
    movable = f"Movable joints of {file}: {', '.join(urdf.movable) or 'none'}."
    for k, entry in enumerate(joints):
        name = entry.name
        joint = urdf.joints.get(name)
        key = f"joint[{k}].name {name!r}"
        if joint is None:
            fault = f"is no joint of {file}"
            hint = f"{nearest(name, urdf.movable)}{movable}"
        elif joint.kind not in MOVABLE:
            fault = f"is a {joint.kind or 'typeless'} joint in {file}"
            hint = (
                "Only revolute, continuous and prismatic joints can be driven."
                f" {movable}"
            )
        elif joint.follows:
            # Those beside the arm are left out before (`followers`).
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
    """List joints that carry the last of `names` and are none of them.

    Each comes with its place in words: between which of `names`.
    """
    carrying: list[tuple[UrdfJoint, str]] = []
    previous = ""  # the last of `names` on the way
    for joint in urdf.chain_to(urdf.joints[names[-1]].child):
        if joint.name in names:
            previous = joint.name
        elif joint.is_driven:
            place = f"before {names[0]!r}"
            if previous:
                following = names[names.index(previous) + 1]
                place = f"between {previous!r} and {following!r}"
            carrying.append((joint, f"{place} in {urdf.path.name}"))
    return carrying


def best_chain(
    urdf: UrdfText, worth: Callable[[UrdfJoint], float] = lambda joint: 1.0
) -> tuple[UrdfJoint, ...]:
    """Return the driven joints from the root to a tip that have the largest worth.

    Of equal chains the first one counts; empty where no joint is driven.
    """
    parents = {joint.parent for joint in urdf.joints.values()}
    tips = [joint.child for joint in urdf.joints.values() if joint.child not in parents]
    chains = [
        tuple(joint for joint in urdf.chain_to(tip) if joint.is_driven) for tip in tips
    ]
    return max(chains, key=lambda chain: sum(map(worth, chain)), default=())
