"""The record of what is known of the soil under each wheel; the fields of topic soil_state."""

from dataclasses import dataclass
from enum import IntEnum

from strap_rover.arrays import FloatArray, IntArray


class SoilStatus(IntEnum):
    """Where a wheel's numbers come from."""

    NO_DATA = 0
    """The strap gives no angles now: vc 1, no flow and the widest slip_max stand in; de is the last one known."""
    PRIOR = 1
    """Angles are good, but the wheel has not stood yet: de is the prior."""
    STATIC_ESTIMATE = 2
    """de comes from the contact zone of the standing wheel."""
    STATIC_AT_BOUND = 3
    """As STATIC_ESTIMATE, but the zone lies beyond what the de family can explain under this load."""
    HELD = 4
    """The wheel has rolled on since de was estimated: its std grows with the way."""
    FILTERED = 5
    """de, and st where torque is told, follow the rolling wheel."""


class ForecastVerdict(IntEnum):
    """What the halting forecast says of the way ahead."""

    NONE = 0
    """Not enough is known yet to say anything."""
    CLEAR = 1
    """The soil that the front wheels stand in carries the whole rover on."""
    CAUTION = 2
    """It may not: the margin is spent, though not beyond its uncertainty."""
    STOP = 3
    """It does not: the rover will halt once all wheels stand in it."""
    SLIPPING = 4
    """The wheels slip away already, whatever the soil."""
    SNAG = 5
    """Something holds the rover back that was not there a moment ago: the margin says nothing for a while."""


@dataclass(frozen=True, slots=True, eq=False)
class SoilState:
    """One estimate for all wheels; arrays have shape (W,) in the order of the rover description's wheels."""

    stamp_ns: int
    slip: FloatArray
    """Slip ratio, driving > 0, braking < 0; 0 at rest, where `slip_std` is 1."""
    slip_std: FloatArray
    """1-sigma of slip, at most 1."""
    de: FloatArray
    """Deformability, 0 firm .. 1 soft: that of the soil family whose standing wheel has the same contact zone."""
    de_std: FloatArray
    st: FloatArray
    """Stickiness, 0 .. 1. Angles do not reveal it: without motor torque it stays near its prior, 0.5 +- 0.29."""
    st_std: FloatArray
    vc: FloatArray
    """Critical flow ratio M_ent/M_out, at slip not below 0.115. Meaningless on firm ground and at symmetric contact."""
    m_ent: FloatArray
    """Soil flow into the zone under the wheel [kg/s]."""
    m_out: FloatArray
    """Soil flow out of it [kg/s]; m_ent/m_out = vc."""
    slip_max: FloatArray
    """Slip at which vc falls to one, at most 0.45; 0.45 where there is none."""
    status: IntArray
    """SoilStatus per wheel."""
    scout_margin: float = 0.0
    """What the rover can pull beyond what it needs [N], once all wheels stand in what the front ones stand in."""
    scout_margin_std: float = 0.0
    """1-sigma of the margin [N]. While the verdict is NONE all scout numbers mean nothing."""
    scout_z: float = 0.0
    """Halting score -margin/std: above 0 the margin is spent, above 0.8 the verdict is STOP. No probability."""
    scout_z_return: float = 0.0
    """The same for the way back out: above 0 the rover could not return over what it now stands in."""
    scout_disturbance: float = 0.0
    """What holds the rover back besides soil and slope [N], as far as the pull of the wheels tells."""
    scout_verdict: int = int(ForecastVerdict.NONE)
    """ForecastVerdict."""
