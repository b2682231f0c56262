"""Joint states as `rostopic echo -p` and `ros2 topic echo --csv` print them.

The first writes a line of names in a comment, `%time,field.header.seq,...`, with
`field.name0` ..., `field.position0` ... for the arrays of a message. The second writes
no names at all: seconds and nanoseconds of the stamp, the frame, then the arrays one
after the other. Its columns get the names of the first form here, so that one naming
scheme reads both. Standard library only.
"""

import re
from collections.abc import Callable, Mapping, Sequence

ARRAYS = ("position", "velocity", "effort")
STAMP = ("field.header.stamp.sec", "field.header.stamp.nanosec")
_NAME = re.compile(r"field\.name(?P<place>[0-9]{1,3})")
_HEAD = 3  # fields in front of the names
_TIMES = 2  # of these, the stamp's


def echoed_names(
    row: Sequence[str], is_value: Callable[[str], bool]
) -> tuple[str, ...]:
    """Return names of the columns that `ros2 topic echo --csv` prints of a JointState.

    Parameters
    ----------
    row : sequence of str
        Fields of a line.
    is_value : callable
        Tells whether a field is a number, or the word for a missing one.

    Returns
    -------
    tuple of str
        Empty where the line is of another form.
    """
    stamp = row[:_TIMES]
    if len(stamp) < _TIMES or not all(field.isdecimal() for field in stamp):
        return ()
    n_joints = 0
    for field in row[_HEAD:]:
        if not field.strip() or is_value(field):
            break
        n_joints += 1
    if not n_joints:
        return ()

    names = [*STAMP, "field.header.frame_id"]
    names += [f"field.name{k}" for k in range(n_joints)]
    at = len(names)
    for array in ARRAYS:
        # An empty array leaves an empty field.
        length = n_joints if at < len(row) and row[at].strip() else 1
        if not all(is_value(field) or length == 1 for field in row[at : at + length]):
            return ()
        names += [f"field.{array}{k}" for k in range(length)]
        at += length
    return tuple(names) if len(names) == len(row) else ()


def joint_places(names: Sequence[str], row: Sequence[str]) -> Mapping[str, int]:
    """Return the place in its arrays of each joint that a line names."""
    places: dict[str, int] = {}
    for name, field in zip(names, row, strict=False):
        match = _NAME.fullmatch(name)
        if match is not None and field.strip():
            places.setdefault(field.strip(), int(match["place"]))
    return places


def name_columns(names: Sequence[str]) -> list[str]:
    """List the columns that hold the joints' names."""
    return [name for name in names if _NAME.fullmatch(name)]
