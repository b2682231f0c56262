"""What a file's friction has absorbed of an effect that was there when it was identified.

Friction trials move one joint at constant speeds, both ways. What an effect has at these speeds and
places against the motion is taken for friction, as far as the surface's terms can follow; a model
that knows the effect has it twice. So the effect shows as its torque X less what was absorbed,

    X - F P,   P = argmin over trials |(X(q, v) - X(q, -v)) / 2 - F(q, v) P|^2,

F being the columns of the surface. The half-sum of both ways is gravity's, and in the rigid body.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from seqid_cli.model.effects.effect import Effect, Settings
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.typing import Array

PLACES = 33  # over the positions of a trial


def has_trials(scene: Scene, joint: Joint) -> bool:
    """Whether the file tells at which speeds and in which postures friction was identified."""
    surfaces = scene.model.surfaces if joint is None else [scene.model.surfaces[joint]]
    return all(s is not None and len(s.speeds) > 0 and s.postures for s in surfaces)


def absorbed(scene: Scene, effect: Effect, joint: Joint, settings: Settings) -> dict[int, Array]:
    """Coefficients (entries, k) of each joint's surface per unit coefficient of an effect."""
    found, first = dict[int, Array](), joint or 0
    touched = effect.steady_columns(_trials(scene, first), joint, settings)
    for j in (j for j in touched if has_trials(scene, j)):
        trials = _trials(scene, j)
        own = touched if j == first else effect.steady_columns(trials, joint, settings)
        ahead, back = np.split(own[j], 2)
        F = surface_columns(trials, j, slice(len(ahead)))
        found[j] = np.asarray(np.linalg.lstsq(F, 0.5 * (ahead - back[::-1]), rcond=None)[0])
    return found


def surface_columns(scene: Scene, joint: int, part: slice = slice(None)) -> Array:
    """Columns (N, entries) of a joint's friction surface, of some samples of a data set."""
    surface, motion = scene.model.surfaces[joint], scene.motion
    assert surface is not None
    columns: Array = surface.columns(motion.q[part, joint], motion.dq[part, joint])
    return columns[:, : surface.entries]


def _trials(scene: Scene, joint: int) -> Scene:
    """One joint at the speeds and places of its trials, all ahead first, then the same way back."""
    if joint not in scene.trials:
        scene.trials[joint] = _steady(scene, joint)
    return scene.trials[joint]


def _steady(scene: Scene, joint: int) -> Scene:
    surface = scene.model.surfaces[joint]
    assert surface is not None
    places = surface.scaling.over_position.at(np.linspace(0.0, 1.0, PLACES))
    every = list(product(surface.postures, surface.speeds, places))
    q = np.array([posture for posture, _, _ in every])
    q[:, joint] = [place for _, _, place in every]
    dq = np.zeros_like(q)
    dq[:, joint] = [speed for _, speed, _ in every]
    q, dq = np.vstack([q, q[::-1]]), np.vstack([dq, -dq[::-1]])
    unfiltered = np.zeros(len(q), dtype=bool)  # steady motion passes a low-pass as it is
    motion = replace(
        scene.motion,
        t=np.arange(len(q)) / scene.motion.rate_hz,
        q=q,
        dq=dq,
        ddq=np.zeros_like(q),
        tau=None,
        moving=dq != 0.0,
        usable=unfiltered,
        valid=unfiltered,
    )
    model, width = scene.model, scene.sign_width
    return Scene(robot=scene.robot, motion=motion, model=model, sign_width=width)
