"""Bodies, springs, gears and forces that a model lacks: an edited MJCF, or torques."""

import xml.etree.ElementTree as ET

import numpy as np

from tests import Array
from tests.studies.outside.arms import GRAVITY, Arm
from tests.studies.outside.effects.effect import Effect, Sized, State, found, only
from tests.studies.outside.robotfiles import row


def spring(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A hose: the joint's own stiffness about a place of its own."""
    rest = arm.links[j].middle + float(rng.uniform(-0.8, 0.8)) * arm.links[j].reach

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            joint = found(root, f".//joint[@name='{arm.names[j]}']")
            joint.set("stiffness", repr(scale * arm.drives[j].coulomb))
            joint.set("springref", repr(rest))

        return Effect("spring", j, xml=xml)

    return Sized("spring", j, make)


def payload(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A body that the last link carries."""
    last = arm.links[-1]
    far = 2.0 * last.centre + rng.normal(0.0, 0.02, 3)

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            mass = scale * 0.3 * last.mass
            body = ET.SubElement(
                found(root, f".//body[@name='l{len(arm.links) - 1}']"), "body", pos=row(far)
            )
            size = row(np.full(3, 0.4 * mass * 0.03**2))
            ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=size)

        return Effect("payload", None, xml=xml)

    return Sized("payload", None, make, most=8.0)


def base_tilt(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A base that stands askew."""
    way = float(rng.uniform(0.0, 6.3))

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            angle = np.radians(2.0) * scale
            level = np.sin(angle) * np.array([np.cos(way), np.sin(way)])
            down = -GRAVITY * np.array([*level, np.cos(angle)])
            found(root, "option").set("gravity", row(down))

        return Effect("base_tilt", None, xml=xml)

    return Sized("base_tilt", None, make, most=5.0)


def rotor_inertia(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Another motor than before: a heavier rotor."""

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            rotor = (1.0 + 0.5 * scale) * arm.drives[j].rotor
            found(root, f".//joint[@name='{arm.names[j]}']").set("armature", repr(rotor))

        return Effect("rotor_inertia", j, xml=xml)

    return Sized("rotor_inertia", j, make, most=8.0)


def transmission_coupling(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A part of a joint's drive turns with the joint before it as well: a tendon over both."""
    other = j - 1 if j else 1
    turns = float(rng.choice([-1.0, 1.0]))

    def make(scale: float) -> Effect:
        part, drive = min(scale, 1.0), arm.drives[j]

        def xml(root: ET.Element) -> None:
            joint = found(root, f".//joint[@name='{arm.names[j]}']")
            joint.set("damping", repr((1.0 - part) * drive.viscous))
            tendon = ET.SubElement(
                found(root, "tendon"),
                "fixed",
                damping=repr(part * drive.viscous),
                frictionloss=repr(part * drive.coulomb),
                solreffriction="0.002 1",
                solimpfriction="0.99 0.999 0.001",
            )
            ET.SubElement(tendon, "joint", joint=arm.names[j], coef="1")
            ET.SubElement(tendon, "joint", joint=arm.names[other], coef=repr(turns))

        def dry(base: Array, state: State) -> Array:
            return base - only(arm, j, part * float(base[j]))

        return Effect("transmission_coupling", j, xml=xml, dry=dry, partner=other)

    return Sized("transmission_coupling", j, make, most=1.0)


def _geared(root: ET.Element, arm: Arm, j: int, name: str) -> ET.Element:
    """Give a joint's motor a body of its own; its gear is the tendon that is returned."""
    joint = found(root, f".//joint[@name='{arm.names[j]}']")
    body = next(b for b in root.iter("body") if joint in list(b))
    parent = next(p for p in root.iter() if body in list(p))
    motor = ET.SubElement(
        parent, "body", pos=body.get("pos", "0 0 0"), euler=body.get("euler", "0 0 0")
    )
    ET.SubElement(motor, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-9 1e-9 1e-9")
    ET.SubElement(motor, "joint", {**joint.attrib, "name": f"{arm.names[j]}_motor"})
    for key in ("armature", "damping", "frictionloss"):
        joint.set(key, "0")
    tendon = ET.SubElement(found(root, "tendon"), "fixed", name=name)
    ET.SubElement(tendon, "joint", joint=arm.names[j], coef="1")
    ET.SubElement(tendon, "joint", joint=f"{arm.names[j]}_motor", coef="-1")
    return tendon


def _stiffness(arm: Arm, j: int, hertz: float) -> tuple[float, float]:
    """Stiffness and damping of a gear whose rotor rings at a frequency against a held link."""
    rotor = arm.drives[j].rotor
    stiffness = rotor * (2.0 * np.pi * hertz) ** 2
    return float(stiffness), float(0.1 * np.sqrt(stiffness * rotor))


def joint_elasticity(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A gear that twists: motor and link are two bodies with a spring between them."""

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            stiffness, damping = _stiffness(arm, j, 25.0 / np.sqrt(scale))
            tendon = _geared(root, arm, j, "gear")
            tendon.set("stiffness", repr(stiffness))
            tendon.set("damping", repr(damping))
            tendon.set("springlength", "0 0")

        return Effect("joint_elasticity", j, xml=xml)

    return Sized("joint_elasticity", j, make, most=6.0)


def backlash(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """A gear with a dead zone between stiff flanks."""

    def make(scale: float) -> Effect:
        def xml(root: ET.Element) -> None:
            stiffness, damping = _stiffness(arm, j, 50.0)
            tendon, half = _geared(root, arm, j, "gap"), 0.5 * 0.003 * scale
            tendon.set("stiffness", repr(stiffness))
            tendon.set("damping", repr(0.3 * damping))
            tendon.set("springlength", f"{-half!r} {half!r}")

        return Effect("backlash", j, xml=xml)

    return Sized("backlash", j, make, most=5.0)


def torque_ripple(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Cogging, mesh or commutation: a sine of the motor's angle, or of the gear's."""
    order = arm.drives[j].ratio if rng.random() < 0.5 else float(rng.integers(6, 40))
    phase, law = float(rng.uniform(0.0, 6.3)), rng.choice(["constant", "torque"])

    def make(scale: float) -> Effect:
        def push(state: State) -> Array:
            wave = scale * float(np.sin(order * state.q[j] + phase))
            size = 0.3 * arm.drives[j].coulomb if law == "constant" else 0.05 * state.load[j]
            return only(arm, j, float(size) * wave)

        return Effect("torque_ripple", j, push=push)

    return Sized("torque_ripple", j, make)


def external_contact(arm: Arm, j: int, rng: np.random.Generator) -> Sized:
    """Somebody pushes the last body, once in every log."""
    start, seconds = float(rng.uniform(2.0, 3.0)), float(10.0 ** rng.uniform(-0.5, 0.6))
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)

    def make(scale: float) -> Effect:
        def flange(t: float) -> Array:
            wave = np.sin(np.pi * np.clip((t - start) / seconds, 0.0, 1.0))
            return np.asarray(2.0 * scale * GRAVITY * arm.links[-1].mass * wave * way)

        return Effect("external_contact", None, flange=flange)

    return Sized("external_contact", None, make)
