"""Layouts of viewers for a file of torques, with a plot for each joint of the robot.

PlotJuggler and Foxglove know topics by their names, and joints by their names or by
their number. A layout for other joints shows nothing.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

from seqid_cli.params.files import write_text_atomic, writing

NAMES = ("plotjuggler.xml", "foxglove.json")
_COLORS = {
    "measured": "#1f77b4",
    "predicted": "#ff7f0e",
    "low": "#bcbd22",
    "high": "#bcbd22",
    "residual": "#d62728",
    "std": "#2ca02c",
}
_TABS = {
    "torque": ("measured", "predicted", "low", "high"),
    "residual": ("residual", "std"),
}
Layout: TypeAlias = "str | dict[str, object]"


def write_layouts(folder: Path, joints: Sequence[str]) -> list[Path]:
    """Write a layout for each viewer into a folder, and return the files.

    The folder is made. Raises UsageError where that cannot be done.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in NAMES]
    for path, text in zip(paths, (plotjuggler(joints), foxglove(joints)), strict=True):
        write_text_atomic(path, text)
    return paths


def plotjuggler(joints: Sequence[str]) -> str:
    """Return PlotJuggler's layout: a tab of torques and one of residuals."""
    root = ElementTree.Element("root")
    attributes = {"name": "Main Window", "parent": "main_window"}
    widget = ElementTree.SubElement(root, "tabbed_widget", attributes)
    for tab_name, topics in _TABS.items():
        tab = ElementTree.SubElement(widget, "Tab", tab_name=tab_name, containers="1")
        container = ElementTree.SubElement(tab, "Container")
        columns = _columns(joints)
        beside = _splitter(container, "|", len(columns))
        for column in columns:
            below = _splitter(beside, "-", len(column))
            for joint in column:
                area = ElementTree.SubElement(below, "DockArea", name=joint)
                plot = ElementTree.SubElement(
                    area,
                    "plot",
                    mode="TimeSeries",
                    style="Lines",
                    flip_x="false",
                    flip_y="false",
                )
                for topic in topics:
                    name = f"/seqid/{topic}/{joint}/effort"
                    ElementTree.SubElement(
                        plot, "curve", name=name, color=_COLORS[topic]
                    )
    ElementTree.SubElement(widget, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root, " ")
    text = ElementTree.tostring(root, encoding="unicode")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{text}\n"


def _splitter(
    parent: ElementTree.Element, orientation: str, count: int
) -> ElementTree.Element:
    """Add an area that is split into equal parts, beside or below each other."""
    sizes = ";".join([f"{1.0 / count:.6g}"] * count)
    return ElementTree.SubElement(
        parent, "DockSplitter", orientation=orientation, count=str(count), sizes=sizes
    )


def _columns(joints: Sequence[str]) -> list[Sequence[str]]:
    """Part joints into two columns of plots, or one where there are few."""
    half = max(1, -(-len(joints) // 2))
    return [joints[:half], joints[half:]] if len(joints) > 1 else [joints]


def foxglove(joints: Sequence[str]) -> str:
    """Return Foxglove's layout: a plot for each joint."""
    panels: dict[str, object] = {}
    for number, joint in enumerate(joints):
        panels[_panel(number)] = {
            "title": joint,
            "paths": [
                {
                    "value": f"/seqid/{topic}.effort[{number}]",
                    "label": topic,
                    "enabled": True,
                    "timestampMethod": "headerStamp",
                    "color": color,
                }
                for topic, color in _COLORS.items()
            ],
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "showPlotValuesInLegend": False,
            "isSynced": True,
            "xAxisVal": "timestamp",
            "sidebarDimension": 240,
        }
    columns = _columns([_panel(number) for number in range(len(joints))])
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", [_split("column", column) for column in columns]),
    }
    return json.dumps(document, indent=2) + "\n"


def _panel(number: int) -> str:
    return f"Plot!seqid{number + 1}"


def _split(direction: str, parts: Sequence[Layout]) -> Layout:
    """Lay panels of equal size in a row or a column; each split has two sides."""
    first, *others = parts
    if not others:
        return first
    return {
        "direction": direction,
        "first": first,
        "second": _split(direction, others),
        "splitPercentage": round(100.0 / len(parts), 1),
    }
