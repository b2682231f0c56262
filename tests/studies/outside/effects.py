"""What a model can lack, and how it acts on the simulated arm:
by MuJoCo's own means.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from tests import Array
from tests.studies.outside.arms import GRAVITY, Arm
from tests.studies.outside.robotfiles import FRICTION, STEP_S, row
from tests.studies.outside.simulate import Effect, State, built

Draw = Callable[[Arm, int, np.random.Generator], Effect]
POSTURES = 25  # over which the inertia that hangs on a belt is taken


def found(root: ET.Element, path: str) -> ET.Element:
    element = root.find(path)
    assert element is not None, path
    return element


def joint_of(root: ET.Element, arm: Arm, j: int) -> ET.Element:
    return found(root, f".//joint[@name='{arm.names[j]}']")


def stribeck(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    slow = float(rng.uniform(0.03, 0.12)) * arm.links[j].speed
    power, size = float(rng.uniform(0.8, 2.0)), 0.8 * arm.drives[j].coulomb
    return Effect(
        j,
        dry=lambda c, base, now: c * size * np.exp(-((abs(now.dq[j]) / slow) ** power)),
        most=4.0,
    )


def spring(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A hose: the joint's own stiffness about a place of its own."""
    rest = arm.links[j].middle + float(rng.uniform(-0.8, 0.8)) * arm.links[j].reach

    def xml(scale: float, root: ET.Element) -> None:
        stiffness = repr(scale * arm.drives[j].coulomb)
        joint_of(root, arm, j).attrib.update(stiffness=stiffness, springref=repr(rest))

    return Effect(j, xml=xml)


def torque_bias(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A current sensor with an offset."""
    side, level = float(rng.choice([-1.0, 1.0])), arm.drives[j].coulomb
    return Effect(j, told=lambda scale, tau, t: tau + 0.4 * side * scale * level)


def payload(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A body that the last link carries."""
    last = arm.links[-1]
    far = 2.0 * last.centre + rng.normal(0.0, 0.02, 3)

    def xml(scale: float, root: ET.Element) -> None:
        mass = scale * 0.3 * last.mass
        link = found(root, f".//body[@name='l{len(arm.links) - 1}']")
        body = ET.SubElement(link, "body", pos=row(far))
        size = row(np.full(3, 0.4 * mass * 0.03**2))
        ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=size)

    return Effect(None, xml=xml, most=8.0)


def load_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Dry friction that grows with the torque that the gear carries."""
    return Effect(
        j, dry=lambda scale, base, now: 0.08 * scale * abs(now.load[j]), most=3.0
    )


def torque_ripple(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Cogging, mesh or commutation: a sine of the motor's angle, or of the gear's."""
    order = arm.drives[j].ratio if rng.random() < 0.5 else float(rng.integers(6, 40))
    phase, law = float(rng.uniform(0.0, 6.3)), rng.choice(["constant", "torque"])

    def push(scale: float, state: State) -> float:
        size = (
            0.3 * arm.drives[j].coulomb if law == "constant" else 0.05 * state.load[j]
        )
        return size * (scale * np.sin(order * state.q[j] + phase))

    return Effect(j, push=push)


def time_skew(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Torques that are logged late, or early, against the positions."""
    joint, side = j if rng.random() < 0.5 else None, float(rng.choice([-1.0, 1.0]))
    return Effect(
        joint, told=lambda c, tau, t: np.interp(t - side * 0.003 * c, t, tau), most=8.0
    )


def friction_change(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Dry and viscous friction of one joint that have become larger, or smaller."""
    dry, viscous = (1.0, 0.8) if rng.random() < 0.7 else (-0.4, 0.0)
    return Effect(
        j,
        dry=lambda c, base, now: base * np.clip(0.4 * c * dry, -0.8, 4.0),
        push=lambda c, now: -(0.4 * c * viscous * arm.drives[j].viscous) * now.dq[j],
        most=8.0 if dry > 0 else 4.0,
    )


def _geared(root: ET.Element, arm: Arm, j: int, stiffness: float) -> ET.Element:
    """Give a joint's motor a body of its own; return the tendon that is its gear, of a
    stiffness in N m/rad.
    """
    joint = joint_of(root, arm, j)
    body = next(b for b in root.iter("body") if joint in list(b))
    parent = next(p for p in root.iter() if body in list(p))
    place = {"pos": body.get("pos", "0 0 0"), "euler": body.get("euler", "0 0 0")}
    motor = ET.SubElement(parent, "body", place)
    ET.SubElement(
        motor, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-9 1e-9 1e-9"
    )
    ET.SubElement(motor, "joint", {**joint.attrib, "name": f"{arm.names[j]}_motor"})
    joint.attrib.update(armature="0", damping="0", frictionloss="0")
    tendon = ET.SubElement(found(root, "tendon"), "fixed", stiffness=repr(stiffness))
    ET.SubElement(tendon, "joint", joint=arm.names[j], coef="1")
    ET.SubElement(tendon, "joint", joint=f"{arm.names[j]}_motor", coef="-1")
    return tendon


def _ringing(arm: Arm, j: int, hertz: float) -> tuple[float, float]:
    """Return stiffness and damping of a gear whose rotor rings at a frequency against a
    held link.
    """
    rotor = arm.drives[j].rotor
    stiffness = float(rotor * (2.0 * np.pi * hertz) ** 2)
    return stiffness, float(0.1 * np.sqrt(stiffness * rotor))


def joint_elasticity(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A gear that twists: motor and link are two bodies with a spring between them."""

    def xml(scale: float, root: ET.Element) -> None:
        stiffness, damping = _ringing(arm, j, 25.0 / np.sqrt(scale))
        tendon = _geared(root, arm, j, stiffness)
        tendon.attrib.update(damping=repr(damping), springlength="0 0")

    return Effect(j, xml=xml, most=6.0)


def _drag(arm: Arm, j: int, power: float) -> Effect:
    def push(scale: float, state: State) -> float:
        v = float(state.dq[j]) / arm.links[j].speed
        return -(scale * arm.drives[j].coulomb) * np.sign(v) * abs(v) ** power

    return Effect(j, push=push)


def nonlinear_viscous(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Shear-thinning grease, or worse than quadratic."""
    return _drag(arm, j, float(rng.choice([0.5, 0.6, 3.0])))


def torque_constant(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """More amperes per newton metre than before."""
    side = float(rng.choice([-1.0, 1.0]))
    return Effect(
        j, told=lambda scale, tau, t: (1.0 + 0.05 * side * scale) * tau, most=6.0
    )


def external_contact(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Somebody pushes the last body, once in every log."""
    start, seconds = float(rng.uniform(2.0, 3.0)), float(10.0 ** rng.uniform(-0.5, 0.6))
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)

    def flange(scale: float, t: float) -> Array:
        wave = np.sin(np.pi * np.clip((t - start) / seconds, 0.0, 1.0))
        return 2.0 * scale * GRAVITY * arm.links[-1].mass * wave * way

    return Effect(None, flange=flange)


def asymmetric_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    side = float(rng.choice([-0.4, 0.4]))

    def dry(scale: float, base: float, state: State) -> float:
        return base * np.clip(scale * side * np.sign(state.dq[j]), -0.9, 0.9)

    return Effect(j, dry=dry, most=2.0)


def base_tilt(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A base that stands askew."""
    way = float(rng.uniform(0.0, 6.3))

    def xml(scale: float, root: ET.Element) -> None:
        angle = np.radians(2.0) * scale
        level = np.sin(angle) * np.array([np.cos(way), np.sin(way)])
        down = -GRAVITY * np.array([*level, np.cos(angle)])
        found(root, "option").set("gravity", row(down))

    return Effect(None, xml=xml, most=5.0)


def drift(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """An offset that creeps while the drive warms up."""
    side, level = float(rng.choice([-1.0, 1.0])), arm.drives[j].coulomb
    return Effect(j, told=lambda scale, tau, t: tau + side * scale * level * t / 60.0)


def gear_efficiency(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Losses in proportion to the load, of their own while driving and while driven."""
    driving, driven = (0.15, 0.03) if rng.random() < 0.5 else (0.06, 0.15)

    def dry(scale: float, base: float, state: State) -> float:
        load = state.load[j]
        return scale * abs(load) * (driving if load * state.dq[j] >= 0.0 else driven)

    return Effect(j, dry=dry, most=3.0)


def backlash(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A gear with a dead zone between stiff flanks."""

    def xml(scale: float, root: ET.Element) -> None:
        stiffness, damping = _ringing(arm, j, 50.0)
        tendon = _geared(root, arm, j, stiffness)
        half = 0.5 * 0.003 * scale
        tendon.attrib.update(
            damping=repr(0.3 * damping), springlength=f"{-half!r} {half!r}"
        )

    return Effect(j, xml=xml, most=5.0)


def encoder_eccentricity(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A disc off centre, on the joint's own shaft or the motor's: the controller
    believes it.
    """
    slow = rng.random() < 0.6
    order = float(rng.choice([1.0, 2.0])) if slow else arm.drives[j].ratio
    size, phase = (0.01 if slow else 0.02 / order), float(rng.uniform(0.0, 6.3))
    return Effect(
        j, angle=lambda scale, q: scale * size * np.sin(order * q + phase), most=5.0
    )


def presliding_hysteresis(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Bristles carry a part of the dry friction; they bend before they slide (Dahl)."""
    settle = float(10.0 ** rng.uniform(-2.3, -1.4))  # rad

    def part(scale: float) -> float:
        return min(scale, 1.0) * (1.0 - arm.drives[j].waviness) * arm.drives[j].coulomb

    def push(scale: float, state: State) -> float:
        x, way = state.memory.get("bristle", 0.0), state.dq[j] * STEP_S
        side = np.sign(way)
        bent = (
            side + (x - side) * np.exp(-abs(way) / (settle * max(scale, 1.0)))
            if way
            else x
        )
        state.memory["bristle"] = bent
        return -part(scale) * bent

    return Effect(j, dry=lambda scale, base, now: -part(scale), push=push, most=4.0)


def transmission_coupling(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A part of a joint's drive turns with the joint before it as well: a tendon over
    both.
    """
    other = j - 1 if j else 1
    turns, drive = float(rng.choice([-1.0, 1.0])), arm.drives[j]

    def xml(scale: float, root: ET.Element) -> None:
        part = min(scale, 1.0)
        joint_of(root, arm, j).set("damping", repr((1.0 - part) * drive.viscous))
        losses = {
            "damping": repr(part * drive.viscous),
            "frictionloss": repr(part * drive.coulomb),
        }
        tendon = ET.SubElement(found(root, "tendon"), "fixed", losses | FRICTION)
        ET.SubElement(tendon, "joint", joint=arm.names[j], coef="1")
        ET.SubElement(tendon, "joint", joint=arm.names[other], coef=repr(turns))

    return Effect(
        j,
        xml=xml,
        dry=lambda c, base, now: -(min(c, 1.0) * base),
        partner=other,
        most=1.0,
    )


def torque_saturation(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Iron that saturates: more and more amperes for the last newton metres."""
    rated = 10.0 * arm.drives[j].coulomb
    return Effect(
        j, told=lambda c, tau, t: tau * (1.0 + 0.05 * c * (tau / rated) ** 2), most=6.0
    )


def quadratic_drag(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Churning grease."""
    return _drag(arm, j, 2.0)


def rotor_inertia(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Another motor than before: a heavier rotor."""

    def xml(scale: float, root: ET.Element) -> None:
        rotor = (1.0 + 0.5 * scale) * arm.drives[j].rotor
        joint_of(root, arm, j).set("armature", repr(rotor))

    return Effect(j, xml=xml, most=8.0)


def periodic_disturbance(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A pump, a fan or the mains in the current sensor."""
    hertz, phase = (
        float(rng.choice([3.7, 8.3, 14.6, 29.5, 50.0])),
        float(rng.uniform(0.0, 6.3)),
    )
    level, pace = arm.drives[j].coulomb, 2.0 * np.pi * hertz
    return Effect(
        j, told=lambda c, tau, t: tau + 0.3 * c * level * np.sin(pace * t + phase)
    )


def thermal_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Grease that thins while the gear warms up: an exponential of the temperature."""

    def less(scale: float, state: State) -> float:
        return np.expm1(-0.02 * scale * state.warmth[j])

    def push(scale: float, state: State) -> float:
        return -arm.drives[j].viscous * less(scale, state) * state.dq[j]

    return Effect(
        j, dry=lambda c, base, now: 0.5 * base * less(c, now), push=push, most=5.0
    )


def actuator_lag(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """The log holds what was commanded; the drive follows it with a lag."""
    joint = j if rng.random() < 0.5 else None

    def drive(scale: float, torque: Array, state: State) -> Array:
        acting = state.memory.get("acting", torque)
        step = 1.0 - np.exp(-STEP_S / (0.003 * scale))
        state.memory["acting"] = acting + step * (torque - acting)
        late = (joint is None) | (np.arange(arm.n) == joint)
        return np.where(late, state.memory["acting"], torque)

    return Effect(joint, drive=drive, most=4.0)


def position_dependent_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    waves, phase = float(rng.choice([1.0, 2.0, 3.0, 5.0])), float(rng.uniform(0.0, 6.3))
    return Effect(
        j,
        dry=lambda c, base, now: (
            min(0.4 * c, 0.95) * base * np.sin(waves * now.q[j] + phase)
        ),
        most=2.3,
    )


def joint_zero(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """An encoder whose zero has been moved: the controller believes it."""
    side = float(rng.choice([-1.0, 1.0]))
    return Effect(
        j, angle=lambda scale, q: 0.01 * side * scale, settled=True, most=10.0
    )


def torque_filter(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A driver that averages the torques of all joints before it reports them."""

    def told(scale: float, tau: Array, t: Array) -> Array:
        width = max(int(0.02 * scale / STEP_S), 1)
        padded = np.concatenate([np.full(width - 1, tau[0]), tau])
        return np.convolve(padded, np.full(width, 1.0 / width), "valid")

    return Effect(None, told=told, most=15.0)


def hysteresis(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A rope or a hose that rubs within itself: it takes tenths of a radian to turn."""
    settle = float(rng.uniform(0.1, 0.3))  # rad

    def push(scale: float, state: State) -> float:
        way = float(state.dq[j]) * STEP_S
        bent = state.memory.get("rope", np.zeros(()))
        bent = bent + (abs(way) / settle) * (np.sign(way) - bent)
        state.memory["rope"] = bent
        return -0.4 * scale * arm.drives[j].coulomb * float(bent)

    return Effect(j, push=push)


def belt(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A belt: with the motor held, the arm rings on it at 8 to 20 Hz, in the posture
    between those where it is lightest and heaviest.
    """
    hertz = float(np.exp(rng.uniform(np.log(8.0), np.log(20.0))))
    links = arm.links[: arm.n]
    middle, reach = (
        np.array([getattr(x, k) for x in links]) for k in ("middle", "reach")
    )
    model = built(arm)
    data = mujoco.MjData(model)
    felt = list[float]()
    # Of an arm that stands upright a turntable feels next to nothing.
    for _ in range(POSTURES):
        data.qpos[:] = middle + rng.uniform(-1.0, 1.0, arm.n) * reach
        mujoco.mj_forward(model, data)
        full = np.zeros((arm.n, arm.n))
        mujoco.mj_fullM(model, data, full)
        felt.append(float(full[j, j]) - arm.drives[j].rotor)
    inertia = float(np.median(felt))
    stiffness = inertia * (2.0 * np.pi * hertz) ** 2
    damping = 0.06 * np.sqrt(stiffness * inertia)  # 3 % of the critical one

    def xml(scale: float, root: ET.Element) -> None:
        tendon = _geared(root, arm, j, stiffness)
        tendon.attrib.update(damping=repr(float(damping)), springlength="0 0")

    return Effect(j, xml=xml, most=1.0, name="joint_elasticity")


# In this order they come to the seeds.
_ORDER = """
stribeck spring torque_bias payload load_dependent_friction torque_ripple time_skew
friction_change joint_elasticity nonlinear_viscous torque_constant external_contact
asymmetric_friction base_tilt drift gear_efficiency backlash encoder_eccentricity
presliding_hysteresis transmission_coupling torque_saturation quadratic_drag
rotor_inertia periodic_disturbance thermal_friction actuator_lag
position_dependent_friction
"""


def named(name: str, draw: Draw) -> Draw:
    """Return a drawing whose effects have a name."""
    return lambda arm, j, rng: replace(draw(arm, j, rng), name=name)


KINDS = {name: named(name, globals()[name]) for name in _ORDER.split()}

# The mixed cases were drawn before these were in the catalogue, and stay as they are.
MORE: dict[str, Draw] = {
    "joint_zero": named("joint_zero", joint_zero),
    "torque_filter": named("torque_filter", torque_filter),
    "hysteresis": named("hysteresis", hysteresis),
}
