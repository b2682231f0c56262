"""Pictures of a report for the docs: python -m tests.unit.report.pictures PAGE.html FOLDER."""

import sys
import tempfile
from pathlib import Path

from tests.unit.report.browser import browsing

# name: width and height of the screen, part to show, dark, on paper
VIEWS = {
    "report": (1280, 860, "#verdict", False, False),
    "report_dark": (1280, 560, "#torque-2", True, False),
    "report_phone": (400, 800, "#torque-2", False, False),
    "report_print": (760, 1000, "#verdict", False, True),
}


def main(page: Path, folder: Path) -> None:
    """Write what a screen, a phone and a sheet of paper show of the page."""
    with tempfile.TemporaryDirectory() as profile, browsing(Path(profile)) as tab:
        for name, (width, height, part, dark, paper) in VIEWS.items():
            tab.open(page, width=width, height=height, dark=dark)
            if paper:
                tab.call("Emulation.setEmulatedMedia", media="print")
            top = "0" if part == "#verdict" else f"document.querySelector('{part}').offsetTop - 60"
            tab.run(f"scrollTo(0, {top})")
            tab.picture(folder / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
