"""Every number of the strap sensor that can be tuned, with its meaning and bounds."""

import math
from dataclasses import dataclass, field
from typing import Any

from strap_rover.settings import check_settings
from strap_sensor_driver.contact_zone import ZoneLimits
from strap_sensor_driver.device_clock import scan_duration_us, transfer_time_us
from strap_sensor_driver.end_curve import EndCurve
from strap_sensor_driver.frames import DATA_WIRE_BYTES
from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, Strap, strap_resistance_ohm


def _row(doc: str, low: float | None = None, high: float | None = None, *, tunable: bool = False) -> dict[str, Any]:
    bounds = {"min": low, "max": high}
    row = {"doc": doc} | {name: bound for name, bound in bounds.items() if bound is not None}
    return row | {"tunable": True} if tunable else row


_R_STR = strap_resistance_ohm(0.25)


@dataclass(frozen=True, slots=True)
class StrapReaderSettings:
    """Every number of the sensor that can be tuned. ValueError names field, value and bounds."""

    total_resistance_ohm: float = field(
        default=_R_STR, metadata=_row("strap resistance once round the wheel; measure it, 5 % is 16 deg", 1e2, 1e8)
    )
    pull_down_a_ohm: float = field(
        default=BEST_PULL_DOWN_RATIO * _R_STR, metadata=_row("pull-down at strap end A", 1e2, 1e8)
    )
    pull_down_b_ohm: float = field(
        default=BEST_PULL_DOWN_RATIO * _R_STR, metadata=_row("pull-down at strap end B", 1e2, 1e8)
    )
    supply_v: float = field(default=5.0, metadata=_row("supply of the strap", 0.5, 50.0))
    inverted: bool = field(default=False, metadata=_row("conductor to ground, pull-ups: converter sees supply - V"))
    rate_hz: float = field(default=200.0, metadata=_row("scans per second of a board", 1.0, 400.0))
    osr: int = field(default=4, metadata=_row("samples summed per input and scan", 1, 64))
    baud: int = field(default=115_200, metadata=_row("serial speed", 9600, 2_000_000))
    noise_lsb: float = field(
        default=0.5, metadata=_row("1-sigma noise of one sample in converter steps", 0.0, 50.0, tunable=True)
    )
    resistance_std_ratio: float = field(
        default=0.0, metadata=_row("1-sigma of R_str, relative; above 0 the seam corrects it", 0.0, 0.5, tunable=True)
    )
    angle_floor_std_rad: float = field(
        default=0.0035, metadata=_row("1-sigma of what no volt shows: encoder, strap edges", 0.0, 1.0, tunable=True)
    )
    contact_level: float = field(
        default=0.1, metadata=_row("fraction of supply below which an end is open", 0.001, 0.5, tunable=True)
    )
    seam_level: float = field(
        default=0.98, metadata=_row("fraction of supply above which an end is shorted", 0.5, 0.999, tunable=True)
    )
    range_margin: float = field(
        default=0.1,
        metadata=_row("how far below the lowest possible volts a reading may be, relative", 0.0, 0.5, tunable=True),
    )
    order_margin_rad: float = field(
        default=0.2, metadata=_row("beta_1 - beta_2 that still is a contact", 0.0, 1.0, tunable=True)
    )
    width_max_rad: float = field(default=math.pi, metadata=_row("widest zone that is believed", 0.1, 6.0, tunable=True))
    seam_rotation_max_rad: float = field(
        default=3.5,
        metadata=_row("wheel rotation in the seam after which it is a short; above width_max", 0.1, 6.0, tunable=True),
    )
    stuck_rotation_rad: float = field(
        default=0.35,
        metadata=_row("wheel rotation an end may stay unchanged, or copy its neighbour", 0.05, 6.0, tunable=True),
    )
    stuck_band_v: float = field(
        default=0.02, metadata=_row("change of volts that counts as unchanged", 0.0, 1.0, tunable=True)
    )
    theta_max_rad: float = field(
        default=2.3,
        metadata=_row("how far from bottom dead centre soil may touch the wheel", 0.5, math.pi, tunable=True),
    )
    jump_rad: float = field(
        default=0.04,
        metadata=_row("how far an end of the zone may go from one scan to the next", 0.01, 1.0, tunable=True),
    )
    slide_rad: float = field(
        default=0.04,
        metadata=_row("wheel rotation over which a zone end must stay in the soil", 0.01, 1.0, tunable=True),
    )
    settle_rotation_rad: float = field(
        default=0.2,
        metadata=_row("wheel rotation over which a zone that jumped must stay to be believed", 0.05, 3.0, tunable=True),
    )
    supply_follows_reference: bool = field(
        default=True,
        metadata=_row("strap fed by the board's own 5V: what that is does not matter; false: converter's volts count"),
    )
    fault_scans: int = field(default=3, metadata=_row("bad scans in a row that make a fault", 1, 1000, tunable=True))
    recovery_scans: int = field(default=5, metadata=_row("good scans in a row that end a fault", 1, 1000, tunable=True))
    recovery_rotation_rad: float = field(
        default=0.5,
        metadata=_row("good wheel rotation that ends a fault which shows in motion only", 0.0, 6.0, tunable=True),
    )
    predicted_std_per_rad: float = field(
        default=0.15,
        metadata=_row("growth of the held zone's 1-sigma per rad of wheel rotation", 0.0, 10.0, tunable=True),
    )
    fault_std_per_s: float = field(
        default=0.1,
        metadata=_row("further growth of the held zone's 1-sigma per second in a fault", 0.0, 10.0, tunable=True),
    )
    encoder_extrapolation_s: float = field(
        default=0.03, metadata=_row("farthest that the encoder is carried on with its speed", 0.0, 0.5)
    )
    reversing_travel_rad: float = field(
        default=0.02, metadata=_row("wheel rotation after which a new direction of travel is believed", 0.0, 1.0)
    )
    silent_s: float = field(
        default=0.1, metadata=_row("time without a scan after which a board is silent", 0.01, 10.0, tunable=True)
    )
    hello_period_s: float = field(
        default=0.5, metadata=_row("how often a board is asked to say hello", 0.05, 60.0, tunable=True)
    )
    clock_window_s: float = field(default=10.0, metadata=_row("window of the line that is the device clock", 3.0, 60.0))

    def __post_init__(self) -> None:
        check_settings(self)
        period_us = 1e6 / self.rate_hz
        if not scan_duration_us(self.osr) < period_us:
            raise ValueError(
                f"StrapReaderSettings.osr = {self.osr}: a scan of {scan_duration_us(self.osr)} us does not fit "
                f"{self.rate_hz} Hz; lower osr or rate_hz"
            )
        if not transfer_time_us(self.baud, DATA_WIRE_BYTES) < period_us:
            raise ValueError(f"StrapReaderSettings.baud = {self.baud}: too slow for {self.rate_hz} Hz; raise it")
        self.zone_limits(self.strap())

    def strap(self) -> Strap:
        """The strap these settings describe, for wheels without a calibration of their own."""
        return Strap(
            self.total_resistance_ohm, self.pull_down_a_ohm, self.pull_down_b_ohm, self.supply_v, self.inverted
        )

    def zone_limits(self, strap: Strap, curves: tuple[EndCurve, EndCurve] | None = None) -> ZoneLimits:
        """The levels of `contact_zone.locate` for `strap`, with calibrated `curves` if any; ValueError if unfit."""
        return ZoneLimits.of(
            strap,
            curves=curves,
            contact_level=self.contact_level,
            seam_level=self.seam_level,
            range_margin=self.range_margin,
            order_margin_rad=self.order_margin_rad,
            width_max_rad=self.width_max_rad,
        )
