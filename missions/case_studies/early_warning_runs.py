"""One run of the study `early_warning`: a member met at constant speed by the estimators, or driven by a controller."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

from missions.case_studies.early_warning_families import member
from missions.case_studies.early_warning_results import ClosedRun, scored
from missions.case_studies.early_warning_rig import Watcher, drive_constantly, drive_controlled
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from traction_controller.traction_settings import TractionSettings

EVERYTHING: Final = "everything"
ACTING: Final = "soil_flow, acting on the forecast"
NOT_ACTING: Final = "soil_flow, not acting on it"
SLIP_03: Final = "slip 0.3"
RETURN_MINDED: Final = "minded, 1.5"
RETURN_NOT_MINDED: Final = "not minded"
WATCHERS: Mapping[str, Watcher] = MappingProxyType(
    {
        EVERYTHING: Watcher(),
        "no torque": Watcher(SoilEstimatorSettings(uses_torque=False)),
        "no bogie angles": Watcher(sees_suspension=False),
    }
)
"""Estimators that watch the same drive; the first has all that there is."""


@dataclass(frozen=True, slots=True)
class Driver:
    """A way to drive a member."""

    settings: TractionSettings
    wheel_speed: float | None = None
    """Asked for [rad/s]; None: the member's own."""


DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        ACTING: Driver(TractionSettings()),
        NOT_ACTING: Driver(TractionSettings(acts_on_forecast=False)),
        SLIP_03: Driver(TractionSettings(policy="slip_limit", slip_limit=0.3)),
        "slip 0.4": Driver(TractionSettings(policy="slip_limit", slip_limit=0.4)),
        "constant 2 rad/s": Driver(TractionSettings(policy="constant"), 2.0),
        "constant 0.5 rad/s": Driver(TractionSettings(policy="constant"), 0.5),
        "angle threshold": Driver(TractionSettings(policy="angle_threshold")),
    }
)
"""In the order of the tables."""
SNAG_DRIVERS: Final = (ACTING, NOT_ACTING, SLIP_03)
RETURN_DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        RETURN_NOT_MINDED: Driver(TractionSettings(return_z_max=0.0)),
        RETURN_MINDED: Driver(TractionSettings(return_z_max=1.5)),
    }
)
"""Whether the rover goes on where it could not come back."""
_EVERY_DRIVER = {**DRIVERS, **RETURN_DRIVERS}


@dataclass(frozen=True, slots=True)
class Job:
    """A member and who drives it."""

    family: str
    number: int
    variant: str = "plain"
    driver: str | None = None
    """A key of DRIVERS or RETURN_DRIVERS; None: its constant speed."""
    is_ablated: bool = False
    """At constant speed, whether every one of WATCHERS watches or the first alone."""

    @property
    def key(self) -> str:
        """Unique in a ledger."""
        watched = ", ablated" if self.is_ablated else ""
        return f"{self.family} {self.number} {self.variant}: {self.driver or 'constant speed'}{watched}"


def run_item(job: Job) -> dict[str, Any]:
    """Run a job; plain JSON values: of a driver a ClosedRun, at constant speed a ScoredRun by watcher."""
    chosen = member(job.family, job.number, job.variant)
    if job.driver is None:
        watchers = WATCHERS if job.is_ablated else {EVERYTHING: WATCHERS[EVERYTHING]}
        return {name: scored(trace).to_json() for name, trace in drive_constantly(chosen, watchers).items()}
    driver = _EVERY_DRIVER[job.driver]
    if driver.wheel_speed is not None:
        chosen = replace(chosen, wheel_speed=driver.wheel_speed)
    return ClosedRun.of(drive_controlled(chosen, driver.settings)).to_json()
