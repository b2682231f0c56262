"""A payload in the words of robot controllers.

Universal Robots: `set_target_payload(m, cog, inertia)` of URScript, inertia about the centre of
mass as [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]; `set_payload(m, cog)` before software 5.10. Franka Robotics:
`Robot::setLoad(load_mass, F_x_Cload, load_inertia)` of libfranka, the inertia column by column.
ROS 2: `geometry_msgs/msg/Inertia`.
"""

from __future__ import annotations

from collections.abc import Sequence

Inertia = Sequence[Sequence[float]] | None


def settings_of(mass: float, center: Sequence[float], inertia: Inertia) -> dict[str, str]:
    """Write a payload as controllers take it.

    `mass`: kg. `center` (3,): centre of mass in the flange's frame, m. `inertia` (3, 3): about the
    centre of mass, in the axes of the flange's frame, kg m^2; zeros if not known.
    """
    m, c = _number(mass), [_number(x) for x in center]
    rows = inertia or [[0.0] * 3] * 3
    six = [rows[i][k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    column = [_number(rows[i][k]) for k in range(3) for i in range(3)]
    at = ", ".join(c)
    numbers = ", ".join(_number(x) for x in six)
    script = f"set_target_payload({m}, [{at}], [{numbers}])"
    found = {
        "urscript": script if inertia else f"set_payload({m}, [{at}])",
        "libfranka": f"robot.setLoad({m}, {{{at}}}, {{{', '.join(column)}}});",
    }
    fields = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), _upper(rows), strict=True)
    parts = "".join(f", {name}: {_number(x)}" for name, x in fields)
    found["ros2"] = f"{{m: {m}, com: {{x: {c[0]}, y: {c[1]}, z: {c[2]}}}{parts}}}"
    return found


def _upper(rows: Sequence[Sequence[float]]) -> list[float]:
    return [float(rows[i][k]) for i in range(3) for k in range(i, 3)]


def _number(value: float) -> str:
    return f"{value:.5g}" if value else "0.0"
