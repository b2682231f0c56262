"""Joints of a URDF in the order of its chains, with their limits; text only, no Pinocchio."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

from .urdf_text import MOVABLE, UrdfText


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
    root = ElementTree.fromstring(urdf.raw)
    elements = {joint.get("name", ""): joint for joint in root.findall("joint")}
    children: dict[str, list[str]] = {}
    below = set()
    for name, joint in elements.items():
        child = _link(joint, "child")
        children.setdefault(_link(joint, "parent"), []).append(name)
        below.add(child)
    roots = [link for link in children if link not in below]
    found: list[tuple[str, ...]] = []
    for link in roots:
        found += _paths(link, children, elements)
    kept = [tuple(n for n in path if _drives(urdf, n)) for path in found]
    unique = dict.fromkeys(path for path in kept if path)
    return [tuple(_joint(elements[name]) for name in path) for path in unique]


def best_chain(
    urdf: UrdfText, worth: Callable[[UrdfJoint], float] = lambda joint: 1.0
) -> tuple[UrdfJoint, ...]:
    """Return the chain of the largest total worth, the first of equals; empty where none."""
    return max(chains(urdf), key=lambda chain: sum(map(worth, chain)), default=())


def _drives(urdf: UrdfText, name: str) -> bool:
    return urdf.types[name] in MOVABLE and name not in urdf.mimics


def _paths(
    link: str, children: Mapping[str, list[str]], elements: Mapping[str, ElementTree.Element]
) -> list[tuple[str, ...]]:
    paths: list[tuple[str, ...]] = []
    stack: list[tuple[str, tuple[str, ...], frozenset[str]]] = [(link, (), frozenset({link}))]
    while stack:
        at, path, seen = stack.pop()
        below = children.get(at, [])
        if not below:
            paths.append(path)
        for name in reversed(below):
            child = _link(elements[name], "child")
            if child not in seen:
                stack.append((child, (*path, name), seen | {child}))
    return paths


def _link(joint: ElementTree.Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _joint(element: ElementTree.Element) -> UrdfJoint:
    limit = element.find("limit")
    kind = element.get("type", "")
    lower, upper = _number(limit, "lower"), _number(limit, "upper")
    if kind == "continuous" or lower is None or upper is None or lower >= upper:
        lower = upper = None
    return UrdfJoint(
        element.get("name", ""),
        kind,
        lower,
        upper,
        _positive(_number(limit, "velocity")),
        _positive(_number(limit, "effort")),
    )


def _number(element: ElementTree.Element | None, key: str) -> float | None:
    try:
        value = float((element.get(key) if element is not None else None) or "nan")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0.0 else None
