"""A process that watches the one which does the work, and says what it died of.

Logs are read by libraries in native code, and a fault there ends the process without a
word. So the program runs in a child, forked before anything is imported, which costs a
millisecond. When it dies in a library, the command is started again without the file
that was being read: that is a message like any other, and the rest of a folder counts.
Of Linux only: there the kernel ends the child when its watcher is gone.
"""

import contextlib
import fcntl
import os
import signal
import sys

from seqid_cli.being_read import Note, note_in
from seqid_cli.commands.signals import ENDING, answer_signals
from seqid_cli.errors import EXIT_BUG, EXIT_INTERRUPTED, UsageError

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection

# By which faults in native code end a process.
_FAULTS = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGFPE")
# Files of one command: each is read anew with all that came before it.
MOST_DEADLY = 20


def watched() -> int | None:
    """Go on in a child, and watch it from here.

    Returns
    -------
    int or None
        The exit code of the program; None in the child, which has the work to do.
    """
    deadly: dict[str, str] = {}
    # Of a caller that ignores it, no child's end would be told.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    while True:
        note = Note(deadly)
        taken = _taken_signals()
        signal.pthread_sigmask(signal.SIG_BLOCK, taken)
        alive_end, watcher_end = os.pipe()
        watcher = os.getpid()
        try:
            child = os.fork()
        except OSError:  # no more processes are allowed: it works unwatched
            os.close(alive_end)
            os.close(watcher_end)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, taken)
            return None
        if not child:
            os.close(watcher_end)
            _die_with(watcher, alive_end)
            note_in(note)
            answer_signals()
            signal.pthread_sigmask(signal.SIG_UNBLOCK, taken)
            return None

        os.close(alive_end)
        status = _wait(child, taken)
        os.close(watcher_end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, taken)
        if not os.WIFSIGNALED(status):
            return os.WEXITSTATUS(status)

        name = signal.Signals(os.WTERMSIG(status)).name
        path = note.read()
        if name == "SIGKILL":
            return _said(
                "error: the process was killed, most likely because memory ran out",
                UsageError.exit_code,
                path=path,
                hint="Use a machine with more memory, or split the log.",
            )
        if name in ENDING:  # once more, when it was interrupted and about to end
            return EXIT_INTERRUPTED
        if name not in _FAULTS:
            return 128 + os.WTERMSIG(status)
        if not path or path in deadly or len(deadly) == MOST_DEADLY:
            return _said(
                f"a library has ended the process ({name}); this is a bug",
                EXIT_BUG,
                path=path,
            )
        deadly[path] = name


def _taken_signals() -> set[signal.Signals]:
    """Return the signals that the watcher waits for."""
    ending = {getattr(signal, name) for name in ENDING}
    heard = {
        number for number in ending if signal.getsignal(number) is not signal.SIG_IGN
    }
    return {signal.SIGCHLD, *heard}


def _die_with(watcher: int, alive_end: int) -> None:
    """Let this process end when its watcher does, as if they were one."""
    # The kernel sends SIGIO once nobody holds the other end, and SIGIO ends a process.
    fcntl.fcntl(alive_end, fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(alive_end, fcntl.F_GETFL)
    fcntl.fcntl(alive_end, fcntl.F_SETFL, flags | os.O_ASYNC)
    if os.getppid() != watcher:
        os._exit(EXIT_BUG)


def _wait(child: int, taken: "Collection[signal.Signals]") -> int:
    """Pass signals on until the child has ended; returns its status."""
    while True:
        received = signal.sigwaitinfo(taken)
        if received.si_signo == signal.SIGCHLD:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return status
        # A terminal sends its signals to both.
        elif received.si_pid:
            os.kill(child, received.si_signo)


def _said(message: str, code: int, *, path: str, hint: str = "") -> int:
    """Say how the child has ended, and what it read then; returns the exit code."""
    # It is imported only here, as it takes longer than all the rest of this module.
    from seqid_cli.visible import visible

    text = f"seqid: {message}\n"
    if path:
        text += f"  file: {visible(path)}\n"
    if hint:
        text += f"  hint: {hint}\n"
    with contextlib.suppress(OSError):
        sys.stderr.write(text)
        sys.stderr.flush()
    return code
