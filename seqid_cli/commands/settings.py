"""`--show-settings`: the settings of a command, which needs nothing else to show them."""

from typing import cast

import typer
from typer._click import Context
from typer.core import TyperCommand

from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.settings import Entry, Settings, entries, overridden


def command_with(settings: Settings) -> type[TyperCommand]:
    """Return the class of a command with these settings, given by their defaults."""

    class SettingsCommand(TyperCommand):
        """A command that shows its settings before it asks for its arguments."""

        def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
            given, _, _ = self.make_parser(ctx).parse_args(args=list(args))
            if given.get("show_settings"):
                effective = overridden(settings, given.get("set_values") or ())
                flags = ("quiet", "verbose", "json", "no_color")
                ctx.params = {name: bool(given.get(name)) for name in flags}
                show_settings(
                    screen_of(cast("typer.Context", ctx)), list(entries(effective))
                )
                raise typer.Exit
            return super().parse_args(ctx, args)

    return SettingsCommand


def show_settings(screen: Screen, shown: list[Entry]) -> None:
    """Print settings as a table, or as one JSON document."""
    screen.document(
        {
            "settings": [
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
        }
    )
    rows = [
        (entry.name, value_text(entry), entry.unit, entry.reason) for entry in shown
    ]
    screen.table(("setting", "value", "unit", "reason"), rows)


def value_text(entry: Entry) -> str:
    """Return the value of a setting, with its default where it is another."""
    if not entry.changed:
        return f"{entry.value:g}"
    return f"{entry.value:g} (default {entry.default:g})"
