"""The progress bar of rich, as one line that leaves nothing behind.

Import this module where a bar is drawn, not before.
"""

from collections.abc import Callable
from typing import TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

_BAR_WIDTH = 16
_REFRESH_HZ = 2.0
# Steps may take minutes each, and rich forgets those that are older than this.
_SPEED_PERIOD_S = 24 * 3600.0


class _TimeLeftColumn(TimeRemainingColumn):
    """The time that is left, or nothing where nobody knows how many parts there are."""

    def render(self, task: Task) -> Text:
        """Return the time as text."""
        if task.total is None:
            return Text("")
        return super().render(task).append(" left")


def progress_bar(
    stream: TextIO, *, color: bool, clock: Callable[[], float]
) -> Progress:
    """Return a bar that is not drawn yet: parts done, what comes next, times.

    Whoever writes to the stream stops the bar first: were rich to redirect the stream
    instead, it would break the commands in messages at the width of the terminal.
    """
    console = Console(
        file=stream,
        force_terminal=True,
        force_jupyter=False,
        color_system="standard" if color else None,
        markup=False,
        emoji=False,
        highlight=False,
    )
    return Progress(
        BarColumn(bar_width=_BAR_WIDTH),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        _TimeLeftColumn(),
        console=console,
        refresh_per_second=_REFRESH_HZ,
        speed_estimate_period=_SPEED_PERIOD_S,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
        get_time=clock,
    )
