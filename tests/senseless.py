"""Numbers in documents that no log can mean."""

from collections.abc import Iterator

# Of any number in a result in SI units, dates and counts of samples included.
LARGEST = 1e15


def senseless(document: object, place: str = "$") -> Iterator[str]:
    """Yield the places of numbers that are too large, and of texts that hold such."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from senseless(value, f"{place}.{key}")
    elif isinstance(document, list):
        for number, value in enumerate(document):
            yield from senseless(value, f"{place}[{number}]")
    elif isinstance(document, float | int) and abs(document) > LARGEST:
        yield f"{place} is {document}"
    elif isinstance(document, str) and place.rpartition(".")[2] != "sha256":
        digits = "".join(c if c.isdigit() else " " for c in document).split()
        yield from (f"{place} says {run}" for run in digits if len(run) > 15)
