"""How a strap sits on its wheel: strap angles <-> contact angles from bottom dead centre.

Contact angles are measured from bottom dead centre, positive forward: entry theta_1 > 0, exit theta_2 normally < 0,
both signed. (Published forms give the exit as a magnitude; the sign is settled here, once.) A strap whose angle grows
forward (direction +1) and its mirror image, as on the other side of the rover (direction -1), obey one law:
`theta = direction (theta_n + beta - 3/2 pi)` with the wheel angle `theta_n = offset - direction * encoder`.
Rolling forward makes the encoder grow, so a point of either strap travels backward, d theta / dt = -omega.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import FloatArray

THREE_QUARTER_TURN_RAD = 1.5 * math.pi
_FULL_TURN_RAD = 2.0 * math.pi


def wrap(angle: npt.ArrayLike) -> FloatArray:
    """`angle` [rad], any shape, brought into (-pi, pi]."""
    return np.asarray(math.pi - np.mod(math.pi - np.asarray(angle, dtype=np.float64), _FULL_TURN_RAD))


@dataclass(frozen=True, slots=True)
class StrapMounting:
    """Where strap end A is, and which way round the strap runs. ValueError unless direction is +1 or -1."""

    offset_rad: float
    """theta_n at encoder position zero [rad]."""
    direction: int = 1
    """+1: strap angle grows forward; -1: the mirrored mounting."""

    def __post_init__(self) -> None:
        if self.direction not in (1, -1):
            raise ValueError(f"StrapMounting.direction = {self.direction}: give +1, or -1 for a mirrored strap")
        if not math.isfinite(self.offset_rad):
            raise ValueError(f"StrapMounting.offset_rad = {self.offset_rad}: give a finite angle in rad")

    def wheel_angle(self, encoder_rad: npt.ArrayLike) -> FloatArray:
        """theta_n [rad] at encoder positions [rad], any shape, not wrapped."""
        return np.asarray(self.offset_rad - self.direction * np.asarray(encoder_rad, dtype=np.float64))

    def contact_angles(
        self, beta_1: npt.ArrayLike, beta_2: npt.ArrayLike, encoder_rad: npt.ArrayLike, *, reversing: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """(theta_1, theta_2): entry and exit in (-pi, pi] from the arc [beta_1, beta_2] and the encoder, all rad.

        The leading end of the zone is the entry: the front end when driving forward, the rear end when `reversing`.
        """
        theta_n = self.wheel_angle(encoder_rad) - THREE_QUARTER_TURN_RAD
        of_1 = wrap(self.direction * (theta_n + np.asarray(beta_1, dtype=np.float64)))
        of_2 = wrap(self.direction * (theta_n + np.asarray(beta_2, dtype=np.float64)))
        return (of_1, of_2) if reversing == (self.direction == 1) else (of_2, of_1)

    def strap_angles(
        self, theta_1: npt.ArrayLike, theta_2: npt.ArrayLike, encoder_rad: npt.ArrayLike, *, reversing: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """(beta_1, beta_2) in [0, 2 pi) from entry, exit and encoder, all rad: the inverse of `contact_angles`.

        beta_1 > beta_2 in the answer means that the zone covers the strap's seam.
        """
        theta_n = self.wheel_angle(encoder_rad) - THREE_QUARTER_TURN_RAD
        of_entry = _positive(self.direction * np.asarray(theta_1, dtype=np.float64) - theta_n)
        of_exit = _positive(self.direction * np.asarray(theta_2, dtype=np.float64) - theta_n)
        return (of_entry, of_exit) if reversing == (self.direction == 1) else (of_exit, of_entry)


def _positive(angle: FloatArray) -> FloatArray:
    """Into [0, 2 pi): np.mod of a tiny negative number rounds up to the full turn itself."""
    turned = np.mod(angle, _FULL_TURN_RAD)
    return np.where(turned >= _FULL_TURN_RAD, 0.0, turned)
