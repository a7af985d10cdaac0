"""What the time of a scan is worth in angle: encoder interpolation, and the device's clock against other ways.

.venv/bin/python docs/decisions/scan_time.py
"""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any
from unittest import mock

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from strap_sensor_driver.device_clock import DeviceClock, scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import DATA_WIRE_BYTES

WHEEL_SPEED = 2.0
SCAN_US, TRANSFER_US = scan_duration_us(4), transfer_time_us(115_200, DATA_WIRE_BYTES)
PERIOD_US = 5000
FRAMES, WARM_UP = 12_000, 400
SEEDS = range(10)
PPM = (-3000, -1000, 0, 1000, 3000)
Delay = Callable[[Any, np.random.Generator], Any]


def angle_error_deg() -> float:
    """Root mean square of theta_1 and theta_2 over 20 s of `mars_snag` at 2 rad/s."""
    plan = plan_run("mars_snag", "constant", duration_s=20.0)
    return summarize(plan, run_cores(plan)).angle_error_rms_deg


def newest_sample(encoder: Any, _stamp_ns: int) -> list[float] | None:
    return list(encoder._angles[-1]) if encoder._angles else None  # noqa: SLF001 - what an interpolation stands for


def with_newest_sample() -> float:
    """The same with the newest encoder sample in place of the position at the scan's time."""
    with mock.patch("strap_sensor_driver.encoder_track.EncoderTrack.at", newest_sample):
        return angle_error_deg()


def prompt(arrival_us: Any, _rng: np.random.Generator) -> Any:
    return arrival_us


def usb(arrival_us: Any, rng: np.random.Generator) -> Any:
    """Up to 1 ms late, one in a hundred 10 ms more, in order."""
    late_us = rng.uniform(0.0, 1e3, len(arrival_us)) + 1e4 * (rng.random(len(arrival_us)) < 0.01)
    return np.maximum.accumulate(arrival_us + late_us)


def batches(arrival_us: Any, rng: np.random.Generator) -> Any:
    """Read every 16 ms."""
    first_us = rng.uniform(0.0, 16e3)
    return np.ceil((arrival_us - first_us) / 16e3) * 16e3 + first_us


def late_batches(arrival_us: Any, rng: np.random.Generator) -> Any:
    return batches(np.maximum.accumulate(arrival_us + 1e4 * (rng.random(len(arrival_us)) < 0.01)), rng)


LINKS: dict[str, Delay] = {"prompt": prompt, "usb": usb, "16 ms reads": batches, "16 ms, 1 % late": late_batches}


def frames(delay: Delay, ppm: Any, rng: np.random.Generator) -> tuple[Any, Any, Any]:
    """(device time, time of receipt, true middle) [us]; the board's clock is `ppm` fast, one number or one per scan."""
    device_us = PERIOD_US * np.arange(FRAMES) + rng.integers(0, PERIOD_US)
    passed_us = PERIOD_US / (1.0 + 1e-6 * np.broadcast_to(np.asarray(ppm, dtype=float), FRAMES))
    start_us = np.concatenate([[0.0], np.cumsum(passed_us)[:-1]]) + rng.uniform(1e6, 1e6 + PERIOD_US)
    return device_us, delay(start_us + SCAN_US + TRANSFER_US, rng), start_us + 0.5 * SCAN_US


def by_line(device_us: Any, host_us: Any) -> Any:
    clock = DeviceClock()
    return 1e-3 * np.array(
        [
            clock.scan_middle_ns(t_us, host_ns, SCAN_US, TRANSFER_US)
            for t_us, host_ns in zip(device_us.tolist(), np.rint(1e3 * host_us).astype(int).tolist(), strict=True)
        ]
    )


def by_least_of_a_second(device_us: Any, host_us: Any) -> Any:
    """Least offset of the last second, as if the rate were true."""
    offset_us = np.concatenate([np.full(199, np.inf), host_us - device_us])
    return sliding_window_view(offset_us, 200).min(axis=1) + device_us - TRANSFER_US - 0.5 * SCAN_US


def by_receipt(_device_us: Any, host_us: Any) -> Any:
    return host_us - TRANSFER_US - 0.5 * SCAN_US


WAYS = {"line of 10 s": by_line, "least of 1 s": by_least_of_a_second, "time of receipt": by_receipt}


def errors_ms(way: Callable[[Any, Any], Any], delay: Delay, ppm: Any, seed: int) -> Any:
    device_us, host_us, middle_us = frames(delay, ppm, np.random.default_rng(seed))
    return 1e-3 * np.abs(way(device_us, host_us) - middle_us)


def worst(way: Callable[[Any, Any], Any], delay: Delay, ppm: Any, seeds: Sequence[int] = SEEDS) -> tuple[float, float]:
    """Worst (mean, largest) error of `seeds` [ms] after 2 s."""
    runs = [errors_ms(way, delay, ppm, seed)[WARM_UP:] for seed in seeds]
    return max(float(run.mean()) for run in runs), max(float(run.max()) for run in runs)


def print_clocks() -> None:
    print("mean / largest error in ms after 2 s, worst of ten runs")
    for link, delay in LINKS.items():
        for ppm in PPM:
            cells = [
                f"{name} {mean:6.3f} / {most:6.3f}" for name in WAYS for mean, most in [worst(WAYS[name], delay, ppm)]
            ]
            start = max(float(errors_ms(by_line, delay, ppm, seed)[:WARM_UP].mean()) for seed in SEEDS)
            off_s = max(0.005 * (errors_ms(by_line, delay, ppm, seed)[:WARM_UP] > 1.5).sum() for seed in SEEDS)
            print(
                f"{link:15s} {ppm:6d} ppm  {'   '.join(cells)}   first 2 s {start:.2f}, over 1.5 ms for {off_s:.3f} s"
            )
    for ppm in (10, 30, 100, 300):
        print(f"16 ms reads     {ppm:6d} ppm  line of 10 s {worst(by_line, batches, ppm)}")
    bent = np.where(np.arange(FRAMES) < FRAMES // 2, 0.0, 1.0)
    for ppm in (-500.0, 500.0):
        print(f"usb, rate changes by {ppm} ppm: line of 10 s {worst(by_line, usb, ppm * bent)}")
    device_us, host_us, _ = frames(usb, 1000, np.random.default_rng(1))
    begin = time.perf_counter()
    by_line(device_us, host_us)
    print(f"{1e6 * (time.perf_counter() - begin) / FRAMES:.1f} us per frame")


def main() -> None:
    print_clocks()
    print(f"1 ms at {WHEEL_SPEED:g} rad/s is {math.degrees(1e-3 * WHEEL_SPEED):.2f} deg")
    print(f"encoder interpolated to the scan: {angle_error_deg():.2f} deg rms")
    print(f"newest encoder sample:            {with_newest_sample():.2f} deg rms")


if __name__ == "__main__":
    main()
