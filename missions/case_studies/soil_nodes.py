"""Soil as a bed of nodes that the flow law displaces under a rolling wheel (Figs 4, 5, 12 and 13 of the source paper).

Nodes know where they lie along the way and how deep below the surface; each carries the soil of its cell. Eq. 5 moves
them as the wheel goes by. The law says nothing of how the load presses the soil down: in pictures the column under a
rim is let down with it, and the law acts on depth below the rim.
"""

from dataclasses import dataclass

import numpy as np

from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.terramechanics.spiral_flow import bulb_depth, flow_velocity

REACH_RADII = 3.5
"""Nodes further than this from the wheel's centre, in radii, are left alone: where the flow is widest, at slip 0.45,
its velocity there is below 1e-5 of its largest."""
COLUMNS, ROWS = 400, 25
"""10 000 nodes."""
BED_DEPTH = 1.25
"""Depth of a bed over that of the pressure bulb: what lies below must not move."""


@dataclass(frozen=True, slots=True)
class Passing:
    """The wheel at one instant, as far as the flow law knows it; ValueError unless theta_1 > theta_2."""

    x_m: float
    """Of the wheel's centre."""
    radius_m: float
    speed_mps: float
    slip: float
    theta_1: float
    theta_2: float
    """Signed [rad]."""
    sinkage_m: float
    load_n: float

    def __post_init__(self) -> None:
        if not self.theta_1 > self.theta_2:
            raise ValueError(f"theta_1 must lie ahead of theta_2, got {self.theta_1!r} and {self.theta_2!r} rad")

    @property
    def front(self) -> float:
        """Sin theta_1: entering boundary x_ent from the wheel's centre, in radii."""
        return float(np.sin(self.theta_1))

    @property
    def rear(self) -> float:
        """Sin theta_2: departing boundary x_out from the wheel's centre, in radii."""
        return float(np.sin(self.theta_2))


@dataclass(frozen=True, slots=True)
class MassFlow:
    """Soil into and out of the zone under a wheel, summed over nodes [kg/s]."""

    entering: float
    leaving: float

    @property
    def ratio(self) -> float:
        """M_ent/M_out; inf where nothing leaves."""
        return self.entering / self.leaving if self.leaving > 0.0 else float("inf")


class SoilNodes:
    """A bed of `columns` x `rows` nodes from `start` to `end` [m], `depth` [m] deep, at rest.

    `x` and `depth` [m], shape (N,), are where the nodes are; `travel` [m] how far the flow has carried each from its
    place. ValueError for an empty bed.
    """

    def __init__(self, start: float, end: float, depth: float, columns: int = COLUMNS, rows: int = ROWS) -> None:
        if not (end > start and depth > 0.0 and columns > 0 and rows > 0):
            raise ValueError(
                f"a bed of nodes needs end > start, depth > 0 and one node or more, got {start}..{end} m, {depth} m, "
                f"{columns} x {rows}"
            )
        x = start + (end - start) * (np.arange(columns) + 0.5) / columns
        below = depth * (np.arange(rows) + 0.5) / rows
        self.start_x: FloatArray = np.tile(x, rows)
        self.start_depth: FloatArray = np.repeat(below, columns)
        self.x: FloatArray = self.start_x.copy()
        self.depth: FloatArray = self.start_depth.copy()
        self.cell_area: float = (end - start) * depth / (columns * rows)
        """Of one node [m^2]."""

    @property
    def travel(self) -> FloatArray:
        """How far each node is from where it lay [m], shape (N,)."""
        return np.asarray(np.hypot(self.x - self.start_x, self.depth - self.start_depth))

    def velocity(self, wheel: Passing, deformability: float) -> tuple[FloatArray, FloatArray]:
        """Forward and upward velocity of every node [m/s], shape (N,) each; 0 below the bulb and out of reach."""
        forward, up = np.zeros(self.x.size), np.zeros(self.x.size)
        moved = self._moved(wheel)
        bulb = float(bulb_depth(wheel.load_n))
        factor = np.minimum(1.0 - self.depth[moved] / bulb, 1.0)
        x_over_r = (self.x[moved] - wheel.x_m) / wheel.radius_m
        forward[moved], up[moved] = flow_velocity(x_over_r, factor, deformability, wheel.speed_mps, wheel.slip)
        return forward, up

    def _moved(self, wheel: Passing) -> BoolArray:
        near = np.abs(self.x - wheel.x_m) < REACH_RADII * wheel.radius_m
        return np.asarray(near & (self.depth < float(bulb_depth(wheel.load_n))))

    def advance(self, wheel: Passing, deformability: float, seconds: float) -> None:
        """Let the wheel pass for a moment that is short beside radius over speed."""
        forward, up = self.velocity(wheel, deformability)
        self.x += forward * seconds
        self.depth -= up * seconds

    def lobe_flow(
        self, wheel: Passing, deformability: float, centre: float, width_m: float, density: float
    ) -> MassFlow:
        """What the nodes in the contact carry ahead of and behind the flow's centre x_c (in radii), per contact length.

        The nodes' own sum of what `spiral_flow.mass_flow` gives in closed form.
        """
        forward, _ = self.velocity(wheel, deformability)
        place = (self.x - wheel.x_m) / wheel.radius_m
        length = wheel.radius_m * (wheel.front - wheel.rear)
        per_node = 2.0 * density * width_m * self.cell_area * np.abs(forward) / length
        entering = per_node[(place > centre) & (place < wheel.front)].sum()
        leaving = per_node[(place < centre) & (place > wheel.rear)].sum()
        return MassFlow(float(entering), float(leaving))

    def boundary_flow(
        self, wheel: Passing, deformability: float, width_m: float, density: float, column_m: float
    ) -> MassFlow:
        """What crosses the two boundaries, Eq. 9 as printed: from the nodes in a column of `column_m` about each."""
        forward, _ = self.velocity(wheel, deformability)
        flows = []
        for boundary in (wheel.front, wheel.rear):
            inside = np.abs(self.x - wheel.x_m - boundary * wheel.radius_m) < 0.5 * column_m
            flows.append(float(2.0 * density * width_m * self.cell_area * np.abs(forward[inside]).sum() / column_m))
        return MassFlow(*flows)


class Rut:
    """The surface the wheel leaves: undisturbed ahead, the rim below, and behind as deep as the contact ended."""

    def __init__(self) -> None:
        self._exit_x: list[float] = []
        self._exit_depth: list[float] = []

    def pass_over(self, wheel: Passing) -> None:
        """Take the wheel a little further on."""
        exit_x = wheel.x_m + wheel.radius_m * wheel.rear
        if not self._exit_x or exit_x > self._exit_x[-1]:
            self._exit_x.append(exit_x)
            lift = wheel.radius_m * (1.0 - float(np.cos(wheel.theta_2)))
            self._exit_depth.append(max(wheel.sinkage_m - lift, 0.0))

    def depth(self, x: FloatArray, wheel: Passing) -> FloatArray:
        """Depth of the surface below the undisturbed one [m] at `x` [m], with the wheel where it is."""
        place = (x - wheel.x_m) / wheel.radius_m
        below_hub = wheel.radius_m * np.sqrt(np.maximum(1.0 - place**2, 0.0))
        rim = np.where(np.abs(place) < 1.0, np.maximum(wheel.sinkage_m - wheel.radius_m + below_hub, 0.0), 0.0)
        rear = wheel.x_m + wheel.radius_m * wheel.rear
        front = wheel.x_m + wheel.radius_m * wheel.front
        behind = np.interp(x, self._exit_x, self._exit_depth, left=0.0) if self._exit_x else np.zeros(x.size)
        # A wheel that digs on the spot goes deeper than the rut it left: no soil is inside its rim.
        return np.where(x > front, 0.0, np.where(x >= rear, rim, np.maximum(behind, rim)))
