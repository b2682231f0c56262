"""A URDF as text: all checks of it that need no Pinocchio.

Meshes, visuals and transmissions play no part in the dynamics and are neither read nor required.
"""

import math
import re
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
