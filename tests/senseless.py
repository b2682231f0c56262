"""Numbers in documents that no log can mean."""

from collections.abc import Iterator

# Of any number in a result in SI units, dates and counts of samples included.
LARGEST = 1e15


def senseless(document: object, place: str = "$") -> Iterator[str]:
    """Yield the places of numbers without sense: too large, none, errors of zero; and
    of texts that hold such.

    A standard error of zero is that of a number that was given and not identified: of
    one with a value of its own beside it, it claims what no log can show.
    """
    if isinstance(document, dict):
        if document.get("std_error") == 0.0 and document.get("value") is not None:
            yield f"{place}.std_error is 0"
        for key, value in document.items():
            yield from senseless(value, f"{place}.{key}")
    elif isinstance(document, list):
        for number, value in enumerate(document):
            yield from senseless(value, f"{place}[{number}]")
    elif isinstance(document, float | int) and not abs(document) <= LARGEST:
        yield f"{place} is {document}"
    elif isinstance(document, str) and place.rpartition(".")[2] != "sha256":
        digits = "".join(c if c.isdigit() else " " for c in document).split()
        yield from (f"{place} says {run}" for run in digits if len(run) > 15)
