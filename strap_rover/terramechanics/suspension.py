"""How the suspension shares the weight between the wheels, and how body and rockers tilt on uneven ground.

Two kinds. A **rocker-bogie** (three wheels per side): each side's rocker carries the front wheel and, on a pivot, the
bogie with the other two; a differential lets both rockers carry equal moments and the body follow their mean angle.
It is statically determinate. Moments about the rocker pivot (x_p, height h_p) and the bogie pivot (x_b, h_b), with
R the load on the side, F_x the net horizontal force on each wheel at the ground and D the differential's moment:

    N_2 (x_2 - x_b) + N_3 (x_3 - x_b) + h_b (F_x2 + F_x3) = 0,   B = N_2 + N_3,   N_1 + B = R
    N_1 (x_1 - x_p) + B (x_b - x_p) + h_p F_x1 + (h_p - h_b)(F_x2 + F_x3) = D

with D = -(h - h_p) W sin(pitch)/2 for a centre of gravity at height h above x_p. Wheels that pull unload the front of
their own bogie and rocker: thrust matters. Every **other** rover is `planar`: its loads are linear in the position of
the wheel, as on equal springs that are stiff.

The pivots are where level ground gives each wheel its share of the load, so the rover file need not name them. Tilts
of rockers against the body are small: lever arms are those of level ground. A wheel about to lift keeps a twentieth of
its share.
"""

import math
from dataclasses import dataclass

import numpy as np

from strap_rover.arrays import FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.compiled import compiled

LEAST_SHARE = 0.05
"""Of a wheel's share on level ground: what is left on a wheel that would lift."""


@dataclass(frozen=True, slots=True, eq=False)
class SuspensionGeometry:
    """What load and tilt depend on; `sides` is empty for a planar suspension."""

    sides: IntArray
    """Shape (2, 3) or (0, 3): front, middle, rear wheel of the left and the right side."""
    numbers: FloatArray
    """Shape (11,): centre of gravity x, y and height, rocker pivot height, bogie pivot height, track [m], sums of the
    squares of wheel x and y about their means [m^2], those means [m], sum of the products x y about them [m^2]."""
    wheels: FloatArray
    """Shape (3, W): x, y [m], share of the load."""

    @property
    def is_rocker_bogie(self) -> bool:
        """Whether rockers and bogies share the load."""
        return bool(self.sides.size)


def suspension_of(rover: RoverDescription) -> SuspensionGeometry:
    """The geometry of a rover's suspension: rocker-bogie where it names joints, else planar.

    Raises ValueError for joints on a rover that is no rocker-bogie of three wheels per side.
    """
    wheels = np.array([[w.x_m, w.y_m, w.load_share] for w in rover.wheels]).T.copy()
    x, y, share = wheels
    cg_x, cg_y = float(share @ x / share.sum()), float(share @ y / share.sum())
    sides = _sides(rover)
    track = 0.0
    if sides.size:
        left, right = (float((share[side] @ y[side]) / share[side].sum()) for side in sides)
        track = left - right
    numbers = np.array(
        [
            cg_x,
            cg_y,
            rover.cg_height_m,
            rover.rocker_pivot_height_m,
            rover.bogie_pivot_height_m,
            track,
            ((x - x.mean()) ** 2).sum(),
            ((y - y.mean()) ** 2).sum(),
            x.mean(),
            y.mean(),
            (x - x.mean()) @ (y - y.mean()),
        ]
    )
    return SuspensionGeometry(sides, numbers, wheels)


def _sides(rover: RoverDescription) -> IntArray:
    joints, wheels = rover.suspension_joints, rover.wheels
    if not joints:
        return np.empty((0, 3), dtype=np.int64)
    sides = [
        sorted((i for i, wheel in enumerate(wheels) if (wheel.y_m > 0.0) == left), key=lambda i: -wheels[i].x_m)
        for left in (True, False)
    ]
    if len(joints) != 4 or [len(side) for side in sides] != [3, 3]:
        raise ValueError(
            f"rover {rover.name!r}: suspension_joints are simulated for rocker and bogie of three wheels per "
            f"side, left then right, not for {len(joints)} joints on {len(sides[0])} + {len(sides[1])} wheels; "
            "leave the list empty"
        )
    return np.array(sides, dtype=np.int64)


def joint_angles(geometry: SuspensionGeometry, bottoms: FloatArray, pitch: float) -> list[float]:
    """Rocker and bogie of each side against the body [rad], left then right; empty without joints.

    `bottoms`: height of each wheel's lowest point [m], shape (W,). Front end up is positive.
    """
    angles: list[float] = []
    for side in geometry.sides:
        rocker, bogie = _side_tilts_kernel(side, geometry.wheels, bottoms)
        angles += [rocker - pitch, bogie - pitch]
    return angles


@compiled
def _bogie_pivot_kernel(side: IntArray, wheels: FloatArray) -> float:
    """X of the bogie pivot [m]."""
    share_2, share_3 = wheels[2, side[1]], wheels[2, side[2]]
    return float((share_2 * wheels[0, side[1]] + share_3 * wheels[0, side[2]]) / (share_2 + share_3))


@compiled
def _side_tilts_kernel(side: IntArray, wheels: FloatArray, bottoms: FloatArray) -> tuple[float, float]:
    """Tilt of rocker and bogie of one side [rad], front end up positive."""
    front, middle, rear = side[0], side[1], side[2]
    bogie = math.atan2(bottoms[middle] - bottoms[rear], wheels[0, middle] - wheels[0, rear])
    pivot_x = _bogie_pivot_kernel(side, wheels)
    part = (pivot_x - wheels[0, rear]) / (wheels[0, middle] - wheels[0, rear])
    pivot_z = bottoms[rear] + part * (bottoms[middle] - bottoms[rear])
    return math.atan2(bottoms[front] - pivot_z, wheels[0, front] - pivot_x), bogie


@compiled
def _plane_kernel(numbers: FloatArray, along: float, across: float) -> tuple[float, float]:
    """Per x and per y, the plane over the wheels whose moments in x and y are `along` and `across`; 0 where undefined.

    Sums over the wheels of plane times (x - mean) and plane times (y - mean) are the moments.
    """
    common = numbers[6] * numbers[7] - numbers[10] * numbers[10]
    if common > 1e-9 * numbers[6] * numbers[7]:
        return (
            (along * numbers[7] - across * numbers[10]) / common,
            (across * numbers[6] - along * numbers[10]) / common,
        )
    return along / numbers[6] if numbers[6] > 0.0 else 0.0, across / numbers[7] if numbers[7] > 0.0 else 0.0


@compiled
def tilt_of_plane_kernel(rise: float, lean: float) -> tuple[float, float]:
    """Pitch (nose up) and roll (right side down) [rad] of a body on a plane that rises so much per length ahead, left.

    Heading, pitch, roll in this order (ROS REP 103): roll is about the pitched axis, so less than atan(lean).
    """
    pitch = math.atan(rise)
    return pitch, math.atan(lean * math.cos(pitch))


@compiled
def body_tilt_kernel(
    sides: IntArray, numbers: FloatArray, wheels: FloatArray, bottoms: FloatArray
) -> tuple[float, float]:
    """Pitch (nose up) and roll (right side down) of the body [rad] on wheels whose lowest points are at `bottoms`.

    Rocker-bogie: pitch is the mean of the rockers; others: of the plane through the wheels. Roll is of that plane. 0
    where all wheels are in one line.
    """
    along = across = 0.0
    for i in range(bottoms.size):
        along += (wheels[0, i] - numbers[8]) * bottoms[i]
        across += (wheels[1, i] - numbers[9]) * bottoms[i]
    rise, lean = _plane_kernel(numbers, along, across)
    if sides.shape[0] == 2:
        left, _ = _side_tilts_kernel(sides[0], wheels, bottoms)
        right, _ = _side_tilts_kernel(sides[1], wheels, bottoms)
        rise = math.tan(0.5 * (left + right))
    return tilt_of_plane_kernel(rise, lean)


@compiled
def wheel_loads_kernel(
    weight: float,
    pitch: float,
    roll: float,
    pulls: FloatArray,
    sides: IntArray,
    numbers: FloatArray,
    wheels: FloatArray,
    loads: FloatArray,
) -> None:
    """Load on each wheel along the body's vertical [N] into `loads`; `pulls`: net force on each along the body [N]."""
    count = loads.size
    pressing = weight * math.cos(pitch) * math.cos(roll)
    height = numbers[2]
    to_right = weight * math.sin(roll) * math.cos(pitch) * height
    backward = weight * math.sin(pitch)
    if sides.shape[0] == 2:
        differential = -0.5 * backward * (height - numbers[3])
        whole = wheels[2].sum()
        for k in range(2):
            front, middle, rear = sides[k, 0], sides[k, 1], sides[k, 2]
            share = wheels[2, front] + wheels[2, middle] + wheels[2, rear]
            side_load = pressing * share / whole + (-to_right if k == 0 else to_right) / numbers[5]
            pivot_x = _bogie_pivot_kernel(sides[k], wheels)
            bogie_share = wheels[2, middle] + wheels[2, rear]
            rocker_x = (wheels[2, front] * wheels[0, front] + bogie_share * pivot_x) / share
            bogie_pull = pulls[middle] + pulls[rear]
            moment = (
                differential - numbers[3] * pulls[front] - (numbers[3] - numbers[4]) * bogie_pull
                - side_load * (pivot_x - rocker_x)
            )  # fmt: skip
            loads[front] = moment / (wheels[0, front] - pivot_x)
            on_bogie = side_load - loads[front]
            loads[middle] = (-numbers[4] * bogie_pull - on_bogie * (wheels[0, rear] - pivot_x)) / (
                wheels[0, middle] - wheels[0, rear]
            )
            loads[rear] = on_bogie - loads[middle]
    else:
        per_x, per_y = _plane_kernel(numbers, backward * height, to_right)
        for i in range(count):
            loads[i] = wheels[2, i] * pressing
            loads[i] -= per_x * (wheels[0, i] - numbers[8]) + per_y * (wheels[1, i] - numbers[9])
    for i in range(count):
        loads[i] = max(loads[i], LEAST_SHARE * wheels[2, i] * weight)
