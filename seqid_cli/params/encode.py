"""JSON text of structures that a person can read and compare.

Objects are indented, lists of numbers stay on one line, floats have 12 significant
digits: enough for every result, few enough to hide the last bits of another BLAS.
"""

import json
import math
from collections.abc import Mapping, Sequence

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


def plain(value: object, path: str = "$") -> Json:
    """Turn structures into dictionaries, lists and rounded numbers.

    `path` is the place of the value, for messages. Errors are those of `encode`.
    """
    if isinstance(value, bool | str | int | None):
        return value
    if isinstance(value, float):
        return _rounded(value, path)
    if isinstance(value, msgspec.Struct):
        return _of_struct(value, path)
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{path}.{key}") for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [plain(item, f"{path}[{index}]") for index, item in enumerate(value)]
    raise TypeError(f"{path} is a {type(value).__name__}, which has no JSON form")


def _rounded(value: float, path: str) -> float:
    """Return a number with the digits of a result, and no larger than these may be."""
    if not math.isfinite(value):
        raise ValueError(f"{path} is {value}: every number of a result must be finite")
    within = min(max(value, -LARGEST), LARGEST)
    return float(f"{within:.{_DIGITS}g}")


def _of_struct(struct: msgspec.Struct, path: str) -> dict[str, Json]:
    """Return the fields of a structure; a sparse one leaves out what is None."""
    is_sparse = struct.__struct_config__.omit_defaults
    fields: dict[str, Json] = {}
    for name in struct.__struct_fields__:
        value = getattr(struct, name)
        if value is not None or not is_sparse:
            fields[name] = plain(value, f"{path}.{name}")
    return fields


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
