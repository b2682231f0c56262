"""Laws that no catalogue has, each at one joint of an arm of two or more.

None of them has a right name. `score.QUANTITIES` says on what each may rightly be said
to depend.
"""

import numpy as np

from tests.studies.outside.arms import Arm
from tests.studies.outside.effects import Draw, named
from tests.studies.outside.robotfiles import STEP_S
from tests.studies.outside.simulate import Effect, State


def _other(arm: Arm, j: int) -> int:
    """Return the joint before, or after the first: the one that a law looks at."""
    return j - 1 if j else 1


def friction_of_neighbours_load(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Dry friction that grows with the torque that another joint's gear carries."""
    other = _other(arm, j)
    level = arm.drives[j].coulomb / (3.0 * arm.drives[other].coulomb)

    def dry(scale: float, base: float, state: State) -> float:
        return 0.3 * scale * level * abs(state.load[other])

    return Effect(j, dry=dry)


def friction_of_neighbours_speed(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Dry friction that grows with another joint's speed: a bearing that it loads."""
    other = _other(arm, j)
    fast = arm.links[other].speed

    def dry(scale: float, base: float, state: State) -> float:
        return scale * base * abs(state.dq[other]) / fast

    return Effect(j, dry=dry)


def product_of_speeds(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A torque in the product of two joints' velocities, at one of them."""
    other, side = _other(arm, j), float(rng.choice([-1.0, 1.0]))
    level = side * arm.drives[j].coulomb / (arm.links[j].speed * arm.links[other].speed)

    def push(scale: float, state: State) -> float:
        return 2.0 * scale * level * state.dq[j] * state.dq[other]

    return Effect(j, push=push)


def hose_over_two_joints(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A hose that lies over two joints: a wave of a sum of their angles."""
    other, phase = _other(arm, j), float(rng.uniform(0.0, 6.3))
    turns = rng.choice([-1.0, 1.0], 2) * rng.uniform(1.0, 2.5, 2)

    def push(scale: float, state: State) -> float:
        angle = turns[0] * state.q[j] + turns[1] * state.q[other] + phase
        return 0.4 * scale * arm.drives[j].coulomb * np.sin(angle)

    return Effect(j, push=push)


def remembered_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Grease that motion of the last seconds has thinned, and rest thickens again."""
    seconds = float(rng.uniform(1.0, 4.0))
    fast = 0.3 * arm.links[j].speed

    def dry(scale: float, base: float, state: State) -> float:
        thinned = state.memory.get("thinned", np.zeros(()))
        way = min(abs(float(state.dq[j])) / fast, 1.0)
        state.memory["thinned"] = thinned + (STEP_S / seconds) * (way - thinned)
        return -min(0.5 * scale, 0.95) * base * float(thinned)

    return Effect(j, dry=dry, most=1.9)


def torque_of_warmth(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """An offset in the cube of a winding's warmth, which no log has: motion warms it
    within seconds, and it begins cold.
    """
    side, seconds = float(rng.choice([-1.0, 1.0])), float(rng.uniform(3.0, 9.0))
    fast = 0.3 * arm.links[j].speed

    def push(scale: float, state: State) -> float:
        warmth = state.memory.get("winding", np.zeros(()))
        heat = min(abs(float(state.dq[j])) / fast, 1.5)
        state.memory["winding"] = warmth + (STEP_S / seconds) * (heat - warmth)
        return side * scale * arm.drives[j].coulomb * float(warmth) ** 3

    # It is larger in longer logs than in the short one by which sizes are drawn.
    return Effect(j, push=push, most=4.0)


def bumper(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A rubber stop on one side of the range, in the square of how far it is bent."""
    link, side = arm.links[j], float(rng.choice([-1.0, 1.0]))
    begins = float(rng.uniform(0.0, 0.4))  # of the reach, from the middle

    def push(scale: float, state: State) -> float:
        bent = side * (state.q[j] - link.middle) / link.reach - begins
        return -2.0 * side * scale * arm.drives[j].coulomb * max(bent, 0.0) ** 2

    return Effect(j, push=push)


def step_over_speed(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """A drive that loses torque from a speed on."""
    fast = float(rng.uniform(0.25, 0.5)) * arm.links[j].speed

    def push(scale: float, state: State) -> float:
        v = float(state.dq[j])
        over = 0.5 * (1.0 + np.tanh((abs(v) - fast) / (0.02 * arm.links[j].speed)))
        return -0.4 * scale * arm.drives[j].coulomb * np.sign(v) * over

    return Effect(j, push=push)


def breathing_friction(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
    """Dry friction that swells and falls with a clock: a brake that does not let go."""
    seconds, phase = float(rng.uniform(3.0, 9.0)), float(rng.uniform(0.0, 6.3))

    def dry(scale: float, base: float, state: State) -> float:
        wave = np.sin(2.0 * np.pi * state.t / seconds + phase)
        return min(0.4 * scale, 0.95) * base * wave

    return Effect(j, dry=dry, most=2.3)


_LAWS: tuple[Draw, ...] = (
    friction_of_neighbours_load,
    product_of_speeds,
    remembered_friction,
    torque_of_warmth,
    bumper,
    friction_of_neighbours_speed,
    hose_over_two_joints,
    step_over_speed,
    breathing_friction,
)
# In this order they come to the seeds.
FOREIGN: dict[str, Draw] = {law.__name__: named(law.__name__, law) for law in _LAWS}
