"""What a calibrated strap is worth in angle: table against line against nothing, bench against rolling.

.venv/bin/python docs/decisions/calibration.py
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from strap_sensor_driver.calibration_fit import InputFit, StrapFit, bench_fit, rolling_fit
from strap_sensor_driver.end_curve import EndCurve
from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, FULL_TURN_RAD, strap_resistance_ohm

R_STR = strap_resistance_ohm(0.25)
PULL_DOWN = BEST_PULL_DOWN_RATIO * R_STR
FULL, OSR, RATE_HZ = 1024, 4, 200.0
STRAPS = range(20)
ENTRY, EXIT = math.radians(35.0), math.radians(-20.0)


class TrueStrap(NamedTuple):
    """Resistance per arc 5 % off nominal, and 5 % (rms) uneven in three slow waves; contact and lead beside it."""

    off: float
    waves: Any
    phases: Any
    contact_a: float
    contact_b: float

    def resistance(self, beta: Any) -> Any:
        """From end A to strap angle beta [ohm]."""
        beta = np.asarray(beta)[..., None]
        orders = np.arange(1, self.waves.size + 1)
        bulge = np.sum(self.waves / orders * (np.sin(orders * beta + self.phases) - np.sin(self.phases)), axis=-1)
        return R_STR * self.off / FULL_TURN_RAD * (beta[..., 0] + bulge)

    def shares(self, beta_1: Any, beta_2: Any) -> tuple[Any, Any]:
        """V / V_DD at both ends."""
        r_a = self.contact_a + self.resistance(beta_1)
        r_b = self.contact_b + self.resistance(FULL_TURN_RAD) - self.resistance(beta_2)
        return PULL_DOWN / (PULL_DOWN + r_a), PULL_DOWN / (PULL_DOWN + r_b)


def true_strap(rng: Any, off: float = 0.05, uneven: float = 0.05) -> TrueStrap:
    waves = rng.normal(size=3)
    waves *= uneven * math.sqrt(2.0) / np.linalg.norm(waves)
    contact = rng.uniform(200.0, 2000.0, 2)
    return TrueStrap(1.0 + rng.choice([-off, off]), waves, rng.uniform(0, FULL_TURN_RAD, 3), *contact)


def counts(share: Any, rng: Any, noise_lsb: float = 1.0, osr: int = OSR) -> Any:
    """Mean counts of `osr` samples."""
    samples = FULL * np.asarray(share)[..., None] + noise_lsb * rng.standard_normal((*np.shape(share), osr))
    return np.clip(np.rint(samples), 0, FULL - 1).mean(axis=-1)


class Roll(NamedTuple):
    """Scans of a roll, and what they were of."""

    encoder: Any
    count_a: Any
    count_b: Any
    beta_1: Any
    beta_2: Any
    in_zone: Any


def roll(
    strap: TrueStrap, rng: Any, turns: float = 5.5, speed: float = 1.0, wander_deg: float = 0.0, direction: int = 1
) -> Roll:
    """A wheel rolled over ground on which both zone ends wander by `wander_deg` (1-sigma) within 1 rad."""
    size = int(turns * FULL_TURN_RAD / abs(speed) * RATE_HZ)
    encoder = rng.uniform(-5, 5) + np.arange(size) * speed / RATE_HZ
    front, rear = ENTRY + wander(rng, encoder, wander_deg), EXIT + wander(rng, encoder, wander_deg)
    offset = rng.uniform(0.0, FULL_TURN_RAD)
    theta_n = offset - direction * encoder
    of_front = np.mod(direction * front - theta_n + 1.5 * math.pi, FULL_TURN_RAD)
    of_rear = np.mod(direction * rear - theta_n + 1.5 * math.pi, FULL_TURN_RAD)
    beta_1, beta_2 = (of_rear, of_front) if direction == 1 else (of_front, of_rear)
    in_zone = beta_1 < beta_2
    share_a, share_b = strap.shares(np.where(in_zone, beta_1, 0.0), np.where(in_zone, beta_2, FULL_TURN_RAD))
    return Roll(encoder, counts(share_a, rng), counts(share_b, rng), beta_1, beta_2, in_zone)


def wander(rng: Any, encoder: Any, std_deg: float) -> Any:
    keep = math.exp(-abs(encoder[1] - encoder[0]))
    kicks = math.sqrt(1.0 - keep * keep) * rng.standard_normal(encoder.size)
    kicks[0] = rng.standard_normal()
    return math.radians(std_deg) * lfilter([1.0], [1.0, -keep], kicks)


def fit_roll(rolled: Roll, direction: int = 1) -> StrapFit:
    at = InputFit(PULL_DOWN)
    return rolling_fit(rolled.encoder, rolled.count_a, rolled.count_b, direction, input_a=at, input_b=at)


def fit_bench(strap: TrueStrap, rng: Any, step_deg: float = 20.0, place_deg: float = 0.3) -> StrapFit:
    """A presser 10 deg wide every `step_deg`, placed as well as `place_deg`, 100 scans each."""
    width = math.radians(10.0)
    asked = np.radians(np.arange(10.0, 351.0, step_deg))
    placed = np.clip(
        asked + math.radians(place_deg) * rng.standard_normal(asked.size), 0.5 * width, FULL_TURN_RAD - 0.5 * width
    )
    share_a, share_b = strap.shares(placed - 0.5 * width, placed + 0.5 * width)
    count_a, count_b = (counts(np.repeat(s[:, None], 100, axis=1), rng).mean(axis=1) for s in (share_a, share_b))
    at = InputFit(PULL_DOWN)
    return bench_fit(
        asked,
        count_a,
        count_b,
        width_rad=width,
        input_a=at,
        input_b=at,
        noise_lsb=1.0,
        scans=100,
        angle_std_rad=math.radians(place_deg),
    )


def line_of(fit: StrapFit) -> tuple[EndCurve, EndCurve]:
    """Only R_str and contact resistance fitted to the same samples, by least squares of arcs."""
    curves = []
    for end in (fit.end_a, fit.end_b):
        slope, contact = least_squares(
            lambda v, end=end: (end.resistance_ohm - v[1] * 1e3) / (v[0] * R_STR / FULL_TURN_RAD) - end.arc_rad,
            (1.0, 1.0),
            bounds=((0.1, 0.0), (10.0, 500.0)),
        ).x
        ends = np.array([contact * 1e3, contact * 1e3 + slope * R_STR]) / PULL_DOWN
        curves.append(EndCurve(tuple(ends.tolist()), (0.0, FULL_TURN_RAD), (0.0, 0.0)))
    return curves[0], curves[1]


def errors(curves: tuple[EndCurve, EndCurve], rolled: Roll) -> tuple[Any, Any]:
    """Errors of both angles [rad], and the 1-sigma claimed for them."""
    share_std = math.sqrt((1.0 + 1.0 / 12.0) / OSR) / FULL
    error, sigma = [], []
    for curve, seen, arc in (
        (curves[0], rolled.count_a, rolled.beta_1),
        (curves[1], rolled.count_b, FULL_TURN_RAD - rolled.beta_2),
    ):
        ratio = FULL / seen[rolled.in_zone] - 1.0
        knots, arcs = np.array(curve.ratio), np.array(curve.arc_rad)
        slope = np.diff(arcs) / np.diff(knots)
        place = np.clip(np.searchsorted(knots, ratio, side="right") - 1, 0, slope.size - 1)
        answer = np.clip(arcs[place] + slope[place] * (ratio - knots[place]), arcs[0], FULL_TURN_RAD)  # `EndCurve.at`
        error.append(answer - arc[rolled.in_zone])
        table_std = np.interp(ratio, knots, np.array(curve.arc_std_rad))
        sigma.append(np.hypot(slope[place] * (1.0 + ratio) ** 2 * share_std, table_std))
    return np.concatenate(error), np.concatenate(sigma)


def curves_of(fit: StrapFit) -> tuple[EndCurve, EndCurve]:
    return fit.end_a.calibration.curve(), fit.end_b.calibration.curve()


UNCALIBRATED = (EndCurve.uniform(R_STR / PULL_DOWN),) * 2


def main() -> None:
    ways = {
        "not calibrated": lambda _strap, _rng: UNCALIBRATED,
        "bench, 18 angles placed to 0.3 deg": lambda strap, rng: curves_of(fit_bench(strap, rng)),
        "bench, 35 angles placed to 0.3 deg": lambda strap, rng: curves_of(fit_bench(strap, rng, 10.0)),
        "bench, 18 angles placed to 1 deg": lambda strap, rng: curves_of(fit_bench(strap, rng, 20.0, 1.0)),
        "rolling, 5 turns, 1 rad/s": lambda strap, rng: curves_of(fit_roll(roll(strap, rng))),
        "rolling, 5 turns, 2 rad/s": lambda strap, rng: curves_of(fit_roll(roll(strap, rng, speed=2.0))),
        "rolling, 5 turns, ends wander 1 deg": lambda s, rng: curves_of(fit_roll(roll(s, rng, wander_deg=1.0))),
        "rolling, 20 turns, ends wander 1 deg": lambda s, rng: curves_of(fit_roll(roll(s, rng, 20.5, wander_deg=1.0))),
        "rolling, 5 turns, ends wander 2 deg": lambda s, rng: curves_of(fit_roll(roll(s, rng, wander_deg=2.0))),
        "R_str and contact only, rolling, 5 turns": lambda strap, rng: line_of(fit_roll(roll(strap, rng))),
        "R_str and contact only, bench, 18 angles": lambda strap, rng: line_of(fit_bench(strap, rng)),
    }
    print("| calibration | rms error | worst strap | largest error | normalised error | of single straps |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, way in ways.items():
        rms, worst, scores = [], 0.0, []
        for seed in STRAPS:
            rng = np.random.default_rng(seed)
            strap = true_strap(rng)
            curves = way(strap, rng)
            error, sigma = errors(curves, roll(strap, rng, 3.0))
            rms.append(float(np.sqrt(np.mean(error**2))))
            worst = max(worst, float(np.abs(error).max()))
            scores.append(float(np.sqrt(np.mean((error / sigma) ** 2))))
        rms_deg = np.degrees(rms)
        print(
            f"| {name} | {np.sqrt(np.mean(rms_deg**2)):.2f} deg | {rms_deg.max():.2f} | {math.degrees(worst):.1f} | "
            f"{np.sqrt(np.mean(np.square(scores))):.2f} | {min(scores):.2f} .. {max(scores):.2f} |"
        )


if __name__ == "__main__":
    main()
