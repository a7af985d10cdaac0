"""Slip: how far the rim outruns the ground, or lags behind it.

Driving s = 1 - v/(r omega) in [0, 1]; braking s = r omega/v - 1 in [-1, 0). The source paper (Eq. 2) prints the
braking ratio the other way up, which would leave [-1, 0) for a locked wheel. Driving backwards mirrors the wheel:
entry and exit swap and s keeps its meaning.
"""

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.compiled import compiled

REST_SPEED = 1e-3
"""Below this |v| and |r omega| [m/s] slip is undefined and taken as 0."""
LOCKED_FLOOR = 0.05
"""Least 1 + s for which the braking transport ratio is evaluated; s = -1 is a locked wheel."""


@compiled
def slip_kernel(speed: float, rim_speed: float) -> float:
    """Slip ratio from body speed and r omega [m/s], scalars."""
    if abs(speed) < REST_SPEED and abs(rim_speed) < REST_SPEED:
        return 0.0
    if rim_speed < 0.0 or (rim_speed == 0.0 and speed < 0.0):
        speed, rim_speed = -speed, -rim_speed
    if speed <= rim_speed:
        return min(1.0 - speed / rim_speed, 1.0)
    return max(rim_speed / speed - 1.0, -1.0)


@compiled
def transport_ratio_kernel(slip: float) -> float:
    """Transport ratio lambda = v/(r omega) from slip: 1 - s driving, 1/max(1 + s, 0.05) braking."""
    if slip >= 0.0:
        return 1.0 - slip
    return 1.0 / max(1.0 + slip, LOCKED_FLOOR)


def slip_ratio(speed: npt.ArrayLike, wheel_radius: npt.ArrayLike, omega: npt.ArrayLike) -> FloatArray:
    """Slip s [-] in [-1, 1] from body speed [m/s], radius [m] and angular velocity [rad/s]; inputs broadcast.

    Zero at rest (see `at_rest`). A wheel driven against the body's motion is at full slip, s = 1.
    """
    v = np.asarray(speed, dtype=np.float64)
    rim = np.asarray(wheel_radius, dtype=np.float64) * np.asarray(omega, dtype=np.float64)
    mirror = np.where((rim < 0.0) | ((rim == 0.0) & (v < 0.0)), -1.0, 1.0)
    v, rim = np.broadcast_arrays(v * mirror, rim * mirror)
    larger = np.maximum(np.maximum(np.abs(v), np.abs(rim)), REST_SPEED)
    slip = np.clip((rim - v) / larger, -1.0, 1.0)
    return np.where((np.abs(v) < REST_SPEED) & (np.abs(rim) < REST_SPEED), 0.0, slip)


def at_rest(speed: npt.ArrayLike, wheel_radius: npt.ArrayLike, omega: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """True where body and rim are both slower than 1 mm/s and slip has no meaning."""
    rim = np.asarray(wheel_radius, dtype=np.float64) * np.asarray(omega, dtype=np.float64)
    return (np.abs(np.asarray(speed, dtype=np.float64)) < REST_SPEED) & (np.abs(rim) < REST_SPEED)
