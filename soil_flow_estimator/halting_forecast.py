"""The halting forecast: the front wheels as scouts for the whole rover.

With de and st of the soil that the front wheels stand in, the most that a wheel can pull there is known, whatever the
slip now. What the rover could pull once **all** wheels stand in that soil, less what the slope takes and what else
holds it back, is the scout margin; it falls below zero before slip tells anything.

    C(de, st, delta) = max over slip of (F_t - R_c) of a wheel that has long slipped so, in soil dug by delta
    M = sum C(scouts) - W sin(max(pitch, slope behind the scouts)) - d,          z = -M/sigma_M
    d = low-pass over .3 m of rim of [sum of the wheels' pull now - W sin(pitch) - m dv/dt]
    sigma_M^2 = (sum grad C' P grad C of the scouts, as if one error) + (half of C(shallow) - C(deep))^2
                + (.003 W)^2 + (.045 W)^2

z is a score, not a probability: strength that is not mobilised is hardly seen at low slip. The same sum with the slope
behind the middle wheels taken the other way tells whether the rover could come back out.

What appears within centimetres (a stone under the belly) is no soil: while the disturbance has just jumped the margin
says nothing, and the verdict is SNAG. Slip that is beyond a limit, or will be within SLIP_AHEAD_S as it grows now, is
SLIPPING whatever the soil: wheels that hold out at a large slip do so steadily, those that do not run away.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np

from soil_flow_estimator.soil_filter import DE, DE_RANGE, P_DD, P_DS, P_SS, PULL, REFILL, ST, STANDING
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.slip_sinkage import (
    MEASURED_LAW,
    dug_wheel_kernel,
    kinematics_kernel,
    law_on_soil_kernel,
    pressed_depth_kernel,
)
from strap_rover.terramechanics.soil import soil_row_kernel

CAPACITY_DE = np.geomspace(DE_RANGE[0], DE_RANGE[1], 20)
CAPACITY_ST = np.linspace(0.0, 1.0, 11)
CAPACITY_REFILL = np.linspace(0.0, MEASURED_LAW.full_refill, 4)
CAPACITY_SLIPS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
SHALLOW_AND_DEEP = np.array([0.48, 1.0, 1.68])
"""Digging depths that a capacity is known for, over the one assumed: what it may be, one sigma down and up."""
LEAST_CAPACITY = -0.36
"""Of a wheel's load: deeper in the red the law knows no more."""
CARRIED = 0.98
"""Share of the load that a state must carry to count."""
DISTURBANCE_RIM_M = 0.3
SNAG_RIM_M = (0.08, 0.6)
"""Rim travel over which a jump of the disturbance is told from its trend [m]."""
SNAG_RATIO = 0.035
"""Jump of the disturbance over the rover's weight that is a snag."""
SNAG_HOLD_M = 1.2
"""Rim travel for which the margin then says nothing [m]."""
DEMAND_RIM_M = 0.1
SLIP_S = 0.3
"""Low-pass of the slip that is judged [s]."""
SLIP_AHEAD_S = 0.4
"""How far ahead the slip is judged [s]."""
SLIP_RATE_READINGS = 2
"""Readings over which its rate is taken."""
ACCELERATION_S = 0.4
PITCH_STD_RAD = 0.003
UNMODELLED_STD_RATIO = 0.045
"""1-sigma of the margin that no state tells of, over the rover's weight."""
RUNNING = 2
"""Readings running that it takes to say STOP."""
UNDER_WAY_M = 0.1
"""Way since the rover last stood after which its slip says something: a start is all slip [m]."""
LEARNING = 10
"""Readings after which the scouts' soil counts as known."""
MOVING_RIM_MPS = 0.02
LEAST_SLIP_SPEED = 0.03
"""Rim speed by which slip is judged at least [m/s]."""


@dataclass(frozen=True, slots=True)
class ForecastLimits:
    """Where verdicts begin."""

    caution_z: float = 0.0
    stop_z: float = 0.8
    slip_most: float = 0.75


@dataclass(frozen=True, slots=True)
class Forecast:
    """What lies ahead; forces [N]."""

    margin: float = 0.0
    margin_std: float = 0.0
    z: float = 0.0
    z_return: float = 0.0
    disturbance: float = 0.0
    verdict: ForecastVerdict = ForecastVerdict.NONE


NOTHING_KNOWN = Forecast()


class HaltingForecast:
    """Feed it once per reading of the soil filter, in the direction of travel."""

    def __init__(self, rover: RoverDescription, excavation_depth_m: float) -> None:
        self._mass = rover.mass_kg
        self._weight = rover.vertical_load_n
        wheels = rover.wheels
        loads = [rover.vertical_load_n * wheel.load_share for wheel in wheels]
        self._tables = np.array(
            [
                capacity_table(
                    wheel.radius_m,
                    wheel.width_m,
                    wheel.grouser_height_m,
                    float(f"{load:.6g}"),
                    excavation_depth_m,
                )
                for wheel, load in zip(wheels, loads, strict=True)
            ]
        )
        self._front, self._rear = scouts_of(rover, ahead=True), scouts_of(rover, ahead=False)
        self.forget()

    def forget(self) -> None:
        """As if nothing had been driven yet: also for a rover that turns back, what lay ahead lies behind."""
        self._last = NOTHING_KNOWN
        self._readings = 0
        self._speed: float | None = None
        self._acceleration = 0.0
        self._slips = [0.0] * (SLIP_RATE_READINGS + 1)
        self._slip_ahead = 0.0
        self._way = 0.0
        self._disturbance = self._sudden = self._trend = 0.0
        self._demand = self._demand_return = 0.0
        self._snag_rim_m = 0.0
        self._halting = 0

    @property
    def last(self) -> Forecast:
        """The last forecast."""
        return self._last

    def update(
        self,
        states: FloatArray,
        *,
        rim_speed: float,
        speed: float,
        pitch: float,
        slope_ahead: float,
        slope_behind: float,
        step_s: float,
        forwards: bool,
        limits: ForecastLimits,
        judges: bool = True,
    ) -> Forecast:
        """The forecast after one more reading.

        Args:
            states: of `SoilFilter`, shape (W, 20).
            rim_speed: mean over the wheels, in the direction of travel [m/s].
            speed: of the body in the direction of travel [m/s].
            pitch: of the body, uphill positive in the direction of travel [rad].
            slope_ahead: of the ground from the second to the foremost axle, likewise [rad].
            slope_behind: of the ground from the hindmost axle to the one before it, likewise [rad].
            step_s: time since the last reading [s].
            forwards: whether the front wheels are ahead.
            limits: where verdicts begin.
            judges: whether the slope of the ground is known; where it is not, all is forgotten.
        """
        if not judges:  # on unknown ground nothing can be held against anything
            self.forget()
            return self._last
        rim = max(rim_speed, 0.0)
        rim_way = rim * step_s
        self._follow_motion(rim, speed, step_s)
        weight = self._weight
        demand = weight * math.sin(max(pitch, slope_ahead))
        demand_return = weight * math.sin(max(-slope_behind, 0.0))
        held = float(states[:, PULL].sum()) - weight * math.sin(pitch) - self._mass * self._acceleration
        if self._readings == 0:
            self._demand, self._demand_return = demand, demand_return
        share = _share(rim_way, DEMAND_RIM_M)
        self._demand += share * (demand - self._demand)
        self._demand_return += share * (demand_return - self._demand_return)
        self._disturbance += _share(rim_way, DISTURBANCE_RIM_M) * (held - self._disturbance)
        self._sudden += _share(rim_way, SNAG_RIM_M[0]) * (held - self._sudden)
        self._trend += _share(rim_way, SNAG_RIM_M[1]) * (held - self._trend)
        if self._readings < LEARNING:  # what is there from the start has not just come
            self._trend = self._sudden

        scouts = self._front if forwards else self._rear
        pull, soil_std, spread = _capacities_kernel(self._tables, states, scouts)
        level = math.cos(pitch)
        pull, soil_std, spread = level * pull, level * soil_std, level * spread
        std = math.sqrt(
            soil_std**2 + (0.5 * spread) ** 2 + (PITCH_STD_RAD * weight) ** 2 + (UNMODELLED_STD_RATIO * weight) ** 2
        )
        margin = pull - self._demand - self._disturbance
        margin_return = pull - max(self._disturbance, 0.0) - self._demand_return
        rolls = bool(states[scouts, STANDING].max() < 0.5)
        if rolls and rim > MOVING_RIM_MPS:
            self._readings += 1
        z = -margin / std
        verdict = ForecastVerdict.NONE
        if self._readings >= LEARNING:
            verdict = self._judge(z, rim, rim_way, limits)
        self._last = Forecast(margin, std, z, -margin_return / std, self._disturbance, verdict)
        return self._last

    def _follow_motion(self, rim: float, speed: float, step_s: float) -> None:
        if self._speed is None:
            self._speed = speed
        before = self._speed
        share = step_s / (ACCELERATION_S + step_s)
        self._speed += share * (speed - self._speed)
        self._acceleration += share * ((self._speed - before) / step_s - self._acceleration)
        slip = min(max((rim - speed) / max(rim, LEAST_SLIP_SPEED), -1.0), 1.0) if rim > MOVING_RIM_MPS else 0.0
        last = self._slips[-1] + step_s / (SLIP_S + step_s) * (slip - self._slips[-1])
        self._slips = [*self._slips[1:], last]
        rate = (last - self._slips[0]) / (SLIP_RATE_READINGS * step_s)
        self._slip_ahead = last + SLIP_AHEAD_S * rate
        self._way = self._way + max(speed, 0.0) * step_s if rim > MOVING_RIM_MPS else 0.0

    def _judge(self, z: float, rim: float, rim_way: float, limits: ForecastLimits) -> ForecastVerdict:
        self._snag_rim_m = max(self._snag_rim_m - rim_way, 0.0)
        if self._sudden - self._trend > SNAG_RATIO * self._weight:
            self._snag_rim_m = SNAG_HOLD_M
        if rim > MOVING_RIM_MPS:
            self._halting = self._halting + 1 if z > limits.stop_z and not self._snag_rim_m else 0
        if rim > MOVING_RIM_MPS and self._way > UNDER_WAY_M and self._slip_ahead > limits.slip_most:
            return ForecastVerdict.SLIPPING
        if self._snag_rim_m:
            return ForecastVerdict.SNAG
        if self._halting >= RUNNING:
            return ForecastVerdict.STOP
        return ForecastVerdict.CAUTION if z > limits.caution_z else ForecastVerdict.CLEAR


def scouts_of(rover: RoverDescription, *, ahead: bool) -> IntArray:
    """For every wheel the foremost (or hindmost) wheel whose track is nearest to its own, shape (W,)."""
    x = [wheel.x_m for wheel in rover.wheels]
    edge = max(x) if ahead else min(x)
    first = [index for index, place in enumerate(x) if abs(place - edge) < 1e-6]
    return np.array(
        [min(first, key=lambda index: abs(rover.wheels[index].y_m - wheel.y_m)) for wheel in rover.wheels],
        dtype=np.int64,
    )


@functools.lru_cache(maxsize=32)
def capacity_table(
    radius: float, width: float, grouser_height: float, load: float, excavation_depth: float
) -> FloatArray:
    """Largest pull [N] of a wheel by CAPACITY_REFILL, CAPACITY_DE, CAPACITY_ST, SHALLOW_AND_DEEP: shape (4, 20, 11, 3).

    `excavation_depth` is delta/(1 + kappa) [m]. Read-only.
    """
    table = np.empty((CAPACITY_REFILL.size, CAPACITY_DE.size, CAPACITY_ST.size, SHALLOW_AND_DEEP.size))
    law = np.empty_like(MEASURED_LAW.row())
    for part, kappa in zip(table, CAPACITY_REFILL.tolist(), strict=True):
        law_on_soil_kernel(MEASURED_LAW.row(), kappa, law)
        _capacity_table_kernel(
            radius, width, grouser_height, load, excavation_depth * (1.0 + kappa), kappa, law,
            CAPACITY_DE, CAPACITY_ST, CAPACITY_SLIPS, SHALLOW_AND_DEEP, part,
        )  # fmt: skip
    table.setflags(write=False)
    return table


def _share(way: float, length: float) -> float:
    return 1.0 - math.exp(-way / length)


@compiled
def _capacity_table_kernel(
    radius: float,
    width: float,
    grouser_height: float,
    load: float,
    excavation_depth: float,
    refill_ratio: float,
    law: FloatArray,
    des: FloatArray,
    sts: FloatArray,
    slips: FloatArray,
    depths: FloatArray,
    table: FloatArray,
) -> None:
    soil = np.empty(6)
    for i in range(des.size):
        for j in range(sts.size):
            soil_row_kernel(des[i], sts[j], width, soil)
            for k in range(depths.size):
                best = LEAST_CAPACITY * load
                pressed = 0.0
                for slip in slips:
                    om, along, _ = kinematics_kernel(slip, 0.0)
                    dug = min(depths[k] * excavation_depth * slip / (1.0 - slip + refill_ratio), 0.8 * radius)
                    pressed = pressed_depth_kernel(
                        load, pressed, radius, width, grouser_height, soil, law, dug, 0.0, om, along, 0.0
                    )
                    forces = dug_wheel_kernel(
                        radius, width, grouser_height, soil, law, pressed, dug, 0.0, om, along, 0.0
                    )
                    if forces[5] > CARRIED * load:
                        best = max(best, forces[2] - forces[3])
                table[i, j, k] = best


@compiled
def _capacity_kernel(table: FloatArray, refill: float, de: float, st: float, depth: int) -> float:
    """Linear in kappa, ln de and st, the edge beyond it."""
    kinds, rows, columns = table.shape[0], table.shape[1], table.shape[2]
    up = min(max(refill / CAPACITY_REFILL[-1], 0.0), 1.0) * (kinds - 1)
    across = math.log(max(de, DE_RANGE[0]) / DE_RANGE[0]) / math.log(DE_RANGE[1] / DE_RANGE[0]) * (rows - 1)
    along = min(max(st, 0.0), 1.0) * (columns - 1)
    k, i, j = int(min(up, kinds - 2.0)), int(min(across, rows - 2.0)), int(min(along, columns - 2.0))
    w, u, v = up - k, min(across - i, 1.0), along - j
    pull = 0.0
    for dk in range(2):
        for di in range(2):
            part = (w if dk else 1.0 - w) * (u if di else 1.0 - u)
            low, high = table[k + dk, i + di, j, depth], table[k + dk, i + di, j + 1, depth]
            pull += part * ((1.0 - v) * low + v * high)
    return float(pull)


@compiled
def _capacities_kernel(tables: FloatArray, states: FloatArray, scouts: IntArray) -> tuple[float, float, float]:
    """Sums over wheels of what each could pull in its scout's soil [N], of its 1-sigma, and of shallow less deep."""
    pull = std = spread = 0.0
    for i in range(scouts.size):
        scout, table = states[scouts[i]], tables[i]
        de, st, refill = scout[DE], scout[ST], scout[REFILL]
        pull += _capacity_kernel(table, refill, de, st, 1)
        spread += abs(_capacity_kernel(table, refill, de, st, 0) - _capacity_kernel(table, refill, de, st, 2))
        up, down = min(st + 0.05, 1.0), max(st - 0.05, 0.0)
        by_de = _capacity_kernel(table, refill, 1.05 * de, st, 1) - _capacity_kernel(table, refill, de / 1.05, st, 1)
        by_de /= 1.05 * de - de / 1.05
        by_st = _capacity_kernel(table, refill, de, up, 1) - _capacity_kernel(table, refill, de, down, 1)
        by_st /= up - down
        variance = by_de**2 * scout[P_DD] + 2.0 * by_de * by_st * scout[P_DS] + by_st**2 * scout[P_SS]
        std += math.sqrt(max(variance, 0.0))
    return pull, std, spread
