"""Every fault a strap can have, begun again and again on a rolling wheel: how soon it is named, and what it costs.

For each fault: episodes of a sound wheel that turns at some speed, then the fault, then its end; speeds, zones,
mountings and moments drawn from the study's seed. An angle is wrong that is called VALID and is off by more than
WRONG_RAD and by more than WRONG_STDS of its own 1-sigma. Noise is 1 LSB, R_str known to 1 %: a strap calibrated some
time ago.
"""

import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.strap_rig import TICK_NS, Ground, Mounted, Record, StrapRig
from missions.stop_request import never
from sim_bridge.painted_strap import PaintedStrap
from sim_bridge.strap_faults import StrapFault
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings

STUDY_SEED = 20261124
WRONG_RAD, WRONG_STDS = math.radians(5.0), 4.0
FRAMES = 100_000
SHORT_FRAMES = 6_000
SETTINGS = replace(StrapReaderSettings(), noise_lsb=1.0, resistance_std_ratio=0.01)
SPEEDS_RADPS = (0.3, 3.0)
SOUND_RAD, FAULTY_RAD = 9.0, 20.0
"""Rotation of an episode before the fault, so that the strap is proven, and with it."""
_FRAMES_PER_TICK = 2
_RESULTS = "summary.json"
_REPORT = "strap_faults.md"

CASES: tuple[tuple[str, StrapFault, float], ...] = (
    ("open lead A", StrapFault.OPEN_A, 1.0),
    ("open lead B", StrapFault.OPEN_B, 1.0),
    ("A shorted to the conductor", StrapFault.SHORT_A, 1.0),
    ("B shorted to the conductor", StrapFault.SHORT_B, 1.0),
    ("converter stuck, A", StrapFault.STUCK_A, 1.0),
    ("converter stuck, B", StrapFault.STUCK_B, 1.0),
    ("pin floats, A", StrapFault.FLOATING_A, 1.0),
    ("pin floats, B", StrapFault.FLOATING_B, 1.0),
    ("A and B swapped", StrapFault.SWAPPED, 1.0),
    ("mounted mirrored", StrapFault.MIRRORED, 1.0),
    ("conductor unfed", StrapFault.CONTACT_LOST, 1.0),
    ("noise, 20 LSB", StrapFault.NOISY, 1.0),
    ("loose lead", StrapFault.INTERMITTENT, 1.0),
    ("wrong board", StrapFault.WRONG_BOARD, 1.0),
    ("R_str drifts, 1.2 % per minute", StrapFault.DRIFT, 0.04),
    ("supply sinks, 1 % per minute", StrapFault.REFERENCE_CREEP, 1.0),
    ("supply steps by 5 %", StrapFault.REFERENCE, 1.0),
)
"""What a person calls it, the fault, its size."""
FOLLOWED = frozenset({StrapFault.DRIFT, StrapFault.REFERENCE_CREEP, StrapFault.REFERENCE})
"""Faults that the seam corrects up to 10 %: they are told as health, and named only beyond that."""
SLOW = frozenset({StrapFault.DRIFT, StrapFault.REFERENCE_CREEP})
"""Faults that grow over many turns: their episodes last until they are at their worst."""
_SLOW_S = 600.0


@dataclass(frozen=True, slots=True)
class FaultRow:
    """What came of one fault."""

    name: str
    frames: int
    """Of the board, with the fault."""
    episodes: int
    named: int
    """Episodes in which a fault was named (or, unfed, no contact)."""
    frames_to_name_median: float | None
    frames_to_name_max: float | None
    statuses: dict[str, int]
    """Records with the fault, by status."""
    valid: int
    """Records called VALID while the fault was there."""
    wrong: int
    """Of those, wrong."""
    wrong_after: int
    """Wrong ones after its end."""
    worst_valid_deg: float
    """Largest error of a record called VALID while the fault was there."""
    is_followed: bool
    """The seam corrects it, so that it needs no name."""

    @property
    def is_good(self) -> bool:
        """Every episode was named or corrected, and no angle was wrong."""
        return not (self.wrong or self.wrong_after) and (self.is_followed or self.named == self.episodes)


def run_fault(
    name: str, fault: StrapFault, size: float, frames: int, source: np.random.SeedSequence, stopped: Callable[[], bool]
) -> FaultRow:
    """Episodes of one fault until `frames` frames of it have been seen, or `stopped`."""
    rng = np.random.default_rng(source)
    waits: list[float] = []
    statuses: Counter[str] = Counter()
    seen = episodes = named = valid = wrong = wrong_after = 0
    worst = 0.0
    while seen < frames and not stopped():
        rig, speed = _rig(rng, source.spawn(1)[0])
        rig.run(SOUND_RAD / abs(speed))
        rig.run(float(rng.uniform(0.0, 2.0 * math.pi)) / abs(speed))
        rig.begin(fault, size)
        during = Record()
        if fault in SLOW:
            rig.run(min(_SLOW_S, (frames - seen) / _FRAMES_PER_TICK * 1e-9 * TICK_NS), during)
        else:
            rig.run(FAULTY_RAD / abs(speed), during)
        rig.begin(StrapFault.NONE)
        after = Record()
        rig.run(0.5 * FAULTY_RAD / abs(speed), after)
        episodes += 1
        seen += _FRAMES_PER_TICK * len(during.status)
        codes = during.statuses()
        statuses.update(ContactStatus(code).name for code in codes.tolist())
        tells = (codes >= ContactStatus.FAULT_OPEN_A) | (
            (codes == ContactStatus.NO_CONTACT) & (fault is StrapFault.CONTACT_LOST)
        )
        if tells.any():
            named += 1
            waits.append(float(_FRAMES_PER_TICK * (int(np.argmax(tells)) + 1)))
        valid += int(np.count_nonzero(codes == ContactStatus.VALID))
        wrongs, largest = _wrong(during)
        wrong += wrongs
        worst = max(worst, largest)
        wrong_after += _wrong(after)[0]
    return FaultRow(
        name=name,
        frames=seen,
        episodes=episodes,
        named=named,
        frames_to_name_median=float(np.median(waits)) if waits else None,
        frames_to_name_max=max(waits) if waits else None,
        statuses=dict(statuses.most_common()),
        valid=valid,
        wrong=wrong,
        wrong_after=wrong_after,
        worst_valid_deg=math.degrees(worst),
        is_followed=fault in FOLLOWED,
    )


def _rig(rng: np.random.Generator, source: np.random.SeedSequence) -> tuple[StrapRig, float]:
    """A wheel of its own, turning [rad/s]."""
    true = PaintedStrap.perfect(SETTINGS.strap())
    mounting = StrapMounting(float(rng.uniform(0.0, 2.0 * math.pi)), int(rng.choice((-1, 1))))
    ground = Ground(float(rng.uniform(0.3, 0.8)), float(rng.uniform(-0.5, -0.1)), math.radians(0.5))
    rig = StrapRig([Mounted(true, mounting)], SETTINGS, 1.0, source, ground)
    speed = math.exp(float(rng.uniform(*np.log(SPEEDS_RADPS)))) * float(rng.choice((-1.0, 1.0, 1.0)))
    rig.speed_radps = speed
    return rig, speed


def _wrong(record: Record) -> tuple[int, float]:
    """Records called VALID with a wrong angle, and the largest error of any called so [rad]."""
    good = record.statuses() == ContactStatus.VALID
    if not good.any():
        return 0, 0.0
    error, std = np.abs(record.error())[good], record.std()[good]
    is_wrong = ((error > WRONG_RAD) & (error > WRONG_STDS * std)).any(axis=1)
    return int(np.count_nonzero(is_wrong)), float(error.max())


def table(rows: list[FaultRow]) -> PlainTable:
    """For terminal and document."""
    return PlainTable(
        "Faults of a strap",
        ("fault", "named", "frames to name", "at most", "VALID, %", "worst, deg", "wrong", "as"),
        tuple(
            (
                row.name,
                "corrected" if row.is_followed and not row.named else f"{row.named} of {row.episodes}",
                "-" if row.frames_to_name_median is None else f"{row.frames_to_name_median:.0f}",
                "-" if row.frames_to_name_max is None else f"{row.frames_to_name_max:.0f}",
                f"{100.0 * row.valid / max(sum(row.statuses.values()), 1):.1f}",
                f"{row.worst_valid_deg:.1f}",
                f"{row.wrong} + {row.wrong_after}",
                " ".join(name.removeprefix("FAULT_") for name in row.statuses if _is_name(name)) or "-",
            )
            for row in rows
        ),
    )  # fmt: skip


def _is_name(status: str) -> bool:
    return status not in {"VALID", "PREDICTED", "UNCONFIRMED"}


def run_study(folder: Path, console: Console, stopped: Callable[[], bool] = never, *, frames: int = FRAMES) -> bool:
    """All faults into `folder`; what is done is kept when stopped. True when each came to its end and is good."""
    rows: list[FaultRow] = []
    sources = np.random.SeedSequence(STUDY_SEED).spawn(len(CASES))
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("faults", total=len(CASES))
        for (name, fault, size), source in zip(CASES, sources, strict=True):
            progress.update(task, description=name)
            row = run_fault(name, fault, size, frames, source, stopped)
            if stopped():
                break
            rows.append(row)
            _write(folder, rows)
            progress.advance(task)
    console.print(table(rows).drawn())
    console.print(
        f"{rows[0].frames if rows else 0} frames and more of each. Wrong: VALID, off by more than 5 deg and "
        f"{WRONG_STDS:g} of its own 1-sigma; during the fault + after it. Results in {folder}"
    )
    return len(rows) == len(CASES) and all(row.is_good for row in rows)


def _write(folder: Path, rows: list[FaultRow]) -> None:
    (folder / _RESULTS).write_text(json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8")
    (folder / _REPORT).write_text(table(rows).as_markdown(), encoding="utf-8")
