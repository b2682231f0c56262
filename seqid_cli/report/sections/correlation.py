"""How a stage's parameters hang together: which ones its logs tell apart badly."""

import numpy as np

from seqid_cli.params.schema import RigidStage
from seqid_cli.report import views
from seqid_cli.report.chart import WIDE, Box, Panel, element, figure, label
from seqid_cli.report.words import listed

_ROW = 14.0  # height of a parameter, in units of the drawing
_NAMES = 74.0  # width of the names
_TOP, _RIGHT = 26.0, 12.0
_LEAST = 0.1  # below it a cell stays empty
_STRONG = 0.9  # from here on a pair is named: its errors are twice what one alone has
_MOST_PAIRS = 40


def correlation_figure(stage: RigidStage, title: str) -> views.Figure | None:
    """Draw the correlations of a stage's parameters; None where there is no pair.

    Parameters
    ----------
    stage : RigidStage
        With the covariance of its parameters.
    title : str
        Name of the stage.

    Returns
    -------
    Figure or None
        A cell for each pair below the diagonal, with a table of the strongest.
    """
    n = len(stage.parameters)
    covariance = np.array(stage.covariance)
    if n < 2 or covariance.shape != (n, n):
        return None
    deviations = np.sqrt(np.diag(covariance))
    if not (np.isfinite(deviations).all() and (deviations > 0.0).all()):
        return None
    correlation = np.clip(covariance / np.outer(deviations, deviations), -1.0, 1.0)

    names = [parameter.name for parameter in stage.parameters]
    height = _ROW * n
    panel = Panel(
        box=Box(_NAMES, _TOP, WIDE - _RIGHT, _TOP + height),
        x_range=(0.0, float(n)),
        y_range=(0.0, float(n)),
        x_ticks=0,
        y_ticks=0,
    )
    for row in range(n):
        middle = panel.y(n - row - 0.5)
        panel.words.append(label(_NAMES - 6.0, middle + 4.0, names[row], "end"))
        for column in range(row):
            value = float(correlation[row, column])
            if abs(value) < _LEAST:
                continue
            cell = element(
                "rect",
                class_="cell plus" if value > 0.0 else "cell minus",
                x=panel.x(float(column)),
                y=panel.y(float(n - row)),
                width=panel.x(1.0) - panel.x(0.0),
                height=_ROW,
                fill_opacity=f"{abs(value):.2f}",
            )
            panel.marks.append(cell)

    strong = [
        (names[row], names[column], float(correlation[row, column]))
        for row in range(n)
        for column in range(row)
        if abs(correlation[row, column]) >= _STRONG
    ]
    strong.sort(key=lambda pair: -abs(pair[2]))
    pairs = views.table(
        f"{title}: pairs with a correlation of {_STRONG} and more",
        "parameter | with | correlation",
        "text text number",
        strong[:_MOST_PAIRS],
    )
    told = f"No pair has a correlation of {_STRONG} or more."
    if strong:
        some = listed([f"{first} with {second}" for first, second, _ in strong])
        told = f"Told apart badly by these logs: {some}."
    legend = {"plus": "positive", "minus": "negative; the stronger, the darker"}
    return figure(
        [panel],
        f"{title}: correlation of the parameters",
        told,
        legend,
        pairs,
        name="Correlation",
        note=told,
    )
