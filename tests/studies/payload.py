"""Payloads of drawn six-joint arms: mass, centre and inertia against truth, in stated errors.

    python -m tests.studies.payload --seeds 10700:10710

Each seed draws an arm of the coverage study and a body for its flange. The arm is recorded and
identified without the body; six moves of two joints with it, of other noise, go to `payload`.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import SeqidWarning
from seqid_cli.payload import payload
from tests.plants import twin
from tests.plants.arms.rigs import mounting, standard_parameters
from tests.plants.motions.experiments import inertia_trials
from tests.plants.samples import SIX_POSTURES
from tests.plants.simulate import Plant
from tests.studies.coverage.cases import case_of, draw, noise_seed, record, write_log
from tests.studies.coverage.score import identified
from tests.studies.coverage.study import seeds_of
from tests.studies.tables import number, table

Array = NDArray[np.float64]

STREAM = 2107
PAIRS = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (1, 4)]
SECONDS = 6.0
FIRST_NOISE = 500  # number of the first log with the load


def drawn_body(rng: np.random.Generator) -> Array:
    """Standard parameters (10,) of a body of 0.5 to 4 kg before the flange."""
    return standard_parameters(
        float(rng.uniform(0.5, 4.0)),
        tuple(rng.uniform([-0.06, -0.06, 0.03], [0.06, 0.06, 0.15])),
        tuple(rng.uniform(0.03, 0.07, 3)),
        mounting(*rng.uniform(-0.5, 0.5, 3)),
    )


def loaded(plant: Plant, body: Array) -> Plant:
    """The plant with the body at its last link."""
    links = plant.arm.phi.copy()
    links[-1] += body
    return replace(plant, arm=replace(plant.arm, phi=links))


def errors_of(seed: int) -> dict[str, tuple[float, float, float]]:
    """Estimate, standard error and truth of every number of one seed's body, by name."""
    case = case_of("six", seed)
    drawn = draw(case)
    rng = np.random.default_rng([STREAM, seed])
    body = drawn_body(rng)
    heavy = loaded(drawn.plant, body)
    with TemporaryDirectory(prefix="seqid-payload-") as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        folder = Path(name)
        record(case, drawn, folder)
        _, problem = identified(folder)
        if problem:
            raise RuntimeError(problem)
        trials = inertia_trials(
            heavy, list(SIX_POSTURES), rng, pairs=PAIRS, rate_hz=500.0, seconds=SECONDS
        )
        for k, trial in enumerate(trials):
            log = twin.simulate(
                heavy, trial.reference, noise_seed(case, FIRST_NOISE + k), every=drawn.every
            )
            write_log(folder / "loaded" / f"{trial.name}.parquet", replace(heavy, imus=()), log)
        found = payload(folder / "loaded", folder / "robot.toml", folder / "inertia.json")
    center = body[1:4] / body[0]
    rows = {"mass kg": (found.payload.mass, body[0])}
    for axis, own, true in zip("xyz", found.payload.center_of_mass, center, strict=True):
        rows[f"centre {axis} m"] = (own, true)
    told = {
        key: (own.value, own.std_error, float(true))
        for key, (own, true) in rows.items()
        if own.value is not None and own.std_error is not None
    }
    for parameter, true in zip(found.parameters, body, strict=True):
        if parameter.name.startswith("payload_I"):
            told[parameter.name] = (parameter.value, parameter.std_error, float(true))
    return told


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the seeds and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.payload")
    parser.add_argument("--seeds", default="10700:10710")
    found: dict[str, list[tuple[float, float, float]]] = {}
    for seed in seeds_of(parser.parse_args(arguments).seeds):
        for name, values in errors_of(seed).items():
            found.setdefault(name, []).append(values)
        sys.stderr.write(f"seed {seed}\n")
    rows = []
    for name, values in found.items():
        estimate, error, truth = np.array(values).T
        z = (estimate - truth) / error
        off = np.abs(estimate - truth)
        largest = f"{100.0 * float(np.max(off / np.abs(truth))):.2g} %" if "mass" in name else "-"
        inside = f"{np.count_nonzero(np.abs(z) < 2.0)} of {len(z)}"
        rms = float(np.sqrt(np.mean(z**2)))
        rows.append([name, number(float(np.median(off))), largest, number(rms), inside])
    header = ["number", "median error", "largest, relative", "rms z", "within 2 std errors"]
    sys.stdout.write(table(header, rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
