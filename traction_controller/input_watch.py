"""Everything the controller is told, and what of it is late or faulty."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from soil_flow_estimator.soil_state import SoilState
from strap_rover.arrays import BoolArray
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import (
    BODY_MOTION_WORDS,
    CONTACT_ANGLES_WORDS,
    WHEEL_STATES_WORDS,
    BodyMotion,
    Input,
    InputWords,
    SpeedRequest,
    WheelStates,
)
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, remedy
from traction_controller.supervisor import Fault
from traction_controller.traction_settings import TractionSettings

USABLE_STATUS = (int(ContactStatus.VALID), int(ContactStatus.PREDICTED), int(ContactStatus.UNCONFIRMED))
"""Readings whose angles are taken as they are: a predicted one is what the driver knows while the seam is below, and a
wheel has to turn before its strap can be confirmed."""
KNOWN_STATUS = frozenset({*USABLE_STATUS, int(ContactStatus.NO_CONTACT)})
"""Readings after which the angles of a wheel are known: usable, or none because the wheel is in the air."""
SILENT_STATUS = (
    int(ContactStatus.NO_DATA),
    int(ContactStatus.UNKNOWN_PROTOCOL),
    int(ContactStatus.WRONG_BOARD),
)
"""Readings that say no reading comes from this board: as good as no message, so there is no patience with them.

The driver has waited before it says NO_DATA, and a frame of a protocol it does not know had a good CRC: nothing of the
board can be read until it is flashed. STALE_ENCODER is not one of them: scans come, and a gap in wheel_states of more
than the driver carries on over (30 ms) often is over by the next one, which the hold time bridges; a source of
encoders that is gone is WHEEL_STATES_LATE here.
"""
NEVER_NS = int(np.iinfo(np.int64).min // 2)
"""When a strap was usable last [ns] that never was, or too long ago."""
SOIL_STATE_WORDS = InputWords(
    "soil_state is", "is soil_flow_estimator running? ~/reset lets the rover go on without it"
)
SPEED_REQUEST_WORDS = InputWords("cmd_vel is", "does the operator or planner still send it?")
NO_SOIL_STATE = "no soil_state: driving on the slip cap alone; start soil_flow_estimator to use what the soil says"


class InputWatch:
    """The last good record of each input, and the last angles known of each strap."""

    def __init__(self, rover: RoverDescription, settings: TractionSettings) -> None:
        count = len(rover.wheels)
        self._wheel_names = rover.wheel_names
        self.angles: Input[ContactAngles] = Input(CONTACT_ANGLES_WORDS, count, settings.sensor_timeout_s)
        self.body_motion: Input[BodyMotion] = Input(BODY_MOTION_WORDS, count, settings.odometry_timeout_s)
        self.wheel_states: Input[WheelStates] = Input(WHEEL_STATES_WORDS, count, settings.encoder_timeout_s)
        self.request: Input[SpeedRequest] = Input(SPEED_REQUEST_WORDS, count, settings.command_timeout_s)
        self.soil_state: Input[SoilState] = Input(SOIL_STATE_WORDS, count, settings.soil_state_timeout_s)
        self.theta_1 = self.theta_2 = np.zeros(count)
        """Angles of each strap's last usable reading [rad], shape (W,); 0 of a wheel in the air."""
        self.blind: BoolArray = np.ones(count, dtype=np.bool_)
        """Wheels whose angles are not known at the time last judged, shape (W,)."""
        self.faulty_readings = 0
        """Straps read with a fault, wheel by wheel, since construction."""
        self._silent: BoolArray = np.zeros(count, dtype=np.bool_)
        self._usable_ns = np.full(count, NEVER_NS, dtype=np.int64)
        self._judged_ns: int | None = None
        self._faults: tuple[Fault, ...] = ()
        self.retune(settings)

    def retune(self, settings: TractionSettings) -> None:
        """Go by other time-outs, hold time and number of blind wheels from now on."""
        self.angles.timeout_s = settings.sensor_timeout_s
        self.body_motion.timeout_s = settings.odometry_timeout_s
        self.wheel_states.timeout_s = settings.encoder_timeout_s
        self.request.timeout_s = settings.command_timeout_s
        self.soil_state.timeout_s = settings.soil_state_timeout_s
        self._hold_ns = round(settings.sensor_hold_s * 1e9)
        self._lead_ns = round(settings.sensor_timeout_s * 1e9)
        self._blind_max = settings.blind_wheels_max
        self._uses_soil = settings.policy == "soil_flow"

    def forget_request_and_soil(self) -> None:
        """Forget what was asked and said of the soil; records of the sensors are facts and keep their age."""
        self.request.forget()
        self.soil_state.forget()

    @property
    def rejected_records(self) -> int:
        """Records left out since construction."""
        inputs = (self.angles, self.body_motion, self.wheel_states, self.request, self.soil_state)
        return sum(one.rejected for one in inputs)

    def take_contact_angles(self, angles: ContactAngles) -> bool:
        """Take contact angles; a strap that reads with a fault keeps its last usable ones."""
        if not self.angles.take(angles, self._judged_ns, (angles.theta_1, angles.theta_2, angles.status)):
            return False
        status = angles.status
        in_air = status == ContactStatus.NO_CONTACT
        usable = np.isin(status, USABLE_STATUS)
        self.theta_1 = np.where(usable, angles.theta_1, np.where(in_air, 0.0, self.theta_1))
        self.theta_2 = np.where(usable, angles.theta_2, np.where(in_air, 0.0, self.theta_2))
        known = usable | in_air
        self._usable_ns = np.where(known, angles.stamp_ns, self._usable_ns)
        self._silent = np.isin(status, SILENT_STATUS)
        self.faulty_readings += known.size - int(np.count_nonzero(known))
        return True

    def take_wheel_states(self, states: WheelStates) -> bool:
        """Take encoders."""
        return self.wheel_states.take(states, self._judged_ns, (states.angle,))

    def take_body_motion(self, motion: BodyMotion) -> bool:
        """Take odometry."""
        return self.body_motion.take(motion, self._judged_ns, (), motion.speed)

    def take_soil_state(self, soil: SoilState) -> bool:
        """Take the soil estimate."""
        return self.soil_state.take(soil, self._judged_ns, (soil.slip_max, soil.status))

    def take_request(self, request: SpeedRequest) -> bool:
        """Take what the operator asks for."""
        return self.request.take(request, self._judged_ns, (), request.speed)

    def judge(self, now_ns: int) -> tuple[Fault, ...]:
        """Every fault present now, the lowest code first."""
        self._judged_ns = now_ns
        # A hold that began in the future began at a time nobody knows: the clock was set back.
        expired = (self._usable_ns < now_ns - self._hold_ns) | (self._usable_ns > now_ns + self._lead_ns)
        if expired.any():  # for good: a clock set back comes by that time once more
            self._usable_ns = np.where(expired, NEVER_NS, self._usable_ns)
        self.blind = self._silent | expired
        faults = []
        sensor_late = self.angles.judge(now_ns) or int(np.count_nonzero(self._silent)) > self._blind_max
        if sensor_late:
            faults.append(Fault.SENSOR_LATE)
        if self.body_motion.judge(now_ns):
            faults.append(Fault.ODOMETRY_LATE)
        if self.wheel_states.judge(now_ns):
            faults.append(Fault.WHEEL_STATES_LATE)
        if not sensor_late and int(np.count_nonzero(self.blind)) > self._blind_max:
            faults.append(Fault.SENSOR_FAULT)
        if self.request.record is not None and self.request.judge(now_ns):
            faults.append(Fault.COMMAND_LATE)
        # An estimator that never spoke is not there by choice; one that fell silent has died.
        if self._uses_soil and self.soil_state.record is not None and self.soil_state.judge(now_ns):
            faults.append(Fault.SOIL_STATE_LATE)
        self._faults = tuple(faults)
        return self._faults

    def complaints(self) -> Sequence[str]:
        """What was wrong when last judged, each with what to do about it; empty when all is well."""
        if self._judged_ns is None:
            return []
        told = [self._complaint(fault, self._judged_ns) for fault in self._faults]
        if self.request.record is None and self.request.is_ahead:
            told.append(self.request.complaint(self._judged_ns))
        if self._uses_soil and self.soil_state.record is None:
            told.append(NO_SOIL_STATE)
        return told

    def _complaint(self, fault: Fault, now_ns: int) -> str:
        if fault is Fault.SENSOR_LATE:
            return self.angles.complaint(now_ns) if self.angles.is_late else self._straps(self._silent)
        if fault is Fault.SENSOR_FAULT:
            return self._straps(self.blind)
        late: dict[Fault, Input[Any]] = {
            Fault.ODOMETRY_LATE: self.body_motion,
            Fault.WHEEL_STATES_LATE: self.wheel_states,
            Fault.COMMAND_LATE: self.request,
            Fault.SOIL_STATE_LATE: self.soil_state,
        }
        return late[fault].complaint(now_ns)

    def _straps(self, which: BoolArray) -> str:
        """What is wrong with the straps of `which` wheels, one remedy for all that read the same."""
        assert self.angles.record is not None
        names_by_code: dict[int, list[str]] = {}
        rows = zip(self._wheel_names, self.angles.record.status.tolist(), which.tolist(), strict=True)
        for name, code, is_meant in rows:
            if is_meant and code not in KNOWN_STATUS:
                names_by_code.setdefault(code, []).append(name)
        told = [f"strap of {', '.join(names)}: {_remedy(code)}" for code, names in sorted(names_by_code.items())]
        return "; ".join(told) or "the clock was set back: straps are believed again with their next reading"


def _remedy(code: int) -> str:
    try:
        return remedy(code)
    except ValueError:
        return f"status {code} is unknown here: driver and controller must be of one version"
