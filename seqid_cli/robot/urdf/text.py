"""A URDF as text, without Pinocchio: checks, joints in the order of its chains, their limits.

Meshes, visuals and transmissions play no part in the dynamics and are neither read nor required.
Pinocchio refuses revolute and prismatic joints without a complete <limit>, which plays no part
either and which hand-made files lack, and links with the name of a joint, which URDF allows;
`readable` repairs both.
"""

import copy
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from seqid_cli.errors import ConfigError
from seqid_cli.robot.toml.checks import LARGEST, nearest
from seqid_cli.robot.toml.read import read_limited

SIZE_LIMIT = 64 * 2**20  # bytes
MOVABLE = frozenset({"revolute", "continuous", "prismatic"})
XACRO_HINT = "Run `xacro robot.urdf.xacro > robot.urdf` and name the result."


@dataclass(frozen=True)
class UrdfText:
    """A URDF file that is well-formed: `types` by joint name, and who follows another joint."""

    path: Path
    raw: bytes
    root: ElementTree.Element
    types: dict[str, str]
    mimics: dict[str, str]
    has_inertia: bool

    @property
    def movable(self) -> tuple[str, ...]:
        """Joints that can move, in the order of the file."""
        return tuple(name for name, kind in self.types.items() if kind in MOVABLE)


def read_urdf_text(path: Path) -> UrdfText:
    """Read a URDF and check that it is one.

    Raises ConfigError: it is missing, a xacro file, not well-formed XML or not a URDF.
    """
    raw = read_limited(path, "URDF", SIZE_LIMIT)
    where = str(path)
    if path.suffix == ".xacro" or re.search(
        rb"<\s*xacro:", re.sub(rb"<!--.*?-->", b"", raw, flags=re.DOTALL)
    ):
        raise ConfigError("this is a xacro file, not a URDF", where=where, hint=XACRO_HINT)
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", raw, re.IGNORECASE):
        raise ConfigError(
            "the URDF declares XML entities", where=where, hint="Remove the DOCTYPE declaration."
        )
    try:
        root = ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError, LookupError) as problem:
        raise ConfigError(f"not well-formed XML: {problem}", where=where) from None
    if root.tag != "robot":
        message = f"not a URDF: its outermost element is <{root.tag}>, not <robot>"
        hint = "SDF and MJCF files have to be converted to URDF."
        raise ConfigError(message, where=where, hint=hint)
    types: dict[str, str] = {}
    mimics: dict[str, str] = {}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in types:
            raise ConfigError(f"the URDF has two joints named {name!r}", where=str(path))
        types[name] = joint.get("type", "")
        mimic = joint.find("mimic")
        if mimic is not None:
            mimics[name] = mimic.get("joint", "")
    _check_numbers(root, path)
    has_inertia = root.find("link/inertial") is not None
    return UrdfText(path, raw, root, types, mimics, has_inertia)


def _check_numbers(root: ElementTree.Element, path: Path) -> None:
    """Check what the parser of the library passes over or takes: masses and vectors."""
    where = str(path)
    for link in root.iterfind("link"):
        for mass in link.iterfind("inertial/mass"):
            if not all(value >= 0.0 for value in numbers(mass.get("value", "")) or [-1.0]):
                message = f"link {link.get('name')!r} has a mass of {mass.get('value')!r}"
                raise ConfigError(message, where=where, hint="A mass is 0 or more, in kg.")
    for owner in root:
        for part in (*owner.iterfind("origin"), *owner.iterfind("inertial/origin")):
            for key in {"xyz", "rpy"} & {*part.keys()}:
                three = numbers(part.attrib[key]) or []
                if len(three) != 3 or max(map(abs, three)) > LARGEST:
                    name = f"{owner.tag} {owner.get('name')!r}"
                    message = (
                        f"{name} has {key}={part.attrib[key]!r}, which is not three finite numbers "
                        f"or goes beyond {LARGEST:g}"
                    )
                    hint = "Write three finite numbers."
                    raise ConfigError(message, where=where, hint=hint)


def numbers(text: str) -> list[float] | None:
    """Return the finite numbers of an attribute; None where a word is none."""
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        return None
    return found if all(map(math.isfinite, found)) else None


def link_of(joint: ElementTree.Element, which: str) -> str:
    """Return the parent or child link of a joint; empty where it names none."""
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def check_names(urdf: UrdfText, names: tuple[str, ...], source: Path) -> None:
    """Check that the robot file's joints `names` are movable joints of the URDF.

    Raises ConfigError naming `source`, the key, the joint, and what the URDF has instead.
    """
    for k, name in enumerate(names):
        key, where = f"joint[{k}].name", str(source)
        known = f"Movable joints of {urdf.path.name}: {', '.join(urdf.movable) or 'none'}."
        if name not in urdf.types:
            message = f"{key} {name!r} is no joint of {urdf.path.name}"
            raise ConfigError(message, where=where, hint=f"{nearest(name, urdf.movable)}{known}")
        if urdf.types[name] not in MOVABLE:
            raise ConfigError(
                f"{key} {name!r} is a {urdf.types[name] or 'typeless'} joint in {urdf.path.name}",
                where=where,
                hint=f"Only revolute, continuous and prismatic joints can be driven. {known}",
            )
        if name in urdf.mimics:
            raise ConfigError(
                f"{key} {name!r} follows joint {urdf.mimics[name]!r} (mimic) in {urdf.path.name}",
                where=where,
                hint="Leave it out, it is then locked at zero; or remove <mimic> from the URDF.",
            )


WIDE = "1e9"
_NUMBERS = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
}


@dataclass(frozen=True)
class UrdfJoint:
    """A movable joint: limits in rad (m), rad/s (m/s), N m (N), None where not given."""

    name: str
    kind: str
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None


def chains(urdf: UrdfText) -> list[tuple[UrdfJoint, ...]]:
    """List the chains from the root to each tip, movable joints only.

    Joints that follow another one (mimic) are left out. The order is that of the file; a URDF with
    a loop, or without a root, has no chain that counts the loop's joints.
    """
    elements = {joint.get("name", ""): joint for joint in urdf.root.findall("joint")}
    children: dict[str, list[str]] = {}
    for name, joint in elements.items():
        children.setdefault(link_of(joint, "parent"), []).append(name)
    roots = children.keys() - {link_of(joint, "child") for joint in elements.values()}
    found: dict[tuple[str, ...], None] = {}
    stack: list[tuple[str, tuple[str, ...], frozenset[str]]] = [
        (link, (), frozenset({link})) for link in reversed(children) if link in roots
    ]
    while stack:
        at, path, seen = stack.pop()
        if at not in children:  # a tip
            drives = (n for n in path if urdf.types[n] in MOVABLE and n not in urdf.mimics)
            found.setdefault(tuple(drives))
        for name in reversed(children.get(at, [])):
            child = link_of(elements[name], "child")
            if child not in seen:
                stack.append((child, (*path, name), seen | {child}))
    return [tuple(_joint(elements[name]) for name in path) for path in found if path]


def best_chain(
    urdf: UrdfText, worth: Callable[[UrdfJoint], float] = lambda joint: 1.0
) -> tuple[UrdfJoint, ...]:
    """Return the chain of the largest total worth, the first of equals; empty where none."""
    return max(chains(urdf), key=lambda chain: sum(map(worth, chain)), default=())


def readable(urdf: UrdfText) -> bytes:
    """Repair parts that readers of URDFs refuse and that play no part in the dynamics.

    Every revolute and prismatic joint that lacks part of its <limit> gets a wide one; a link that
    shares its name with a joint is renamed. The text is returned as it is where nothing is to do.
    """
    root = copy.deepcopy(urdf.root)
    changed = False
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic"):
            limit, needed = joint.find("limit"), {"effort": WIDE, "velocity": WIDE}
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
                needed |= {"lower": f"-{WIDE}", "upper": WIDE}
            lacking = {key: value for key, value in needed.items() if key not in limit.attrib}
            limit.attrib.update(lacking)
            changed |= bool(lacking)
    joints, links = ({x.get("name", "") for x in root.findall(kind)} for kind in ("joint", "link"))
    new = {name: f"{name}/link" for name in links & joints}
    while set(new.values()) & (links | joints):
        new = {name: f"{text}/" for name, text in new.items()}
    named = [(link, "name") for link in root.findall("link")]
    named += [(end, "link") for end in root.findall("joint/*") if end.tag in ("parent", "child")]
    for element, key in named if new else ():
        element.set(key, new.get(element.get(key, ""), element.get(key, "")))
    return ElementTree.tostring(root) if changed or new else urdf.raw


def check_urdf(urdf: UrdfText) -> None:
    """Check for faults that a reader of URDFs refuses without naming the place.

    Raises ConfigError naming the file, the joint or link: links named twice, joints between links
    that are not there, links with two parents, loops, no or several roots, numbers that are none.
    """
    root = urdf.root
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        for which in ("parent", "child"):
            end = link_of(joint, which)
            if end not in links:
                text = f"joint {name!r}: its {which} link {end!r} is not in the URDF"
                raise _refused(urdf, text, "Add the link, or correct its name.")
        for tag, keys in _NUMBERS.items():
            for element in joint.findall(tag)[:1]:
                for key in keys:
                    text = element.get(key, "")
                    if numbers(text) is None:
                        message = f"joint {name!r}: <{tag} {key}={text!r}> is not finite numbers"
                        raise _refused(urdf, message, "Correct the number in the URDF.")
    parents = check_parents(urdf)
    twice = next((name for name in links if links.count(name) > 1), None)
    if twice is not None:
        raise _refused(urdf, f"two links are named {twice!r}", "Rename or remove one of them.")
    if not links:
        raise _refused(urdf, "it has no links", "Name the URDF that describes the arm.")
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        found = f"{len(roots)} root links ({', '.join(roots[:5])})" if roots else "a loop, no root"
        raise _refused(urdf, f"it has {found}", "All links must hang in one tree from one root.")


def check_parents(urdf: UrdfText) -> dict[str, str]:
    """Return the joint that moves each link.

    Raises ConfigError: a link has two, of which a reader of URDFs may drop one without a word.
    """
    parents: dict[str, str] = {}
    for joint in urdf.root.findall("joint"):
        name, child = joint.get("name", ""), link_of(joint, "child")
        if child in parents:
            message = f"link {child!r} is the child of two joints, {parents[child]!r} and {name!r}"
            hint = "Links must form a tree: cut loops open, and model the closing joint apart."
            raise _refused(urdf, message, hint)
        parents[child] = name
    return parents


def _refused(urdf: UrdfText, message: str, hint: str) -> ConfigError:
    return ConfigError(message, where=str(urdf.path), hint=hint)


def _joint(element: ElementTree.Element) -> UrdfJoint:
    limit, kind = element.find("limit"), element.get("type", "")
    known: dict[str, float] = {}
    for key in ("lower", "upper", "velocity", "effort"):
        found = numbers(limit.get(key, "")) if limit is not None else None
        if found and len(found) == 1 and (key in ("lower", "upper") or found[0] > 0.0):
            known[key] = found[0]
    lower, upper = known.get("lower"), known.get("upper")
    if kind == "continuous" or lower is None or upper is None or lower >= upper:
        lower = upper = None
    largest = known.get("velocity"), known.get("effort")
    return UrdfJoint(element.get("name", ""), kind, lower, upper, *largest)
