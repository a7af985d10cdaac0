"""Calibration: measured counts in, `EndCalibration`s out. Three fits, each by itself.

`fit_inputs`: known resistors in place of the strap give the pull-down, and offset and gain of the converter's input.
`bench_fit`: a presser at known strap angles gives the table of both ends. `rolling_fit`: the wheel rolls over steady
ground, and the seam's passages make its encoder an angle measured on the strap (`seam_turns`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from strap_rover.arrays import FloatArray
from strap_sensor_driver.calibration import EndCalibration, StrapCalibration
from strap_sensor_driver.monotone_table import ArcSamples, MonotoneTable, fit_table
from strap_sensor_driver.seam_turns import SeamTurns, seam_turns, turn_samples
from strap_sensor_driver.strap import FULL_TURN_RAD, UNIFORM_VARIANCE

FULL_COUNT_10_BIT = 1024.0
TURNS_MIN = 3
"""Fewer turns do not tell an odd one from a good one."""
_ANGLES_MIN = 4
_OUTLIER_STDS = 6.0
_ODD_SCATTER = 4.0
"""Mean square of residuals over what is usual, from which on a turn is odd."""
_LEAST_SHARE = 1e-3
_STEADY_RATIO = 0.02
_ENCODER_SCALE_TOLERANCE = 0.05


class CalibrationError(ValueError):
    """The data cannot calibrate a strap; says why, and what to do."""


@dataclass(frozen=True, slots=True)
class InputFit:
    """One input of the board with its pull-down."""

    pull_down_ohm: float
    offset_lsb: float = 0.0
    gain: float = 1.0
    pull_down_std_ohm: float = 0.0
    offset_std_lsb: float = 0.0
    gain_std: float = 0.0
    residual_rms_lsb: float = 0.0

    @classmethod
    def of(cls, end: EndCalibration) -> "InputFit":
        """As a calibration has it."""
        return cls(end.pull_down_ohm, end.offset_lsb, end.gain)

    def ratio(self, counts: FloatArray, full_count: float) -> FloatArray:
        """Resistance of the path over the pull-down's from mean counts of a sample; infinite without contact."""
        share = (np.asarray(counts, dtype=np.float64) - self.offset_lsb) / (self.gain * full_count)
        return np.where(share > _LEAST_SHARE, 1.0 / np.maximum(share, _LEAST_SHARE) - 1.0, math.inf)

    def share_std(self, sample_std_lsb: float, full_count: float) -> float:
        """1-sigma of the share of the supply from that of a mean count."""
        return sample_std_lsb / (self.gain * full_count)


def fit_inputs(
    resistors_ohm: Sequence[float],
    counts: Sequence[float],
    *,
    full_count: float = FULL_COUNT_10_BIT,
    count_std: float = 0.3,
) -> InputFit:
    """Pull-down, offset and gain from mean counts with known resistors between the supply and the input.

    `math.inf` stands for nothing connected, 0 for a wire. A reading at either end of the range only says that the input
    is there or beyond. `count_std` is the 1-sigma of each mean count. CalibrationError with fewer than three different
    resistors, or when none of them is finite and above 0, or when the counts do not fit.
    """
    ohms = np.asarray(resistors_ohm, dtype=np.float64)
    seen = np.asarray(counts, dtype=np.float64)
    if ohms.shape != seen.shape or ohms.ndim != 1 or not np.isfinite(seen).all() or not (ohms >= 0.0).all():
        raise CalibrationError(f"resistors {ohms.tolist()}, counts {seen.tolist()}: give one count for each, ohms >= 0")
    between = ohms[np.isfinite(ohms) & (ohms > 0.0)]
    if np.unique(ohms).size < 3 or between.size == 0:
        raise CalibrationError(
            f"resistors {ohms.tolist()}: give three different ones at least, such as open, 470 kOhm and a wire"
        )

    def model(values: FloatArray) -> FloatArray:
        pull_down = math.exp(values[0])
        share = np.where(np.isfinite(ohms), pull_down / (pull_down + np.where(np.isfinite(ohms), ohms, 0.0)), 0.0)
        return np.asarray(np.clip(values[1] + values[2] * full_count * share, 0.0, full_count - 1.0))

    best = min(
        (
            least_squares(
                lambda values: (model(values) - seen) / count_std,
                (math.log(start), 0.5, 0.999),
                x_scale=(1.0, 1.0, 0.01),
            )
            for start in (0.3 * float(between.mean()), float(between.mean()), 3.0 * float(between.mean()))
        ),
        key=lambda found: float(found.cost),
    )
    rms = float(np.sqrt(np.mean((model(best.x) - seen) ** 2)))
    excess = max(1.0, 2.0 * float(best.cost) / max(ohms.size - 3, 1))
    stds = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)) * excess)
    if rms > 5.0 or not (abs(best.x[1]) <= 50.0 and 0.8 <= best.x[2] <= 1.2):
        raise CalibrationError(
            f"counts {seen.tolist()} for resistors {ohms.tolist()} ohm miss every divider by {rms:.1f} steps: check "
            "each resistor with an ohmmeter, and that it lies between the 5 V and this input"
        )
    pull_down = math.exp(best.x[0])
    return InputFit(
        pull_down, float(best.x[1]), float(best.x[2]), pull_down * float(stds[0]), float(stds[1]), float(stds[2]), rms
    )


@dataclass(frozen=True, slots=True, eq=False)
class EndResult:
    """One end, and how its samples lie about its table."""

    calibration: EndCalibration
    arc_rad: FloatArray
    """Arc of every sample, shape (N,)."""
    resistance_ohm: FloatArray
    residual_rad: FloatArray
    """Arc by the table less arc of the sample."""
    group: FloatArray
    """Number of the turn or angle that the sample belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class StrapFit:
    """Both ends of a strap as fitted."""

    method: str
    end_a: EndResult
    end_b: EndResult
    noise_lsb: float
    samples: int
    turns: int
    """Turns used, of the end with fewer; 0 on the bench."""
    rejected_turns: int
    width_rad: tuple[float, ...]
    """Of the zone at each passage of the seam."""
    strap_offset_rad: float | None
    """theta_n at encoder zero if the ground was level and hard, the zone symmetric about bottom dead centre."""
    strap_offset_std_rad: float
    """Scatter over passages [rad]; what a slope does to all of them is not in it."""

    def record(self, wheel: str, board: int, channel: int, created: str, firmware: str) -> StrapCalibration:
        """As it is kept, under the strap's name."""
        return StrapCalibration(
            wheel=wheel,
            board=board,
            channel=channel,
            method=self.method,
            created=created,
            firmware=firmware,
            samples=self.samples,
            noise_lsb=round(self.noise_lsb, 3),
            end_a=self.end_a.calibration,
            end_b=self.end_b.calibration,
        )


def bench_fit(
    angle_rad: FloatArray,
    count_a: FloatArray,
    count_b: FloatArray,
    *,
    width_rad: float,
    input_a: InputFit,
    input_b: InputFit,
    noise_lsb: float = 0.0,
    scans: int = 1,
    osr: int = 4,
    full_count: float = FULL_COUNT_10_BIT,
    angle_std_rad: float = math.radians(0.3),
) -> StrapFit:
    """Tables of both ends from mean counts with a presser of `width_rad` centred at known strap angles, shape (N,).

    Each mean is of `scans` scans of `osr` samples with `noise_lsb` 1-sigma. `angle_std_rad` is how well the presser is
    placed. CalibrationError with fewer than four angles, angles off the strap, or counts without contact.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    seen_a, seen_b = np.asarray(count_a, dtype=np.float64), np.asarray(count_b, dtype=np.float64)
    if not angle.shape == seen_a.shape == seen_b.shape or np.unique(angle).size < _ANGLES_MIN:
        raise CalibrationError(
            f"{np.unique(angle).size} angles: press at {_ANGLES_MIN} different ones or more, all round the strap"
        )
    low, high = angle - 0.5 * width_rad, angle + 0.5 * width_rad
    if width_rad < 0.0 or low.min() < 0.0 or high.max() > FULL_TURN_RAD:
        off = angle[(low < 0.0) | (high > FULL_TURN_RAD)]
        raise CalibrationError(
            f"presser of {math.degrees(width_rad):g} deg at {np.degrees(off).round(2).tolist()} deg reaches over the "
            "seam: press between both ends of the strap"
        )
    sample_std = _mean_std(noise_lsb, osr) / math.sqrt(scans) + math.sqrt(UNIFORM_VARIANCE) / osr
    ends = []
    for name, arcs, seen, at in (("A", low, seen_a, input_a), ("B", FULL_TURN_RAD - high, seen_b, input_b)):
        ratio = at.ratio(seen, full_count)
        silent = angle[~np.isfinite(ratio) | (ratio > 50.0)]
        if silent.size:
            raise CalibrationError(
                f"end {name} read 0 V with the presser at {np.degrees(silent).round(1).tolist()} deg: no contact, or "
                "its lead is off; press there again"
            )
        std = (1.0 + ratio) ** 2 * at.share_std(sample_std, full_count)
        groups = [
            ArcSamples(arcs[i : i + 1], ratio[i : i + 1], std[i : i + 1], np.full((1, 1), angle_std_rad**2))
            for i in range(arcs.size)
        ]
        ends.append(_end(name, groups, at))
    return StrapFit("bench", ends[0], ends[1], noise_lsb, int(angle.size), 0, 0, (), None, math.inf)


def rolling_fit(
    encoder_rad: FloatArray,
    count_a: FloatArray,
    count_b: FloatArray,
    direction: int,
    *,
    input_a: InputFit,
    input_b: InputFit,
    osr: int = 4,
    full_count: float = FULL_COUNT_10_BIT,
    turns_min: int = TURNS_MIN,
) -> StrapFit:
    """Tables of both ends from scans of a wheel that rolled over steady ground, in order of time, shape (N,) each.

    Counts are means of `osr` samples; `encoder_rad` is the wheel's angle at the middle of the scan, not wrapped.
    Forward, backward, or both; gaps and standing do no harm. CalibrationError says what is missing: turns, contact,
    a seam; or that strap and encoder contradict each other.
    """
    encoder = np.asarray(encoder_rad, dtype=np.float64)
    seen_a, seen_b = np.asarray(count_a, dtype=np.float64), np.asarray(count_b, dtype=np.float64)
    if direction not in (1, -1) or encoder.ndim != 1 or not encoder.shape == seen_a.shape == seen_b.shape:
        raise ValueError(
            f"encoder {encoder.shape}, counts {seen_a.shape} and {seen_b.shape}, direction {direction}: give one of "
            "each per scan, and +1 or -1"
        )
    known = np.isfinite(encoder) & np.isfinite(seen_a) & np.isfinite(seen_b)
    encoder, seen_a, seen_b = encoder[known], seen_a[known], seen_b[known]
    ratio_a, ratio_b = input_a.ratio(seen_a, full_count), input_b.ratio(seen_b, full_count)
    turns = seam_turns(direction * encoder, ratio_a, ratio_b)
    _check_turns(turns, encoder, ratio_a, ratio_b, turns_min)
    noise_lsb = _noise_lsb(seen_a, seen_b, osr)
    mean_std = _mean_std(noise_lsb, osr)
    ends = []
    used = []
    for name, mine, seam, at in (
        ("A", turns.turns_a, turns.seam_ratio_a, input_a),
        ("B", turns.turns_b, turns.seam_ratio_b, input_b),
    ):
        share_std = at.share_std(mean_std, full_count)
        contact = ArcSamples(
            np.zeros(1),
            np.maximum(np.array([np.median(seam)]), 0.0),
            np.array([share_std / math.sqrt(min(seam.size, 100)) + 0.3 / full_count]),
            np.zeros((1, 1)),
        )
        groups, odd = _without_odd([turn_samples(turn, turns.wander_var, share_std) for turn in mine], contact)
        used.append(len(groups))
        if len(groups) < turns_min:
            raise CalibrationError(
                f"only {len(groups)} of {len(mine)} turns agree: roll {turns_min + odd} turns and more over steadier "
                "ground"
            )
        ends.append(_end(name, [contact, *groups], at))
    offset, offset_std = _strap_offset(turns)
    return StrapFit(
        "rolling",
        ends[0],
        ends[1],
        noise_lsb,
        int(encoder.size),
        min(used),
        turns.rejected + len(turns.turns_a) + len(turns.turns_b) - sum(used),
        tuple(passage.width for passage in turns.passages if math.isfinite(passage.width)),
        offset,
        offset_std,
    )


def calibrate_rolling(
    encoder_rad: FloatArray,
    share_a: FloatArray,
    share_b: FloatArray,
    direction: int,
    *,
    pull_down_a_ohm: float,
    pull_down_b_ohm: float,
    wheel: str = "wheel",
    board: int = 0,
    channel: int = 0,
    created: str = "1970-01-01T00:00:00Z",
    firmware: str = "",
    osr: int = 4,
    full_count: float = FULL_COUNT_10_BIT,
) -> StrapCalibration:
    """A strap from encoder [rad] and shares V / V_DD of both ends by scan, shape (N,): `rolling_fit` for studies."""
    fit = rolling_fit(
        encoder_rad,
        full_count * np.asarray(share_a),
        full_count * np.asarray(share_b),
        direction,
        input_a=InputFit(pull_down_a_ohm),
        input_b=InputFit(pull_down_b_ohm),
        osr=osr,
        full_count=full_count,
    )
    return fit.record(wheel, board, channel, created, firmware)


def noise_of(counts: FloatArray, osr: int) -> float:
    """1-sigma noise of one sample [steps] in mean counts of `osr` samples, shape (N,), of an input that stays put."""
    if counts.size < 2:
        return 0.0
    return math.sqrt(max(osr * float(np.var(counts, ddof=1)) - UNIFORM_VARIANCE, 0.0))


def _noise_lsb(count_a: FloatArray, count_b: FloatArray, osr: int) -> float:
    """From how a scan differs from the mean of its neighbours, jumps left out."""
    bends = np.concatenate([np.diff(counts, n=2) for counts in (count_a, count_b)]) / math.sqrt(6.0)
    moving = bends[np.concatenate([np.abs(np.diff(c, n=2)) + (c[1:-1] < 1.0) * 1e9 for c in (count_a, count_b)]) < 1e8]
    if moving.size < 10:
        return 0.0
    limit = 5.0 * 1.4826 * float(np.median(np.abs(moving))) + 1.0
    inner = moving[np.abs(moving) < limit]
    return math.sqrt(max(osr * float(np.mean(inner**2)) - UNIFORM_VARIANCE, 0.0))


def _mean_std(noise_lsb: float, osr: int) -> float:
    """1-sigma of a mean of `osr` samples [steps]; rounding is not taken to average out without noise."""
    rounding = UNIFORM_VARIANCE / osr if noise_lsb >= 0.4 else UNIFORM_VARIANCE
    return math.sqrt(noise_lsb**2 / osr + rounding)


def _without_odd(groups: list[ArcSamples], contact: ArcSamples) -> tuple[list[ArcSamples], int]:
    """Without turns that lie about the table far worse than the others do, and samples that lie nowhere near it."""
    table = fit_table([contact, *groups])
    groups = [_cleaned(group, table) for group in groups]
    table = fit_table([contact, *groups])
    scatter = np.array(table.scatter[1:])
    good = scatter <= _ODD_SCATTER * max(1.0, float(np.median(scatter)))
    kept = [group for group, is_good in zip(groups, good.tolist(), strict=True) if is_good]
    return kept, len(groups) - len(kept)


def _cleaned(group: ArcSamples, table: MonotoneTable) -> ArcSamples:
    slope = np.gradient(table.ratio, table.arc_rad)
    expected = np.interp(group.arc_rad, table.arc_rad, table.ratio)
    spread = np.sqrt(group.ratio_std**2 + np.diag(group.arc_cov) * np.interp(group.arc_rad, table.arc_rad, slope) ** 2)
    off = np.abs(group.ratio - expected - np.median(group.ratio - expected))
    keep = off <= _OUTLIER_STDS * (spread + 1.4826 * float(np.median(off)))
    return ArcSamples(group.arc_rad[keep], group.ratio[keep], group.ratio_std[keep], group.arc_cov[np.ix_(keep, keep)])


def _end(name: str, groups: Sequence[ArcSamples], at: InputFit) -> EndResult:
    try:
        table = fit_table(groups)
    except ValueError as error:
        raise CalibrationError(
            f"end {name}: {error}: are its lead and the strap whole, and ends A and B not swapped?"
        ) from error
    arcs = np.concatenate([group.arc_rad for group in groups])
    ratios = np.concatenate([group.ratio for group in groups])
    try:
        calibration = EndCalibration(
            pull_down_ohm=round(at.pull_down_ohm, 1),
            offset_lsb=round(at.offset_lsb, 3),
            gain=round(at.gain, 6),
            resistance_ohm=tuple((table.ratio * round(at.pull_down_ohm, 1)).round(1).tolist()),
            arc_rad=tuple((np.floor(1e6 * table.arc_rad) * 1e-6).round(6).tolist()),
            arc_std_rad=tuple(table.arc_std_rad.round(6).tolist()),
            residual_rms_rad=round(table.residual_rms_rad, 6),
        )
    except ValueError as error:
        raise CalibrationError(f"end {name}: {error}") from error
    numbers = np.concatenate([np.full(group.arc_rad.size, float(i)) for i, group in enumerate(groups)])
    return EndResult(calibration, arcs, ratios * at.pull_down_ohm, np.concatenate(table.residuals_rad), numbers)


def _check_turns(
    turns: SeamTurns, encoder: FloatArray, ratio_a: FloatArray, ratio_b: FloatArray, turns_min: int
) -> None:
    """CalibrationError when these scans cannot calibrate a strap."""
    ask = f"roll {turns_min + 1} turns or more over steady ground"
    if encoder.size < 50:
        raise CalibrationError(f"{encoder.size} scans with an encoder position: {ask}, with the board and encoder on")
    turned = float(np.ptp(encoder)) / FULL_TURN_RAD
    if turned < 1.0:
        raise CalibrationError(f"the wheel turned by {turned:.2f} of a turn, by its encoder: {ask}")
    touching = np.isfinite(ratio_a) & np.isfinite(ratio_b)
    if touching.mean() < 0.2:
        silent = [name for name, ratio in (("A", ratio_a), ("B", ratio_b)) if np.isfinite(ratio).mean() < 0.2]
        raise CalibrationError(
            f"end {' and '.join(silent)} read 0 V while the wheel turned: put it on the ground, check leads and supply"
        )
    for name, ratio in (("A", ratio_a), ("B", ratio_b)):
        spread = float(np.ptp(np.percentile(ratio[np.isfinite(ratio)], [5.0, 95.0])))
        if spread < _STEADY_RATIO:
            raise CalibrationError(
                f"end {name} did not change while the wheel turned {turned:.1f} turns: stuck input or a short, see "
                "its lead"
            )
    if not turns.passages:
        raise CalibrationError(
            f"the seam (both ends at the supply) never passed in {turned:.1f} turns: {ask}; check leads and strap"
        )
    if turns.sense < 0.0:
        raise CalibrationError(
            "the zone runs against the wheel: ends A and B are swapped, or strap_direction or the encoder has the "
            "wrong sign; mend that, then calibrate"
        )
    off = turns.interval_rad / FULL_TURN_RAD - 1.0
    if abs(off) > _ENCODER_SCALE_TOLERANCE:
        raise CalibrationError(
            f"the seam comes round every {turns.interval_rad:.2f} rad of the encoder, not every 6.28: give "
            "wheel_states in rad of the wheel, behind the gears; or the ground is too uneven"
        )
    found = min(len(turns.turns_a), len(turns.turns_b))
    if found < turns_min:
        rejected = f" ({turns.rejected} left out, since the zone moved in them)" if turns.rejected else ""
        raise CalibrationError(f"{found} turns between passages of the seam{rejected}, of {turns_min} needed: {ask}")


def _strap_offset(turns: SeamTurns) -> tuple[float | None, float]:
    """theta_n at encoder zero: the seam stands at bottom dead centre in the middle of its passage.

    Travel has the direction in it already: theta_n = offset - direction x encoder = offset - travel.
    """
    middles = np.array([0.5 * (p.enters + p.leaves) for p in turns.passages if math.isfinite(p.width)])
    if middles.size == 0:
        return None, math.inf
    east, north = float(np.mean(np.cos(middles))), float(np.mean(np.sin(middles)))
    offset = (math.atan2(north, east) + 1.5 * math.pi) % FULL_TURN_RAD
    return offset, math.sqrt(max(-2.0 * math.log(max(math.hypot(east, north), 1e-9)), 0.0))
