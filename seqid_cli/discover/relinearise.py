"""The model moved to where a search has brought it, so that effects are seen from there.

Many effects follow the modelled torque: a gear's load, gravity on a tilted base, the bending of a
joint. A model that was fitted to logs with such an effect in them is biased by it, and gives it the
wrong shape. Gauss-Newton: the rigid body is moved by what the free base has found beside the
effects, and the search begins anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import Base
from seqid_cli.discover.candidates import Stage
from seqid_cli.discover.rows import Rows
from seqid_cli.discover.search import Search
from seqid_cli.model.effects.scene import Scene
from seqid_cli.robot.base import STANDARD

Array = NDArray[np.float64]


def moved(search: Search) -> float:
    """Largest RMS, as a share of a joint's rigid-body torque, by which the base has moved it."""
    rows, base = search.stage.rows, search.base
    shift = _shift(search)
    torque = [scene.rigid for scene in rows.scenes]
    shares = [
        np.linalg.norm(base.rigid[j] @ shift)
        / max(float(np.linalg.norm(rows.of(j, torque)[:, j])), 1e-300)
        for j in range(rows.n)
        if rows.count(j)
    ]
    return float(max(shares, default=0.0))


def relinearised(search: Search) -> tuple[Stage, Base]:
    """Stage and base about the model that a search has arrived at; friction stays."""
    rows, base, shift = search.stage.rows, search.base, _shift(search)
    standard = base.basis.representative @ shift
    scenes = tuple(_about(scene, standard) for scene in rows.scenes)
    again = replace(
        base,
        y=tuple(y - H @ shift for y, H in zip(base.y, base.rigid, strict=True)),
        whole=tuple(
            replace(w, residual=w.residual - (w.H @ shift.astype(np.float32)).astype(np.float64))
            for w in base.whole
        ),
    )
    return Stage(_with_scenes(rows, scenes)), again


def _shift(search: Search) -> Array:
    system = search.system()
    return system.theta[system.where[0]]


def _about(scene: Scene, standard: Array) -> Scene:
    model = scene.model
    if model.phi is None or model.rotor is None:
        return scene
    links = len(STANDARD) * scene.robot.n
    near = replace(
        model,
        phi=model.phi + standard[:links].reshape(model.phi.shape),
        rotor=model.rotor + standard[links:],
    )
    full = None if scene.full is None else _about(scene.full, standard)
    return replace(scene, model=near, full=full)


def _with_scenes(rows: Rows, scenes: Sequence[Scene]) -> Rows:
    """The same rows of scenes that have another model; the low-pass is kept."""
    result = replace(rows, scenes=tuple(scenes))
    result.keep_sieves_of(rows)
    return result
