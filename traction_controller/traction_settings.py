"""What an operator may set of the traction controller, and what of it while it drives."""

import math
from dataclasses import dataclass, field
from typing import Any

from strap_rover.settings import check_settings


def _tunable(doc: str, least: float, most: float = math.inf) -> dict[str, Any]:
    """Metadata of a setting that may change while the rover drives."""
    bounds = {"min": least} if most == math.inf else {"min": least, "max": most}
    return {"doc": doc, **bounds, "tunable": True}


@dataclass(frozen=True, slots=True)
class TractionSettings:
    """How the controller drives. Construction raises SettingsError, a ValueError, for a value out of range."""

    policy: str = field(
        default="soil_flow",
        metadata={
            "doc": "soil_flow: the speed band; constant, slip_limit, angle_threshold: baselines to compare with",
            "choices": ("soil_flow", "constant", "slip_limit", "angle_threshold"),
        },
    )
    v_creep_mps: float = field(
        default=0.02, metadata=_tunable("added to body speed in speed limits [m/s]: a start", 0.0, 0.5)
    )
    slip_cap: float = field(
        default=0.2,
        metadata=_tunable(
            "soil_flow: largest slip allowed; s_max alone grows with sinkage, 0.45 leaves it alone", 0.01, 0.45
        ),
    )
    lower_end_share: float = field(
        default=0.0,
        metadata=_tunable(
            "soil_flow: share of the way up to the lower end of the band that wheels are raised by when slow", 0.0, 1.0
        ),
    )
    caution_speed_ratio: float = field(
        default=0.5,
        metadata=_tunable("soil_flow: share of the speed asked for while the forecast says CAUTION", 0.1, 1.0),
    )
    acts_on_forecast: bool = field(
        default=True,
        metadata={
            "doc": "soil_flow: slow, stop and back out when the halting forecast says so; false: only report it",
            "tunable": True,
        },
    )
    back_out_m: float = field(
        default=2.5, metadata=_tunable("way driven back after a stop by forecast [m], 0 = stay and HALT", 0.0, 100.0)
    )
    return_z_max: float = field(
        default=0.0,
        metadata=_tunable(
            "halting score of the way back at which the rover goes no further, 0 = off, 1.5 = cautious", 0.0, 100.0
        ),
    )
    slip_limit: float = field(default=0.3, metadata=_tunable("slip_limit policy: largest slip allowed", 0.01, 0.95))
    angle_threshold_rad: float = field(
        default=0.75, metadata=_tunable("angle_threshold policy: entry angle that slows [rad]", 0.0, 1.6)
    )
    acceleration_limit_radps2: float = field(
        default=2.0, metadata=_tunable("limit of commanded wheel acceleration [rad/s^2], 0 = off", 0.0)
    )
    stall_rim_travel_m: float = field(
        default=0.1, metadata=_tunable("rim travel without progress that is a stall [m]", 0.01, 10.0)
    )
    stall_progress_m: float = field(
        default=0.02, metadata=_tunable("way of the body that counts as progress [m]", 0.001, 1.0)
    )
    probe_rim_travel_m: float = field(
        default=0.03,
        metadata=_tunable("soil_flow: as stall_rim_travel_m, once under way; progress in proportion [m]", 0.01, 10.0),
    )
    wait_s: float = field(default=8.0, metadata=_tunable("standing time after a stall [s]", 0.0, 3600.0))
    wait_growth: float = field(
        default=1.0,
        metadata=_tunable("soil_flow: each further wait is so many times as long as the one before", 1.0, 4.0),
    )
    retries_max: int = field(default=3, metadata=_tunable("attempts after a stall before HALT", 0, 100))
    free_distance_m: float = field(
        default=0.5, metadata=_tunable("way after which a stall is over and retries start anew [m]", 0.0)
    )
    sensor_timeout_s: float = field(
        default=0.1, metadata=_tunable("age of contact angles that is a fault [s]", 0.005, 10.0)
    )
    odometry_timeout_s: float = field(
        default=0.2, metadata=_tunable("age of body motion that is a fault [s]", 0.005, 10.0)
    )
    encoder_timeout_s: float = field(
        default=0.1, metadata=_tunable("age of wheel states that is a fault [s]", 0.005, 10.0)
    )
    command_timeout_s: float = field(
        default=0.5, metadata=_tunable("age of the speed request that is a fault [s]", 0.005, 60.0)
    )
    soil_state_timeout_s: float = field(
        default=0.2, metadata=_tunable("age of a soil state that is a fault, once one came [s]", 0.005, 10.0)
    )
    sensor_hold_s: float = field(
        default=0.5, metadata=_tunable("how long a faulty strap's last angles are used [s]", 0.0, 60.0)
    )
    blind_wheels_max: int = field(
        default=0, metadata=_tunable("wheels that may drive on the slip cap, strap faulty", 0, 100)
    )

    def __post_init__(self) -> None:
        check_settings(self)
