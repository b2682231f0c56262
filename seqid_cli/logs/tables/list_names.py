"""Names of the elements of list columns, where the file or its data set tells them.

A table made of JointState messages has a `name` column of string lists. A LeRobot data set names
the motors of `observation.state` in `meta/info.json`, two folders or one above its data files.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.logs.tables.naming_schemes import LEROBOT_STATE

_LARGEST = 16 << 20  # bytes of an info.json
_ENDINGS = ("", ".pos", ".position", "_pos", "_position", ".q")
_NAME_COLUMNS = ("name", "names", "joint_names")


def list_entries(
    path: Path, file: pq.ParquetFile, lists: Mapping[str, int], joints: Sequence[str]
) -> tuple[dict[str, int], tuple[str, ...]]:
    """Find the place of each joint in the file's lists, where it names them all; and notes."""
    if LEROBOT_STATE in lists:
        length = lists[LEROBOT_STATE]
        places = _places(_lerobot_names(path), joints)
        if len(places) == len(joints):
            return places, ()
        if joints and length == len(joints):
            return {}, (f"{LEROBOT_STATE}: values are taken in the order of the robot file",)
        return {}, ()
    places = _places(_name_column(path, file), joints)
    return (places, ()) if len(places) == len(joints) else ({}, ())


def _places(names: Sequence[str], joints: Sequence[str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for joint in joints:
        for ending in _ENDINGS:
            if joint + ending in names:
                found.setdefault(joint, list(names).index(joint + ending))
    return found


def motors_of(path: Path) -> tuple[str, ...]:
    """Name the motors of a LeRobot data set as joints; empty where they are not told."""
    plain = re.compile("(?:[._]pos(?:ition)?|[.]q)$")
    return tuple(plain.sub("", name) for name in _lerobot_names(path))


def _lerobot_names(path: Path) -> list[str]:
    for folder in list(path.absolute().parents)[1:4]:
        info = folder / "meta" / "info.json"
        try:
            if info.stat().st_size > _LARGEST:
                return []
            content = json.loads(info.read_text(encoding="utf-8"))
            names = content["features"][LEROBOT_STATE]["names"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue
        if isinstance(names, dict) and len(names) == 1:  # {"motors": [...]} of older data sets
            names = next(iter(names.values()))
        if isinstance(names, list):
            return [str(name) for name in names]
    return []


def _name_column(path: Path, file: pq.ParquetFile) -> list[str]:
    for column in _NAME_COLUMNS:
        if column not in file.schema_arrow.names:
            continue
        kind = file.schema_arrow.field(column).type
        if not pa.types.is_list(kind) or not pa.types.is_string(kind.value_type):
            continue
        rows = file.read(columns=[column]).column(0).to_pylist()
        given = [row for row in rows if row]
        if any(row != given[0] for row in given):
            message = f"the names in column {column!r} change from row to row"
            hint = "Write one column per joint, <joint>.position and so on."
            raise InputError(message, hint=hint, where=str(path))
        return [str(name) for name in given[0]] if given else []
    return []
