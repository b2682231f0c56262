"""What a call of exported code costs: an arm of six joints, without and with every
effect.
"""

import subprocess
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from seqid_cli.effects.fitted import Fitted
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.export.code import identifier
from seqid_cli.export.formats import export
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests.studies.tables import table
from tests.unit.export.arms import sample
from tests.unit.export.motions import CASES, fitted, with_effects

CALLS = 200_000
MAIN = """
#include <stdio.h>
#include <time.h>
#include "arm.h"

enum {{ N = {joints}, CALLS = {calls} }};

int main(void)
{{
    static {name}_state s;
    double q[N], dq[N], ddq[N], degrees[N], tau[N], sum = 0.0;
    clock_t begun;
    int i, k;
    for (i = 0; i < N; ++i) {{
        q[i] = 0.1 * i;
        degrees[i] = 30.0 + i;
    }}
    {name}_start(&s, q);
    begun = clock();
    for (k = 0; k < CALLS; ++k) {{
        /* no sine, so that the loop costs nothing beside the call */
        for (i = 0; i < N; ++i) {{
            const double way = (k + 97 * i) % 1000 / 500.0 - 1.0;
            q[i] = way * (1.0 - way * way);
            dq[i] = 2.0 * (1.0 - 3.0 * way * way);
            ddq[i] = -24.0 * way;
        }}
        {call};
        sum += tau[k % N];
    }}
    printf("%g %g\\n", 1e6 * (double)(clock() - begun) / CLOCKS_PER_SEC / CALLS, sum);
    return 0;
}}
"""


def study(chosen: Namespace) -> str:
    """Return the table of calls and their cost."""
    rounds = 1 if chosen.quick else 9
    robot, plain = sample("six_joint")
    items = every_effect(robot)
    refined = with_effects(plain, robot, items)
    torque, step = (
        "{name}_torque(q, dq, ddq, tau)",
        "{name}_step(&s, q, dq, ddq, degrees, 1e-3 * k, 1e-3, tau)",
    )
    cases = [
        ("torque, no effects", plain, torque),
        ("step, no effects", plain, step),
        (f"torque, {len(items)} effects", refined, torque),
        (f"step, {len(items)} effects", refined, step),
    ]
    rows = [
        [title, f"{cost_us(robot, stages, call, rounds):.2f}"]
        for title, stages, call in cases
    ]
    return table(["six joints, cc -O2", "us per call"], rows)


def every_effect(robot: Robot) -> list[Fitted]:
    """Return every effect of the catalogue at every joint that can have it."""
    items: list[Fitted] = []
    for name, cases in CASES.items():
        effect, one = CATALOGUE[name], cases[0]
        if effect.arm:
            items.append(fitted(effect, one))
            continue
        for joint in range(robot.n):
            settings = dict(one.settings)
            if "neighbour" in settings and joint == 0:
                settings["neighbour"] = 1.0
            items.append(fitted(effect, replace(one, joint=joint, settings=settings)))
    return items


def cost_us(robot: Robot, stages: Stages, call: str, rounds: int) -> float:
    """Return the CPU time of a call, us: the median over rounds of `CALLS` calls."""
    name = identifier(robot.name)
    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "arm.h").write_text(export(robot, stages, kind="C header").text)
        main = MAIN.format(
            name=name, joints=robot.n, calls=CALLS, call=call.format(name=name)
        )
        (place / "main.c").write_text(main)
        built = [
            "cc",
            "-std=c99",
            "-O2",
            "-o",
            str(place / "main"),
            str(place / "main.c"),
            "-lm",
        ]
        subprocess.run(built, check=True)
        runs = [
            subprocess.run(
                [str(place / "main")], capture_output=True, text=True, check=True
            )
            for _ in range(rounds)
        ]
    return median(float(run.stdout.split()[0]) for run in runs)
