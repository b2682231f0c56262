"""What the parts of a long log show of it, its joints and IMUs, merged into one.

Each field has a rule. A value that a part does not know (None) does not count.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from msgspec import structs

from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
)

V = TypeVar("V", InspectedLog, InspectedJoint, InspectedImu)
# From the values of all parts and their numbers of samples.
Rule = Callable[[Sequence[Any], Sequence[int]], object]


def _sum(values: Sequence[Any], _: Sequence[int]) -> object:
    return sum(values)


def _least(values: Sequence[Any], _: Sequence[int]) -> object:
    return min(values)


def _largest(values: Sequence[Any], _: Sequence[int]) -> object:
    return max(values)


def _any(values: Sequence[Any], _: Sequence[int]) -> object:
    return any(values)


def _median(values: Sequence[Any], _: Sequence[int]) -> object:
    return float(np.median(values))


def _rms(values: Sequence[Any], samples: Sequence[int]) -> object:
    return float(np.sqrt(np.average(np.square(values), weights=samples)))


def _concatenated(values: Sequence[Any], _: Sequence[int]) -> object:
    return [item for items in values for item in items]


def _listed(values: Sequence[Any], _: Sequence[int]) -> object:
    return "; ".join(filter(None, values))


def _first_word(values: Sequence[Any], _: Sequence[int]) -> object:
    return next(filter(None, values), "")


def _range(values: Sequence[Any], _: Sequence[int]) -> object:
    return [min(low for low, _ in values), max(high for _, high in values)]


def _command(values: Sequence[Any], samples: Sequence[int]) -> object:
    """Merge commands: of the longest part in which the joint follows them."""
    following = [
        (count, value)
        for value, count in zip(values, samples, strict=True)
        if value.mode
    ]
    if not following:
        return values[0]
    return max(following, key=lambda pair: pair[0])[1]


_RULES: Mapping[str, Rule] = {
    # of logs
    "samples": _sum,
    "non_monotonic": _sum,
    "duplicates": _sum,
    "jitter": _rms,
    "log_minus_header_s": _median,
    "gaps": _concatenated,
    "partial": _listed,
    # of joints
    "moves": _any,
    "low": _least,
    "high": _largest,
    "top_speed": _largest,
    "encoder_step": _median,
    "effort": _first_word,
    "effort_rms": _rms,
    "temperature": _range,
    "command": _command,
    # of IMUs
    "accelerometers": _largest,
    "gyro": _any,
    "rate_hz": _median,
    "rest_norm": _median,
    "delay_s": _median,
}


def merged(parts: Sequence[V], samples: Sequence[int]) -> V:
    """Merge what all parts show of a log, a joint or an IMU.

    Parameters
    ----------
    parts : sequence of structures of one kind
        In the order of time.
    samples : sequence of int
        Samples of each, by which means are weighted.
    """
    fields: dict[str, object] = {}
    for name in _RULES.keys() & set(parts[0].__struct_fields__):
        values = []
        weights = []
        for part, count in zip(parts, samples, strict=True):
            value = getattr(part, name)
            if value is not None:
                values.append(value)
                weights.append(count)
        fields[name] = _RULES[name](values, weights) if values else None
    return structs.replace(parts[0], **fields)
