"""de and st of the soil under every rolling wheel: an extended Kalman filter with implicit residuals.

Per wheel the state is [de, st, b], the load being W e^(sigma_W b) with b of unit variance. What is measured
are the ends of the contact, slip and motor torque; none is a function of the state, but two residuals vanish at the
truth:

    e_0 = ln W + sigma_W b - ln F_z(theta_1, theta_2, s, z_e; de, st)
    e_1 = T - T(theta_1, theta_2, s, z_e; de, st)                      where torque is told

with F_z and T of `slip_sinkage`. Noise of angles, slip, dug depth and torque is carried into the covariance of the
residuals through their derivatives. b is considered, not estimated (Schmidt's filter: its gain is zero, its
correlation with de and st is kept): averaging cannot make the estimate better than the load is known. Without torque
e_0 alone is left, and st is considered, too: it stays where it is, and de is known up to what st could be.

What the residuals need and no sensor tells follows from the motion: slip as the shear under the wheel has it lags
by `slip_relaxation_m` of travel; the depth z_e that slip has dug obeys

    dz_e/dt = [delta (r omega - v) - (v + kappa r omega) z_e]/L_c,   L_c = r (sin theta_1 + sin|theta_2|)

with delta/(1 + kappa) assumed and 40 % of z_e + 1 mm as its 1-sigma. kappa, whether sand flows back into the hole that
a wheel digs, shows in the exit angle: sand that does not stands no higher behind the wheel than its lowest point.

Soil changes along the way: de and st wander by `de_drift` and `st_drift` per root metre, and jump where two residuals
running are a surprise. A wheel that comes to where another wheel of its side has been is told what that one found, at
the rate of one opinion per CORRELATION_M of way.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.slip_sinkage import MEASURED_LAW, kinematics_kernel, seen_wheel_kernel
from strap_rover.terramechanics.soil import soil_row_kernel

DE_RANGE = (0.005, 0.95)
"""Bounds of de in the filter: below, the family is so steep that a millimetre is the whole range."""
PRIOR_MEAN = 0.5
PRIOR_STD = 1.0 / math.sqrt(12.0)
"""Mean and 1-sigma of de and st before anything is known: uniform on [0, 1]."""
SURPRISE = 12.0
"""Normalised innovation squared beyond which a residual is a surprise (two degrees of freedom: once in 400)."""
REFILL_PRIOR, REFILL_PRIOR_M = 1.0, 0.01
"""kappa before anything is seen of it, and how much that counts: as much way [m] over which the soil would rise to
theta_1 behind the wheel."""
REFILL_M = 1.0
"""Rim travel over which kappa is remembered [m]."""
MEAN_M = 0.2
"""Way of the rim over which the running means of the angles follow [m]."""
PULL_M = 0.05
"""Way of the rim over which the pull of a wheel is averaged [m]."""
LEAST_RIM_SPEED = 0.01
"""Rim speed [m/s] below which slip is noise and nothing is learned from the motion."""
STANDING_MOST = 0.5
"""Share of a standing wheel's symmetric contact above which the rolling law says nothing."""
DEEP_SLIP, SPINNING_SLIP = 0.6, 0.8
"""Slip beyond which the law is stretched and residuals count for a quarter, and beyond which they count for nothing."""
RIM_WAY_SHARE = 0.05
"""Share of the rim's way that counts as way of the soil: a wheel that spins meets new soil in depth."""
CORRELATION_M = 0.25
"""Way over which what two wheels say of one place is one opinion [m]."""
NO_OPINION = 1e6
"""Variance of what is not heard."""
CELL_M = 0.05
"""Length of a cell of the map of what wheels have found."""
CELLS = 512
"""Cells per side: 25.6 m of memory."""
PASS_DE_STD, PASS_ST_STD = 0.25, 0.08
"""How much soil changes as a wheel passes: 1-sigma of de, relative (and 0.01), and of st."""
DE_SCALE = 0.2
"""de at which it drifts by `de_drift` per root metre: softer soil varies more, as its root."""
JUMP_DE_STD, JUMP_ST_STD = 0.3, 0.1
"""How far soil may have jumped after SURPRISES_MOST surprises running: 1-sigma of de, relative (and .01), and of st."""
SURPRISES_MOST = 2
ATTEMPTS = 4
"""Most linearisations of one update."""
FAR_DE, FAR_ST = 0.02, 0.01
"""Changes (of de relative) after which an update is linearised anew."""
CALM_STEP = (0.5, 1.0, 0.02, 0.2)
"""Largest change of one update: down and up as share of de, plus; and of st."""

# Columns of the state, one row per wheel.
DE, ST, P_DD, P_DS, P_DB, P_SS, P_SB, P_BB, SLIP, DUG, STANDING, SURPRISES, PULL = range(13)
MEAN_1, MEAN_2, MEANS, REFILL, REAR_SUM, REAR_WEIGHT, LEARNED = range(13, 20)
COLUMNS = 20
# Columns of a reading, one row per wheel.
THETA_1, THETA_2, VAR_1, VAR_2, SLIP_SEEN, SLIP_STD, TORQUE, LOAD, RIM_SPEED, HAS_ANGLES = range(10)
# Entries of the row that FilterNoise hands to the kernels.
TORQUE_STD, TORQUE_RATIO, LAW_STD, DE_DRIFT, ST_DRIFT, RELAXATION = range(6)
EXCAVATION, DUG_RATIO, USES_TORQUE, SHARES_SOIL, LOAD_STD = range(6, 11)
# Columns of a cell of the map.
CELL_PLACE, CELL_WHEEL, CELL_DE, CELL_ST, CELL_DD, CELL_DS, CELL_SS = range(7)


@dataclass(frozen=True, slots=True)
class FilterNoise:
    """What the filter assumes; all >= 0."""

    torque_std_nm: float = 1.5
    torque_std_ratio: float = 0.03
    load_std_ratio: float = 0.1
    law_std_ratio: float = 0.03
    """1-sigma of ln F_z that the law itself is off by, from reading to reading."""
    de_drift_per_sqrt_m: float = 0.16
    st_drift_per_sqrt_m: float = 0.3
    slip_relaxation_m: float = 0.2
    excavation_depth_m: float = 0.025
    """delta/(1 + kappa): z_e = this times s at little slip."""
    dug_std_ratio: float = 0.4
    shares_soil: bool = True
    """Whether wheels are told what others found where they now are."""

    def row(self, *, uses_torque: bool) -> FloatArray:
        """As the kernel takes it."""
        return np.array(
            [
                self.torque_std_nm,
                self.torque_std_ratio,
                self.law_std_ratio,
                self.de_drift_per_sqrt_m,
                self.st_drift_per_sqrt_m,
                self.slip_relaxation_m,
                self.excavation_depth_m,
                self.dug_std_ratio,
                float(uses_torque),
                float(self.shares_soil),
                self.load_std_ratio,
            ]
        )


class SoilFilter:
    """The soil under all wheels. `state`, shape (W, 20), has the columns DE .. LEARNED of this module.

    Feed readings of equal or longer spacing than the sensors' noise is correlated over (0.1 s).
    """

    def __init__(self, rover: RoverDescription) -> None:
        wheels = rover.wheels
        self._geometry = np.array([[w.radius_m, w.width_m, w.grouser_height_m, w.x_m] for w in wheels])
        rows = sorted({wheel.y_m for wheel in wheels})
        self._track: IntArray = np.array([rows.index(wheel.y_m) for wheel in wheels], dtype=np.int64)
        self._law = MEASURED_LAW.row()
        self._cells = np.zeros((len(rows), CELLS, 7))
        self.state: FloatArray = np.zeros((len(wheels), COLUMNS))
        self.forget()

    def forget(self) -> None:
        """Know nothing: de and st at the prior, wheels just set down."""
        self.state[:] = 0.0
        self.state[:, DE] = self.state[:, ST] = PRIOR_MEAN
        self.state[:, P_DD] = self.state[:, P_SS] = PRIOR_STD**2
        self.state[:, P_BB] = 1.0
        self.state[:, STANDING] = 1.0
        self.state[:, REFILL] = REFILL_PRIOR
        self._cells[:, :, CELL_PLACE] = -1.0
        self._way = 1e6 * CELL_M  # far from zero: cells are numbered by it, forwards and backwards

    def set_static(
        self, which: BoolArray, de: FloatArray, variance: FloatArray, load_slope: FloatArray, load_std_ratio: float
    ) -> None:
        """Take over what the standing wheels of `which` say of de; st is left as it is.

        Args:
            which: wheels meant, shape (W,).
            de: deformability, shape (W,).
            variance: of de, that of the load included, shape (W,).
            load_slope: change of de per change of ln load, shape (W,).
            load_std_ratio: 1-sigma of ln load.
        """
        state = self.state
        state[which, DE] = np.clip(de, *DE_RANGE)[which]
        state[which, P_DD] = variance[which]
        most = 0.999 * np.sqrt(variance)
        state[which, P_DB] = np.clip(load_slope * load_std_ratio, -most, most)[which]
        state[which, P_DS] = state[which, P_DB] * state[which, P_SB]  # the load is all that ties them now
        state[which, SURPRISES] = 0.0

    def lose_way(self) -> None:
        """Nobody knows how far the rover has moved: what wheels found is of no known place any more."""
        self._cells[:, :, CELL_PLACE] = -1.0

    def turn_back(self) -> None:
        """The rover drives the other way: its wheels stand anew."""
        self.state[:, STANDING] = 1.0
        self.state[:, SLIP] = 0.0
        self.state[:, MEANS] = 0.0

    def update(
        self,
        readings: FloatArray,
        speed: float,
        advance_m: float,
        step_s: float,
        noise: FilterNoise,
        *,
        uses_torque: bool,
    ) -> None:
        """One reading of all wheels, mirrored so that the rover drives forward.

        Args:
            readings: columns THETA_1 .. HAS_ANGLES, shape (W, 10), in rad, N m, N and m/s.
            speed: of the body, >= 0 [m/s].
            advance_m: way of the body over ground since the last reading, backwards negative [m].
            step_s: time since the last reading [s].
            noise: what is assumed.
            uses_torque: whether torque is there to be used.
        """
        self._way += advance_m
        _filter_kernel(
            self.state, readings, self._geometry, self._track, self._cells, self._law,
            noise.row(uses_torque=uses_torque), self._way, speed, abs(advance_m), step_s,
        )  # fmt: skip


@compiled
def _residual_forces_kernel(
    geometry: FloatArray,
    law: FloatArray,
    de: float,
    st: float,
    theta_1: float,
    theta_2: float,
    slip: float,
    dug: float,
    standing: float,
    row: FloatArray,
) -> tuple[float, float, float, float]:
    """(ln F_z, T, F_t, R_c) of a wheel seen in contact from theta_1 to theta_2 that has dug `dug` [m]."""
    soil_row_kernel(de, st, geometry[1], row)
    depth = geometry[0] * (1.0 - math.cos(theta_1))
    share = max(1.0 - dug / depth, 0.1) if depth > 0.0 else 1.0
    om, along, _ = kinematics_kernel(slip, 0.0)
    thrust, resistance, _, vertical, torque = seen_wheel_kernel(
        geometry[0], geometry[1], geometry[2], row, law, theta_1, theta_2, share, standing, om, along, 0.0
    )
    return math.log(max(vertical, 1.0)), torque, thrust, resistance


@compiled
def _shrink_kernel(state: FloatArray, most_d: float, most_s: float) -> None:
    """Hold the variances of de and st below bounds, correlations kept."""
    for at, most, crossing in ((P_DD, most_d, P_DB), (P_SS, most_s, P_SB)):
        if state[at] > most:
            ratio = math.sqrt(most / state[at])
            state[at] = most
            state[P_DS] *= ratio
            state[crossing] *= ratio


@compiled
def _opinion_kernel(state: FloatArray, cell: FloatArray, way: float) -> None:
    """Take in what another wheel found at this place, as the share `way`/CORRELATION_M of one opinion."""
    weight = CORRELATION_M / max(way, 1e-4)
    of_de = cell[CELL_DD] + (PASS_DE_STD * cell[CELL_DE] + 0.01) ** 2
    of_st = cell[CELL_SS] + PASS_ST_STD**2
    r_dd, r_ss, r_ds = weight * of_de, weight * of_st, weight * cell[CELL_DS]
    # Its error is the same all along: however often it is heard, it makes nobody surer than it is itself.
    if state[P_DD] <= of_de:
        r_dd, r_ds = NO_OPINION, 0.0
    if state[P_SS] <= of_st:
        r_ss, r_ds = NO_OPINION, 0.0
    s_dd, s_ss, s_ds = state[P_DD] + r_dd, state[P_SS] + r_ss, state[P_DS] + r_ds
    det = s_dd * s_ss - s_ds * s_ds
    if det <= 0.0:
        return
    e_d, e_s = cell[CELL_DE] - state[DE], cell[CELL_ST] - state[ST]
    p = np.array(
        [
            [state[P_DD], state[P_DS]],
            [state[P_DS], state[P_SS]],
            [state[P_DB], state[P_SB]],
        ]
    )
    inverse = np.array([[s_ss / det, -s_ds / det], [-s_ds / det, s_dd / det]])
    gain = np.zeros((3, 2))
    for i in range(2):  # the load's error is considered, not estimated
        for j in range(2):
            gain[i, j] = p[i, 0] * inverse[0, j] + p[i, 1] * inverse[1, j]
    h = np.zeros((2, 3))
    h[0, 0] = h[1, 1] = 1.0
    r = np.array([[r_dd, r_ds], [r_ds, r_ss]])
    state[DE] = min(max(state[DE] + gain[0, 0] * e_d + gain[0, 1] * e_s, DE_RANGE[0]), DE_RANGE[1])
    state[ST] = min(max(state[ST] + gain[1, 0] * e_d + gain[1, 1] * e_s, 0.0), 1.0)
    _joseph_kernel(state, gain, h, r)


@compiled
def _refill_kernel(state: FloatArray, seen: FloatArray, depth_over_radius: float, way: float, law: FloatArray) -> None:
    """Kappa by least squares over the last REFILL_M of rim: the soil behind a wheel is what flowed back."""
    full = law[4] * (1.0 - math.exp(-((depth_over_radius / law[5]) ** 2)))
    standing = state[STANDING]
    keep = math.exp(-way / REFILL_M)
    state[REAR_SUM] *= keep
    state[REAR_WEIGHT] *= keep
    if standing < STANDING_MOST and seen[THETA_1] > 0.0:
        ratio = min(max((-seen[THETA_2] / seen[THETA_1] - standing) / (1.0 - standing), -0.2), 1.0)
        state[REAR_SUM] += way * full * ratio
        state[REAR_WEIGHT] += way * full * full
    share = (REFILL_PRIOR_M * REFILL_PRIOR / law[17] + state[REAR_SUM]) / (REFILL_PRIOR_M + state[REAR_WEIGHT])
    state[REFILL] = law[17] * min(max(share, 0.0), 1.0)


@compiled
def _covariance_kernel(state: FloatArray, p: FloatArray) -> None:
    """The covariance of (de, st, b) into `p`, shape (3, 3)."""
    p[0, 0], p[0, 1], p[0, 2] = state[P_DD], state[P_DS], state[P_DB]
    p[1, 0], p[1, 1], p[1, 2] = state[P_DS], state[P_SS], state[P_SB]
    p[2, 0], p[2, 1], p[2, 2] = state[P_DB], state[P_SB], state[P_BB]


@compiled
def _joseph_kernel(state: FloatArray, gain: FloatArray, h: FloatArray, r: FloatArray) -> None:
    """P <- (I - G H) P (I - G H)' + G R G'."""
    p = np.empty((3, 3))
    _covariance_kernel(state, p)
    left = np.eye(3) - gain @ h
    p = left @ p @ left.T + gain @ r @ gain.T
    state[P_DD], state[P_DS], state[P_DB] = p[0, 0], p[0, 1], p[0, 2]
    state[P_SS], state[P_SB], state[P_BB] = p[1, 1], p[1, 2], p[2, 2]


@compiled
def _derivatives_kernel(
    geometry: FloatArray,
    law: FloatArray,
    de: float,
    st: float,
    theta_1: float,
    theta_2: float,
    slip: float,
    dug: float,
    standing: float,
    row: FloatArray,
    moved: FloatArray,
) -> tuple[float, float]:
    """(ln F_z, T), and their derivatives by de, st, theta_1, theta_2, slip and dug depth into `moved`, shape (6, 2)."""
    base = _residual_forces_kernel(geometry, law, de, st, theta_1, theta_2, slip, dug, standing, row)
    for k in range(6):
        step = 0.02 * de + 1e-4 if k == 0 else 1e-5 if k == 5 else 1e-3
        forces = _residual_forces_kernel(
            geometry,
            law,
            de + (step if k == 0 else 0.0),
            st + (step if k == 1 else 0.0),
            theta_1 + (step if k == 2 else 0.0),
            theta_2 + (step if k == 3 else 0.0),
            slip + (step if k == 4 else 0.0),
            dug + (step if k == 5 else 0.0),
            standing,
            row,
        )
        moved[k, 0] = (forces[0] - base[0]) / step
        moved[k, 1] = (forces[1] - base[1]) / step
    return base[0], base[1]


@compiled
def _residuals_kernel(
    state: FloatArray,
    seen: FloatArray,
    geometry: FloatArray,
    law: FloatArray,
    noise: FloatArray,
    de: float,
    st: float,
    row: FloatArray,
    innovation: FloatArray,
    h: FloatArray,
    r: FloatArray,
) -> None:
    """The residuals at (de, st), their derivatives by (de, st, b) and the covariance of their noise.

    Angles enter by their first derivatives at their running means: derivatives that follow the noise of single readings
    let de and st wander off together along what the load leaves open.
    """
    slip, dug = state[SLIP], state[DUG]
    moved = np.empty((6, 2))
    log_vertical, torque = _derivatives_kernel(
        geometry, law, de, st, state[MEAN_1], state[MEAN_2], slip, dug, state[STANDING], row, moved
    )
    off_1, off_2 = seen[THETA_1] - state[MEAN_1], seen[THETA_2] - state[MEAN_2]
    variances = np.array([seen[VAR_1], seen[VAR_2], seen[SLIP_STD] ** 2, (noise[DUG_RATIO] * dug + 1e-3) ** 2])
    r[:] = 0.0
    for j in range(innovation.size):
        h[j, 0], h[j, 1], h[j, 2] = moved[0, j], moved[1, j], -noise[LOAD_STD] if j == 0 else 0.0
        for k in range(innovation.size):
            for m in range(4):
                r[j, k] += moved[2 + m, j] * moved[2 + m, k] * variances[m]
    innovation[0] = math.log(seen[LOAD]) - log_vertical - moved[2, 0] * off_1 - moved[3, 0] * off_2
    r[0, 0] += noise[LAW_STD] ** 2
    if innovation.size == 2:
        innovation[1] = seen[TORQUE] - torque - moved[2, 1] * off_1 - moved[3, 1] * off_2
        r[1, 1] += noise[TORQUE_STD] ** 2 + (noise[TORQUE_RATIO] * torque) ** 2
    for j in range(innovation.size):
        innovation[j] -= h[j, 0] * (state[DE] - de) + h[j, 1] * (state[ST] - st)
    if abs(slip) > DEEP_SLIP:
        r *= 4.0


@compiled
def _is_jump_kernel(state: FloatArray, innovation: FloatArray, inverse: npt.NDArray[np.floating[Any]]) -> bool:
    """Whether the soil has jumped: then its covariance has grown."""
    is_surprise = innovation @ inverse @ innovation > SURPRISE
    state[SURPRISES] = state[SURPRISES] + 1.0 if is_surprise else 0.0
    if state[SURPRISES] < SURPRISES_MOST:
        return False
    state[SURPRISES] = 0.0
    state[P_DD] += (JUMP_DE_STD * state[DE] + 0.01) ** 2
    state[P_SS] += JUMP_ST_STD**2
    return True


@compiled
def _learn_kernel(
    state: FloatArray, seen: FloatArray, geometry: FloatArray, law: FloatArray, noise: FloatArray, row: FloatArray
) -> None:
    """Update one wheel's soil by its residuals, linearised anew where the update goes far (iterated filter)."""
    count = 2 if noise[USES_TORQUE] > 0.0 and math.isfinite(seen[TORQUE]) else 1
    innovation = np.empty(count)
    h = np.empty((count, 3))
    r = np.empty((count, count))
    gain = np.empty((3, count))
    p = np.empty((3, 3))
    de, st = state[DE], state[ST]
    for attempt in range(ATTEMPTS):
        _residuals_kernel(state, seen, geometry, law, noise, de, st, row, innovation, h, r)
        _covariance_kernel(state, p)
        inverse = np.linalg.inv(h @ p @ h.T + r)
        if attempt == 0 and _is_jump_kernel(state, innovation, inverse):
            _covariance_kernel(state, p)
            inverse = np.linalg.inv(h @ p @ h.T + r)
        gain[:] = p @ h.T @ inverse
        gain[2, :] = 0.0  # the load's error is considered, not estimated
        if count == 1:  # so is st, of which contact angles alone say next to nothing
            gain[1, :] = 0.0
        change_d, change_s = 0.0, 0.0
        for j in range(count):
            change_d += gain[0, j] * innovation[j]
            change_s += gain[1, j] * innovation[j]
        change_d = min(max(change_d, -CALM_STEP[0] * state[DE]), CALM_STEP[1] * state[DE] + CALM_STEP[2])
        change_s = min(max(change_s, -CALM_STEP[3]), CALM_STEP[3])
        last_d, last_s = de, st
        de = min(max(state[DE] + change_d, DE_RANGE[0]), DE_RANGE[1])
        st = min(max(state[ST] + change_s, 0.0), 1.0)
        if abs(de - last_d) < FAR_DE * last_d and abs(st - last_s) < FAR_ST:
            break
    state[DE], state[ST] = de, st
    _joseph_kernel(state, gain, h, r)


@compiled
def _filter_kernel(
    states: FloatArray,
    readings: FloatArray,
    geometry: FloatArray,
    track: IntArray,
    cells: FloatArray,
    law: FloatArray,
    noise: FloatArray,
    way: float,
    speed: float,
    advance: float,
    dt: float,
) -> None:
    row = np.empty(6)
    for i in range(states.shape[0]):
        state, seen, shape = states[i], readings[i], geometry[i]
        rim = max(seen[RIM_SPEED], 0.0)
        travel = max(rim, speed)
        entry, leave = seen[THETA_1], seen[THETA_2]
        if seen[HAS_ANGLES] == 0.0 and state[MEANS] > 0.0:  # the seam in the zone is no wheel in the air
            entry, leave = state[MEAN_1], state[MEAN_2]
        contact = shape[0] * (math.sin(min(entry, 0.5 * math.pi)) + math.sin(max(-leave, 0.0)))
        contact = max(contact, 0.05 * shape[0])
        state[SLIP] += (1.0 - math.exp(-travel * dt / noise[RELAXATION])) * (seen[SLIP_SEEN] - state[SLIP])
        state[SLIP] = min(max(state[SLIP], -0.97), 0.97)
        state[STANDING] *= math.exp(-speed * dt / contact)
        kappa = state[REFILL]
        digging = dt * noise[EXCAVATION] * (1.0 + kappa) * max(rim - speed, 0.0) / contact
        state[DUG] = (state[DUG] + digging) / (1.0 + dt * (speed + kappa * rim) / contact)
        depth = shape[0] * (1.0 - math.cos(entry))
        state[DUG] = min(state[DUG], 0.8 * depth)

        moved = advance + RIM_WAY_SHARE * rim * dt
        state[P_DD] += noise[DE_DRIFT] ** 2 * moved * max(state[DE], 0.05) / DE_SCALE
        state[P_SS] += noise[ST_DRIFT] ** 2 * moved
        _shrink_kernel(state, PRIOR_STD**2, PRIOR_STD**2)

        place = math.floor((way + shape[3]) / CELL_M)
        cell = cells[track[i], int(place) % CELLS]
        is_known = cell[CELL_PLACE] == place and cell[CELL_WHEEL] != i
        if noise[SHARES_SOIL] > 0.0 and is_known and advance > 0.0:
            _opinion_kernel(state, cell, advance)
        if seen[HAS_ANGLES] > 0.0:
            state[MEANS] += 1.0
            share = max(1.0 / state[MEANS], 1.0 - math.exp(-travel * dt / MEAN_M))
            state[MEAN_1] += share * (seen[THETA_1] - state[MEAN_1])
            state[MEAN_2] += share * (seen[THETA_2] - state[MEAN_2])
            _refill_kernel(state, seen, depth / shape[0], travel * dt, law)
        rolls = rim > LEAST_RIM_SPEED and state[STANDING] < STANDING_MOST and abs(state[SLIP]) < SPINNING_SLIP
        if seen[HAS_ANGLES] > 0.0 and rolls:
            _learn_kernel(state, seen, shape, law, noise, row)
            state[LEARNED] += 1.0
            if speed > LEAST_RIM_SPEED:
                cell[CELL_PLACE], cell[CELL_WHEEL] = place, i
                cell[CELL_DE], cell[CELL_ST] = state[DE], state[ST]
                cell[CELL_DD], cell[CELL_DS], cell[CELL_SS] = state[P_DD], state[P_DS], state[P_SS]
        if seen[HAS_ANGLES] > 0.0:
            forces = _residual_forces_kernel(
                shape, law, state[DE], state[ST], seen[THETA_1], seen[THETA_2], state[SLIP], state[DUG],
                state[STANDING], row,
            )  # fmt: skip
            share = 1.0 - math.exp(-rim * dt / PULL_M)
            state[PULL] += share * (forces[2] - forces[3] - state[PULL])
