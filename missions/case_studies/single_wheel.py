"""Case study 1 of the source paper, `single_wheel`: one wheel on a test stand on Earth, 1 kg, 70 N, soil S11.

Figures 2 to 5, 7 and 9 to 14 as numbers and pictures beside what the paper states; every controller on randomised
sand of two kinds; and one run through the ROS graph, number for number equal to the run without it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.flow_sweep import SPEEDS_MPS, HeldFlow
from missions.case_studies.graph_comparison import GraphComparison, compare_with_graph
from missions.case_studies.plain_table import PlainTable
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.single_wheel_claims import (
    Findings,
    claims,
    family_tables,
    flow_tables,
    in_stated_sinkage,
    kept_going,
    spread,
    unbalanced_energy,
)
from missions.case_studies.single_wheel_contact import (
    SLIPS,
    split_of_one_contact,
    split_on_the_stand,
    split_under_load,
    static_zones,
)
from missions.case_studies.single_wheel_estimation_claims import estimation_tables, estimations, step_ups
from missions.case_studies.single_wheel_pictures import (
    draw_control_volume,
    draw_controlled,
    draw_estimation,
    draw_family,
    draw_flow,
    draw_split,
    draw_stages,
    draw_static_zones,
    draw_step_up,
    draw_uncontrolled,
)
from missions.case_studies.single_wheel_runs import (
    FAMILY_SEED,
    SANDS,
    UNCONTROLLED,
    Drive,
    Job,
    drive_plan,
    run_job,
    study_jobs,
)
from missions.case_studies.single_wheel_stages import play_back
from missions.case_studies.single_wheel_stand import stand_deformability
from missions.case_studies.study_result import Chart, Curve, StudyFigure, StudyResult
from missions.stop_request import never

MEMBERS, SHORT_MEMBERS = 20, 1
STAGES_S = (0.6, 2.0, 3.5, 5.0)
UNCONTROLLED_STAGES_S = (0.6, 1.6, 3.0, 6.0)
LOCKSTEP_S = 2.5
TITLE = "Case study 1: one wheel on a test stand, 70 N on soil S11"


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    members: int | None = None,
) -> bool:
    """Run what the folder does not hold yet on all cores, then judge, draw and write `summary.json`.

    False when `stopped()` ended it early (what is done is kept), or when energy or the run through the graph is wrong.
    """
    number = members or (SHORT_MEMBERS if short else MEMBERS)
    form = LedgerForm("single_wheel", short, {"members": number, "seed": FAMILY_SEED})
    jobs = study_jobs(number, short=short)
    runs = run_jobs(folder, form, jobs, run_job, console, stopped)
    if len(runs) < len(jobs) or stopped():
        return False
    with console.status("one run through the ROS graph"):
        plan = drive_plan(_first_drive(jobs))
        compared = compare_with_graph(replace(plan, duration_s=min(plan.duration_s, LOCKSTEP_S)), stopped)
    if compared is None:
        return False
    with console.status("soil nodes, pictures"):
        found = findings(runs)
        draw(found, folder)
    result = study_result(found, compared, number, short=short)
    result.write(folder)
    for table in (*result.tables, result.claims_table()):
        console.print(table.drawn())
    for words in result.words:
        console.print(escape(words))
    console.print(f"every run: {escape(str(folder / RUNS_FILE))}")
    return compared.is_equal and not unbalanced_energy(found)


def _first_drive(jobs: Mapping[str, Job]) -> Drive:
    """The first member's drive by the controller."""
    job = jobs[f"trapping 0 {SOIL_FLOW}"]
    if not isinstance(job, Drive):
        raise TypeError(f"a member's run must be a drive, got {job!r}")
    return job


def findings(runs: Mapping[str, Any]) -> Findings:
    """All that is needed to judge and draw, from the results of the runs."""
    _, de = stand_deformability()
    flows = {
        kind: [HeldFlow(**run) for key, run in runs.items() if key.startswith(f"sweep {kind} ")]
        for kind in ("trapping", "refilling")
    }
    return Findings(
        runs=runs,
        splits=(
            split_of_one_contact(),
            split_under_load(),
            split_on_the_stand(SANDS["trapping"].reference(), "S11, trapping"),
            split_on_the_stand(SANDS["refilling"].reference(), "S11, refilling"),
        ),
        zones=static_zones(),
        controlled={
            sand: play_back(runs[f"reference {sand} {SOIL_FLOW}"]["trace"], de, STAGES_S)
            for sand in ("trapping", "refilling")
        },
        uncontrolled=play_back(runs[f"reference weak {UNCONTROLLED}"]["trace"], de, UNCONTROLLED_STAGES_S),
        flows=flows,
    )


PICTURES: tuple[StudyFigure, ...] = (
    StudyFigure(
        "single_wheel_split.png",
        "Figs 2, 3: bulldozing and traction",
        "Share of the contact that pushes back against the wheel, and the force of both parts, against slip.",
    ),
    StudyFigure(
        "single_wheel_stages.png",
        "Figs 4, 13: soil under the controlled wheel",
        "10 000 nodes moved by the flow law while the controller drives, on both kinds of sand.",
    ),
    StudyFigure(
        "single_wheel_control_volume.png",
        "Fig. 5: control volume",
        "Where soil enters and leaves the zone under the wheel; arrows: the flow law.",
    ),
    StudyFigure(
        "single_wheel_static_zones.png",
        "Fig. 7: static contact zones",
        "Curiosity's wheel at rest on S1 to S24, and the deformability that either rule reads from it.",
    ),
    StudyFigure(
        "single_wheel_flow.png",
        "Fig. 9: soil flow at held slip",
        "18 runs per kind of sand: mass flow in and out, flow ratio, angles.",
    ),
    StudyFigure(
        "single_wheel_estimation.png",
        "Fig. 10: estimation of de and st",
        "At 0.01 rad/s the standing contact tells de; st comes with motor torque, and with way at a speed at which "
        "odometry can tell slip. Without torque it stays where it was assumed.",
    ),
    StudyFigure(
        "single_wheel_step_up.png",
        "Fig. 11: who tells first",
        "Flow ratio, slip and exit angle after the wheel is turned up to 4 rad/s: on sand that holds it, and at the "
        "stated load.",
    ),
    StudyFigure(
        "single_wheel_uncontrolled.png",
        "Fig. 12: without sensor",
        "2 rad/s whatever happens: the soil on weaker sand, force and speed at first, and in the long run. "
        "The gap below the rim at much slip is the flow law's, which was never fitted there.",
    ),
    StudyFigure(
        "single_wheel_controlled.png",
        "Fig. 14: controlled",
        "Contact zone, angular and linear velocity, sinkage, force and flow ratio of the controlled wheel.",
    ),
    StudyFigure(
        "single_wheel_family.png",
        "All controllers, all members",
        "Deepest sinkage of every randomised member, and whether it ever stood.",
    ),
)


def draw(found: Findings, folder: Path) -> None:
    """All pictures into the folder."""
    split, stages, volume, zones, flow, estimation, step_up, uncontrolled, controlled, family = (
        folder / picture.file for picture in PICTURES
    )
    _, de = stand_deformability()
    draw_split(found.splits, split)
    titled = {f"{sand} sand": play for sand, play in found.controlled.items()}
    draw_stages(titled, "Controlled wheel pulling 40 N: 10 000 soil nodes under the flow law", stages)
    play = found.controlled["trapping"]
    shown = play.stages[-2]
    draw_control_volume(shown, de, play.flow[int(np.searchsorted(play.time_s, shown.time_s))], volume)
    draw_static_zones(found.zones, zones)
    draw_flow(found.flows, flow)
    told = {f"{torque} torque": estimations(found.runs, "S11", torque) for torque in ("with", "without")}
    draw_estimation(told, estimation)
    draw_step_up({SANDS[sand].title: step_ups(found.runs, sand) for sand in ("weak", "trapping")}, step_up)
    constant = {
        f"{sand.reference().drawbar_load_n:g} N, {sand.name} sand": found.runs[f"reference {name} {UNCONTROLLED}"][
            "trace"
        ]
        for name, sand in SANDS.items()
    }
    free = [run for key, run in found.runs.items() if key.startswith("free wheel")]
    draw_uncontrolled(found.uncontrolled, free, constant, uncontrolled)
    driven = {
        f"{SOIL_FLOW}, {sand}": found.runs[f"reference {sand} {SOIL_FLOW}"]["trace"]
        for sand in ("trapping", "refilling")
    }
    draw_controlled(driven, controlled)
    members = {
        sand: {
            name: [(m["largest_sinkage_mm"], bool(m["kept_going"])) for m in found.members(sand, name)]
            for name in BASELINES
        }
        for sand in SANDS
    }
    draw_family(members, family)


def study_result(found: Findings, compared: GraphComparison, members: int, *, short: bool) -> StudyResult:
    """Everything as a record that a report can read."""
    return StudyResult(
        study="single_wheel",
        title=TITLE,
        is_short=short,
        words=_words(found, compared, members),
        assumptions=(
            "Wheel r = b = 0.20 m: the paper does not state its size.",
            "Stickiness st 0.6 of S11 (phi 35 deg, c 1.9 kPa): the paper states none; members 0.57 to 0.63.",
            "A drawbar load of 40 N, members 38 to 50 N: the paper shows a force of 38 to 50 N and no load.",
            "Trapping sand: delta 20 mm and kappa 0, members 10 to 30 mm and 0 to 0.5; no such sand has been measured.",
            "Refilling sand: delta 80 mm and kappa 3, members 25 to 82 mm; it spans the two sands that were measured.",
            "Members' stiffness 0.8 to 1.25 times Table II; sensor noise 0.5 to 2 times the simulation's usual.",
            "Weaker sand: st lower by 0.25, load 38 N; not in the paper, where no sand is named that holds a wheel.",
            "Asked for: 0.1 m/s, but for the constant speeds; motor lag 0.1 s and 2 rad/s^2.",
            "Flow law as corrected (q squared, vertical part about x_p, M_out at x_out), vc in its lobe form.",
            "Fig. 10: de of S11 is 0.51 for the stand's wheel; the paper's speeds until 2 s, then faster than it goes.",
            "Fig. 11: the wheel turns at 4 rad/s from one moment to the next, and 0.1 s are left out as its start.",
            "The flow law is evaluated at slip 0.45 where slip is more; de is the inverse of Eq. 7.",
        ),
        claims=claims(found),
        tables=(
            *family_tables(found),
            *flow_tables(found.flows),
            *estimation_tables(found.runs),
            _graph_table(compared),
        ),
        figures=PICTURES,
        charts=_charts(found),
    )


def _graph_table(compared: GraphComparison) -> PlainTable:
    row = ("soil_flow, first member", f"{compared.seconds:g}", str(compared.values), str(compared.differing))
    return PlainTable("Through the ROS graph in lockstep, beside without", ("run", "s", "numbers", "differing"), (row,))


def _words(found: Findings, compared: GraphComparison, members: int) -> tuple[str, ...]:
    words = []
    for sand in ("trapping", "refilling"):
        driven = found.members(sand, SOIL_FLOW)
        words.append(
            f"At the stated load on {sand} sand the controlled wheel keeps going in {kept_going(driven)} of {members} "
            f"members, {spread(driven, 'steady_sinkage_mm').said('mm')} deep, {in_stated_sinkage(driven)} of them "
            f"within 3 to 4 cm. {_all_alike(found, sand)}"
        )
    deepest = ", ".join(
        f"{name} {kept_going(chosen)} of {len(chosen)} at {spread(chosen, 'largest_sinkage_mm').said('mm')}"
        for name in BASELINES
        if (chosen := found.members("weak", name))
    )
    words.append(
        f"On weaker sand, where 38 N is more than most wheels can pull, kept going and how deep in: {deepest}."
    )
    wrong = unbalanced_energy(found)
    drives = sum("wheel_work_j" in run for run in found.runs.values())
    energy = "in every one" if not wrong else f"but for {', '.join(wrong)}"
    words.append(
        f"In {drives} drives the motor's work on the wheel exceeds the wheel's work on its load {energy}. "
        f"One run went through the ROS graph in lockstep: of {compared.values} numbers {compared.differing} differ "
        "from the run without."
    )
    return tuple(words)


def _all_alike(found: Findings, sand: str) -> str:
    """Says whether any baseline does worse at the stated load."""
    ours = found.members(sand, SOIL_FLOW)
    worse = [
        name
        for name in BASELINES
        if kept_going(found.members(sand, name)) < kept_going(ours)
        or in_stated_sinkage(found.members(sand, name)) < in_stated_sinkage(ours)
    ]
    if worse:
        return f"Fewer do so under {', '.join(worse)}."
    return "No baseline does worse, the constant speeds and the plain slip limits included."


def _charts(found: Findings) -> tuple[Chart, ...]:
    charts = [
        Chart(
            "Bulldozing share of the contact (Figs 2, 3)",
            "slip [-]",
            "share of the contact [-]",
            tuple(Curve(c.name, _floats(SLIPS), _floats(c.bulldozing_share)) for c in found.splits),
        )
    ]
    for sand, runs in found.flows.items():
        curves = []
        for speed in SPEEDS_MPS:
            chosen = [run for run in runs if run.speed_mps == speed]
            slip = tuple(run.slip for run in chosen)
            curves.append(Curve(f"in, {speed:g} m/s", slip, tuple(1e3 * run.entering for run in chosen)))
            curves.append(Curve(f"out, {speed:g} m/s", slip, tuple(1e3 * run.leaving for run in chosen)))
        charts.append(
            Chart(f"Soil flow at held slip, {sand} sand (Fig. 9)", "slip [-]", "mass flow [g/s]", tuple(curves))
        )
    free = [run for key, run in found.runs.items() if key.startswith("free wheel")]
    charts.append(
        Chart(
            "Set down at 2 rad/s: horizontal force (Fig. 12)",
            "time [s]",
            "force [N]",
            tuple(Curve(f"pulls {run['load_n']:g} N", tuple(run["time_s"]), tuple(run["force_n"])) for run in free),
        )
    )
    for name, label, factor in (
        ("command_radps", "angular velocity, commanded [rad/s]", 1.0),
        ("speed_mps", "speed [m/s]", 1.0),
        ("sinkage_m", "sinkage [mm]", 1e3),
        ("pull_n", "horizontal force [N]", 1.0),
    ):
        for family in SANDS.values():
            curves = [
                _band(found.members(family.name, controller), controller, name, factor)
                for controller in (SOIL_FLOW, UNCONTROLLED)
            ]
            charts.append(
                Chart(f"{label.split(' [')[0]}: {family.title} (Figs 12, 14)", "time [s]", label, tuple(curves))
            )
    return tuple(charts)


def _band(members: Sequence[Mapping[str, Any]], name: str, quantity: str, factor: float) -> Curve:
    """Mean and spread over the members, over time."""
    values = factor * np.array([member["trace"][quantity] for member in members])
    time_s = members[0]["trace"]["time_s"]
    return Curve(name, tuple(time_s), _floats(values.mean(axis=0)), _floats(values.std(axis=0)))


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in values)
