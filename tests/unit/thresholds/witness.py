"""What every test of a threshold does, and what it proves.

A `Witness` is a small case of one setting. `is_flagged` gets the settings of the group
and a size, which stands for what is compared with the threshold; `beyond` and `within`
are two such sizes, near the threshold on either side. They are numbers written down,
not worked out from the default: were the default loosened or tightened by half, one of
them would change sides, which the second assertion shows of each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from seqid_cli.settings import Group


@dataclass(frozen=True, kw_only=True)
class Witness:
    """A case in which a setting decides."""

    command: str
    setting: str
    beyond: float
    within: float
    is_flagged: Callable[[Any, float], bool]

    @property
    def group(self) -> Group:
        """The settings by default."""
        of_command = SETTINGS_OF_COMMANDS[self.command]
        return getattr(of_command, self.setting.partition(".")[0])  # type: ignore[no-any-return]

    @property
    def key(self) -> tuple[type[Group], str]:
        """The field; several commands may have its group."""
        return type(self.group), self.setting.partition(".")[2]

    def sides(self, group: Group) -> tuple[bool, bool]:
        """Return whether the two sizes are flagged."""
        return self.is_flagged(group, self.beyond), self.is_flagged(group, self.within)

    def check(self) -> None:
        """Assert that the default lies between the sizes, and no number half as far
        off.
        """
        assert self.sides(self.group) == (True, False)
        (field,) = (x for x in fields(self.group) if x.name == self.key[1])
        default = getattr(self.group, field.name)
        for factor in (0.5, 1.5):
            number = factor * default
            if isinstance(field.default, int):
                number = round(number)
            low, high = field.metadata["low"], field.metadata["high"]
            moved = min(max(number, low), high)
            changed = replace(self.group, **{field.name: moved})
            assert self.sides(changed) != (True, False), f"{factor} times"


def witnesses(
    command: str, rows: Sequence[tuple[str, float, float, Callable[[Any, float], bool]]]
) -> list[Witness]:
    """Return those of one command, by rows: setting, beyond, within, is_flagged."""
    return [
        Witness(
            command=command,
            setting=setting,
            beyond=beyond,
            within=within,
            is_flagged=is_flagged,
        )
        for setting, beyond, within, is_flagged in rows
    ]
