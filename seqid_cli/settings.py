"""Settings: numbers that a user or a calibration may turn.

Each has a unit, bounds and a reason.

A command has one frozen `Settings` class. Its fields are groups, and the fields of a
group are the numbers: `judging.max_gravity_factor` is the field `max_gravity_factor` of
the group `judging`. A number that is out of its bounds, or none, cannot be made part of
a group, so that no algorithm meets one. Other numbers stay constants beside their use.
"""

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
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
    metadata = {"unit": unit, "reason": reason, "low": low, "high": high}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Base of groups of settings.

    Raises
    ------
    UsageError
        A number is none, or out of its bounds.
    """

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            is_integer = isinstance(item.default, int)
            if not _is_number(value, integer=is_integer):
                kind = "whole number" if is_integer else "number"
                raise UsageError(
                    f"{item.name} is no {kind}: {value!r}", hint=_bounds(item)
                )
            if not item.metadata["low"] <= value <= item.metadata["high"]:
                raise UsageError(
                    f"{item.name} is out of bounds: {value:g}", hint=_bounds(item)
                )


def _is_number(value: object, *, integer: bool) -> bool:
    """Return whether a value is a finite number, or a whole one."""
    if isinstance(value, bool):  # which Python counts among the integers
        return False
    if not isinstance(value, int if integer else int | float):
        return False
    return math.isfinite(value)


def _bounds(item: Any) -> str:
    """Return what a setting may be, in words."""
    metadata = item.metadata
    bounds = f"from {metadata['low']:g} to {metadata['high']:g}"
    return f"It may be {bounds} ({metadata['unit']}); the default is {item.default:g}."


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of the settings of one command; its fields are groups."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One setting as it is shown, with its full name "group.field"."""

    name: str
    value: float
    default: float
    unit: str
    low: float
    high: float
    reason: str

    @property
    def changed(self) -> bool:
        """Whether the value differs from the default."""
        return self.value != self.default


def entries(settings: Settings) -> Iterator[Entry]:
    """Yield all settings of a command, group by group."""
    for group_field in fields(settings):
        group = getattr(settings, group_field.name)
        for item in fields(group):
            yield Entry(
                name=f"{group_field.name}.{item.name}",
                value=getattr(group, item.name),
                default=item.default,  # type: ignore[arg-type]
                unit=item.metadata["unit"],
                low=item.metadata["low"],
                high=item.metadata["high"],
                reason=item.metadata["reason"],
            )


def overridden(settings: S, assignments: Sequence[str]) -> S:
    """Return settings with numbers as they are typed, "judging.max_gravity_factor=3".

    Parameters
    ----------
    settings : Settings
        Settings of one command.
    assignments : sequence of str
        Name and value of each number that is another one; the last one counts.

    Raises
    ------
    UsageError
        There is no such setting (near names are named), or its value is no number or
        out of bounds.
    """
    for text in assignments:
        name, equals, value = text.partition("=")
        group_name, _, field_name = name.strip().partition(".")
        if not equals:
            hint = "Give a name and a number: --set judging.max_gravity_factor=3."
            raise UsageError(f"--set {text}: there is no value", hint=hint)

        by_name = {entry.name: entry for entry in entries(settings)}
        entry = by_name.get(name.strip())
        if entry is None:
            message = f"--set {text}: there is no setting {name.strip()!r}"
            raise UsageError(message, hint=_near_names(name.strip(), list(by_name)))

        group = getattr(settings, group_name)
        try:
            number = _parsed(value.strip(), integer=isinstance(entry.default, int))
            changed = replace(group, **{field_name: number})
        except UsageError as error:
            message = f"--set {text}: {group_name}.{error.message}"
            raise UsageError(message, hint=error.hint) from None
        settings = replace(settings, **{group_name: changed})
    return settings


def with_values(settings: S, values: Mapping[str, float]) -> S:
    """Return settings with numbers as a document has them.

    Parameters
    ----------
    settings : Settings
        Settings of one command.
    values : mapping of str to float
        By full name. What is no setting (any more) is left out.
    """
    by_name = {entry.name: entry for entry in entries(settings)}
    for name, value in values.items():
        entry = by_name.get(name)
        if entry is None:
            continue
        group_name, _, field_name = name.partition(".")
        number = int(value) if isinstance(entry.default, int) else value
        group = replace(getattr(settings, group_name), **{field_name: number})
        settings = replace(settings, **{group_name: group})
    return settings


def _parsed(text: str, *, integer: bool) -> Any:
    """Return a text as a number; as it is where it is none, which its group refuses."""
    try:
        return int(text) if integer else float(text)
    except ValueError:
        return text


def _near_names(name: str, names: Sequence[str]) -> str:
    """Return a hint with the names that may be meant."""
    # Whoever leaves the group out, or takes another one, still means the same field.
    by_field = {full_name.partition(".")[2]: full_name for full_name in names}
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    close_fields = difflib.get_close_matches(
        name.rpartition(".")[2], list(by_field), n=3, cutoff=0.6
    )
    close += [by_field[field_name] for field_name in close_fields]
    if close:
        meant = " or ".join(dict.fromkeys(close))
        return f"Did you mean {meant}? All of them: --show-settings."
    return "--show-settings lists all of them."
