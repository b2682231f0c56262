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
            if not given.get("show_settings"):
                return super().parse_args(ctx, args)

            flags = ("show_settings", "quiet", "verbose", "json", "no_color")
            ctx.params = {name: bool(given.get(name)) for name in flags}
            ctx.params["set_values"] = given.get("set_values") or ()
            return []

        def invoke(self, ctx: Context) -> object:
            if not ctx.params["show_settings"]:
                return super().invoke(ctx)

            effective = overridden(settings, ctx.params["set_values"])
            screen = screen_of(cast("typer.Context", ctx))
            show_settings(screen, list(entries(effective)))
            return 0

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
