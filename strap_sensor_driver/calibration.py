"""What calibration has found out about straps: records. `calibration_fit` makes them, `calibration_file` keeps them.

Per end: R_path(arc) as a monotone table, the pull-down's resistance, offset and gain of the converter's input, the
resistance of contact and lead. A calibration belongs to one wheel, board and input, and says so.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from strap_sensor_driver.end_curve import EndCurve


@dataclass(frozen=True, slots=True)
class EndCalibration:
    """One end of a strap. ValueError for a table that does not rise, or numbers no converter has."""

    pull_down_ohm: float
    offset_lsb: float
    """What the input reads at 0 V [converter steps of one sample]."""
    gain: float
    """Steps read over steps due, offset taken off; 1 ideally."""
    resistance_ohm: tuple[float, ...]
    """Of the path from this end to the contact, at the knots; the first is lead and contact alone."""
    arc_rad: tuple[float, ...]
    """Arc from this end at the knots [rad]."""
    arc_std_rad: tuple[float, ...]
    """1-sigma of the table at the knots [rad]."""
    residual_rms_rad: float
    """Of the samples about the table [rad]."""

    def __post_init__(self) -> None:
        if not 0.0 < self.pull_down_ohm < math.inf:
            raise ValueError(f"pull_down_ohm = {self.pull_down_ohm}: give a finite resistance above 0")
        if not abs(self.offset_lsb) <= 50.0:
            raise ValueError(f"offset_lsb = {self.offset_lsb}: no converter is off by more than 50 steps; check wiring")
        if not 0.8 <= self.gain <= 1.2:
            raise ValueError(f"gain = {self.gain}: must lie in 0.8 .. 1.2; check reference and supply")
        if not (math.isfinite(self.residual_rms_rad) and self.residual_rms_rad >= 0.0):
            raise ValueError(f"residual_rms_rad = {self.residual_rms_rad}: give a finite number of at least 0")
        self.curve()

    @property
    def contact_ohm(self) -> float:
        """Resistance of lead and contact: the path with the contact at this end [ohm]."""
        return self.resistance_ohm[0]

    def curve(self) -> EndCurve:
        """The table in terms of R / R_pull_down."""
        ratio = tuple(value / self.pull_down_ohm for value in self.resistance_ohm)
        return EndCurve(ratio, self.arc_rad, self.arc_std_rad)


@dataclass(frozen=True, slots=True)
class StrapCalibration:
    """One strap on one wheel."""

    wheel: str
    """Joint name of the rover's file."""
    board: int
    channel: int
    """Strap input 0, 1 or 2 of the board."""
    method: str
    """`bench` (known angles) or `rolling` (d beta / d theta_n = -1)."""
    created: str
    """ISO 8601 date and time, UTC."""
    firmware: str
    """Version the board said in its HELLO."""
    samples: int
    """Scans or angles that it rests on."""
    noise_lsb: float
    """1-sigma noise of one converter sample [steps], as measured."""
    end_a: EndCalibration
    end_b: EndCalibration

    def __post_init__(self) -> None:
        if self.method not in {"bench", "rolling"}:
            raise ValueError(f"method = {self.method!r}: give bench or rolling")
        if not (math.isfinite(self.noise_lsb) and self.noise_lsb >= 0.0):
            raise ValueError(f"noise_lsb = {self.noise_lsb}: give a finite number of at least 0")


@dataclass(frozen=True, slots=True)
class RoverCalibration:
    """All calibrated straps of a rover, under one id."""

    rover: str
    """Name in the rover's description."""
    straps: tuple[StrapCalibration, ...]
    id: str
    """First 12 hexadecimal digits of the SHA-256 of the content."""

    def of(self, wheel: str, board: int, channel: int) -> StrapCalibration | None:
        """The strap of `wheel` on this input, or None when it is not calibrated."""
        for strap in self.straps:
            if (strap.wheel, strap.board, strap.channel) == (wheel, board, channel):
                return strap
        return None

    def mismatches(self, rover: str, inputs: Sequence[tuple[str, int, int]]) -> list[str]:
        """What does not fit a rover called `rover` with straps on `inputs`, (wheel, board, channel) each; in words.

        A strap that the rover has and the calibration has not is no mismatch.
        """
        if rover != self.rover:
            return [f"calibration {self.id} is of rover {self.rover!r}, not {rover!r}: give that rover's, or calibrate"]
        owner = {(board, channel): wheel for wheel, board, channel in inputs}
        problems = []
        for strap in self.straps:
            now = owner.get((strap.board, strap.channel))
            if now != strap.wheel:
                has = "no wheel" if now is None else f"wheel {now!r}"
                problems.append(
                    f"calibration {self.id}: wheel {strap.wheel!r} was calibrated on board {strap.board} channel "
                    f"{strap.channel}, which now reads {has}: put the leads back, or calibrate the wheel again"
                )
        return problems
