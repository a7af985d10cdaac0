"""What case study 1 of the source paper states beside what came out here, with verdicts drawn from the numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.flow_sweep import SLIPS as SWEPT_SLIPS
from missions.case_studies.flow_sweep import HeldFlow
from missions.case_studies.plain_table import PlainTable
from missions.case_studies.single_wheel_contact import FAMILY_DE, SLIPS, SplitCurve, StaticZones
from missions.case_studies.single_wheel_estimation_claims import estimation_claims, step_claims
from missions.case_studies.single_wheel_pictures import SINKAGE_STATED_MM
from missions.case_studies.single_wheel_runs import SANDS, START_S, UNCONTROLLED
from missions.case_studies.single_wheel_stages import Playback
from missions.case_studies.single_wheel_stand import stand_deformability
from missions.case_studies.study_result import Claim, Verdict

FORCE_STATED_N = (38.0, 50.0)
_STILL_N = 2.0
"""Net force below which a free wheel counts as rolling."""


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All that the study found, before it is judged."""

    runs: Mapping[str, Any]
    """Every job's result by its key."""
    splits: Sequence[SplitCurve]
    zones: StaticZones
    controlled: Mapping[str, Playback]
    uncontrolled: Playback
    flows: Mapping[str, Sequence[HeldFlow]]

    def members(self, sand: str, controller: str) -> list[Mapping[str, Any]]:
        """Results of all members of a sand under one controller."""
        chosen = []
        for key, result in self.runs.items():
            first, second, *rest = key.split(" ", 2)
            if first == sand and second.isdigit() and rest == [controller]:
                chosen.append(result)
        return chosen


@dataclass(frozen=True, slots=True)
class Spread:
    """Of one number over members."""

    median: float
    least: float
    most: float

    def said(self, unit: str, digits: int = 0) -> str:
        """E.g. `37 mm (31 to 43)`."""
        return f"{self.median:.{digits}f} {unit} ({self.least:.{digits}f} to {self.most:.{digits}f})"


def spread(members: Sequence[Mapping[str, Any]], name: str) -> Spread:
    """Median and range; ValueError without members."""
    if not members:
        raise ValueError(f"no members to take {name} of")
    values = np.array([float(member[name]) for member in members])
    return Spread(float(np.median(values)), float(values.min()), float(values.max()))


def kept_going(members: Sequence[Mapping[str, Any]]) -> int:
    """How many never stood after the start."""
    return sum(bool(member["kept_going"]) for member in members)


def in_stated_sinkage(members: Sequence[Mapping[str, Any]]) -> int:
    """How many kept going with a steady sinkage of 3 to 4 cm."""
    least, most = SINKAGE_STATED_MM
    return sum(bool(member["kept_going"]) and least <= member["steady_sinkage_mm"] <= most for member in members)


def claims(found: Findings) -> tuple[Claim, ...]:
    """In the order of the paper's figures."""
    return (
        *_contact_claims(found),
        *_node_claims(found),
        *_zone_claims(found.zones),
        *_flow_claims(found),
        *estimation_claims(found.runs),
        *step_claims(found.runs),
        *_uncontrolled_claims(found),
        *_controlled_claims(found),
    )


def _contact_claims(found: Findings) -> list[Claim]:
    held, loaded = found.splits[0], found.splits[1]
    low, high = int(np.argmin(np.abs(SLIPS - 0.1))), int(np.argmin(np.abs(SLIPS - 0.6)))
    is_falling = all(curve.bulldozing_share[high] < curve.bulldozing_share[low] for curve in (held, loaded))
    share = [
        f"{100 * curve.bulldozing_share[low]:.0f} to {100 * curve.bulldozing_share[high]:.0f} %"
        for curve in (held, loaded)
    ]
    stand = max(float(curve.bulldozing_share[: high + 1].max()) for curve in found.splits[2:])
    deepest = max(float(curve.bulldozing_share[-1]) for curve in found.splits[2:])
    deep = found.splits[1].bulldozing_n
    return [
        Claim(
            "Figs 2, 3",
            "bulldozing part of the contact, slip 0.1 to 0.6",
            "shrinks with slip",
            f"{share[0]} of a contact held, {share[1]} under load (Mars sand)",
            Verdict.REPRODUCED if is_falling else Verdict.NOT_REPRODUCED,
            f"on the stand's S11 with st 0.6 at most {100 * stand:.0f} % bulldozes up to slip 0.6, "
            f"{100 * deepest:.0f} % at {SLIPS[-1]:.1f} where it has dug itself in",
        ),
        Claim(
            "Fig. 2",
            "traction as the bulldozing part vanishes",
            "increases",
            f"thrust {loaded.thrust_n[low]:.0f} to {loaded.thrust_n[high]:.0f} N, bulldozing "
            f"{deep[low]:.0f} to {deep[high]:.0f} N at slip 0.1 to 0.6",
            Verdict.REPRODUCED if loaded.thrust_n[high] > loaded.thrust_n[low] else Verdict.NOT_REPRODUCED,
            f"beyond slip {SLIPS[int(np.argmax(loaded.thrust_n))]:.2f} thrust falls again",
        ),
    ]


def _node_claims(found: Findings) -> list[Claim]:
    play = found.controlled["trapping"]
    entering = np.array([flow.entering for flow in play.flow])
    leaving = np.array([flow.leaving for flow in play.flow])
    inside = (entering > 0.0) & (play.time_s >= START_S)
    return [
        Claim(
            "Fig. 4",
            "soil displaced beneath a rolling wheel",
            "10 000 nodes, picture",
            f"10 000 nodes, the furthest carried {play.largest_travel_mm:.1f} mm",
            Verdict.NO_NUMBER,
            "the flow law as corrected; pressing under the load is drawn, not displaced by it",
        ),
        Claim(
            "Fig. 5",
            "M_ent, M_out of the control volume",
            "picture",
            f"{1e3 * _mean(entering, inside):.2f} and {1e3 * _mean(leaving, inside):.2f} g/s, summed over nodes",
            Verdict.NO_NUMBER,
            "controlled wheel, trapping sand",
        ),
    ]


def _mean(values: np.ndarray[Any, np.dtype[np.float64]], chosen: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    return float(values[chosen].mean()) if chosen.any() else 0.0


def _zone_claims(zones: StaticZones) -> list[Claim]:
    s11 = zones.names.index("S11")
    linear = ", ".join(f"{value:.2f}" for value in zones.family_linear)
    inverse = ", ".join(f"{value:.2f}" for value in zones.family_inverse)
    true = ", ".join(f"{value:g}" for value in FAMILY_DE)
    rms = float(np.sqrt(np.mean((zones.family_linear - np.array(FAMILY_DE)) ** 2)))
    _, stand_de = stand_deformability()
    return [
        Claim(
            "Fig. 7",
            "static contact zones of S1 to S24",
            "picture, 0 to 180 deg",
            f"{zones.zone_deg.min():.1f} to {zones.zone_deg.max():.1f} deg, S11 the widest",
            Verdict.NO_NUMBER,
            "S16 as printed, k_phi 14.26; almost surely 1426",
        ),
        Claim(
            "Fig. 7",
            "de = zone/100 deg",
            f"de {true}",
            f"reads back {linear}; the inverse of Eq. 7 {inverse}",
            Verdict.NOT_REPRODUCED if rms > 0.05 else Verdict.REPRODUCED,
            "the rule contradicts the paper's own Eq. 7",
        ),
        Claim(
            "Sec. 5.1",
            "de of S11",
            "0.9",
            f"{zones.de_inverse[s11]:.2f} (stand's wheel: {stand_de:.2f}); linear rule {zones.de_linear[s11]:.2f}",
            Verdict.REPRODUCED if abs(zones.de_inverse[s11] - 0.9) < 0.05 else Verdict.NOT_REPRODUCED,
            "by neither rule",
        ),
    ]


def _flow_claims(found: Findings) -> list[Claim]:
    result = []
    for sand, runs in found.flows.items():
        slow, fast = (
            np.array([run.entering + run.leaving for run in runs if run.speed_mps == speed]) for speed in (0.01, 0.1)
        )
        ratios = [run.ratio for run in runs if run.speed_mps == 0.1]
        agreement = [run.nodes_entering / run.entering for run in runs if run.entering > 1e-4 and run.slip <= 0.3]
        critical = next((slip for slip, ratio in zip(SWEPT_SLIPS, ratios, strict=True) if ratio < 1.0), None)
        said = "never" if critical is None else f"first at slip {critical:g}"
        result.append(
            Claim(
                "Fig. 9",
                f"soil flow of 18 runs, {sand} sand",
                "picture",
                f"vc at slip {', '.join(f'{s:g}' for s in SWEPT_SLIPS)}: {', '.join(f'{r:.2f}' for r in ratios)}; "
                f"below 1 {said}; flow at 0.1 m/s is {np.median(fast / slow):.1f} x that at 0.01 m/s",
                Verdict.NO_NUMBER,
                f"nodes' M_ent over the closed form's, slip to 0.3: {min(agreement):.2f} to {max(agreement):.2f}",
            )
        )
    return result


def _uncontrolled_claims(found: Findings) -> list[Claim]:
    free = found.runs["free wheel 0 N"]
    force = np.array(free["force_n"])
    moving = np.flatnonzero(np.abs(force) > _STILL_N)
    settled_ms = 1e3 * free["time_s"][int(moving[-1])] if moving.size else 0.0
    speed = free["speed_mps"][-1]
    stated = [member for sand in ("trapping", "refilling") for member in found.members(sand, UNCONTROLLED)]
    weak = found.members("weak", UNCONTROLLED)
    stood, stood_weak = len(stated) - kept_going(stated), len(weak) - kept_going(weak)
    verdict = Verdict.NOT_REPRODUCED
    if stood > 0.5 * len(stated):
        verdict = Verdict.REPRODUCED
    elif stood_weak > 0.5 * len(weak):
        verdict = Verdict.CHANGED
    return [
        Claim(
            "Fig. 12(b)",
            "force of the uncontrolled wheel",
            "a peak, then 0 after 0.1 s: stuck",
            f"peak {force.max():.0f} N, below {_STILL_N:g} N after {settled_ms:.0f} ms; it rolls at {speed:.2f} m/s",
            Verdict.NOT_PHYSICAL if speed > 0.2 else Verdict.NOT_REPRODUCED,
            "a free wheel of 1 kg reaches rolling speed, and then nothing is left to accelerate",
        ),
        Claim(
            "Fig. 12(a)",
            "2 rad/s without sensor",
            "sticks in the sand",
            f"stands in {stood} of {len(stated)} at the stated load, in {stood_weak} of {len(weak)} on weaker sand",
            verdict,
            f"on weaker sand it is in by {spread(weak, 'largest_sinkage_mm').said('mm')}",
        ),
    ]


def _controlled_claims(found: Findings) -> list[Claim]:
    result = []
    for sand in ("trapping", "refilling"):
        members = found.members(sand, SOIL_FLOW)
        number, well = len(members), in_stated_sinkage(members)
        others = min(in_stated_sinkage(found.members(sand, name)) for name in BASELINES)
        median = spread(members, "steady_sinkage_mm")
        least, most = SINKAGE_STATED_MM
        result.append(
            Claim(
                "Figs 13, 14(d)",
                f"sinkage at 38-50 N, {sand} sand",
                "3 to 4 cm",
                f"{median.said('mm')}; within, and never standing: {well} of {number}",
                Verdict.CHANGED if least <= median.median <= most and well > 0.5 * number else Verdict.NOT_REPRODUCED,
                f"assumed st 0.6, r = b = 0.20 m, digging; every baseline has it in {others} or more",
            )
        )
    stated = [member for sand in ("trapping", "refilling") for member in found.members(sand, SOIL_FLOW)]
    weak, weak_plain = found.members("weak", SOIL_FLOW), found.members("weak", UNCONTROLLED)
    pulls = spread(stated, "pull_n")
    inside = FORCE_STATED_N[0] - 1.0 <= pulls.least and pulls.most <= FORCE_STATED_N[1] + 1.0
    result += [
        Claim(
            "Figs 13, 14",
            "the controlled wheel",
            "does not stick",
            f"keeps going in {kept_going(stated)} of {len(stated)} at the stated load",
            Verdict.CHANGED if kept_going(stated) > 0.9 * len(stated) else Verdict.NOT_REPRODUCED,
            f"so does the uncontrolled one there, in {_uncontrolled_going(found)}",
        ),
        Claim(
            "Sec. 3",
            "vc >= 1 guarantees that it does not halt",
            "always",
            f"on weaker sand it keeps going in {kept_going(weak)} of {len(weak)}, uncontrolled in "
            f"{kept_going(weak_plain)}",
            Verdict.REPRODUCED if kept_going(weak) == len(weak) else Verdict.NOT_REPRODUCED,
            f"overload stops a wheel whatever flows; it stops at {spread(weak, 'largest_sinkage_mm').said('mm')}, "
            f"the uncontrolled one is in by {spread(weak_plain, 'largest_sinkage_mm').said('mm')}",
        ),
        Claim(
            "Fig. 14(e)",
            "horizontal force",
            "38 N, up to 50 N",
            pulls.said("N", 1),
            Verdict.CHANGED if inside else Verdict.NOT_REPRODUCED,
            "it is the load put in: a wheel at steady speed pulls what it is loaded with, whoever controls it",
        ),
        _less_sinkage(found),
        _speed_claim(found),
    ]
    return result


def _uncontrolled_going(found: Findings) -> str:
    members = [member for sand in ("trapping", "refilling") for member in found.members(sand, UNCONTROLLED)]
    return f"{kept_going(members)} of {len(members)}"


def _less_sinkage(found: Findings) -> Claim:
    pairs = [
        (one["steady_sinkage_mm"], other["steady_sinkage_mm"])
        for sand in ("trapping", "refilling")
        for one, other in zip(found.members(sand, SOIL_FLOW), found.members(sand, UNCONTROLLED), strict=True)
    ]
    gain = np.array([other - one for one, other in pairs])
    return Claim(
        "Fig. 14(a), (d)",
        "sinkage with control against without",
        "decreases",
        f"less by {np.median(gain):.2f} mm ({gain.min():.2f} to {gain.max():.2f}), member by member",
        Verdict.REPRODUCED if np.median(gain) > 1.0 else Verdict.NOT_REPRODUCED,
        "at a steady load the slip, and with it the rut, is set by the load",
    )


def _speed_claim(found: Findings) -> Claim:
    trace = found.runs[f"reference trapping {SOIL_FLOW}"]["trace"]
    time_s, command = np.array(trace["time_s"]), np.array(trace["command_radps"])
    early = time_s <= START_S
    peak = int(np.argmax(command[early]))
    after = command[(time_s > time_s[peak]) & early]
    least = float(after.min()) if after.size else float(command[peak])
    dropped = least < 0.9 * command[peak]
    return Claim(
        "Fig. 14(b)",
        "angular velocity",
        "rises until 0.6 s, then drops: vc leaves its range",
        f"highest at {time_s[peak]:.1f} s with {command[peak]:.2f} rad/s, then {least:.2f} rad/s, at the end "
        f"{command[-1]:.2f} rad/s",
        Verdict.CHANGED if dropped else Verdict.NOT_REPRODUCED,
        "what ramps the wheel up here is the creep speed of a standing start",
    )


def family_tables(found: Findings) -> list[PlainTable]:
    """Per sand, every controller: outcomes, sinkage, force."""
    headings = (
        "controller", "runs", "kept going", "and 30-40 mm", "sinkage mm", "deepest mm", "pull N", "end m/s", "way m",
        "stalls",
    )  # fmt: skip
    tables = []
    for sand in SANDS.values():
        rows = []
        for controller in BASELINES:
            members = found.members(sand.name, controller)
            if not members:
                continue
            sinkage, deepest = spread(members, "steady_sinkage_mm"), spread(members, "largest_sinkage_mm")
            rows.append(
                (
                    controller,
                    str(len(members)),
                    str(kept_going(members)),
                    str(in_stated_sinkage(members)),
                    _range(sinkage, 1),
                    _range(deepest, 0),
                    _range(spread(members, "pull_n"), 1),
                    _range(spread(members, "final_speed_mps"), 2),
                    _range(spread(members, "distance_m"), 1),
                    str(sum(int(member["stalls"]) for member in members)),
                )
            )
        tables.append(PlainTable(f"{sand.title}: median (least to most)", headings, tuple(rows)))
    return tables


def _range(of: Spread, digits: int) -> str:
    return f"{of.median:.{digits}f} ({of.least:.{digits}f}-{of.most:.{digits}f})"


def flow_tables(flows: Mapping[str, Sequence[HeldFlow]]) -> list[PlainTable]:
    """Fig. 9 as numbers: 18 runs per sand."""
    headings = (
        "m/s, slip", "theta_1 deg", "theta_2 deg", "z mm", "pull N", "M_ent g/s", "by nodes", "M_out g/s", "by nodes",
        "vc",
    )  # fmt: skip
    tables = []
    for sand, runs in flows.items():
        rows = tuple(
            (
                f"{run.speed_mps:g}, {run.slip:g}",
                f"{run.theta_1_deg:.1f}",
                f"{run.theta_2_deg:.1f}",
                f"{run.sinkage_mm:.1f}",
                f"{run.drawbar_pull_n:.1f}",
                f"{1e3 * run.entering:.3f}",
                f"{1e3 * run.nodes_entering:.3f}",
                f"{1e3 * run.leaving:.3f}",
                f"{1e3 * run.nodes_leaving:.3f}",
                f"{run.ratio:.2f}",
            )
            for run in runs
        )
        tables.append(PlainTable(f"Fig. 9, soil flow at held slip, {sand} sand", headings, rows))
    return tables


def unbalanced_energy(found: Findings) -> list[str]:
    """Keys of the drives whose motors did less work on the wheel than the wheel did on its load."""
    return [
        key for key, run in found.runs.items() if "wheel_work_j" in run and run["wheel_work_j"] < run["load_work_j"]
    ]
