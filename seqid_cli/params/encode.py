"""JSON text of structures that a person can read and compare.

Objects are indented, lists of numbers stay on one line, floats have 12 significant
digits: enough for every result, few enough to hide the last bits of another BLAS.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence

import msgspec

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
_DIGITS = 12
LARGEST = 1e29  # of a result: whoever reads it refuses 1e30 and more
_SCALARS = (str, int, float, bool, type(None))


def encode(document: object) -> str:
    """Render a structure as JSON text, ending in a newline.

    Raises
    ------
    ValueError
        A number is not finite.
    TypeError
        A value has no JSON form.
    """
    return _render(plain(document), "") + "\n"


def plain(value: object) -> Json:
    """Turn structures into dictionaries, lists and rounded numbers.

    Errors are those of `encode`, and name the place of the value.
    """
    try:
        return _plain(value)
    except _NoJsonError as error:
        place = "".join(reversed(error.steps))
        raise error.of_kind(f"${place} {error}") from None


class _NoJsonError(Exception):
    """A value has no place in JSON: what is said of it, and the steps up from it.

    `of_kind` is the error that callers know.
    """

    def __init__(self, said: str, of_kind: type[Exception]) -> None:
        super().__init__(said)
        self.of_kind = of_kind
        self.steps: list[str] = []


def _plain(value: object) -> Json:
    if isinstance(value, float):
        return _rounded(value)
    if isinstance(value, bool | str | int | None):
        return value
    if isinstance(value, msgspec.Struct):
        return _of_struct(value)
    if isinstance(value, Mapping):
        return _of_items(value.items())
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        items: list[Json] = []
        for item in value:
            try:
                items.append(_plain(item))
            except _NoJsonError as error:
                error.steps.append(f"[{len(items)}]")
                raise
        return items
    raise _NoJsonError(
        f"is a {type(value).__name__}, which has no JSON form", TypeError
    )


def _rounded(value: float) -> float:
    """Return a number with the digits of a result, and no larger than these may be."""
    if not math.isfinite(value):
        said = f"is {value}: every number of a result must be finite"
        raise _NoJsonError(said, ValueError)
    within = min(max(value, -LARGEST), LARGEST)
    return float(f"{within:.{_DIGITS}g}")


def _of_struct(struct: msgspec.Struct) -> dict[str, Json]:
    """Return the fields of a structure; a sparse one leaves out what is None."""
    is_sparse = struct.__struct_config__.omit_defaults
    fields = ((name, getattr(struct, name)) for name in struct.__struct_fields__)
    return _of_items(
        (name, value) for name, value in fields if value is not None or not is_sparse
    )


def _of_items(items: Iterable[tuple[object, object]]) -> dict[str, Json]:
    named: dict[str, Json] = {}
    for key, item in items:
        try:
            named[str(key)] = _plain(item)
        except _NoJsonError as error:
            error.steps.append(f".{key}")
            raise
    return named


def _render(value: Json, margin: str) -> str:
    """Write a value; `margin` are the spaces before its lines."""
    inner = margin + "  "
    if isinstance(value, dict) and value:
        items = [
            f"{inner}{json.dumps(key)}: {_render(item, inner)}"
            for key, item in value.items()
        ]
        return "{\n" + ",\n".join(items) + f"\n{margin}}}"
    if isinstance(value, list) and not all(
        isinstance(item, _SCALARS) for item in value
    ):
        items = [inner + _render(item, inner) for item in value]
        return "[\n" + ",\n".join(items) + f"\n{margin}]"
    return json.dumps(value, allow_nan=False)
