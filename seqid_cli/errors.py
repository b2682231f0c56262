"""Errors that a user can meet, each with its exit code and remedy.

Library code raises; only the command layer prints and exits.
"""

EXIT_BUG = 70
EXIT_INTERRUPTED = 130


class SeqidWarning(UserWarning):
    """A doubt about the inputs; commands print it, and go on."""


class SeqidError(Exception):
    """A problem that the user can act on.

    `message` says what is wrong, with the value and the limit, `hint` what to do about
    it, `where` which file, channel, joint or key it is about.
    """

    exit_code = 2

    def __init__(self, message: str, *, hint: str = "", where: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


class UsageError(SeqidError):
    """The command line asks for something that cannot be done."""


class ConfigError(SeqidError):
    """The robot file or a parameter file is wrong."""


class InputError(SeqidError):
    """A log cannot be read or does not hold what the command needs."""


class QualityError(SeqidError):
    """The logs were read, but the result must not be trusted."""

    exit_code = 1
