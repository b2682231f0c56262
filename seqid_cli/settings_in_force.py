"""The settings of the command that runs, for rooms that decide deep inside.

A stage hands its settings down as arguments. Where a number decides many calls below,
in a check of one channel or a score of one term, the functions between would hand down
what they do not use. Such a number is asked for where it decides:

    limits = in_force(InspectSettings).channels

Settings are in force in one thread of one process. Processes that read logs have the
defaults, so nothing that is decided there may ask here for other ones.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar, cast

from seqid_cli.settings import Settings

S = TypeVar("S", bound=Settings)
P = ParamSpec("P")
R = TypeVar("R")

_in_force: ContextVar[Mapping[type[Settings], Settings]] = ContextVar("settings")
_NONE: Mapping[type[Settings], Settings] = {}
_defaults: dict[type[Settings], Settings] = {}


def in_force(kind: type[S]) -> S:
    """Return the settings of a class that are in force, by default its defaults."""
    settings = _in_force.get(_NONE).get(kind)
    if settings is None:
        # Made once: this is asked in inner loops.
        if kind not in _defaults:
            _defaults[kind] = kind()
        settings = _defaults[kind]
    return cast(S, settings)


@contextlib.contextmanager
def put_in_force(settings: Settings) -> Iterator[None]:
    """Let `in_force` return these settings inside the block."""
    before = _in_force.get(_NONE)
    token = _in_force.set({**before, type(settings): settings})
    try:
        yield
    finally:
        _in_force.reset(token)


def puts_settings_in_force(function: Callable[P, R]) -> Callable[P, R]:
    """Put the argument `settings` of a function in force while it works."""

    @functools.wraps(function)
    def with_settings(*arguments: P.args, **keywords: P.kwargs) -> R:
        settings: Any = keywords.get("settings")
        if settings is None:
            return function(*arguments, **keywords)
        with put_in_force(settings):
            return function(*arguments, **keywords)

    return with_settings
