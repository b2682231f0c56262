"""Joints of a URDF in the order of its chains, with their limits; text only, no Pinocchio.

Pinocchio refuses revolute and prismatic joints without a complete <limit>, which plays no part in
the dynamics and which hand-made files lack, and links with the name of a joint, which URDF allows;
`readable` repairs both.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree import ElementTree

from seqid_cli.errors import ConfigError
from seqid_cli.robot.urdf.text import MOVABLE, UrdfText, link_of, numbers

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
        _check_joint(joint, links, str(urdf.path))
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


def _check_joint(joint: ElementTree.Element, links: list[str], where: str) -> None:
    name = joint.get("name", "")
    for which in ("parent", "child"):
        if link_of(joint, which) not in links:
            text = f"joint {name!r}: its {which} link {link_of(joint, which)!r} is not in the URDF"
            raise ConfigError(text, where=where, hint="Add the link, or correct its name.")
    for tag, keys in _NUMBERS.items():
        element = joint.find(tag)
        for key in keys if element is not None else ():
            text = element.get(key, "") if element is not None else ""
            if numbers(text) is None:
                message = f"joint {name!r}: <{tag} {key}={text!r}> is not finite numbers"
                raise ConfigError(message, where=where, hint="Correct the number in the URDF.")


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
