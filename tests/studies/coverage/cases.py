"""Arms of the coverage study, drawn anew for every seed, and the logs that their stages
need.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests import Array
from tests.plants.arms import rigs
from tests.plants.arms.rigs import mounting, off_nominal
from tests.plants.controller import gains_for
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm, Rigid
from tests.plants.motions import experiments
from tests.plants.motions.experiments import Trial
from tests.plants.robotfile import robot_toml
from tests.plants.robots.lab import write_log
from tests.plants.samples import SIX_POSTURES
from tests.plants.sensors import AccelerometerArray
from tests.plants.simulate import Plant, simulate

NOISES = ("white", "coloured")
ENCODERS = ("fine", "coarse")
HALF = 0.5  # of the current noise's variance is 1/f where it is coloured
# per turn of the joint; a large arm has 2**5 times as many
COUNTS = {"fine": 2**14, "coarse": 600}
LARGE = 2**5
STREAM = {"one": 2101, "planar": 2102, "six": 2106}
EVERY = 4  # control periods of 1 ms per row
SIX_CENTRE = np.array([0.0, -1.2, 0.0, 0.0, 0.0, 0.0])  # rad, of the joints' ranges


@dataclass(frozen=True)
class Case:
    """One arm and its logs: everything else follows from these."""

    rig: str
    seed: int
    noise: str
    encoder: str

    @property
    def label(self) -> str:
        return f"{self.rig}-{self.seed}-{self.noise}-{self.encoder}"


@dataclass(frozen=True)
class Drawn:
    plant: Plant
    trials: Sequence[Trial]
    traits: dict[str, bool]
    every: int = EVERY


def case_of(rig: str, seed: int) -> Case:
    return Case(rig, seed, NOISES[seed % 4 // 2], ENCODERS[seed % 2])


def draw(case: Case) -> Drawn:
    """Draw the arm of a case; a seed's arm is the same with every noise and encoder."""
    rng = np.random.default_rng([STREAM[case.rig], case.seed])
    drawn = {"one": _one, "planar": _planar, "six": _six}[case.rig](rng, case.seed // 4)
    turn = COUNTS[case.encoder] * (LARGE if case.rig == "six" else 1)
    steps = np.full(drawn.plant.arm.n, 2 * np.pi / turn)
    coloured = HALF if case.noise == "coloured" else 0.0
    return replace(
        drawn, plant=replace(drawn.plant, encoder_step=steps, coloured=coloured)
    )


def record(case: Case, drawn: Drawn, folder: Path) -> None:
    """Simulate all trials; write `robot.toml` and `<stage>/<trial>.parquet` into
    `folder`.
    """
    (folder / "robot.toml").write_text(
        robot_toml(case.rig, drawn.plant), encoding="ascii"
    )
    for number, trial in enumerate(drawn.trials):
        state = np.random.SeedSequence(
            [STREAM[case.rig], case.seed, number]
        ).generate_state(1)
        seed = int(state[0])
        log = simulate(
            drawn.plant, trial.reference, seed, every=drawn.every, imus=trial.imus
        )
        write_log(folder / trial.stage / f"{trial.name}.parquet", drawn.plant, log)


def _flat_link(
    rng: np.random.Generator, mass: float, along: float, gyration: float
) -> Array:
    """Standard parameters (10,) of a flat link: centre of mass at `along` m, a little
    aside.
    """
    aside = along * rng.uniform(-0.2, 0.2)
    izz = mass * (along**2 + aside**2 + gyration**2)
    return np.array(
        [mass, mass * along, mass * aside, 0, 0.02 * izz, 0, izz, 0, 0, izz]
    )


def _surface(rng: np.random.Generator, coulomb: Array, top: Array) -> SurfaceFriction:
    """Friction that depends on position, with a Stribeck hump; `top` (n,) rad/s."""
    n = len(coulomb)
    return SurfaceFriction(
        coulomb=coulomb,
        viscous=rng.uniform(0.1, 0.5, n) * coulomb / top,
        stribeck=rng.uniform(0.05, 0.2, n) * coulomb,
        stribeck_speed=rng.uniform(0.05, 0.12, n) * top,
        amplitude=rng.uniform(0.3, 1.0, (n, 3)) * np.array([0.10, 0.06, 0.04]),
        phase=rng.uniform(-np.pi, np.pi, (n, 3)),
    )


def _arrays(
    rng: np.random.Generator, levers: dict[int, Array]
) -> tuple[AccelerometerArray, ...]:
    """Tetrahedral arrays on the links `levers` names, turned at random."""
    arrays = []
    for name, (link, lever) in zip(("imu_a", "imu_b"), levers.items(), strict=False):
        turn, place = rng.uniform(-1.2, 1.2, 3), lever * rng.uniform(0.8, 1.2, 3)
        arrays.append(rigs.array_on(name, link, tuple(turn), tuple(place), bias=0.02))
    return tuple(arrays)


def _plant(
    rng: np.random.Generator,
    arm: Arm,
    inertia: Array,
    coulomb: Array,
    top: Array,
    push: Array,
) -> Plant:
    """A rig of the paper with drives, controller and limits of its own, all (n,); no
    IMUs.
    """
    n, bandwidth = arm.n, float(rng.uniform(12.0, 25.0))
    drive = rng.uniform(0.015, 0.04, n)
    hiss = rng.uniform(0.08, 0.2, n) * coulomb / (drive * arm.gear)
    return replace(
        rigs.one_joint() if n == 1 else rigs.two_joint(),
        arm=arm,
        nominal=off_nominal(arm, float(rng.uniform(0.05, 0.2))),
        friction=_surface(rng, coulomb, top),
        gains=gains_for(inertia, bandwidth=bandwidth, observer=5 * bandwidth),
        torque_constant=drive,
        current_noise=hiss,
        coulomb_guess=coulomb * rng.uniform(0.7, 1.1, n),
        velocity_limits=top,
        acceleration_limits=push,
        current_step=0.2 * hiss,
        imus=(),
    )


def _one(rng: np.random.Generator, number: int) -> Drawn:
    """The paper's Sec. 4.1: one link on a tilted axis; every second arm without
    accelerometers.
    """
    tilt = float(np.deg2rad(rng.uniform(15.0, 45.0)))
    link = _flat_link(
        rng, rng.uniform(0.08, 0.2), rng.uniform(0.05, 0.1), rng.uniform(0.05, 0.1)
    )
    gear = np.exp(rng.uniform(np.log(5.0), np.log(60.0), 1))
    rotor = link[9] * rng.uniform(0.03, 0.6, 1) / gear**2
    arm = Arm(
        ("joint_1",), np.array([[tilt, 0, 0, 0]]), link[None], rigs.DOWN, gear, rotor
    )
    coulomb = rng.uniform(0.02, 0.04, 1)
    top, push = rng.uniform(6.0, 9.0, 1), rng.uniform(40.0, 70.0, 1)
    plant = _plant(rng, arm, link[9] + arm.reflected, coulomb, top, push)
    if imus := number % 2 == 0:
        plant = replace(plant, imus=_arrays(rng, {0: np.array([0.06, 0.012, 0.008])}))
    home = [np.zeros(1)]
    trials = [
        *experiments.friction_trials(plant, home[0], speeds=int(rng.integers(8, 13))),
        *experiments.gravity_trials(plant, home, speeds=(0.1, 0.2)),
        *(experiments.imu_trials(plant, home) if imus else ()),
        *experiments.inertia_trials(
            plant, home, rng, seconds=float(rng.uniform(8.0, 14.0))
        ),
    ]
    return Drawn(plant, trials, {"imus": imus})


def _planar(rng: np.random.Generator, number: int) -> Drawn:
    """Two parallel axes; every second arm tilted,
    two of four without accelerometers.
    """
    length = rng.uniform(0.2, 0.4)
    upper = _flat_link(
        rng, rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.6) * length, 0.4 * length
    )
    fore = _flat_link(
        rng, rng.uniform(0.1, 0.3), rng.uniform(0.05, 0.12), rng.uniform(0.03, 0.06)
    )
    outer = np.array([upper[9] + fore[0] * length**2, fore[9]])
    gear = np.exp(rng.uniform(np.log(5.0), np.log(60.0), 2))
    rotor = outer * rng.uniform(0.1, [0.6, 0.8]) / gear**2
    tilted, imus = number % 2 == 1, number // 2 % 2 == 0
    tilt, azimuth = (
        np.deg2rad(rng.uniform(5.0, 20.0)) * tilted,
        rng.uniform(-np.pi, np.pi),
    )
    aside = np.sin(tilt) * np.array([np.cos(azimuth), np.sin(azimuth)])
    dh = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, length, 0.0, 0.0]])
    down, coupled = (
        rigs.GRAVITY * np.array([*aside, -np.cos(tilt)]),
        bool(rng.uniform() < 0.5),
    )
    arm = Arm(rigs.NAMES, dh, np.array([upper, fore]), down, gear, rotor, coupled)
    coulomb = rng.uniform([0.03, 0.015], [0.06, 0.04])
    top, push = (
        rng.uniform([4.0, 6.0], [7.0, 9.0]),
        rng.uniform([20.0, 40.0], [40.0, 70.0]),
    )
    inertia = np.array([outer.sum(), fore[9]]) + arm.reflected
    plant = _plant(rng, arm, inertia, coulomb, top, push)
    if imus:
        levers = {
            0: np.array([0.7 * length, 0.01, 0.02]),
            1: np.array([0.08, -0.01, 0.01]),
        }
        plant = replace(plant, imus=_arrays(rng, levers))
    postures = [np.array([0.0, angle]) for angle in (0.0, 1.2, -0.9, 2.3, -1.9)]
    twice = [(0, 1), (0, 1)]
    trials = [
        *experiments.friction_trials(
            plant, postures[0], speeds=int(rng.integers(8, 13))
        ),
        *(
            experiments.gravity_trials(plant, postures[1:4], speeds=(0.1,))
            if tilted
            else ()
        ),
        *(experiments.imu_trials(plant, postures, turns=1) if imus else ()),
        *experiments.inertia_trials(
            plant, postures[1:], rng, pairs=twice, seconds=float(rng.uniform(10, 16))
        ),
    ]
    return Drawn(
        plant, trials, {"tilted": tilted, "imus": imus, "rotor_coupling": coupled}
    )


def _six(rng: np.random.Generator, number: int) -> Drawn:
    """An arm of a UR5e's kind, bodies, lengths, drives and friction drawn; shorter,
    fewer logs.
    """
    plant = rigs.six_joint()
    dh = plant.arm.dh * np.array([1.0, *rng.uniform(0.85, 1.15, 2), 1.0])
    bodies = []
    for m, c, g in rigs.UR5E_BODIES:
        mass, centre = m * rng.uniform(0.7, 1.3), np.array(c) * rng.uniform(0.8, 1.2, 3)
        radii, turn = (
            np.array(g) * rng.uniform(0.85, 1.15, 3),
            rng.uniform(-0.1, 0.1, 3),
        )
        bodies.append(
            rigs.standard_parameters(mass, tuple(centre), tuple(radii), mounting(*turn))
        )
    rotors, gear = (
        rigs.UR5E_ROTORS * rng.uniform(0.7, 1.3, 6),
        rng.uniform(80.0, 120.0, 6),
    )
    coupled, names = bool(rng.uniform() < 0.5), rigs.UR5E_NAMES
    arm = Arm(
        names, dh, np.array(bodies), rigs.DOWN, gear, rotors, rotor_coupling=coupled
    )
    coulomb = rigs.UR5E_COULOMB * rng.uniform(0.6, 1.4, 6)
    drive = rng.uniform(0.09, 0.13, 6)
    hiss = rng.uniform(0.06, 0.14, 6) * coulomb / (drive * gear)
    inertia = np.diag(Rigid(arm).terms(SIX_POSTURES[0], np.zeros(6))[0])
    levers = {2: np.array([-0.30, 0.03, 0.06]), 5: np.array([0.02, 0.01, 0.04])}
    plant = replace(
        plant,
        arm=arm,
        nominal=off_nominal(arm, 0.12),
        friction=_surface(rng, coulomb, plant.velocity_limits),
        gains=gains_for(inertia, bandwidth=20.0, observer=120.0),
        torque_constant=drive,
        current_noise=hiss,
        coulomb_guess=0.9 * coulomb,
        position_limits=np.tile([-2.0, 2.0], (6, 1)) + SIX_CENTRE[:, None],
        current_step=0.2 * hiss,
        imus=_arrays(rng, levers),
    )
    postures, rate = list(SIX_POSTURES), 500.0
    trials = [
        *experiments.friction_trials(
            plant, postures[0], rate_hz=rate, speeds=7, lowest=0.12
        ),
        *experiments.gravity_trials(plant, postures[:4], rate_hz=rate, speeds=(0.3,)),
        *experiments.imu_trials(plant, postures[:5], rate_hz=rate, turns=1),
        *experiments.inertia_trials(plant, postures, rng, rate_hz=rate, seconds=4.0),
    ]
    return Drawn(plant, trials, {"rotor_coupling": coupled}, every=2)
