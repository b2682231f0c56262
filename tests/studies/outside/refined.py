"""The loop closed on the second simulator: `python -m tests.studies.outside.refined --seeds A:B`.

Each case with one effect is recorded and identified as `cases` does it. `refine` gets the logs that
are asked about, and two more that are held out. The reference is a model that is told the effect
and its joint, and identified anew with it from the same logs.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from seqid_cli import discover
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import held_out_error
from seqid_cli.discover.refinement.material import Material
from seqid_cli.discover.refinement.rounds import on_the_same_samples
from seqid_cli.errors import SeqidWarning
from seqid_cli.logs.read import read_recording
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from tests.studies.outside.cases import Prepared, prepared
from tests.studies.outside.plan import Case, drawn
from tests.studies.records import results
from tests.studies.undeclared.cases import Truth
from tests.studies.undeclared.refine import NEAR, told_model


def refined_case(seed: int, folder: Path) -> dict[str, Any]:
    """What `refine` made of a case, beside the model that is told."""
    case = drawn(seed)
    (effect,) = case.effects
    names = case.arm.names
    joints = [names[j] for j in (effect.joint, effect.partner) if j is not None]
    row = {"seed": seed, "kind": effect.name, "joints": joints, "flow": case.outline.flow}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        ready = prepared(case, folder)
        held_out = ready.recorder.moves(2, 18.0, case.effects)
        clock = time.process_time()
        found = discover.refine(ready.logs, held_out, ready.robot, ready.file)
        row["seconds"] = round(time.process_time() - clock, 1)
        after, told = _errors(case, ready, found, held_out, joints)
    loop = found.closed_loop
    assert loop is not None
    row["added"] = [(r.effect, r.joint, r.confirmed, r.reason) for r in loop.rounds]
    row["refused"] = [(r.effect, r.joint, r.reason) for r in loop.refused]
    worst = max(loop.before, key=lambda j: loop.before[j].rmse / loop.noise_floor[j])
    at = joints[0] if joints and joints[0] in loop.before else worst
    row |= {"at": at, "before": loop.before[at].rmse, "floor": loop.noise_floor[at]}
    row |= {"after": after[at], "told": None if told is None else told[at]}
    return row


def _errors(
    case: Case,
    ready: Prepared,
    found: ParameterFile,
    held_out: Sequence[Path],
    joints: Sequence[str],
) -> tuple[dict[str, float], dict[str, float] | None]:
    """Held-out RMSE N m by joint: as refined, and told under the better account."""
    robot, file = load_robot(ready.robot), read_parameters(ready.file)
    earlier: dict[str, list[Any]] = {}
    for log in file.inputs:
        earlier.setdefault(log.stage, []).append(read_recording(Path(log.path), robot))
    options = on_the_same_samples(DiscoverOptions(), file.stages, robot)
    training = tuple(read_recording(path, robot) for path in ready.logs)
    material = Material(training, earlier, robot, options)
    name = case.effects[0].name
    truth = Truth(name, name, tuple(joints) or (None,), ())
    accounts = (False,) if material.known else (False, True)
    models = [told_model(material, file.stages, [truth], late=late) for late in accounts]
    logs = [read_recording(path, robot) for path in held_out]
    refined, *told = [
        held_out_error(logs, robot, model, options=options.motion).rmse()
        for model in (found.stages, *models)
        if model is not None
    ]
    best = min(told, key=lambda rms: float(sum(rms**2)), default=None)
    names = robot.joint_names
    by_joint = dict(zip(names, refined.tolist(), strict=True))
    return by_joint, None if best is None else dict(zip(names, best.tolist(), strict=True))


def answered(seed: int) -> dict[str, Any]:
    """Run a case; one that fails is an answer too."""
    with tempfile.TemporaryDirectory() as name:
        try:
            return refined_case(seed, Path(name))
        except Exception as error:
            return {"seed": seed, "kind": "", "added": [], "error": repr(error)}


def main(arguments: Sequence[str]) -> int:
    """Run the cases of one effect that the cache does not hold, and say how many closed."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.outside.refined")
    parser.add_argument("--seeds", default="1000:1030", metavar="A:B")
    parser.add_argument("--cache", type=Path, default=Path("out") / "outside")
    chosen = parser.parse_args(arguments)
    first, _, last = chosen.seeds.partition(":")
    cases = {str(s): s for s in range(int(first), int(last)) if len(drawn(s).effects) == 1}
    kept = results(cases, answered, dict[str, Any], chosen.cache / "refined.jsonl", told=str)
    right = [r for r in kept.values() if r["kind"] in {added[0] for added in r["added"]}]
    sure = [r for r in right if all(added[2] for added in r["added"])]
    asked = [r for r in right if r["told"]]
    near = [r for r in asked if r["after"] <= NEAR * r["told"]]
    sys.stdout.write(
        f"{len(kept)} cases, {len(right)} with the right name added, {len(sure)} of them with "
        f"nothing unconfirmed; {len(near)} of {len(asked)} within {NEAR} of a model that is told\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
