"""Every setting has a case on either side of it."""

from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from tests.unit.thresholds import (
    test_discovery,
    test_drives,
    test_inspection,
    test_plans,
    test_stages,
)

WITNESSES = (
    *test_stages.WITNESSES,
    *test_inspection.WITNESSES,
    *test_discovery.WITNESSES,
    *test_plans.WITNESSES,
    *test_drives.WITNESSES,
)


def test_every_setting_has_its_case() -> None:
    """A new setting needs a case that fails when it is loosened by half."""
    held = [witness.key for witness in WITNESSES]
    assert len(held) == len(set(held))
    of_commands = {
        (type(getattr(settings, group)), name)
        for settings in SETTINGS_OF_COMMANDS.values()
        for group in settings.__dataclass_fields__
        for name in getattr(settings, group).__dataclass_fields__
    }
    assert set(held) == of_commands
