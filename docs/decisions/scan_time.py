"""What the time of a scan is worth in angle: encoder interpolation, and the device's clock against time of receipt.

.venv/bin/python docs/decisions/scan_time.py
"""

import math
from typing import Any
from unittest import mock

import numpy as np

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from strap_sensor_driver.device_clock import DeviceClock, scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import DATA_WIRE_BYTES

WHEEL_SPEED = 2.0


def angle_error_deg() -> float:
    """Root mean square of theta_1 and theta_2 over 20 s of `mars_snag` at 2 rad/s."""
    plan = plan_run("mars_snag", "constant", duration_s=20.0)
    return summarize(plan, run_cores(plan)).angle_error_rms_deg


def newest_sample(encoder: Any, _stamp_ns: int) -> list[float] | None:
    return list(encoder._angles[-1]) if encoder._angles else None  # noqa: SLF001 - what an interpolation stands for


def with_newest_sample() -> float:
    """The same with the newest encoder sample in place of the position at the scan's time."""
    with mock.patch("strap_sensor_driver.strap_reader._Encoder.at", newest_sample):
        return angle_error_deg()


def clock_errors_ms(rng: np.random.Generator, drift_ppm: float) -> dict[str, tuple[float, float]]:
    """(mean, largest) error of the scan's time over 60 s: 200 Hz, receipt late by an exponential delay of 2 ms mean."""
    scan_us, transfer_us = scan_duration_us(4), transfer_time_us(115_200, DATA_WIRE_BYTES)
    clock = DeviceClock()
    device: list[float] = []
    receipt: list[float] = []
    for number in range(12_000):
        start_us = 5000 * number
        device_us = round(start_us * (1.0 + 1e-6 * drift_ppm)) + 123_456
        host_us = start_us + scan_us + transfer_us + rng.exponential(2000.0)
        middle_ns = clock.scan_middle_ns(device_us % 2**32, round(1000 * host_us), scan_us, transfer_us)
        if number >= 200:
            truth_us = start_us + 0.5 * scan_us
            device.append(abs(1e-3 * middle_ns - truth_us) * 1e-3)
            receipt.append(abs(host_us - truth_us) * 1e-3)
    return {name: (float(np.mean(x)), max(x)) for name, x in (("device clock", device), ("time of receipt", receipt))}


def main() -> None:
    print(f"encoder interpolated to the scan: {angle_error_deg():.2f} deg rms")
    print(f"newest encoder sample:            {with_newest_sample():.2f} deg rms")
    for drift_ppm in (0.0, 100.0, 1000.0):
        for name, (mean, largest) in clock_errors_ms(np.random.default_rng(1), drift_ppm).items():
            degrees = [math.degrees(1e-3 * ms * WHEEL_SPEED) for ms in (mean, largest)]
            print(
                f"{drift_ppm:6.0f} ppm, {name:16s} mean {mean:5.2f} ms, largest {largest:5.2f} ms "
                f"= {degrees[0]:.2f}, {degrees[1]:.2f} deg at {WHEEL_SPEED:g} rad/s"
            )


if __name__ == "__main__":
    main()
