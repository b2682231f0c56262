"""Settings: numbers that a user or a calibration may turn, each with unit, bounds and reason.

A command has one frozen `Settings` class. Its fields are groups, and the fields of a
group are the numbers: `judging.max_gravity_factor` is the field `max_gravity_factor` of
the group `judging`. A number that is out of its bounds, or none, cannot be made part of
a group, so that no algorithm meets one. Other numbers stay constants beside their use.
"""

import difflib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from seqid_cli.errors import UsageError

S = TypeVar("S", bound="Settings")


def setting(default: float, *, unit: str, reason: str, low: float, high: float) -> Any:
    """Return the field of a group for one number.

    Parameters
    ----------
    default : float or int
        An int takes whole numbers alone.
    unit : str
        What the number is in, "rad" or "of the torque's RMS".
    reason : str
        What it guards, in one line.
    low, high : float
        The least and the largest number that makes sense.
    """
    about = {"unit": unit, "reason": reason, "low": low, "high": high}
    return field(default=default, metadata=about)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Base of groups of settings.

    Raises
    ------
    UsageError
        A number is none, or out of its bounds.
    """

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            whole = isinstance(each.default, int)
            if not _is_number(value, whole=whole):
                kind = "whole number" if whole else "number"
                raise UsageError(
                    f"{each.name} is no {kind}: {value!r}", hint=_asked(each)
                )
            if not each.metadata["low"] <= value <= each.metadata["high"]:
                raise UsageError(
                    f"{each.name} is out of bounds: {value:g}", hint=_asked(each)
                )


def _is_number(value: object, *, whole: bool) -> bool:
    if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
        return False
    return math.isfinite(value)


def _asked(each: Any) -> str:
    """Return what a setting may be, in words."""
    about = each.metadata
    bounds = f"from {about['low']:g} to {about['high']:g}"
    return f"It may be {bounds} ({about['unit']}); the default is {each.default:g}."


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of the settings of one command; its fields are groups."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One setting as it is shown: its whole name, its value, and what is known of it."""

    name: str
    value: float
    default: float
    unit: str
    low: float
    high: float
    reason: str

    @property
    def changed(self) -> bool:
        """Whether it is not what it is by default."""
        return self.value != self.default


def entries(settings: Settings) -> Iterator[Entry]:
    """Yield all settings of a command, group by group."""
    for of_group in fields(settings):
        group = getattr(settings, of_group.name)
        for each in fields(group):
            about = each.metadata
            yield Entry(
                name=f"{of_group.name}.{each.name}",
                value=getattr(group, each.name),
                default=each.default,  # type: ignore[arg-type]
                unit=about["unit"],
                low=about["low"],
                high=about["high"],
                reason=about["reason"],
            )


def overridden(settings: S, given: Sequence[str]) -> S:
    """Return settings with numbers as they are typed, "judging.max_gravity_factor=3".

    Raises
    ------
    UsageError
        There is no such setting (near names are told), or its value is no number or out
        of bounds.
    """
    for text in given:
        name, equals, value = text.partition("=")
        group_name, _, field_name = name.strip().partition(".")
        if not equals:
            hint = "Give a name and a number: --set judging.max_gravity_factor=3."
            raise UsageError(f"--set {text}: there is no value", hint=hint)

        known = {entry.name: entry for entry in entries(settings)}
        entry = known.get(name.strip())
        if entry is None:
            message = f"--set {text}: there is no setting {name.strip()!r}"
            raise UsageError(message, hint=_near(name.strip(), list(known)))

        group = getattr(settings, group_name)
        try:
            number = _number(value.strip(), whole=isinstance(entry.default, int))
            changed = replace(group, **{field_name: number})
        except UsageError as error:
            message = f"--set {text}: {group_name}.{error.message}"
            raise UsageError(message, hint=error.hint) from None
        settings = replace(settings, **{group_name: changed})
    return settings


def _number(text: str, *, whole: bool) -> Any:
    """Return a text as a number; as it is where it is none, which its group refuses."""
    try:
        return int(text) if whole else float(text)
    except ValueError:
        return text


def _near(name: str, known: Sequence[str]) -> str:
    """Return the names that may be meant, by the whole of them or by their last part."""
    last = {one.partition(".")[2]: one for one in known}
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    short = difflib.get_close_matches(
        name.rpartition(".")[2], list(last), n=3, cutoff=0.6
    )
    names = list(dict.fromkeys([*close, *(last[one] for one in short)]))
    if names:
        return f"Did you mean {' or '.join(names)}? All of them: --show-settings."
    return "--show-settings lists all of them."
