"""What a drive came to, from a recording: by what the simulation knows where it was one, else by the sensors."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from missions.report.recording import Recording
from missions.report.site_map import NoSiteError, ground_of, rover_of, wheel_radii
from missions.soil_truth import soil_truth
from missions.summary import Event, Outcome, outcome_of, run_events
from soil_flow_estimator.soil_state import ForecastVerdict, SoilStatus
from strap_rover import topics
from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.topics import Topic
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

SETTLED_S = 2.0
"""A standing start is full slip: peaks of slip count from here on."""
FINAL_S = 2.0
"""The final speed is the mean over so long."""
_WITH_ZONE = (ContactStatus.VALID, ContactStatus.PREDICTED, ContactStatus.UNCONFIRMED)
_JUDGED_BY = ("x", "speed", "external_load")


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest or smallest of something."""

    value: float
    wheel: str
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class WheelSeries:
    """One quantity of every wheel over time."""

    wheels: tuple[str, ...]
    time_s: FloatArray
    """Shape (N,)."""
    values: FloatArray
    """Shape (N, W); NaN where nothing is known."""

    def peak(self, *, lowest: bool = False, from_s: float = 0.0) -> Peak | None:
        """The highest value, or the lowest; None where there is none."""
        values = np.where((self.time_s >= from_s)[:, None], self.values, np.nan)
        if not np.isfinite(values).any():
            return None
        row, wheel = divmod(int(np.nanargmin(values) if lowest else np.nanargmax(values)), len(self.wheels))
        return Peak(float(values[row, wheel]), self.wheels[wheel], float(self.time_s[row]))


@dataclass(frozen=True, slots=True, eq=False)
class DriveFacts:
    """A drive in numbers; None and empty where the bag does not say."""

    is_simulated: bool
    """Whether a simulation said what it knows."""
    outcome: Outcome | None
    from_start_m: float | None
    """Between where it began and where it ended."""
    final_speed_mps: float | None
    zone_deg: WheelSeries | None
    """As measured."""
    sinkage_from_zone_mm: WheelSeries | None
    true_sinkage_mm: WheelSeries | None
    slip: WheelSeries | None
    """As measured, where the wheel turns."""
    true_slip: WheelSeries | None
    slip_margin: WheelSeries | None
    """slip_max - slip, where both are known."""
    flow_ratio: WheelSeries | None
    """vc, where the wheel turns."""
    true_de: WheelSeries | None
    """Of the ground below each wheel, where a simulated ground can be made again."""
    true_st: WheelSeries | None
    verdicts: FloatArray
    """ForecastVerdict codes over the times of soil_state; empty where the bag has no forecast."""
    forecast_stop_s: float | None
    """When the halting forecast first said STOP."""
    forecast_peak: tuple[float, float] | None
    """Largest halting score, and when [s]."""
    mode_shares: Mapping[TractionMode, float]
    mode_at_end: TractionMode | None
    stalls: int
    retries: int
    faults: tuple[Fault, ...]
    events: tuple[Event, ...]
    status_shares: Mapping[str, Mapping[ContactStatus, float]]
    """Per wheel, how much of the time its strap said what."""

    @property
    def verdict_at_end(self) -> ForecastVerdict | None:
        """What the forecast said last."""
        return ForecastVerdict(int(self.verdicts[-1])) if self.verdicts.size else None

    @property
    def sinkage_mm(self) -> WheelSeries | None:
        """True where that is known, else from the zone."""
        return self.true_sinkage_mm or self.sinkage_from_zone_mm


def drive_facts(recording: Recording) -> DriveFacts:
    """The facts of a recording."""
    is_simulated = all(recording.of_rover(topics.GROUND_TRUTH, name) is not None for name in _JUDGED_BY)
    source = topics.GROUND_TRUTH if is_simulated else topics.ODOM
    zone = _zone_deg(recording)
    modes = _codes(recording, "state", TractionMode)
    faults = _codes(recording, "fault", Fault)
    retries = _known(recording.of_rover(topics.TRACTION_STATE, "retries"))
    speed = _final_speed(recording, source)
    moving = _where_turning(recording)
    slip_max = _wheel_series(recording, topics.SOIL_STATE, "slip_max")
    slip = _masked(_wheel_series(recording, topics.SOIL_STATE, "slip"), moving)
    mode_at_end = TractionMode(int(modes[-1])) if modes.size else None
    true_de, true_st = _true_soil(recording)
    verdicts = _verdicts(recording)
    return DriveFacts(
        is_simulated=is_simulated,
        outcome=_outcome(recording, source, speed, zone, mode_at_end),
        from_start_m=_from_start_m(recording, source),
        final_speed_mps=speed,
        zone_deg=zone,
        sinkage_from_zone_mm=_sinkage_from_zone_mm(recording, zone),
        true_sinkage_mm=_wheel_series(recording, topics.GROUND_TRUTH, "sinkage", 1e3),
        slip=slip,
        true_slip=_wheel_series(recording, topics.GROUND_TRUTH, "slip"),
        slip_margin=_difference(slip_max, slip),
        flow_ratio=_masked(_wheel_series(recording, topics.SOIL_STATE, "vc"), moving),
        true_de=true_de,
        true_st=true_st,
        verdicts=verdicts,
        forecast_stop_s=_first_stop_s(recording, verdicts),
        forecast_peak=_forecast_peak(recording, verdicts),
        mode_shares={mode: float(np.mean(modes == mode)) for mode in TractionMode if (modes == mode).any()},
        mode_at_end=mode_at_end,
        stalls=int(np.count_nonzero((np.diff(modes) != 0) & (modes[1:] == TractionMode.STALL))),
        retries=int(retries.max()) if retries.size else 0,
        faults=tuple(Fault(int(code)) for code in np.unique(faults) if code),
        events=_events(recording, modes, faults),
        status_shares=_status_shares(recording),
    )


def contact_status(recording: Recording) -> FloatArray | None:
    """ContactStatus codes over the times of the contact angles, shape (N, W); NaN for what is no known code."""
    codes = recording.of_wheels(topics.CONTACT_ANGLES, "status")
    return None if codes is None else np.where(np.isin(codes, [int(status) for status in ContactStatus]), codes, np.nan)


def _codes(recording: Recording, quantity: str, codes: type[TractionMode | Fault]) -> FloatArray:
    """A code of traction/state over time; empty where the bag has it not, or has codes of another version."""
    found = recording.of_rover(topics.TRACTION_STATE, quantity)
    if found is None or not np.isin(found, [int(code) for code in codes]).all():
        return np.empty(0)
    return found


def _events(recording: Recording, modes: FloatArray, faults: FloatArray) -> tuple[Event, ...]:
    has_state = recording.time_s(topics.TRACTION_STATE).size > 0
    if has_state and not (modes.size and faults.size):
        return ()
    return run_events(recording.run_log())


def _verdicts(recording: Recording) -> FloatArray:
    """Codes of the forecast over time; empty where the bag has none, or has codes of another version."""
    found = recording.of_rover(topics.SOIL_STATE, "scout_verdict")
    if found is None or not np.isin(found, [int(verdict) for verdict in ForecastVerdict]).all():
        return np.empty(0)
    return found


def _first_stop_s(recording: Recording, verdicts: FloatArray) -> float | None:
    stopped = np.flatnonzero(verdicts == ForecastVerdict.STOP)
    return float(recording.time_s(topics.SOIL_STATE)[stopped[0]]) if stopped.size else None


def _forecast_peak(recording: Recording, verdicts: FloatArray) -> tuple[float, float] | None:
    score = recording.of_rover(topics.SOIL_STATE, "scout_z")
    if score is None or not verdicts.size:
        return None
    told = np.where((verdicts != ForecastVerdict.NONE) & np.isfinite(score), score, -np.inf)
    row = int(np.argmax(told))
    return (float(told[row]), float(recording.time_s(topics.SOIL_STATE)[row])) if told[row] > -np.inf else None


def _true_soil(recording: Recording) -> tuple[WheelSeries | None, WheelSeries | None]:
    """De and st below every wheel; None where the ground, the rover or the place is not known."""
    columns = [recording.of_rover(topics.ODOM, axis) for axis in ("x", "y", "z")]
    place = [recording.of_rover(topics.GROUND_TRUTH, name) for name in ("x", "y", "heading")]
    known = [column for column in (*columns, *place) if column is not None and np.isfinite(column).all()]
    if "scenario" not in recording.custom_data or len(known) < 6 or not known[0].size or not known[3].size:
        return None, None
    try:
        rover = rover_of(recording.custom_data)
        terrain = ground_of(recording.custom_data, np.stack(known[:3], axis=1))
    except NoSiteError:
        return None, None  # the map's own notice says why
    if rover.wheel_names != recording.wheels:
        return None, None
    truth, time_s = soil_truth(terrain, rover, *known[3:]), recording.time_s(topics.GROUND_TRUTH)
    return WheelSeries(recording.wheels, time_s, truth.de), WheelSeries(recording.wheels, time_s, truth.st)


def _wheel_series(recording: Recording, row: Topic, quantity: str, scale: float = 1.0) -> WheelSeries | None:
    values = recording.of_wheels(row, quantity)
    return None if values is None else WheelSeries(recording.wheels, recording.time_s(row), scale * values)


def _masked(series: WheelSeries | None, where: BoolArray | None) -> WheelSeries | None:
    if series is None or where is None:
        return series
    return WheelSeries(series.wheels, series.time_s, np.where(where, series.values, np.nan))


def _difference(series: WheelSeries | None, other: WheelSeries | None) -> WheelSeries | None:
    if series is None or other is None:
        return None
    return WheelSeries(series.wheels, series.time_s, series.values - other.values)


def _where_turning(recording: Recording) -> BoolArray | None:
    """Where the estimator knows the slip, and its strap gives angles."""
    std = recording.of_wheels(topics.SOIL_STATE, "slip_std")
    status = recording.of_wheels(topics.SOIL_STATE, "status")
    if std is None:
        return None
    return (std < 1.0) & (True if status is None else status != SoilStatus.NO_DATA)


def _zone_deg(recording: Recording) -> WheelSeries | None:
    """Width of the contact zone while the strap gives one."""
    theta_1 = recording.of_wheels(topics.CONTACT_ANGLES, "theta_1")
    theta_2 = recording.of_wheels(topics.CONTACT_ANGLES, "theta_2")
    if theta_1 is None or theta_2 is None:
        return None
    zone = WheelSeries(recording.wheels, recording.time_s(topics.CONTACT_ANGLES), np.degrees(theta_1 - theta_2))
    return _masked(zone, _with_zone(recording))


def _with_zone(recording: Recording) -> BoolArray | None:
    status = contact_status(recording)
    return None if status is None else np.isin(status, [int(code) for code in _WITH_ZONE])


def _sinkage_from_zone_mm(recording: Recording, zone: WheelSeries | None) -> WheelSeries | None:
    """How deep the wheel's lowest point lies below where it enters the soil: r (1 - cos theta_1)."""
    radii = wheel_radii(recording.custom_data, recording.wheels)
    theta_1 = recording.of_wheels(topics.CONTACT_ANGLES, "theta_1")
    if radii is None or theta_1 is None or zone is None:
        return None
    depth = WheelSeries(zone.wheels, zone.time_s, 1e3 * radii * (1.0 - np.cos(theta_1)))
    return _masked(depth, np.isfinite(zone.values))


def _final_speed(recording: Recording, source: Topic) -> float | None:
    speed, time_s = recording.of_rover(source, "speed"), recording.time_s(source)
    if speed is None or not time_s.size:
        return None
    last = _known(speed[time_s >= time_s[-1] - FINAL_S])
    return float(last.mean()) if last.size else None


def _from_start_m(recording: Recording, source: Topic) -> float | None:
    x, y = _known(recording.of_rover(source, "x")), _known(recording.of_rover(source, "y"))
    if not x.size:
        return None
    across = float(y[-1] - y[0]) if y.size else 0.0
    return float(np.hypot(x[-1] - x[0], across))


def _known(values: FloatArray | None) -> FloatArray:
    """The finite ones of a column over time."""
    return np.empty(0) if values is None else values[np.isfinite(values)]


def _outcome(
    recording: Recording,
    source: Topic,
    final_speed: float | None,
    zone: WheelSeries | None,
    mode: TractionMode | None,
) -> Outcome | None:
    x = recording.of_rover(source, "x")
    known = _known(x)
    if x is None or not known.size or final_speed is None:
        return None
    load = recording.of_rover(topics.GROUND_TRUTH, "external_load")
    snag_x = None
    if source is topics.GROUND_TRUTH and load is not None and (load > load[0]).any():
        snag_x = float(x[np.argmax(load > load[0])])
    widest = _true_zone_deg(recording) if source is topics.GROUND_TRUTH else zone
    peak = None if widest is None else widest.peak()
    return outcome_of(
        final_speed,
        0.0 if peak is None else peak.value,
        TractionMode.STANDBY if mode is None else mode,
        float(known[-1]),
        snag_x,
        float(recording.time_s(source)[-1]),
    )


def _true_zone_deg(recording: Recording) -> WheelSeries | None:
    theta_1 = _wheel_series(recording, topics.GROUND_TRUTH, "theta_1")
    zone = _difference(theta_1, _wheel_series(recording, topics.GROUND_TRUTH, "theta_2"))
    return None if zone is None else WheelSeries(zone.wheels, zone.time_s, np.degrees(zone.values))


def _status_shares(recording: Recording) -> dict[str, dict[ContactStatus, float]]:
    codes = contact_status(recording)
    if codes is None or not codes.size:
        return {}
    return {
        wheel: {
            status: float(np.mean(codes[:, index] == status))
            for status in ContactStatus
            if (codes[:, index] == status).any()
        }
        for index, wheel in enumerate(recording.wheels)
    }
