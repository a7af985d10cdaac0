"""Case study 2, `mars_rover`: Curiosity comes from stones into soft sand; with and without the straps' help.

Runs without ROS on all cores, a part of one drive through the ROS graph in lockstep besides. Three groups of drives:
the reference case whole, for the figures of the source paper; the same with its changed assumptions taken away one by
one; and a family of random members that every controller meets. All on both kinds of sand.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_rover_runs import Drive, DriveResult, LockstepPart, run_item
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.stop_request import never
from sim_bridge.scenarios import (
    REFERENCE_MARS,
    REFERENCE_SNAG,
    MarsCase,
    SnagCase,
    on_refilling_sand,
    random_mars_case,
)

STUDY: Final = "mars_rover"
FAMILY_SEED: Final = 20210112
"""Members are drawn from this; nothing was tuned on them."""
SENSOR_LESS: Final = "constant 2 rad/s"
"""The rover without the sensor in the source paper."""
SANDS: Mapping[str, Callable[[SnagCase], SnagCase]] = MappingProxyType(
    {"trapping": lambda case: case, "refilling": on_refilling_sand}
)
"""The two kinds of sand: the one that keeps the hole a wheel digs is assumed, the one that flows back is measured."""
AS_PRINTED: Final = "level, no snag (as printed)"
VARIANTS: Mapping[str, SnagCase] = MappingProxyType(
    {
        "7 deg slope and snag (reference)": REFERENCE_SNAG,
        "snag, level": replace(REFERENCE_SNAG, slope_deg=0.0),
        "7 deg slope, no snag": replace(REFERENCE_SNAG, snag_n=0.0),
        AS_PRINTED: replace(REFERENCE_SNAG, slope_deg=0.0, snag_n=0.0),
        "level, no snag, very soft (de 0.7, st 0.34)": replace(
            REFERENCE_SNAG, slope_deg=0.0, snag_n=0.0, de=0.7, st=0.34
        ),
    }
)
"""The reference case, and what is left of it without its changed assumptions."""
REFERENCE_SEED: Final = 0
_PAUSING = frozenset({SOIL_FLOW, "slip 0.3", "slip 0.4"})
"""Controllers that stop and wait: they stand for a while without having ended."""


@dataclass(frozen=True, slots=True)
class Form:
    """How much of the study is run."""

    members: int
    reference: MarsCase
    reference_s: float
    variants: tuple[str, ...]
    family_s: float
    """At most so long; members end when they are decided."""
    lockstep_s: float
    near: tuple[float, float] | None = None
    """Start of the soft sand and way from there to the snag [m] of every member; None: as they are drawn."""


FULL = Form(20, REFERENCE_MARS, 160.0, tuple(VARIANTS), 300.0, 8.0)
SHORT = Form(
    2,
    MarsCase(replace(REFERENCE_SNAG, snag_s=6.0), soft_from_m=4.6, snag_after_m=0.8),
    28.0,
    (AS_PRINTED,),
    12.0,
    1.5,
    near=(0.8, 0.6),
)
"""To see that it all works: too short for its verdicts to say much."""


@dataclass(frozen=True, slots=True)
class Results:
    """Everything a study ran, by what it is of."""

    reference: Mapping[tuple[str, str], DriveResult]
    """(sand, controller), whole drives with their traces."""
    variants: Mapping[tuple[str, str, str], DriveResult]
    """(variant, sand, controller)."""
    family: Mapping[tuple[str, str], tuple[DriveResult, ...]]
    """(sand, controller), member by member."""
    lockstep: Mapping[str, Any]

    def drives(self) -> list[DriveResult]:
        """All drives."""
        in_family = [result for results in self.family.values() for result in results]
        return [*self.reference.values(), *self.variants.values(), *in_family]


def members(count: int) -> list[MarsCase]:
    """The first `count` members on trapping sand."""
    return [
        random_mars_case(np.random.default_rng(source)) for source in np.random.SeedSequence(FAMILY_SEED).spawn(count)
    ]


def jobs_of(form: Form) -> dict[str, Drive | LockstepPart]:
    """Every drive by a name; longest first, so that no core is left alone with one at the end."""
    jobs: dict[str, Drive | LockstepPart] = {}
    for sand, on_sand in SANDS.items():
        for controller in (SOIL_FLOW, SENSOR_LESS):
            case = replace(form.reference, sand=on_sand(form.reference.sand))
            jobs[_reference_key(sand, controller)] = Drive(
                case, controller, REFERENCE_SEED, form.reference_s, is_whole=True, is_traced=True
            )
            for variant in form.variants:
                case = replace(form.reference, sand=on_sand(VARIANTS[variant]))
                jobs[_variant_key(variant, sand, controller)] = Drive(
                    case, controller, REFERENCE_SEED, form.reference_s, standing_s=_standing_s(controller)
                )
    near = replace(form.reference, soft_from_m=1.5, snag_after_m=0.5)
    jobs["lockstep"] = LockstepPart(Drive(near, SOIL_FLOW, REFERENCE_SEED, form.lockstep_s))
    for number, drawn in enumerate(members(form.members)):
        member = drawn if form.near is None else replace(drawn, soft_from_m=form.near[0], snag_after_m=form.near[1])
        for sand, on_sand in SANDS.items():
            case = replace(member, sand=on_sand(member.sand))
            for controller in BASELINES:
                jobs[_member_key(number, sand, controller)] = Drive(
                    case, controller, number, form.family_s, standing_s=_standing_s(controller)
                )
    return jobs


def results_from(form: Form, found: Mapping[str, Any]) -> Results:
    """What was run, read back from the folder of a study that came to its end."""
    pair = [(sand, controller) for sand in SANDS for controller in (SOIL_FLOW, SENSOR_LESS)]
    read = DriveResult.from_json
    return Results(
        reference={key: read(found[_reference_key(*key)]) for key in pair},
        variants={
            (variant, *key): read(found[_variant_key(variant, *key)]) for variant in form.variants for key in pair
        },
        family={
            (sand, controller): tuple(
                read(found[_member_key(number, sand, controller)]) for number in range(form.members)
            )
            for sand in SANDS
            for controller in BASELINES
        },
        lockstep=found["lockstep"],
    )


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    runs: int | None = None,
) -> bool:
    """Run the study on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    from missions.case_studies.mars_rover_pictures import draw_all  # noqa: PLC0415 - matplotlib is slow
    from missions.case_studies.mars_rover_tables import study_result  # noqa: PLC0415 - it imports this module

    form = SHORT if short else FULL
    form = form if runs is None else replace(form, members=runs)
    jobs = jobs_of(form)
    settings = {"members": form.members, "seed": FAMILY_SEED}
    found = run_jobs(folder, LedgerForm(STUDY, short, settings), jobs, run_item, console, stopped)
    if len(found) < len(jobs):
        return False
    results = results_from(form, found)
    figures = draw_all(results, form.reference, folder)
    result = study_result(results, form, figures, short=short)
    result.write(folder)
    for table in (*result.tables, result.claims_table()):
        console.print(table.drawn())
    for words in result.words:
        console.print(escape(words))
    console.print(f"pictures and summary.json: {escape(str(folder))}; every drive: {escape(str(folder / RUNS_FILE))}")
    return True


def _standing_s(controller: str) -> float:
    """Three waits and the attempts between them take some 35 s: only then has a supervisor given up."""
    return 45.0 if controller in _PAUSING else 16.0


def _reference_key(sand: str, controller: str) -> str:
    return f"reference, {sand}, {controller}"


def _variant_key(variant: str, sand: str, controller: str) -> str:
    return f"{variant}, {sand}, {controller}"


def _member_key(number: int, sand: str, controller: str) -> str:
    return f"member {number}, {sand}, {controller}"
