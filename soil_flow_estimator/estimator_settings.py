"""How the soil is estimated: the settings of the estimator."""

from dataclasses import dataclass, field
from typing import Any

from strap_rover.settings import check_settings


def _tunable(doc: str, least: float, most: float) -> dict[str, Any]:
    """Metadata of a setting that may change while the rover drives: it decides of readings to come, or scales."""
    return {"doc": doc, "min": least, "max": most, "tunable": True}


@dataclass(frozen=True, slots=True)
class SoilEstimatorSettings:
    """How the soil is estimated. Construction raises SettingsError, a ValueError, for a value out of range."""

    # Not tunable: de of one rule and de of the other are different quantities, and a bag must not hold both.
    deformability_rule: str = field(
        default="inverse",
        metadata={
            "doc": "inverse: de whose static contact zone is the one measured; paper_linear: min(1, zone/100 deg)",
            "choices": ("inverse", "paper_linear"),
        },
    )
    standing_speed_radps: float = field(
        default=0.02, metadata=_tunable("wheel speed below which a wheel stands [rad/s] (paper: 0.01)", 0.0, 1.0)
    )
    standing_travel_m: float = field(
        default=0.01, metadata=_tunable("rim travel that starts a new average [m]", 0.001, 1.0)
    )
    readings_min: int = field(default=5, metadata=_tunable("readings before de is estimated", 1, 10000))
    asymmetry_max: float = field(
        default=0.2,
        metadata=_tunable("largest |theta_1 + theta_2|/zone of a contact that counts as static", 0.0, 1.0),
    )
    angle_bias_std_rad: float = field(
        default=0.006, metadata=_tunable("1-sigma of an angle's error that averaging leaves [rad]", 0.0, 0.5)
    )
    load_std_ratio: float = field(default=0.1, metadata=_tunable("1-sigma of a wheel's load, relative", 0.0, 1.0))
    wheel_speed_std_radps: float = field(default=0.005, metadata=_tunable("1-sigma of encoder speed [rad/s]", 0.0, 1.0))
    de_drift_per_sqrt_m: float = field(
        default=0.16, metadata=_tunable("growth of de's 1-sigma along the way, at de = 0.2 [1/sqrt(m)]", 0.0, 10.0)
    )
    st_drift_per_sqrt_m: float = field(
        default=0.3, metadata=_tunable("growth of st's 1-sigma along the way [1/sqrt(m)]", 0.0, 10.0)
    )
    uses_torque: bool = field(
        default=True,
        metadata={
            "doc": "whether effort in wheel_states is wheel torque; without it st stays near its prior",
            "tunable": True,
        },
    )
    torque_std_nm: float = field(default=1.5, metadata=_tunable("1-sigma of wheel torque [N m], and 3 %", 0.01, 1000.0))
    slip_relaxation_m: float = field(
        default=0.2, metadata=_tunable("rim travel over which the shear under the wheel follows slip [m]", 0.001, 2.0)
    )
    excavation_depth_m: float = field(
        default=0.025,
        metadata={"doc": "depth that a wheel digs per slip, at little slip [m]", "min": 0.001, "max": 0.5},
    )
    caution_z: float = field(
        default=0.0, metadata=_tunable("halting score above which to drive with care", -10.0, 10.0)
    )
    stop_z: float = field(default=0.8, metadata=_tunable("halting score above which to stop", -10.0, 10.0))
    slip_alarm: float = field(
        default=0.75, metadata=_tunable("slip, as it will be in 0.4 s, above which the wheels slip away", 0.05, 1.0)
    )
    soil_density_kgpm3: float = field(
        default=1600.0, metadata=_tunable("bulk density of the soil [kg/m^3]", 100.0, 5000.0)
    )
    input_timeout_s: float = field(
        default=0.2, metadata=_tunable("age of an input at which nothing is said [s]", 0.005, 10.0)
    )

    def __post_init__(self) -> None:
        check_settings(self)
