"""A payload in the words of robot controllers.

- Universal Robots: `set_target_payload(m, cog, inertia)` of URScript, inertia about the
  centre of mass as [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]; `set_payload(m, cog)` before
  software 5.10.
- Franka Robotics: `Robot::setLoad(load_mass, F_x_Cload, load_inertia)` of libfranka,
  the inertia column by column.
- ROS 2: `geometry_msgs/msg/Inertia`.
"""

from collections.abc import Sequence

from seqid_cli.params.results.payload import CarriedBodyEntry
from seqid_cli.params.schema import Matrix
from seqid_cli.typing import Array


def controller_settings(body: CarriedBodyEntry) -> dict[str, str]:
    """Write a body as controllers take it; none without a mass and a centre."""
    center = [
        coordinate.value
        for coordinate in body.center_of_mass
        if coordinate.value is not None
    ]
    if body.mass.value is None or len(center) < 3:
        return {}
    return settings_of(body.mass.value, center, body.inertia)


def settings_of(
    mass: float, center: Sequence[float] | Array, inertia: Matrix
) -> dict[str, str]:
    """Write a payload as controllers take it.

    Parameters
    ----------
    mass : float
        Mass [kg].
    center : (3,) sequence
        Centre of mass in the frame of the flange [m].
    inertia : (3, 3) nested list
        Inertia about the centre of mass, in the axes of that frame [kg m^2]; empty
        where it is not determined.

    Returns
    -------
    dict of str to str
        Text of the setting by controller: "urscript", "libfranka" and "ros2".
    """
    m = _number(mass)
    x, y, z = map(_number, center)
    rows = inertia or [[0.0] * 3] * 3
    I = [list(map(_number, row)) for row in rows]

    script = f"set_payload({m}, [{x}, {y}, {z}])"
    if inertia:
        moments = ", ".join([I[0][0], I[1][1], I[2][2], I[0][1], I[0][2], I[1][2]])
        script = f"set_target_payload({m}, [{x}, {y}, {z}], [{moments}])"

    by_column = ", ".join(I[row][column] for column in range(3) for row in range(3))
    load = f"robot.setLoad({m}, {{{x}, {y}, {z}}}, {{{by_column}}});"

    upper_triangle = ", ".join(
        f"i{'xyz'[row]}{'xyz'[column]}: {I[row][column]}"
        for row in range(3)
        for column in range(row, 3)
    )
    message = f"{{m: {m}, com: {{x: {x}, y: {y}, z: {z}}}, {upper_triangle}}}"
    return {"urscript": script, "libfranka": load, "ros2": message}


def _number(value: float) -> str:
    """Write a number with five digits."""
    return f"{value:.5g}" if value else "0.0"
