"""From structures to JSON text that a person can read and compare.

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

    Raises ValueError for a number that is not finite, TypeError for what has no JSON
    form.
    """
    return _render(plain(document), "") + "\n"


def plain(value: object, path: str = "$") -> Json:
    """Turn structures into dictionaries, lists and rounded numbers."""
    if isinstance(value, bool | str | int | None):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(
                f"{path} is {value}: every number of a result must be finite"
            )
        return float(f"{min(max(value, -LARGEST), LARGEST):.{_DIGITS}g}")
    if isinstance(value, msgspec.Struct):
        sparse = value.__struct_config__.omit_defaults
        fields = {name: getattr(value, name) for name in value.__struct_fields__}
        kept = {
            name: item
            for name, item in fields.items()
            if item is not None or not sparse
        }
        return {name: plain(item, f"{path}.{name}") for name, item in kept.items()}
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{path}.{key}") for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [plain(item, f"{path}[{index}]") for index, item in enumerate(value)]
    raise TypeError(f"{path} is a {type(value).__name__}, which has no JSON form")


def _render(value: Json, margin: str) -> str:
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
