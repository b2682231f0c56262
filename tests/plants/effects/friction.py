"""Undeclared friction and springs of one joint, sized by the joint's rated torque.

Every function takes (plant, joint, size) and returns the plant that has the effect as
well. Size 1 is clear, about 5 % of rated torque (`CLEAR`) where the docstring says
nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, exp

import numpy as np

from tests import Array
from tests.plants.friction.laws import Bristles, Curve, Extra, Heat, MeshLoss, Warming
from tests.plants.mechanics.hidden import Run, TorqueSource
from tests.plants.mechanics.rigid import Rigid
from tests.plants.simulate import Plant

CLEAR = 0.05  # share of rated torque at size 1
# share of the limits of speed and acceleration that busy motion uses at once
BUSY = 0.6
WARMING = 20.0  # K, after hours of usual work, with a time constant of 300 s


def rated_torque(plant: Plant) -> Array:
    """Largest torque of busy motion in 400 random states, friction included,
    (n,) N m.
    """
    rng = np.random.default_rng(0)
    rigid, law = Rigid(plant.arm), plant.friction.begin()
    most = np.zeros(plant.arm.n)
    for _ in range(400):
        q = rng.uniform(*plant.position_limits.T)
        dq, ddq = rng.uniform(-BUSY, BUSY, (2, plant.arm.n))
        dq, ddq = dq * plant.velocity_limits, ddq * plant.acceleration_limits
        rub = law(0.0, q, dq, np.zeros(plant.arm.n)).sliding(dq)
        most = np.maximum(most, np.abs(rigid.inverse(q, dq, ddq) + rub))
    return most


def dry_level(plant: Plant, joint: int) -> float:
    """Smaller dry level of a joint at a third of its top speed, N m."""
    dq = plant.velocity_limits / 3.0
    dry = plant.friction.begin()(
        0.0, plant.position_limits.mean(axis=1), dq, np.zeros_like(dq)
    )
    return float(min(dry.forward[joint], dry.backward[joint]))


def clear(plant: Plant, joint: int, size: float) -> float:
    """`size` times 5 % of the joint's rated torque, N m."""
    return CLEAR * size * float(rated_torque(plant)[joint])


def _add(plant: Plant, joint: int, curve: Curve) -> Plant:
    return replace(plant, friction=Extra(plant.friction, joint, curve))


def _level(
    plant: Plant, joint: int, most: float, share: Callable[[float, float], float]
) -> Plant:
    """`most` N m more dry friction both ways, times a share that depends on q and v."""
    return _add(
        plant, joint, lambda q, v, load: (most * share(q, v), most * share(q, v), 0.0)
    )


def stribeck(plant: Plant, joint: int, size: float) -> Plant:
    """Stribeck hump; its speed is 6 % of the top speed."""
    speed = 0.06 * float(plant.velocity_limits[joint])
    return _level(
        plant, joint, clear(plant, joint, size), lambda q, v: exp(-((v / speed) ** 2))
    )


def asymmetric(plant: Plant, joint: int, size: float) -> Plant:
    """More dry friction forward, less backward, by at most 80 % of the level."""
    more = min(clear(plant, joint, size), 0.8 * dry_level(plant, joint))
    return _add(plant, joint, lambda q, v, load: (more, -more, 0.0))


def load_dependent(plant: Plant, joint: int, size: float) -> Plant:
    """10 % of the transmitted torque times size: 5 % of rated at half of it."""
    return _add(plant, joint, MeshLoss(0.10 * size, 0.10 * size))


def gear_efficiency(plant: Plant, joint: int, size: float) -> Plant:
    """15 % of the transmitted torque is lost when driving, 3 % when back-driven, times
    size.
    """
    return _add(plant, joint, MeshLoss(0.15 * size, 0.03 * size))


def _power(
    plant: Plant, joint: int, size: float, share: float, exponent: float
) -> Plant:
    """Viscous friction factor |v|^exponent sign(v), clear at a share of the top speed.

    Below an exponent of 1 it counts as dry, so that it is not stiff at rest.
    """
    top = share * float(plant.velocity_limits[joint])
    factor = clear(plant, joint, size) / top**exponent

    def curve(q: float, v: float, load: float) -> tuple[float, float, float]:
        size = factor * abs(v) ** exponent
        if exponent < 1.0:
            return size, size, 0.0
        return 0.0, 0.0, size if v > 0 else -size

    return _add(plant, joint, curve)


def quadratic_drag(plant: Plant, joint: int, size: float) -> Plant:
    """c v |v|; clear at 80 % of the top speed."""
    return _power(plant, joint, size, 0.8, 2.0)


def cubic_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c v^3; clear at 80 % of the top speed."""
    return _power(plant, joint, size, 0.8, 3.0)


def root_viscous(plant: Plant, joint: int, size: float) -> Plant:
    """c |v|^0.5 sign(v); clear at 40 % of the top speed."""
    return _power(plant, joint, size, 0.4, 0.5)


def presliding(plant: Plant, joint: int, size: float) -> Plant:
    """Bristles (LuGre) that slip after 20 mrad times size at the joint."""
    stiffness = dry_level(plant, joint) / (0.020 * size)
    damping = 0.3 * np.sqrt(stiffness * float(plant.arm.reflected[joint]))
    return replace(plant, friction=Bristles(plant.friction, joint, stiffness, damping))


def level_wave(plant: Plant, joint: int, size: float) -> Plant:
    """Coulomb level that varies as cos(3 q), by at most 80 % of it."""
    more = min(clear(plant, joint, size), 0.8 * dry_level(plant, joint))
    return _level(plant, joint, more, lambda q, v: cos(3.0 * q))


def thermal(plant: Plant, joint: int, size: float) -> Plant:
    """Warm gears turn more easily: 20 K take a clear torque off the viscous one at top
    speed.

    They warm up at 30 % of that speed.
    """
    middle, zero = plant.position_limits.mean(axis=1), np.zeros(plant.arm.n)
    dq = 0.3 * plant.velocity_limits
    dry = plant.friction.begin()(0.0, middle, dq, zero)
    usual = (dry.forward + dry.smooth) * dq
    loss = usual / WARMING
    heat = Heat(capacity=300.0 * loss, loss=loss, usual=usual)
    viscous = plant.friction.begin()(0.0, middle, plant.velocity_limits, zero).smooth
    share = min(clear(plant, joint, size) / float(viscous[joint]), 0.6)
    thinning = at(plant, joint, -np.log1p(-share) / WARMING)
    return replace(plant, friction=Warming(plant.friction, heat, thinning), heat=heat)


def at(plant: Plant, joint: int, value: float) -> Array:
    """Zero everywhere but at one joint, (n,)."""
    out = np.zeros(plant.arm.n)
    out[joint] = value
    return out


def place_of(plant: Plant, joint: int, share: float = 0.0) -> tuple[float, float]:
    """A place at a share of the way from the middle of a joint's range, half of that
    range, rad.
    """
    low, high = plant.position_limits[joint]
    half = float(0.5 * (high - low))
    return float(0.5 * (low + high)) + share * half, half


def source_on(joint: int, law: Callable[[Array, Array], float]) -> TorqueSource:
    """A torque law(q, dq) N m on one joint, both (n,)."""

    def source(t: float, q: Array, dq: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = law(q, dq)
        return out

    return source


def on_joint(plant: Plant, joint: int, law: Callable[[Array, Array], float]) -> Plant:
    return plant.hiding(torques=lambda run: source_on(joint, law))


@dataclass(frozen=True)
class LinearSpring:
    """-stiffness (q - rest) on one joint; N m/rad, rad."""

    joint: int
    stiffness: float
    rest: float

    def __call__(self, run: Run) -> TorqueSource:
        return source_on(
            self.joint, lambda q, dq: -self.stiffness * (q[self.joint] - self.rest)
        )


def spring(plant: Plant, joint: int, size: float) -> Plant:
    """Linear spring; clear at 60 % of the way from its rest, near the middle, to the
    end.
    """
    rest, half = place_of(plant, joint, 0.1)
    return plant.hiding(
        torques=LinearSpring(joint, clear(plant, joint, size) / (0.6 * half), rest)
    )


def rope(plant: Plant, joint: int, size: float) -> Plant:
    """Rope that rubs, by Bouc and Wen with an exponent of 1.5; a tenth of the range
    settles it.

    Its state is integrated step by step over the link's motion.
    """
    torque, settles = clear(plant, joint, size), 0.2 * place_of(plant, joint)[1]

    def begin(run: Run) -> TorqueSource:
        state = 0.0

        def law(q: Array, dq: Array) -> float:
            nonlocal state
            rate = float(dq[joint]) / settles
            if rate * state > 0.0:
                rate *= 1.0 - abs(state) ** 1.5
            state += rate * run.dt
            return -torque * state

        return source_on(joint, law)

    return plant.hiding(torques=begin)


def counterbalance(plant: Plant, joint: int, size: float) -> Plant:
    """Coil spring between a point of either link, always in tension; at most four times
    clear.

    Distances are in that of the point on the base from the axis: `arm` that of the
    other, `slack` the spring's length without tension. Its torque is minus the slope of
    its energy.
    """
    arm, slack = 0.3, 0.5
    middle, half = place_of(plant, joint)

    def torque(q: float, stiffness: float) -> float:
        angle = q - (middle - 0.5)
        length = float(np.sqrt(1.0 + arm**2 - 2.0 * arm * np.cos(angle)))
        pull = stiffness * max(length - slack, 0.0)
        return -pull * arm * float(np.sin(angle)) / length

    most = max(
        abs(torque(q, 1.0)) for q in np.linspace(middle - half, middle + half, 200)
    )
    stiffness = 4.0 * clear(plant, joint, size) / most
    return on_joint(plant, joint, lambda q, dq: torque(float(q[joint]), stiffness))
