"""Simulated robots with effects: their logs on disk, identified and refined once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from seqid_cli.discover.functions import refine
from seqid_cli.discover.options import RefineOptions
from seqid_cli.identify.functions import simultaneous
from tests.plants.arms.rigs import one_joint, six_joint
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.effects.registry import inject
from tests.plants.motions.trials import drills, run_drill
from tests.plants.robotfile import robot_toml
from tests.plants.robots.lab import write_log
from tests.plants.simulate import Plant
from tests.unit.effects.few import only_effects

SEED = 31  # below 10000: of no study
OTHER_SEED = 57


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A folder with `robot.toml`, `simultaneous.json`, `refined.json` and logs.

    `training` and `held_out` logs are those of the files, `others` of the same kind and
    in none.
    """

    folder: Path
    training: tuple[Path, ...]
    held_out: tuple[Path, ...]
    others: tuple[Path, ...]

    @property
    def robot(self) -> Path:
        return self.folder / "robot.toml"

    @property
    def simultaneous(self) -> Path:
        return self.folder / "simultaneous.json"

    @property
    def refined(self) -> Path:
        return self.folder / "refined.json"


# What the cases have, and what is most like it.
LOOKED_FOR = (
    "gear_efficiency",
    "load_dependent_friction",
    "nonlinear_viscous",
    "quadratic_drag",
    "stribeck",
    "transmission_coupling",
)

# Name of a case: the arm, and what it has that its robot file does not say.
CASES: Mapping[str, tuple[Callable[[], Plant], tuple[tuple[str, int, float], ...]]] = {
    "one_joint": (one_joint, (("nonlinear_viscous", 0, 1.0),)),
    "two_joint": (
        lambda: vertical_two_joint(simple_friction=True),
        (("load_dependent_friction", 0, 1.0), ("nonlinear_viscous", 1, 1.0)),
    ),
    "six_joint": (
        lambda: six_joint(simple_friction=True),
        (("load_dependent_friction", 1, 1.0), ("transmission_coupling", 5, 1.0)),
    ),
}


@cache
def recorded(name: str, own_seed: int = SEED, other_seed: int = OTHER_SEED) -> Recorded:
    """Record, identify and refine a case, once in a process.

    `own_seed` is of the logs of the files, `other_seed` of the others.
    """
    make, effects = CASES[name]
    declared = plant = make()
    for kind, joint, size in effects:
        plant = inject(kind, plant, joint, size).plant
    folder = Path(mkdtemp(prefix=f"seqid_{name}_"))
    (folder / "robot.toml").write_text(robot_toml(name, declared), encoding="ascii")
    logs: dict[str, list[Path]] = {"training": [], "held_out": [], "others": []}
    for seed in (own_seed, other_seed):
        for number, drill in enumerate(drills(declared, seed)):
            group = "held_out" if drill.held_out else "training"
            if seed == other_seed:
                group = "others"
                if drill.held_out:
                    continue
            path = folder / group / f"{drill.name}.parquet"
            write_log(path, plant, run_drill(plant, drill, seed + number))
            logs[group].append(path)
    found = Recorded(
        folder=folder, **{key: tuple(paths) for key, paths in logs.items()}
    )
    simultaneous(found.training, found.robot, output=found.simultaneous)
    with only_effects(LOOKED_FOR):
        refine(
            found.training,
            found.held_out,
            found.robot,
            found.simultaneous,
            RefineOptions(rounds=len(effects)),
            output=found.refined,
        )
    return found
