"""A strap board without hardware: true contact arcs in, the very bytes of the firmware out.

The divider gives the volts; a 10-bit converter with the supply as its reference rounds to the nearest of 1024 codes
(1024 V/Vref, at most 1023; first transition at half a step: ATmega328P data sheet, conversion result and accuracy);
`osr` samples, each with its own Gaussian noise, are summed per input.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from sim_bridge.painted_strap import FULL_COUNT, PaintedStrap
from strap_sensor_driver.device_clock import scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import (
    CHANNELS,
    DATA_WIRE_BYTES,
    PROTOCOL,
    DataFrame,
    HelloFrame,
    encode_data,
    encode_hello,
)
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

POWER_ON_RESET: Final = 1
WATCHDOG_RESET: Final = 8
_HELLO_PERIOD_US = 1_000_000
_VERSION = "virtual-1"


class VirtualUno:
    """One board with three straps. ValueError for straps, osr, rate or noise that no such board can have.

    `rng` is the board's own generator: one scan draws 6 x osr normals from it.
    """

    __slots__ = (
        "_asked",
        "_frame_us",
        "_hello_us",
        "_noise_lsb",
        "_reset_cause",
        "_rng",
        "_seq",
        "_straps",
        "_vref_mv",
        "board_id",
        "osr",
    )

    def __init__(
        self,
        board_id: int,
        straps: Sequence[Strap | PaintedStrap],
        *,
        osr: int = 4,
        noise_lsb: float = 0.5,
        rate_hz: float = 200.0,
        rng: np.random.Generator,
    ) -> None:
        if not 0 <= board_id <= 255:
            raise ValueError(f"board_id = {board_id}: must fit one byte, 0..255")
        painted = [strap if isinstance(strap, PaintedStrap) else PaintedStrap.perfect(strap) for strap in straps]
        if len(painted) * 2 != CHANNELS or len({strap.nominal.supply_v for strap in painted}) != 1:
            raise ValueError(f"{len(straps)} straps: a board reads three straps on one supply; repeat one for a spare")
        if not (1 <= osr <= 64 and rate_hz > 0.0 and scan_duration_us(osr) < 1e6 / rate_hz):
            raise ValueError(
                f"osr = {osr} at {rate_hz} Hz: 1..64 samples, and the scan ({scan_duration_us(osr)} us) must fit; "
                "lower one of them"
            )
        if not noise_lsb >= 0.0:
            raise ValueError(f"noise_lsb = {noise_lsb}: a standard deviation in converter steps, 0 or more")
        self.board_id = board_id
        self.osr = osr
        self._straps = painted
        self._vref_mv = round(1e3 * painted[0].nominal.supply_v)
        self._noise_lsb = noise_lsb
        self._frame_us = round(1e6 / rate_hz)
        self._rng = rng
        self.restart(POWER_ON_RESET)

    def restart(self, reset_cause: int = WATCHDOG_RESET) -> None:
        """Boot: sequence from 0, HELLO first. The caller starts device time anew as well."""
        self._reset_cause = reset_cause
        self._seq = 0
        self._asked = True
        self._hello_us = 0

    @property
    def period_us(self) -> int:
        """Scan period [us]."""
        return self._frame_us

    def latency_us(self, baud: int = 115_200) -> int:
        """From the scan's start until the last byte of its DATA frame has arrived [us]."""
        return scan_duration_us(self.osr) + transfer_time_us(baud, DATA_WIRE_BYTES)

    def middle_us(self) -> int:
        """From the scan's start to its middle [us]: the moment whose arcs `scan` wants."""
        return scan_duration_us(self.osr) // 2

    def feed(self, data: bytes) -> None:
        """Bytes from the driver: `?` asks for a HELLO, which goes out before the next scan; others are ignored."""
        self._asked = self._asked or b"?" in data

    def scan(self, device_us: int, beta_1: Sequence[float], beta_2: Sequence[float], contact: Sequence[bool]) -> bytes:
        """Wire bytes of one scan started at `device_us` (any integer, sent modulo 2^32), a due HELLO first.

        Arcs are strap angles [rad], three of each; beta_1 > beta_2 means the arc covers the seam: both ends then
        read the supply. No contact, or an arc of no width: both read 0 V. ValueError for angles outside [0, 2 pi].
        """
        shares: list[float] = []
        for strap, first, second, touches in zip(self._straps, beta_1, beta_2, contact, strict=True):
            if not (0.0 <= first <= FULL_TURN_RAD and 0.0 <= second <= FULL_TURN_RAD):
                raise ValueError(f"arc [{first}, {second}] rad: strap angles lie in [0, 2 pi]; wrap them first")
            shares += strap.shares(first, second, touches)
        return self.scan_shares(device_us, shares)

    def scan_shares(self, device_us: int, shares: Sequence[float]) -> bytes:
        """As `scan`, from the volts themselves: V/V_DD of the six inputs, A0 B0 A1 B1 A2 B2; the converter clips."""
        counts = [FULL_COUNT * share for share in shares]
        samples = self._rng.standard_normal((self.osr, CHANNELS))
        samples *= self._noise_lsb
        samples += counts
        np.rint(samples, out=samples)
        np.minimum(samples, FULL_COUNT - 1, out=samples)
        np.maximum(samples, 0.0, out=samples)
        sums = tuple([int(total) for total in samples.sum(axis=0).tolist()])
        greeting = self._greeting(device_us)
        frame = DataFrame(self.board_id, self._seq, device_us & 0xFFFFFFFF, 0, self.osr, sums)
        self._seq = (self._seq + 1) & 0xFFFF
        return greeting + encode_data(frame)

    def _greeting(self, device_us: int) -> bytes:
        if not self._asked and device_us - self._hello_us < _HELLO_PERIOD_US:
            return b""
        self._asked = False
        self._hello_us = device_us
        return encode_hello(
            HelloFrame(
                board_id=self.board_id,
                seq=self._seq,
                t_us=device_us & 0xFFFFFFFF,
                proto=PROTOCOL,
                channels=CHANNELS,
                osr=self.osr,
                adc_bits=10,
                vref_mv=self._vref_mv,
                frame_us=self._frame_us,
                reset_cause=self._reset_cause,
                flags=0,
                version=_VERSION,
            )
        )
