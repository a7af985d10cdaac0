"""What two volts of a strap say: a contact zone, no contact, the seam, or a fault that has a name and a remedy.

`locate` judges one reading in plain floats, since the reader calls it for every scan; `classify` and the records
are the array side. With the two ends alone a reading cannot tell several contacts of one wheel (a stone) apart: only
the outer envelope is seen. Faults that show only while the wheel turns are `strap_tracker`'s.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from strap_rover.arrays import FloatArray, IntArray
from strap_sensor_driver.end_curve import EndCurve, uniform_curves
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap


class ContactStatus(IntEnum):
    """What the contact angles of one wheel are worth. From `FIRST_FAULT` on it is a fault: see `remedy`."""

    VALID = 0
    """Measured in this record."""
    PREDICTED = 1
    """The seam is in the zone, or a scan is missing or doubtful: last zone held, std grown with wheel rotation."""
    NO_CONTACT = 2
    """Wheel in the air: both angles 0, std pi, no information."""
    UNCONFIRMED = 3
    """Measured, but the wheel has not turned enough yet, since the start, a fault or a jump of the zone, to show that
    strap, mounting and encoder agree. As good as VALID where nobody has touched the wiring."""
    FAULT_OPEN_A = 10
    FAULT_OPEN_B = 11
    FAULT_SHORT = 12
    FAULT_ORDER = 13
    FAULT_WIDTH = 14
    FAULT_RANGE = 15
    FAULT_STUCK = 16
    FAULT_FLOATING = 17
    FAULT_DRIFT = 18
    FAULT_REFERENCE = 19
    STALE_ENCODER = 20
    NO_DATA = 21
    UNKNOWN_PROTOCOL = 22
    FAULT_MIRRORED = 23
    WRONG_BOARD = 24
    FAULT_UNSTEADY = 25
    FAULT_PLACE = 26

    @property
    def is_fault(self) -> bool:
        """True when somebody has to look at the hardware or the wiring; the held angles are old."""
        return self >= FIRST_FAULT


FIRST_FAULT = 10

_LEARN_ANEW = ", then call ~/reset of strap_sensor_driver"
"""Of faults that only good rotation ends: a rover that stands for one does not turn its wheels."""
_REMEDY = {
    ContactStatus.VALID: "nothing to do",
    ContactStatus.PREDICTED: "nothing to do: the zone is held for the moment",
    ContactStatus.NO_CONTACT: "the wheel is in the air, or both leads or the conductor's supply are off",
    ContactStatus.UNCONFIRMED: "measured; turn the wheel by a quarter turn, after a jump by a whole one, to confirm it",
    ContactStatus.FAULT_OPEN_A: "end A reads 0 V in contact: check the lead and slip ring of end A, and its pull-down",
    ContactStatus.FAULT_OPEN_B: "end B reads 0 V in contact: check the lead and slip ring of end B, and its pull-down",
    ContactStatus.FAULT_SHORT: "an end stays at the supply while the wheel turns: mend the short to the conductor"
    f"{_LEARN_ANEW}",
    ContactStatus.FAULT_ORDER: "the ends contradict each other (beta_1 > beta_2): calibrate R_str, R_A, R_B; if that "
    f"does not help, check for a floating input{_LEARN_ANEW}",
    ContactStatus.FAULT_WIDTH: "a zone of more than half a turn: check for a floating input, mud or a second contact"
    f"{_LEARN_ANEW}",
    ContactStatus.FAULT_RANGE: "volts that no contact on the strap can give: check strap, pull-downs and supply; "
    "calibrate",
    ContactStatus.FAULT_STUCK: "an end does not change while the wheel turns: clean the strap, test the input"
    f"{_LEARN_ANEW}",
    ContactStatus.FAULT_FLOATING: "end B copies end A while the wheel turns: its input floats, check its lead"
    f"{_LEARN_ANEW}",
    ContactStatus.FAULT_DRIFT: "the strap's resistance is not what it was calibrated to: clean it, check glue, leads; "
    "calibrate again",
    ContactStatus.FAULT_REFERENCE: "the strap's supply is not the converter's reference, or a lead gained resistance: "
    "measure the conductor against the board's 5V, mend; else calibrate again",
    ContactStatus.FAULT_MIRRORED: "the zone runs against the wheel: ends A and B are swapped, or strap_direction or "
    f"the encoder has the wrong sign{_LEARN_ANEW}",
    ContactStatus.FAULT_UNSTEADY: "the zone jumps about: look for a loose lead, moisture, a worn slip ring, hum",
    ContactStatus.FAULT_PLACE: "a zone where no soil can be: check strap_offset_rad, the encoder's zero, and that the "
    "leads are not another wheel's",
    ContactStatus.WRONG_BOARD: "another board than the rover's file says is on this port: swap the plugs, mend `port` "
    "or the udev rule, or set the board's id",
    ContactStatus.STALE_ENCODER: "no wheel_states close to the scan's time: check the encoder source and its clock",
    ContactStatus.NO_DATA: "the board is silent or has not said hello: check USB cable, port, baud and power",
    ContactStatus.UNKNOWN_PROTOCOL: "the board speaks another frame protocol: flash the firmware of this release",
}


def remedy(status: ContactStatus | int) -> str:
    """What a person should do about `status`, in words. ValueError for a number that is no ContactStatus."""
    return _REMEDY[ContactStatus(status)]


@dataclass(frozen=True, slots=True, eq=False)
class StrapVoltages:
    """Volts as the converter saw them, mean over the scans of one tick; shape (W,)."""

    stamp_ns: int
    v_a: FloatArray
    """At strap end A [V]."""
    v_b: FloatArray
    """At strap end B [V]."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactAngles:
    """Where each wheel enters and leaves the soil, from bottom dead centre, positive forward [rad], shape (W,)."""

    stamp_ns: int
    theta_1: FloatArray
    """Entry angle, normally > 0."""
    theta_2: FloatArray
    """Exit angle, normally < 0."""
    theta_1_std: FloatArray
    theta_2_std: FloatArray
    status: IntArray
    """`ContactStatus` per wheel, int64."""


class Learnt(NamedTuple):
    """What the seam has taught about a strap since it was calibrated."""

    level: float = 1.0
    """Supply of the strap over the converter's reference."""
    offset_a: float = 0.0
    """Resistance that end A's path has gained, over the pull-down's."""
    offset_b: float = 0.0
    scale: float = 1.0
    """Resistance of the strap now over what it was calibrated to."""


NOTHING_LEARNT = Learnt()


@dataclass(frozen=True, slots=True)
class ZoneLimits:
    """Levels that tell the cases apart, worked out once per strap. Build with `ZoneLimits.of`."""

    supply_v: float
    inverted: bool
    curve_a: EndCurve
    """Of end A: R / R_pull_down -> beta_1."""
    curve_b: EndCurve
    """Of end B: R / R_pull_down -> 2 pi - beta_2."""
    contact_v: float
    """Below this an end is not connected to the conductor."""
    seam_a_v: float
    """Above this, and end B above its own, the zone covers the seam."""
    seam_b_v: float
    lowest_a_v: float
    lowest_b_v: float
    order_margin_rad: float
    """beta_1 may exceed beta_2 by this much (noise, calibration) and still be a narrow contact."""
    width_max_rad: float

    @classmethod
    def of(
        cls,
        strap: Strap,
        *,
        curves: tuple[EndCurve, EndCurve] | None = None,
        contact_level: float = 0.1,
        seam_level: float = 0.98,
        range_margin: float = 0.1,
        order_margin_rad: float = 0.2,
        width_max_rad: float = math.pi,
    ) -> "ZoneLimits":
        """Limits of `strap`: levels as fractions of the supply, `range_margin` relative to the lowest possible volts.

        `curves` of ends A and B are the calibrated ones; None: those of a uniform strap. ValueError when the no-contact
        level would reach into the volts of a good contact.
        """
        supply_v = strap.supply_v
        curve_a, curve_b = curves or uniform_curves(strap)
        lowest_a_v, lowest_b_v = (
            supply_v / (1.0 + curve.full_turn_ratio) * (1.0 - range_margin) for curve in (curve_a, curve_b)
        )
        highest = min(lowest_a_v, lowest_b_v) / supply_v
        if not 0.0 < contact_level < highest:
            raise ValueError(
                f"contact_level = {contact_level}: must lie in (0, {highest:.3f}), "
                "below every volt of a good contact; lower it or use larger pull-downs"
            )
        if not contact_level < seam_level < 1.0:
            raise ValueError(f"seam_level = {seam_level}: must lie between contact_level and 1; try 0.98")
        return cls(
            supply_v=supply_v,
            inverted=strap.inverted,
            curve_a=curve_a,
            curve_b=curve_b,
            contact_v=contact_level * supply_v,
            seam_a_v=seam_level * supply_v / (1.0 + curve_a.ratio[0]),
            seam_b_v=seam_level * supply_v / (1.0 + curve_b.ratio[0]),
            lowest_a_v=lowest_a_v,
            lowest_b_v=lowest_b_v,
            order_margin_rad=order_margin_rad,
            width_max_rad=width_max_rad,
        )


_VALID = int(ContactStatus.VALID)
_PREDICTED = int(ContactStatus.PREDICTED)
_NO_CONTACT = int(ContactStatus.NO_CONTACT)
_OPEN_A = int(ContactStatus.FAULT_OPEN_A)
_OPEN_B = int(ContactStatus.FAULT_OPEN_B)
_ORDER = int(ContactStatus.FAULT_ORDER)
_WIDTH = int(ContactStatus.FAULT_WIDTH)
_RANGE = int(ContactStatus.FAULT_RANGE)
_SEAM_ARC_RAD = 0.6
"""No zone reaches this near both ends: a reading that says so is the seam, and the supply or a lead is off."""


def locate(v_a: float, v_b: float, limits: ZoneLimits, learnt: Learnt = NOTHING_LEARNT) -> tuple[int, float, float]:
    """(status, beta_1, beta_2 [rad]) of one reading [V]; the angles mean something only when the status is VALID.

    Same law as `Strap.strap_angles`, with the curves of `limits` and what was `learnt` since. A reading that is no
    number is FAULT_RANGE. Raises nothing.
    """
    level, offset_a, offset_b, scale = learnt
    supply_v = limits.supply_v
    if limits.inverted:
        v_a = supply_v - v_a
        v_b = supply_v - v_b
    v_a /= level
    v_b /= level
    contact_v = limits.contact_v
    if v_a < contact_v or v_b < contact_v:
        if v_a < contact_v and v_b < contact_v:
            return _NO_CONTACT, 0.0, 0.0
        return (_OPEN_A if v_a < contact_v else _OPEN_B), 0.0, 0.0
    if v_a > limits.seam_a_v and v_b > limits.seam_b_v:
        return _PREDICTED, 0.0, 0.0
    if not (v_a >= limits.lowest_a_v and v_b >= limits.lowest_b_v):
        return _RANGE, 0.0, 0.0
    beta_1 = limits.curve_a.arc_at((supply_v / v_a - 1.0 - offset_a) / scale)
    from_b = limits.curve_b.arc_at((supply_v / v_b - 1.0 - offset_b) / scale)
    if beta_1 < _SEAM_ARC_RAD and from_b < _SEAM_ARC_RAD:
        return _PREDICTED, 0.0, 0.0
    beta_2 = FULL_TURN_RAD - from_b
    width = beta_2 - beta_1
    if width < 0.0:
        if width < -limits.order_margin_rad:
            return _ORDER, beta_1, beta_2
        beta_1 = beta_2 = 0.5 * (beta_1 + beta_2)
    return (_WIDTH if width > limits.width_max_rad else _VALID), beta_1, beta_2


def classify(v_a: FloatArray, v_b: FloatArray, limits: ZoneLimits) -> tuple[IntArray, FloatArray, FloatArray]:
    """`locate` over arrays of one shape: (status int64, beta_1, beta_2 [rad]). ValueError when the shapes differ."""
    if v_a.shape != v_b.shape:
        raise ValueError(f"v_a has shape {v_a.shape}, v_b {v_b.shape}: give one pair of volts per reading")
    rows = [locate(a, b, limits) for a, b in zip(v_a.ravel().tolist(), v_b.ravel().tolist(), strict=True)]
    table = np.asarray(rows, dtype=np.float64).reshape(-1, 3)
    shape = v_a.shape
    return table[:, 0].astype(np.int64).reshape(shape), table[:, 1].reshape(shape), table[:, 2].reshape(shape)


def travel_angles(theta_1: FloatArray, theta_2: FloatArray, direction: float) -> tuple[FloatArray, FloatArray]:
    """Entry and exit angle [rad] of a wheel seen along its direction of travel, the entry positive.

    Backwards the wheel is mirrored. The leading end is the entry, whichever of the two it was called.

    Args:
        theta_1: one end of the contact, positive towards the rover's front [rad].
        theta_2: the other end [rad].
        direction: +1 forwards, -1 backwards.
    """
    front, rear = direction * theta_1, direction * theta_2
    return np.maximum(front, rear), np.minimum(front, rear)
