"""Two results of one robot side by side: what changed beyond its standard errors."""

from pathlib import Path

from seqid_cli.logs.given import PathLike
from seqid_cli.params.io import read_any
from seqid_cli.params.results.comparison import ComparisonFile


def compare(
    first: PathLike,
    second: PathLike,
    *,
    rtol: float | None = None,
    sigma: float | None = None,
) -> ComparisonFile:
    """Compare two parameter, prediction or diagnosis files of one robot.

    Parameters
    ----------
    first, second : path
        What was, or what should be, and what is now.
    rtol : float, optional
        Share of a number's size beyond which it has changed; alone it decides.
    sigma : float, optional
        Combined standard errors beyond which it has changed; alone it decides.

    Returns
    -------
    ComparisonFile
        `changed` counts the numbers that moved by more than both (without limits: 4
        standard errors and 0.01 of the size).

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    first_source, second_source = read_any([Path(first), Path(second)])

    # Imported here because it imports numpy: a file that cannot be read is told first.
    from seqid_cli.compare.differences import compared, rule_of

    return compared(first_source, second_source, rule_of(sigma, rtol))
