"""What happened in a drive, in sentences for somebody who was not there."""

from collections.abc import Mapping
from datetime import UTC, datetime
from types import MappingProxyType

from missions.report.drive_facts import SETTLED_S, DriveFacts, Peak
from missions.report.page import Kind
from missions.report.recording import Recording
from missions.summary import BURIED_ZONE_DEG, MOVING_MPS, Outcome
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

OUTCOME_WORDS: Mapping[Outcome, str] = MappingProxyType(
    {
        Outcome.DROVE_OFF: "It was held back, came free and drove on.",
        Outcome.PASSED: "It was driving at the end, and nothing had held it.",
        Outcome.BURIED: f"It is buried: it stands, and a wheel was in contact over more than {BURIED_ZONE_DEG:g} deg.",
        Outcome.STUCK: "It is stuck: it stands while its wheels are driven.",
        Outcome.HALTED: "It stands on purpose: the supervisor gave up, or waits for a fault to go.",
        Outcome.UNDECIDED: "The recording ends too soon to tell how it came out.",
    }
)
OUTCOME_KINDS: Mapping[Outcome, Kind] = MappingProxyType(
    {
        Outcome.DROVE_OFF: "good",
        Outcome.PASSED: "good",
        Outcome.BURIED: "bad",
        Outcome.STUCK: "bad",
        Outcome.HALTED: "warn",
        Outcome.UNDECIDED: "note",
    }
)
MODE_WORDS: Mapping[TractionMode, str] = MappingProxyType(
    {
        TractionMode.STANDBY: "nothing asked yet, or held by the operator",
        TractionMode.DRIVE: "every wheel turned as asked",
        TractionMode.LIMIT: "some wheel was held below what was asked",
        TractionMode.STALL: "wheels turned and the rover did not: stopping them",
        TractionMode.WAIT: "standing, so that the load may pass",
        TractionMode.RETRY: "driving again after a stall",
        TractionMode.HALT: "could not go on: stands until it is reset",
        TractionMode.FAULT: "an input was late or faulty: stood until it was back",
        TractionMode.FORECAST_STOP: "the forecast said that going on ends badly: stopping",
        TractionMode.BACK_OUT: "driving back by the way it came",
    }
)
FAULT_WORDS: Mapping[Fault, str] = MappingProxyType(
    {
        Fault.SENSOR_LATE: "no contact angles in time: is strap_sensor_driver running, are the boards plugged in?",
        Fault.ODOMETRY_LATE: "no odometry in time: does the rover send odom?",
        Fault.WHEEL_STATES_LATE: "no encoder readings in time: does the rover send wheel_states?",
        Fault.SENSOR_FAULT: "too many straps without a usable reading: see the straps' faults below",
        Fault.COMMAND_LATE: "nobody asked for a speed in time: is the operator or planner still there?",
        Fault.SOIL_STATE_LATE: "the soil estimator fell silent: is soil_flow_estimator running?",
    }
)


def story(recording: Recording, facts: DriveFacts) -> tuple[str, ...]:
    """Paragraphs: how it ended, how deep, what the supervisor did, what the straps saw."""
    return tuple(
        text
        for text in (
            _ending(recording, facts),
            _wheels(facts),
            _forecast(facts),
            _supervisor(facts),
            _straps(facts),
        )
        if text
    )


def subtitle(recording: Recording) -> str:
    """Which rover, situation and controller, and when."""
    data = recording.custom_data
    parts = [f"{data.get('rover', 'a rover')}, {len(recording.wheels)} wheels"]
    if "scenario" in data:
        parts.append(f"scenario {data['scenario']}, seed {data.get('seed', '?')}")
    if recording.began_ns:
        parts.append(f"recorded from {datetime.fromtimestamp(recording.began_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC")
    parts.append(f"{recording.duration_s:.1f} s")
    return "; ".join(parts)


def event_words(what: str) -> str:
    """An event, with the meaning of a mode that is named, or the remedy of a fault."""
    meanings = {mode.name: words for mode, words in MODE_WORDS.items()}
    meanings |= {f"fault {fault.name}": words for fault, words in FAULT_WORDS.items()}
    return f"{what}: {meanings[what]}" if what in meanings else what


def at(peak: Peak, unit: str, digits: int = 0) -> str:
    """A peak with where and when."""
    return f"{peak.value:.{digits}f}{unit} ({peak.wheel}, at {peak.time_s:.1f} s)"


def _ending(recording: Recording, facts: DriveFacts) -> str:
    by = "by what the simulation knows" if facts.is_simulated else "by its own sensors"
    parts = []
    if facts.from_start_m is not None:
        parts.append(f"After {recording.duration_s:.1f} s it was {facts.from_start_m:.1f} m from where it began, {by}.")
    if facts.final_speed_mps is not None:
        stands = abs(facts.final_speed_mps) < MOVING_MPS
        parts.append("It stood at the end." if stands else f"In the end it went {facts.final_speed_mps:.2f} m/s.")
    if not parts:
        parts.append(
            "The bag says neither where the rover was nor how fast it went (no odom): how it ended is unknown."
        )
    return " ".join(parts)


def _wheels(facts: DriveFacts) -> str:
    parts = []
    sinkage = facts.sinkage_mm and facts.sinkage_mm.peak()
    if sinkage:
        how = "" if facts.true_sinkage_mm else " by the strap"
        parts.append(f"The deepest a wheel sank{how} was {at(sinkage, ' mm')}.")
    zone = facts.zone_deg and facts.zone_deg.peak()
    if zone:
        parts.append(f"The widest contact zone measured was {at(zone, ' deg')}; beyond 80 deg a wheel is about buried.")
    slip = facts.slip and facts.slip.peak(from_s=SETTLED_S)
    if slip:
        parts.append(f"The largest slip measured after the start was {at(slip, '', 2)}.")
    margin = facts.slip_margin and facts.slip_margin.peak(lowest=True, from_s=SETTLED_S)
    if margin:
        parts.append(
            f"The least room to the slip limit was {at(margin, '', 2)}"
            + (": the limit was passed." if margin.value < 0.0 else ".")
        )
    return " ".join(parts)


def _forecast(facts: DriveFacts) -> str:
    if facts.forecast_peak is None:
        return ""
    score, at_s = facts.forecast_peak
    when = "never" if facts.forecast_stop_s is None else f"first at {facts.forecast_stop_s:.1f} s"
    parts = [f"The halting forecast said STOP {when}; its score was highest with {score:.2f} at {at_s:.1f} s."]
    if facts.verdict_at_end is not None:
        parts.append(f"At the end it said {facts.verdict_at_end.name}.")
    return " ".join(parts)


def _supervisor(facts: DriveFacts) -> str:
    if not facts.mode_shares:
        return ""
    driving = sum(facts.mode_shares.get(mode, 0.0) for mode in (TractionMode.DRIVE, TractionMode.LIMIT))
    limited = facts.mode_shares.get(TractionMode.LIMIT, 0.0)
    parts = [
        (
            f"The supervisor let it drive {100 * driving:.0f} % of the time; {100 * limited:.0f} % of the time some "
            "wheel was held below what was asked."
        )
    ]
    if facts.stalls:
        parts.append(f"It stalled {_times(facts.stalls)}, and tried again at most {_times(facts.retries)} in a row.")
    if facts.faults:
        parts.append(f"It met these faults: {', '.join(fault.name for fault in facts.faults)}.")
    if facts.mode_at_end is not None:
        parts.append(f"Its mode at the end was {facts.mode_at_end.name} ({MODE_WORDS[facts.mode_at_end]}).")
    return " ".join(parts)


def _straps(facts: DriveFacts) -> str:
    if not facts.status_shares:
        return ""
    count = len(facts.status_shares)

    def mean(*wanted: ContactStatus) -> float:
        return sum(shares.get(status, 0.0) for shares in facts.status_shares.values() for status in wanted) / count

    faulty = sum(
        share for shares in facts.status_shares.values() for status, share in shares.items() if status.is_fault
    )
    return (
        f"The straps measured {100 * mean(ContactStatus.VALID, ContactStatus.UNCONFIRMED):.0f} % of the time, bridged "
        f"their seam or a gap {100 * mean(ContactStatus.PREDICTED):.0f} %, felt no ground "
        f"{100 * mean(ContactStatus.NO_CONTACT):.1f} % and had a fault {100 * faulty / count:.1f} %."
    )


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")
