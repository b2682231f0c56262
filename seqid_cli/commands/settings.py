"""`--show-settings` and `--set`: which settings each command has, and their table."""

from collections.abc import Mapping, Sequence

from typer.core import TyperCommand

from seqid_cli.commands.screen.render import Screen, screen_for
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.identify.settings import (
    FrictionSettings,
    GravitySettings,
    ImuCalibSettings,
    InertiaSettings,
    PredictSettings,
    SimultaneousSettings,
)
from seqid_cli.payload.settings import PayloadSettings
from seqid_cli.settings import Entry, Settings, entries, overridden

SETTINGS_OF_COMMANDS: Mapping[str, Settings] = {
    "friction": FrictionSettings(),
    "gravity": GravitySettings(),
    "imu-calib": ImuCalibSettings(),
    "inertia": InertiaSettings(),
    "predict": PredictSettings(),
    "diagnose": DiscoverSettings(),
    "refine": DiscoverSettings(),
    "simultaneous": SimultaneousSettings(),
    "payload": PayloadSettings(),
}


def show_settings(command: TyperCommand, name: str, words: Sequence[str]) -> int:
    """Show the settings of a command as the words behind it would make them.

    The words need not hold what the command asks for otherwise, such as logs: they are
    read as for completion, which misses nothing.
    """
    with command.make_context(name, list(words), resilient_parsing=True) as context:
        given = context.params
    screen = screen_for(
        name,
        quiet=given["quiet"],
        verbose=given["verbose"],
        json=given["json"],
        no_color=given["no_color"],
    )
    effective = overridden(SETTINGS_OF_COMMANDS[name], given["set_values"] or ())
    _show(screen, list(entries(effective)))
    return 0


def _show(screen: Screen, shown: Sequence[Entry]) -> None:
    """Print settings as a table, or as one JSON document."""
    document = [
        {
            "name": entry.name,
            "value": entry.value,
            "default": entry.default,
            "unit": entry.unit,
            "low": entry.low,
            "high": entry.high,
            "reason": entry.reason,
        }
        for entry in shown
    ]
    screen.document({"settings": document})
    rows = [
        (entry.name, value_text(entry), entry.unit, entry.reason) for entry in shown
    ]
    screen.table(("setting", "value", "unit", "reason"), rows)


def value_text(entry: Entry) -> str:
    """Return the value of a setting, with its default where it is another."""
    if not entry.changed:
        return f"{entry.value:g}"
    return f"{entry.value:g} (default {entry.default:g})"
