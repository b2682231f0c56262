"""The study of undeclared effects: which cases, what is kept, and its tables."""

import tempfile
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import get_args

from tests.studies.coverage.cases import RIGS
from tests.studies.undeclared.cases import RIG_NAMES, Condition, Group, matrix, quick
from tests.studies.undeclared.run import Choice, run, sources
from tests.studies.undeclared.tables import tables


def study(arguments: Namespace) -> str:
    """Run what is not there yet; return the tables."""
    choice = choice_of(arguments)
    records = run(choice)
    command = "python -m tests.studies --only undeclared"
    made = f"Made by `{command}`, sources {sources()[:12]}."
    return f"{made}\n\n{tables(records, len(choice.cases))}"


def add_arguments(parser: ArgumentParser) -> None:
    """Options that only this study has."""
    own = parser.add_argument_group("undeclared effects")
    folder = Path(tempfile.gettempdir()) / "seqid-study"
    own.add_argument("--cache", type=Path, default=folder, help="logs and results (%(default)s)")
    jobs = ("--processes", "--jobs")
    own.add_argument(*jobs, type=int, default=1, help="cases at a time (%(default)s)")
    own.add_argument("--only-kind", nargs="+", metavar="NAME", help="with one of these effects")
    rigs = list(dict.fromkeys([*RIG_NAMES, *RIGS]))
    own.add_argument("--rig", choices=rigs, help="one robot alone")
    own.add_argument("--seeds", metavar="A-B", help="these seeds alone (coverage: A:B)")
    own.add_argument(
        "--fresh",
        type=int,
        default=0,
        metavar="N",
        help="add so much to seeds: other motions, noise",
    )
    own.add_argument("--size", type=float, help="effects of this size alone")
    own.add_argument("--groups", nargs="+", choices=get_args(Group), help="parts of the study")
    own.add_argument("--limit", type=int, metavar="N", help="at most N new cases this time")
    own.add_argument("--tables", action="store_true", help="no runs, tables of what is there")


def choice_of(arguments: Namespace) -> Choice:
    """Cases that the options leave."""
    every = quick() if arguments.quick else matrix()
    chosen = [c for c in every if _chosen(c, arguments)]
    return Choice(
        cases=tuple(replace(c, seed=c.seed + arguments.fresh) for c in chosen),
        whole=not arguments.quick and len(chosen) == len(every) and not arguments.fresh,
        cache=arguments.cache,
        processes=arguments.processes,
        run=not arguments.tables,
        limit=arguments.limit,
    )


def _chosen(condition: Condition, arguments: Namespace) -> bool:
    names = {name for name, _, _ in condition.effects}
    sizes = {size for _, _, size in condition.effects}
    first, _, last = (arguments.seeds or "").partition("-")
    return (
        (arguments.rig is None or condition.rig == arguments.rig)
        and (arguments.groups is None or condition.group in arguments.groups)
        and (arguments.only_kind is None or bool(names & set(arguments.only_kind)))
        and (arguments.size is None or arguments.size in sizes)
        and (not first or int(first) <= condition.seed <= int(last or first))
    )
