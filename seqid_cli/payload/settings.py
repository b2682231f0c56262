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
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    six = {name: _number(rows["xyz".index(name[1])]["xyz".index(name[2])]) for name in names}
    column = [_number(rows[i][k]) for k in range(3) for i in range(3)]
    at, numbers = ", ".join(c), ", ".join(six.values())
    script = f"set_target_payload({m}, [{at}], [{numbers}])"
    found = {
        "urscript": script if inertia else f"set_payload({m}, [{at}])",
        "libfranka": f"robot.setLoad({m}, {{{at}}}, {{{', '.join(column)}}});",
    }
    parts = "".join(f", {name}: {six[name]}" for name in sorted(names))
    found["ros2"] = f"{{m: {m}, com: {{x: {c[0]}, y: {c[1]}, z: {c[2]}}}{parts}}}"
    return found


def _number(value: float) -> str:
    return f"{value:.5g}" if value else "0.0"
