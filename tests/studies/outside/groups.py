"""Groups of cases: every seed is one case of each.

`mixed` draws from everything (`plan`); each of the others asks one thing.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tests import Array
from tests.studies.outside import motions, plan
from tests.studies.outside.arms import Arm, drawn_arm, published_links
from tests.studies.outside.changes import CHANGES
from tests.studies.outside.effects import KINDS, MORE, Draw, belt
from tests.studies.outside.foreign import FOREIGN
from tests.studies.outside.plan import (
    COMES_LATER,
    LEAST,
    MOST,
    PUBLISHED,
    Asked,
    Case,
    Flow,
    Outline,
    sized,
)
from tests.studies.outside.pushes import Push, Shape, pushed
from tests.studies.outside.robotfiles import STEP_S
from tests.studies.outside.simulate import Effect, controller

CATALOGUE: dict[str, Draw] = {**KINDS, **MORE}
LATER = {*COMES_LATER, "joint_zero"}
SHOWS = 0.03  # of the joint's torque, RMS: the least that is drawn where it has to show
DRAWS = 4  # of joint and law, until an effect is large enough
IDENTIFIED_BEFORE: tuple[Flow, ...] = ("late", "late", "step_late")
SEVEN = ("panda", "xarm7")
SEVEN_FLOWS: tuple[Flow, ...] = ("late", "late", "early", "step_late")
# A file of one step lacks friction over the position, which hides what else is there.
FOREIGN_FLOWS: tuple[Flow, ...] = ("late", "late", "early")
CLEAN_FLOWS: tuple[Flow, ...] = ("late", "late", "step_late", "single")
BELT_FLOWS: tuple[Flow, ...] = ("late", "early", "step_late", "step_early")
LENGTHS_S = (0.2, 1.0, 3.0, 6.0, 10.0, 20.0)  # of pushes, as the tables sort them


def clean(seed: int) -> Case:
    """Nothing is missing."""
    outline = _outline("clean", seed, (), CLEAN_FLOWS)
    return Case(outline, _arm("clean", outline), (), (), "clean")


def singles(seed: int) -> Case:
    """One effect of the catalogue that shows, of each sort in turn."""
    kind = [*CATALOGUE][seed % len(CATALOGUE)]
    outline = _outline("singles", seed, (kind,), plan.FLOWS)
    return _alone("singles", outline, CATALOGUE[kind])


def pushes(seed: int) -> Case:
    """Somebody pushes the flange for 0.2 to 20 s, in one of two logs or in both."""
    outline = _outline("pushes", seed, ("external_contact",), IDENTIFIED_BEFORE)
    arm, rng = _arm("pushes", outline), _rng("pushes", seed, 79)
    is_pushed = rng.permutation([True, bool(rng.random() < 0.3)])
    logs, times, shares = list[Asked](), list[Push](), list[float]()
    effects = list[Effect]()
    for number, one_pushes in enumerate(is_pushed):
        seconds = _logarithmic(rng, 0.2, 20.0)
        motion = _motion(arm, rng, max(18.0, 1.6 * seconds + 4.0))
        if not one_pushes:
            logs.append(Asked(motion, ()))
            continue
        shape = Shape(seconds=seconds, is_plateau=bool(rng.random() < 0.5))
        share = _logarithmic(rng, 2.0 * LEAST, 1.5 * MOST)
        effect, push = pushed(
            arm,
            motion,
            log=number,
            shape=shape,
            share=share,
            usual=_usual_torque(arm, motion),
            rng=rng,
        )
        logs.append(Asked(motion, (effect,)))
        effects.append(effect)
        times.append(push)
        shares.append(share)
    return Case(
        outline,
        arm,
        tuple(effects[:1]),
        (max(shares),),
        "pushes",
        _length(max(push.end - push.start for push in times)),
        tuple(logs),
        tuple(times),
    )


def changes(seed: int) -> Case:
    """The arm is no longer as it was identified: in both logs, or in the second."""
    variant = [*CHANGES][seed % len(CHANGES)]
    draw = CHANGES[variant]
    in_both = (seed + seed // len(CHANGES)) % 2 == 0
    outline = _outline("changes", seed, (variant,), IDENTIFIED_BEFORE)
    arm, rng = _arm("changes", outline), _rng("changes", seed, 79)
    effect, share = _shown(arm, draw, rng)
    outline = replace(outline, kinds=(effect.name,))
    first, second = (_motion(arm, rng, 18.0) for _ in range(2))
    logs = (Asked(first, (effect,) if in_both else ()), Asked(second, (effect,)))
    when = "before the logs" if in_both else "between two logs"
    return Case(
        outline, arm, (effect,), (share,), "changes", f"{variant}, {when}", logs
    )


def foreign(seed: int) -> Case:
    """One law that no catalogue has, of each sort in turn."""
    kind = [*FOREIGN][seed % len(FOREIGN)]
    outline = _outline("foreign", seed, (kind,), FOREIGN_FLOWS, joints=(2, 2, 3))
    return _alone("foreign", outline, FOREIGN[kind])


def belts(seed: int) -> Case:
    """A belt at one joint, and IMUs behind it."""
    outline = _outline("belts", seed, ("joint_elasticity",), BELT_FLOWS, imus=True)
    arm, rng = _arm("belts", outline), _rng("belts", seed, 79)
    # A stiffer position loop would not be stable against a rotor behind a belt.
    arm = replace(arm, bandwidth=float(rng.uniform(20.0, 45.0)))
    effect = belt(arm, int(rng.integers(arm.n)), rng)
    return Case(outline, arm, (effect,), (0.0,), "belts")


def walks(seed: int) -> Case:
    """Via-point walks faster and further than the friction trials; every fourth arm is
    clean.
    """
    kinds = _kinds_in_turn(seed)
    outline = _outline("walks", seed, kinds, ("late", "late", "early", "step_late"))
    case = _alone("walks", outline, CATALOGUE[kinds[0]] if kinds else None)
    rng = _rng("walks", seed, 80)
    walked = [Asked(motions.walk(case.arm, rng, 18.0), case.effects) for _ in range(2)]
    return replace(case, asked=tuple(walked))


def periodic(seed: int) -> Case:
    """Periodic excitation of 30 to 60 s; every fourth arm is clean."""
    kinds = _kinds_in_turn(seed)
    outline = _outline("periodic", seed, kinds, ("late", "early", "step_late"))
    case = _alone("periodic", outline, CATALOGUE[kinds[0]] if kinds else None)
    rng = _rng("periodic", seed, 80)
    logs = []
    for _ in range(2):
        seconds = float(rng.uniform(30.0, 60.0))
        motion = motions.excitation(case.arm, rng, seconds)
        logs.append(Asked(motion, case.effects))
    return replace(case, asked=tuple(logs))


def seven(seed: int) -> Case:
    """All joints of published arms of seven; every fourth arm is clean."""
    kinds = _kinds_in_turn(seed)
    outline = _outline("seven", seed, kinds, SEVEN_FLOWS)
    label = SEVEN[seed // 2 % len(SEVEN)]
    rng = _rng("seven", seed, 80)
    outline = replace(
        outline,
        label=label,
        n=len(published_links(label)),
        imus=bool(rng.random() < 0.25),
    )
    return _alone("seven", outline, CATALOGUE[kinds[0]] if kinds else None)


GROUPS: dict[str, Callable[..., Case]] = {
    "mixed": plan.drawn,
    "clean": clean,
    "singles": singles,
    "pushes": pushes,
    "changes": changes,
    "foreign": foreign,
    "belts": belts,
    "walks": walks,
    "periodic": periodic,
    "seven": seven,
}


# ---- what they share


def _kinds_in_turn(seed: int) -> tuple[str, ...]:
    """Nothing for every fourth seed, and an effect of the catalogue for the others."""
    if seed % 4 == 0:
        return ()
    return ([*CATALOGUE][(seed - seed // 4 - 1) % len(CATALOGUE)],)


def _rng(group: str, seed: int, part: int) -> np.random.Generator:
    return np.random.default_rng([seed, part, *group.encode()])


def _outline(
    group: str,
    seed: int,
    kinds: tuple[str, ...],
    flows: Sequence[Flow],
    *,
    joints: Sequence[int] = (1, 2, 2, 2, 2, 3),
    imus: bool | None = None,
) -> Outline:
    """Draw sort and joints of an arm, flow and files; every sixth arm is a published
    one.
    """
    rng = _rng(group, seed, 77)
    flow = flows[int(rng.integers(len(flows)))]
    if LATER & set(kinds):
        flow = "step_late" if flow.startswith("s") else "late"
    label, n = "drawn", int(rng.choice(joints))
    if seed % 6 == 1:
        label, n = PUBLISHED[(seed // 6) % len(PUBLISHED)], int(rng.choice([2, 3, 3]))
    if "transmission_coupling" in kinds:
        n = max(n, 2)
    has_imus = bool(rng.random() < 0.5) if imus is None else imus
    mcap = bool(rng.random() < 0.3)
    clock = mcap or bool(rng.random() < 0.5)
    return Outline(seed, kinds, flow, label, n, has_imus, mcap, clock)


def _arm(group: str, outline: Outline) -> Arm:
    rng = _rng(group, outline.seed, 78)
    return drawn_arm(rng, outline.label, outline.n, outline.imus)


def _alone(group: str, outline: Outline, draw: Draw | None) -> Case:
    """A case with one effect, or none."""
    arm = _arm(group, outline)
    if draw is None:
        return Case(outline, arm, (), (), group)
    effect, share = _shown(arm, draw, _rng(group, outline.seed, 79))
    return Case(outline, arm, (effect,), (share,), group)


def _shown(arm: Arm, draw: Draw, rng: np.random.Generator) -> tuple[Effect, float]:
    """Draw an effect that shows; of a few where none does the largest."""
    drawn = list[tuple[Effect, float]]()
    for _ in range(DRAWS):
        effect = draw(arm, int(rng.integers(arm.n)), rng)
        drawn.append(sized(arm, effect, rng, least=SHOWS))
        if drawn[-1][1] > 0.7 * SHOWS:
            break
    return max(drawn, key=lambda made: made[1])


def _motion(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """A motion of a drawn sort."""
    sorts = [*motions.MOTIONS.values()]
    return sorts[int(rng.integers(len(sorts)))](arm, rng, seconds)


def _usual_torque(arm: Arm, motion: Array) -> Array:
    """Return the RMS torque (n,) N m of a motion (N, n) rad, with friction."""
    rate = np.gradient(motion, STEP_S, axis=0)
    _, rigid = controller(replace(arm, forward=1.0), motion, rate)
    return np.sqrt(np.mean(rigid**2, axis=0) + arm.of("coulomb") ** 2)


def _logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _length(seconds: float) -> str:
    """Return between which lengths a push lies, as the tables say it."""
    longer = next(k for k, end in enumerate(LENGTHS_S) if seconds <= end)
    return f"{LENGTHS_S[longer - 1]:g} to {LENGTHS_S[longer]:g} s"
