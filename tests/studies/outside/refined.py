"""The loop closed outside: `python -m tests.studies.outside.refined --seeds A:B
[--group NAME]`.
"""

import argparse
import sys
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

from seqid_cli import discover
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import held_out_error
from seqid_cli.discover.refinement.reidentify import RefinementData
from seqid_cli.discover.refinement.rounds import on_the_same_samples
from seqid_cli.errors import SeqidWarning
from seqid_cli.logs.read import read_recording
from seqid_cli.params.io import read_parameters
from seqid_cli.robot.file import load_robot
from tests.studies.outside.cases import prepared
from tests.studies.outside.groups import GROUPS
from tests.studies.records import results, seeds_of
from tests.studies.undeclared.cases import Truth
from tests.studies.undeclared.refine import NEAR, told_model


def refined_case(seed: int, folder: Path, group: str) -> dict[str, Any]:
    case = GROUPS[group](seed)
    (effect,), (joints,) = case.effects, case.joints
    row = {
        "seed": seed,
        "kind": effect.name,
        "joints": joints,
        "flow": case.outline.flow,
    }
    ready = prepared(case, folder)
    held_out = ready.recorder.moves(2, 18.0, case.effects)
    clock = time.process_time()
    loop = discover.refine(ready.logs, held_out, ready.recorder.robot, ready.file)
    row["seconds"] = round(time.process_time() - clock, 1)
    robot, file = load_robot(ready.recorder.robot), read_parameters(ready.file)
    earlier: dict[str, list[Any]] = {}
    for log in file.inputs:
        earlier.setdefault(log.stage, []).append(read_recording(Path(log.path), robot))
    options = on_the_same_samples(DiscoverOptions(), file.stages, robot)
    training = tuple(read_recording(path, robot) for path in ready.logs)
    material = RefinementData(training, earlier, robot, options)
    truth = Truth(effect.name, effect.name, tuple(joints) or (None,), ())
    # It came later, or was there all along; in the only log it cannot have come later.
    accounts = (False,) if case.outline.flow == "single" else (False, True)
    models = [
        told_model(material, file.stages, [truth], late=late) for late in accounts
    ]
    logs = [read_recording(path, robot) for path in held_out]
    refined, *told = [
        held_out_error(logs, robot, model, options=options.motion).rmse()
        for model in (loop.stages, *models)
        if model is not None
    ]
    best = min(told, key=lambda rms: float(sum(rms**2)), default=None)
    closed = loop.closed_loop
    added = (*closed.rounds, *closed.unconfirmed)
    row["added"] = [(r.effect, r.joint, r.confirmed, r.reason) for r in added]
    row["refused"] = [(r.effect, r.joint, r.reason) for r in closed.refused]
    before = {joint: error.rmse for joint, error in closed.before.items()}
    worst = max(before, key=lambda joint: before[joint] / closed.noise_floor[joint])
    at = joints[0] if joints and joints[0] in before else worst
    k = robot.joint_names.index(at)
    row |= {"at": at, "before": before[at], "floor": closed.noise_floor[at]}
    return row | {
        "after": float(refined[k]),
        "told": None if best is None else float(best[k]),
    }


def answered(seed: int, group: str = "mixed") -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        try:
            return refined_case(seed, Path(name), group)
        except Exception as error:
            return {"seed": seed, "kind": "", "added": [], "error": repr(error)}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.outside.refined")
    parser.add_argument("--seeds", type=seeds_of, default="1000:1030", metavar="A:B")
    parser.add_argument("--cache", type=Path, default=Path("out") / "outside")
    parser.add_argument("--group", choices=[*GROUPS], default="mixed")
    chosen = parser.parse_args()
    draw = GROUPS[chosen.group]
    cases = {str(seed): seed for seed in chosen.seeds if len(draw(seed).effects) == 1}
    name = f"refined_{chosen.group}.jsonl"
    kept = results(
        cases,
        partial(answered, group=chosen.group),
        dict[str, Any],
        chosen.cache / name,
        told=str,
    )
    right = [
        r for r in kept.values() if r["kind"] in {added[0] for added in r["added"]}
    ]
    sure = [r for r in right if all(added[2] for added in r["added"])]
    asked = [r for r in right if r["told"]]
    near = [r for r in asked if r["after"] <= NEAR * r["told"]]
    sys.stdout.write(
        f"{len(kept)} cases, {len(right)} with the right name added, {len(sure)} of"
        f" them with nothing unconfirmed; {len(near)} of {len(asked)} within {NEAR} of"
        " a model that is told\n"
    )


if __name__ == "__main__":
    main()
