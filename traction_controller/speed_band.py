"""The band of wheel speeds between pushing a bow wave of sand and digging in.

Source: S. Ebrahimi, A. Mardani, K. Alipour, Robotica 2020, Eq. 9 and the minimum bulldozing condition after it.
Two readings differ from the print. The paper never defines s_theta_1; here it is z/r = 1 - cos(theta_1), the relative
sinkage. The lower end is v/(r (1 - s_theta_1)): the printed (1 - s_theta_1) v/r has lost an inverse, for every
driven wheel satisfies it.
"""

from dataclasses import dataclass

import numpy as np

from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.terramechanics.spiral_flow import SLIP_VALID, contact_centre, slip_limit

FIRM_GROUND_ENTRY_ANGLE = float(np.deg2rad(12.0))
"""Entry angle [rad] below which the flow law calls firm ground critical."""
SYMMETRIC_CONTACT_CENTRE = 0.043
"""Contact centre (sin theta_1 + sin theta_2)/2 below which a wheel stands rather than rolls: vc = 1 has no root."""
STEEPEST_ENTRY_COSINE = 0.05
"""Lower bound of cos(theta_1), 87 deg: the lower end of the band stays finite."""


@dataclass(frozen=True, slots=True, eq=False)
class SpeedBand:
    """Angular velocities between which each wheel should turn; every array has shape (W,)."""

    omega_min: FloatArray
    """Minimum bulldozing [rad/s]. May exceed `omega_max`: see `is_empty`."""
    omega_max: FloatArray
    """The fastest the wheel may turn [rad/s]. It wins over `omega_min`."""
    slip: FloatArray
    """The slip that `omega_max` stands for."""
    is_bypassed: BoolArray
    """True where the critical flow ratio has no meaning and the plain slip cap stands in."""

    @property
    def is_empty(self) -> BoolArray:
        """True where the two ends contradict each other (entry above about 45 deg)."""
        return self.omega_min > self.omega_max


def is_flow_law_bypassed(theta_1: FloatArray, theta_2: FloatArray) -> BoolArray:
    """True where the critical flow ratio must not decide: firm ground or a contact symmetric about the lowest point.

    Args:
        theta_1: entry angle, signed [rad], any shape.
        theta_2: exit angle, signed [rad], same shape.
    """
    symmetric = contact_centre(theta_1, theta_2) < SYMMETRIC_CONTACT_CENTRE
    bypassed: BoolArray = (theta_1 < FIRM_GROUND_ENTRY_ANGLE) | symmetric
    return bypassed


def slowest_without_bulldozing(speed: float | FloatArray, radius: FloatArray, theta_1: FloatArray) -> FloatArray:
    """Angular velocity [rad/s] at which the wheel no longer pushes soil ahead: v/(r cos(theta_1)).

    Args:
        speed: body speed, >= 0 [m/s].
        radius: wheel radius [m], shape (W,).
        theta_1: entry angle [rad], shape (W,); beyond 87 deg it counts as 87 deg.
    """
    return speed / (radius * np.maximum(np.cos(theta_1), STEEPEST_ENTRY_COSINE))


def fastest_at_slip(
    speed: float | FloatArray, radius: FloatArray, slip: float | FloatArray, creep_speed: float
) -> FloatArray:
    """Angular velocity [rad/s] at which a driven wheel slips by `slip`: (v + v_creep)/(r (1 - s)).

    Args:
        speed: body speed, >= 0 [m/s].
        radius: wheel radius [m], shape (W,).
        slip: driving slip, 0 <= slip < 1.
        creep_speed: added to the speed [m/s], so that a standing rover may start.
    """
    return (speed + creep_speed) / (radius * (1.0 - slip))


def speed_band(
    speed: float,
    radius: FloatArray,
    theta_1: FloatArray,
    theta_2: FloatArray,
    *,
    creep_speed: float,
    slip_cap: float = SLIP_VALID,
    slip_bound: FloatArray | None = None,
) -> SpeedBand:
    """The band for wheels that roll forward over soil.

    The upper end is the wheel speed at which soil flows out as fast as in (vc = 1), so at slip s_max(theta_1, theta_2).
    s_max grows with sinkage, which is the unsafe direction: `slip_cap` bounds it. Where the flow law has no meaning
    (firm ground, symmetric contact) the upper end is at `slip_cap` itself.

    Args:
        speed: body speed along the direction of travel, >= 0 [m/s].
        radius: wheel radius [m], shape (W,).
        theta_1: entry angle, signed [rad], shape (W,).
        theta_2: exit angle, signed [rad], shape (W,).
        creep_speed: added to the speed at the upper end [m/s].
        slip_cap: largest slip the upper end may stand for, 0 < slip_cap <= 0.45 (the validity of the flow law).
        slip_bound: another upper bound of slip per wheel, shape (W,), used where the flow law is not bypassed.
    """
    bypassed = is_flow_law_bypassed(theta_1, theta_2)
    slip = np.minimum(slip_limit(theta_1, theta_2, unsolved="mask"), slip_cap)
    if slip_bound is not None:
        slip = np.minimum(slip, slip_bound)
    slip = np.where(bypassed, slip_cap, slip)
    return SpeedBand(
        omega_min=slowest_without_bulldozing(speed, radius, theta_1),
        omega_max=fastest_at_slip(speed, radius, slip, creep_speed),
        slip=slip,
        is_bypassed=bypassed,
    )
