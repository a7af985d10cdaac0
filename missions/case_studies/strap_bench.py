"""Appendix B on a bench of our own: resistance against angle, thickness, repeatability; then what calibration is worth.

The source paper draws a strap with a pencil and measures its resistance against the angle of contact with a
multimeter: it grows with the angle, falls with the number of layers, and a strap must be measured once before use (no
numbers are printed). Here straps are painted with flaws drawn from a seed (`sim_bridge.painted_strap`), and everything
goes through converter, frames and the reader of the rover. Part two drives straps that are R_str 5 % off and 5 %
non-uniform over full turns, with 1 LSB of noise, uncalibrated and calibrated in several ways; since they were
calibrated, their resistance has drifted by half a per cent (1-sigma), as the reader is told.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.strap_rig import Ground, Mounted, Record, StrapRig
from missions.stop_request import never
from sim_bridge.painted_strap import FULL_COUNT, PaintedStrap, StrapFlaws, paint
from strap_rover.arrays import FloatArray
from strap_sensor_driver.calibration import StrapCalibration
from strap_sensor_driver.calibration_fit import InputFit, bench_fit, calibrate_rolling
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.mounting import StrapMounting, wrap
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap import FULL_TURN_RAD

STUDY_SEED = 20200501
LAYERS = (1, 2, 3, 4)
INTENDED_LAYERS = 2
ANGLES_RAD = np.radians(np.arange(15.0, 360.0, 15.0))
REPEATS = 10
PRESSER_RAD = math.radians(2.0)
PRESSER_STD_RAD = math.radians(0.3)
"""How well a person puts the presser at an angle, 1-sigma."""
NOISE_LSB = 1.0
SCANS = 100
"""Scans that one press is averaged over."""
FLAWS = StrapFlaws(
    strap_resistance_error=0.05,
    strap_nonuniformity=0.05,
    strap_contact_ohm=300.0,
    strap_lead_ohm=50.0,
    pull_down_error=0.01,
    adc_offset_lsb=1.0,
    adc_gain_error=0.001,
)
DRIFT_STD = 0.005
"""Of R_str since calibration, 1-sigma, relative: ten kelvin, on graphite."""
SPEED_RADPS = 1.0
CALIBRATION_TURNS, TEST_TURNS = 10, 6
GROUND = Ground(wander_rad=math.radians(1.0), wander_over_rad=1.0)
STEADY = Ground(wander_rad=math.radians(0.3), wander_over_rad=1.0)
"""Where one calibrates: firm and level."""
RMS_LIMIT_DEG, PREDICTED_LIMIT_DEG = 1.0, 2.0
NEES_LIMITS = (0.8, 1.2)
"""Root mean square of error over its claimed 1-sigma."""
NEES_STRAPS = 10
"""With fewer straps it is not judged: each has one calibration error, whatever the number of its records."""
_OSR = 4


@dataclass(frozen=True, slots=True)
class Layering:
    """Resistance against angle of a strap of some layers."""

    layers: int
    angle_deg: tuple[float, ...]
    resistance_ohm: tuple[float, ...]
    """Of the path from end A, mean of the repeats."""
    repeat_std_deg: float
    """Scatter of one press, as angle: presser, noise, rounding."""
    is_monotone: bool
    full_turn_ohm: float


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What one way of calibrating is worth, over all straps and full turns."""

    way: str
    straps: int
    records: int
    """Measured ones."""
    rms_deg: float | None
    """None where nothing was measured: every angle was refused as a fault."""
    worst_strap_rms_deg: float | None
    normalised: float | None
    """rms of error over claimed 1-sigma."""
    predicted_share: float
    predicted_rms_deg: float | None
    predicted_normalised: float | None
    fault_share: float
    law_rms_deg: float
    """Of the divider law with the nominal strap, on the same scans of the first strap: no status, no calibration."""
    law_worst_rms_deg: float


def layerings(source: np.random.SeedSequence) -> list[Layering]:
    """One strap painted with more and more layers, pressed at known angles again and again."""
    settings = StrapReaderSettings()
    rng = np.random.default_rng(source.spawn(1)[0])
    results = []
    for layers in LAYERS:
        flaws = replace(FLAWS, strap_thickness=layers / INTENDED_LAYERS)
        strap = paint(settings.strap(), flaws, source)  # the same source: the same layer, thicker
        pressed = np.array([[_press(strap, angle, rng)[0] for angle in ANGLES_RAD] for _ in range(REPEATS)])
        ohm = settings.pull_down_a_ohm * (FULL_COUNT / pressed - 1.0)
        mean = ohm.mean(axis=0)
        per_rad = np.gradient(mean, ANGLES_RAD)
        results.append(
            Layering(
                layers,
                tuple(np.degrees(ANGLES_RAD).round(3).tolist()),
                tuple(mean.round(1).tolist()),
                round(math.degrees(float(np.sqrt(np.mean((ohm.std(axis=0, ddof=1) / per_rad) ** 2)))), 4),
                bool((np.diff(mean) > 0.0).all()),
                round(float(np.polyval(np.polyfit(ANGLES_RAD, mean, 1), FULL_TURN_RAD)), 1),
            )
        )
    return results


def _press(strap: PaintedStrap, angle_rad: float, rng: np.random.Generator) -> tuple[float, float]:
    """Mean counts of both ends with the presser near an angle, as the board would sum them."""
    at = angle_rad + PRESSER_STD_RAD * float(rng.standard_normal())
    shares = np.array(strap.shares(at - 0.5 * PRESSER_RAD, at + 0.5 * PRESSER_RAD))
    samples = np.rint(FULL_COUNT * shares + NOISE_LSB * rng.standard_normal((SCANS * _OSR, 2)))
    a, b = np.clip(samples, 0.0, FULL_COUNT - 1).mean(axis=0).tolist()
    return a, b


def bench_calibration(strap: PaintedStrap, rng: np.random.Generator) -> StrapCalibration:
    """As a person would do it: a press every 15 deg, pull-downs measured with an ohmmeter."""
    settings = StrapReaderSettings()
    pressed = np.array([_press(strap, angle, rng) for angle in ANGLES_RAD])
    true = (strap.gain_a_rad / settings.strap().gain_a_rad, strap.gain_b_rad / settings.strap().gain_b_rad)
    fit = bench_fit(
        ANGLES_RAD,
        pressed[:, 0],
        pressed[:, 1],
        width_rad=PRESSER_RAD,
        input_a=InputFit(settings.pull_down_a_ohm * true[0]),
        input_b=InputFit(settings.pull_down_b_ohm * true[1]),
        noise_lsb=NOISE_LSB,
        scans=SCANS,
        osr=_OSR,
        angle_std_rad=PRESSER_STD_RAD,
    )
    return fit.record("wheel", 1, 1, "2020-01-01T00:00:00+00:00", "bench")


def rolling_calibration(
    strap: PaintedStrap, mounting: StrapMounting, settings: StrapReaderSettings, source: np.random.SeedSequence
) -> StrapCalibration:
    """From turns over firm ground; nothing but nominal pull-downs is known of the strap."""
    rig = StrapRig([Mounted(strap, mounting)], settings, NOISE_LSB, source, STEADY)
    rig.keeps_scans = True
    rig.speed_radps = SPEED_RADPS
    rig.run(CALIBRATION_TURNS * FULL_TURN_RAD / SPEED_RADPS)
    scans = np.array(rig.scans)
    return calibrate_rolling(
        scans[:, 0],
        scans[:, 1] / FULL_COUNT,
        scans[:, 2] / FULL_COUNT,
        mounting.direction,
        pull_down_a_ohm=settings.pull_down_a_ohm,
        pull_down_b_ohm=settings.pull_down_b_ohm,
        wheel="wheel",
        board=1,
        channel=1,
        osr=_OSR,
    )


@dataclass(frozen=True, slots=True)
class _Way:
    """What the driver is told: nothing of the strap but its drawing, or a calibration."""

    name: str
    resistance_std_ratio: float
    calibration: str = ""
    second: bool = False
    turns_before: int = 2


LAW = "law alone"
"""The divider law with the nominal strap: what an uncalibrated strap is without the reader."""
WAYS = (
    _Way("told exact", 0.0),
    _Way("seam corrects", 0.05, turns_before=8),
    _Way("bench", DRIFT_STD, "bench"),
    _Way("rolling", DRIFT_STD, "rolling"),
    _Way("two straps", DRIFT_STD, "rolling", second=True),
)


def accuracy(
    way: _Way, sources: Sequence[np.random.SeedSequence], stopped: Callable[[], bool], done: Callable[[], None]
) -> Accuracy | None:
    """One way over one strap per source; None when stopped."""
    measured: list[tuple[FloatArray, FloatArray]] = []
    predicted: list[tuple[FloatArray, FloatArray]] = []
    by_law: list[FloatArray] = []
    records = predicted_count = faults = 0
    for source in sources:
        if stopped():
            return None
        seen, plain = _drive(way, source)
        by_law.append(plain)
        codes = seen.statuses()
        good = (codes == ContactStatus.VALID) | (codes == ContactStatus.UNCONFIRMED)
        held = codes == ContactStatus.PREDICTED
        measured.append((seen.error()[good], seen.std()[good]))
        predicted.append((seen.error()[held], seen.std()[held]))
        records += codes.size
        predicted_count += int(held.sum())
        faults += int((codes >= ContactStatus.FAULT_OPEN_A).sum())
        done()
    errors, stds = (np.concatenate([pair[i] for pair in measured]) for i in (0, 1))
    ahead, ahead_stds = (np.concatenate([pair[i] for pair in predicted]) for i in (0, 1))
    return Accuracy(
        way=way.name,
        straps=len(sources),
        records=len(errors),
        rms_deg=math.degrees(_rms(errors)) if errors.size else None,
        worst_strap_rms_deg=math.degrees(max(_rms(pair[0]) for pair in measured if pair[0].size))
        if errors.size
        else None,
        normalised=_rms(errors / stds) if errors.size else None,
        predicted_share=predicted_count / records,
        predicted_rms_deg=math.degrees(_rms(ahead)) if ahead.size else None,
        predicted_normalised=_rms(ahead / ahead_stds) if ahead.size else None,
        fault_share=faults / records,
        law_rms_deg=math.degrees(_rms(np.concatenate(by_law))),
        law_worst_rms_deg=math.degrees(max(_rms(errors) for errors in by_law)),
    )


def _drive(way: _Way, source: np.random.SeedSequence) -> tuple[Record, FloatArray]:
    """A wheel with its strap(s) over full turns of ground that is not quite steady."""
    painted, rolled, driven, drawn = (
        np.random.SeedSequence(source.entropy, spawn_key=(*source.spawn_key, k)) for k in range(4)
    )
    rng = np.random.default_rng(drawn)
    settings = replace(
        StrapReaderSettings(),
        resistance_std_ratio=way.resistance_std_ratio,
        noise_lsb=NOISE_LSB,
        angle_floor_std_rad=0.0,  # the bench has no strap edges and no encoder errors
    )
    offset, direction = float(rng.uniform(0.0, FULL_TURN_RAD)), int(rng.choice((-1, 1)))
    mounted = []
    for number, source_of_strap in enumerate(painted.spawn(2 if way.second else 1)):
        strap = paint(settings.strap(), FLAWS, source_of_strap)
        mounting = StrapMounting(offset + number * math.pi, direction)
        calibration = None
        if way.calibration == "bench":
            calibration = bench_calibration(strap, rng)
        elif way.calibration == "rolling":
            calibration = rolling_calibration(strap, mounting, settings, rolled.spawn(1)[0])
        if calibration is not None:
            strap = replace(strap, scale=strap.scale * (1.0 + DRIFT_STD * float(rng.standard_normal())))
        mounted.append(Mounted(strap, mounting, calibration))
    rig = StrapRig(mounted, settings, NOISE_LSB, driven, GROUND)
    rig.speed_radps = SPEED_RADPS
    rig.run(way.turns_before * FULL_TURN_RAD / SPEED_RADPS)
    rig.keeps_scans = True
    record = Record()
    rig.run(TEST_TURNS * FULL_TURN_RAD / SPEED_RADPS, record)
    return record, _by_law(rig, mounted[0].mounting)


def _by_law(rig: StrapRig, mounting: StrapMounting) -> FloatArray:
    """Errors [rad] of the divider law with the nominal strap, scan by scan outside the seam, shape (N, 2)."""
    scans = np.array(rig.scans)
    strap = rig.straps[0].true.nominal
    volts = strap.supply_v * scans[:, 1:3] / FULL_COUNT
    outside = (volts < 0.97 * strap.supply_v).any(axis=1)
    ends = mounting.contact_angles(*strap.strap_angles(volts[:, 0], volts[:, 1]), scans[:, 0])
    return np.stack([wrap(end - truth) for end, truth in zip(ends, scans[:, 3:].T, strict=True)], axis=1)[outside]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def layering_table(rows: Sequence[Layering]) -> PlainTable:
    """For terminal and document."""
    return PlainTable(
        "Resistance from end A, by layers (Appendix B)",
        ("layers", "kOhm at 90 deg", "at 180 deg", "at 270 deg", "grows with angle", "one press, deg (1-sigma)"),
        tuple(
            (
                str(row.layers),
                *(f"{1e-3 * row.resistance_ohm[row.angle_deg.index(angle)]:.0f}" for angle in (90.0, 180.0, 270.0)),
                "yes" if row.is_monotone else "no",
                f"{row.repeat_std_deg:.2f}",
            )
            for row in rows
        ),
    )


def accuracy_table(rows: Sequence[Accuracy]) -> PlainTable:
    """For terminal and document."""
    return PlainTable(
        "Angles over full turns: R_str 5 % off, 5 % non-uniform, 1 LSB",
        ("calibration", "rms, deg", "worst strap", "error / 1-sigma", "faults, %", "seam, %", "seam rms, deg"),
        tuple(
            (LAW, f"{row.law_rms_deg:.2f}", f"{row.law_worst_rms_deg:.2f}", *"----")
            for row in rows[:1]
        )
        + tuple(
            (
                row.way,
                _two(row.rms_deg),
                _two(row.worst_strap_rms_deg),
                _two(row.normalised),
                f"{100.0 * row.fault_share:.1f}",
                f"{100.0 * row.predicted_share:.1f}",
                _two(row.predicted_rms_deg),
            )
            for row in rows
        ),
    )  # fmt: skip


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def verdicts(layers: Sequence[Layering], rows: Sequence[Accuracy]) -> list[tuple[str, bool]]:
    """What must hold, and whether it does."""
    of = {row.way: row for row in rows}
    calibrated = [of[way.name] for way in WAYS if way.calibration]
    single = [of[way.name] for way in WAYS if way.calibration and not way.second]
    full = [row.full_turn_ohm for row in layers]
    return [
        ("resistance grows with the angle, at every thickness", all(row.is_monotone for row in layers)),
        ("more layers, less resistance", all(more < less for less, more in pairwise(full))),
        (
            f"calibrated: rms at most {RMS_LIMIT_DEG:g} deg over full turns",
            all(row.rms_deg is not None and row.rms_deg <= RMS_LIMIT_DEG for row in calibrated),
        ),
        (
            f"through the seam: rms at most {PREDICTED_LIMIT_DEG:g} deg",
            all(row.predicted_rms_deg is not None and row.predicted_rms_deg <= PREDICTED_LIMIT_DEG for row in single),
        ),
        ("with a second strap nothing is predicted", of[WAYS[-1].name].predicted_share == 0.0),
        *(
            [
                (
                    f"its 1-sigma is honest: normalised error {NEES_LIMITS[0]:g} to {NEES_LIMITS[1]:g}",
                    all(
                        row.normalised is not None and NEES_LIMITS[0] <= row.normalised <= NEES_LIMITS[1]
                        for row in calibrated
                    ),
                )
            ]
            if rows[0].straps >= NEES_STRAPS
            else []
        ),
    ]


def run_study(folder: Path, console: Console, stopped: Callable[[], bool] = never, *, straps: int = 20) -> bool:
    """Both parts into `folder`, tables, `summary.json` and picture; True when everything that must hold does."""
    bench, *sources = np.random.SeedSequence(STUDY_SEED).spawn(1 + straps)
    layers = layerings(bench)
    console.print(layering_table(layers).drawn())
    rows: list[Accuracy] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("straps", total=len(WAYS) * straps)
        for way in WAYS:
            progress.update(task, description=way.name)
            row = accuracy(way, sources, stopped, lambda: progress.advance(task))
            if row is None:
                break
            rows.append(row)
            _write(folder, layers, rows)
    console.print(accuracy_table(rows).drawn())
    if len(rows) < len(WAYS):
        return False
    found = verdicts(layers, rows)
    for claim, holds in found:
        console.print(f"{'[green]yes[/]' if holds else '[bold red]no [/]'}  {claim}")
    from missions.case_studies.strap_picture import draw_bench  # noqa: PLC0415 - matplotlib is slow

    draw_bench(layers, bench_examples(sources[0]), folder / "strap_bench.png")
    return all(holds for _, holds in found)


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """Errors of one strap by where its end was, for the picture."""

    way: str
    beta_deg: FloatArray
    error_deg: FloatArray


def bench_examples(source: np.random.SeedSequence) -> list[Example]:
    """Static error of beta_1 against beta_1 of one strap, uncalibrated and calibrated."""
    painted = np.random.SeedSequence(source.entropy, spawn_key=(*source.spawn_key, 0)).spawn(1)[0]
    settings = StrapReaderSettings()
    strap = paint(settings.strap(), FLAWS, painted)
    rng = np.random.default_rng(painted)
    calibrations = {
        "uncalibrated": None,
        "bench": bench_calibration(strap, rng),
        "rolling": rolling_calibration(strap, StrapMounting(0.0), settings, painted.spawn(1)[0]),
    }
    beta = np.radians(np.linspace(1.0, 320.0, 320))
    share = np.array([strap.shares(float(at), FULL_TURN_RAD)[0] for at in beta])
    return [
        Example(name, np.degrees(beta), np.degrees(_read(share, known) - beta)) for name, known in calibrations.items()
    ]


def _read(share: FloatArray, known: StrapCalibration | None) -> FloatArray:
    nominal = StrapReaderSettings().strap()
    if known is None:
        return np.asarray(nominal.gain_a_rad * (1.0 / share - 1.0))
    end = known.end_a
    curve = end.curve()
    return np.array([curve.arc_at(ratio) for ratio in InputFit.of(end).ratio(FULL_COUNT * share, FULL_COUNT).tolist()])


def _write(folder: Path, layers: Sequence[Layering], rows: Sequence[Accuracy]) -> None:
    content = {"layers": [asdict(row) for row in layers], "accuracy": [asdict(row) for row in rows]}
    (folder / "summary.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    text = layering_table(layers).as_markdown() + "\n" + accuracy_table(rows).as_markdown()
    (folder / "strap_bench.md").write_text(text, encoding="utf-8")
