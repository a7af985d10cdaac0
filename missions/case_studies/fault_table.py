"""What the study of faults on the live graph found, as tables for the terminal and as markdown: pure."""

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from missions.case_studies.fault_schedule import EVERY_BOARD, SILENCING
from missions.case_studies.fault_soak import SoakReport
from missions.case_studies.kill_trials import RECORDER, KillTrial
from missions.case_studies.line_trials import LineTrial
from missions.case_studies.plain_table import PlainTable
from sim_bridge.line_faults import LineFault

STOP_LIMIT_MS = 150.0
REPLUG_LIMIT_MS = 500.0
RESTART_LIMIT_MS = 3000.0
"""Of a board that is reset, and of a node that is killed."""
MOST_FRAMES = 0.5
"""A fault that lets more than this share of the frames through must not stop the rover."""
_NOTHING = "-"
_SILENCING = frozenset(fault.value for fault in SILENCING)


@dataclass(frozen=True, slots=True)
class Claim:
    """One figure that was asked for, beside what was measured."""

    what: str
    asked: str
    measured: str
    is_met: bool


def claims(
    line: Sequence[LineTrial],
    kills: Sequence[KillTrial],
    soak: SoakReport | None,
    frames: Mapping[str, int],
    graph_problems: Sequence[str],
) -> list[Claim]:
    """Every figure asked for of which something was measured."""
    found = [
        *_line_claims(line),
        *_frame_claims(frames),
        *_kill_claims(kills),
    ]
    if soak is not None:
        stopped = [spell for spell in soak.spells if spell.stopped]
        slowest = soak.slowest_recovery_ms
        back = f"{sum(spell.recovered for spell in stopped)} of {len(stopped)} times it had stopped"
        if slowest is not None:
            back += f", slowest {slowest:.0f} ms"
        found += [
            _counted("soak: the same processes from the first second to the last", [soak.same_processes]),
            _counted("soak: the rover drives in the last seconds", [soak.drove_at_end]),
            Claim("soak: the rover drives again after a fault", "always", back, all(s.recovered for s in stopped)),
        ]
    if found:
        measured = "; ".join(graph_problems) or "none"
        found.append(
            Claim("nodes that died by themselves, tracebacks, exit codes but 0", "none", measured, not graph_problems)
        )
    return found


def claims_table(found: Iterable[Claim]) -> PlainTable:
    """Asked, measured, and yes or NO."""
    rows = tuple((one.what, one.asked, one.measured, "yes" if one.is_met else "NO") for one in found)
    return PlainTable("Asked and measured", ("what", "asked", "measured", "met"), rows)


def line_table(trials: Sequence[LineTrial]) -> PlainTable:
    """What became of the rover: one row per fault, share, boards struck and boot time."""
    rows = []
    for (name, where), group in _grouped(trials).items():
        good = [trial.good_share for trial in group if trial.good_share is not None]
        rows.append(
            (
                name,
                where,
                str(len(group)),
                f"{100.0 * statistics.mean(good):.0f}" if good else _NOTHING,
                str(sum(trial.to_zero_ms is not None for trial in group)),
                spread([trial.to_zero_ms for trial in group]),
                spread([trial.to_first_frame_ms for trial in group]),
                spread([trial.to_usable_ms for trial in group]),
                spread([trial.to_driving_ms for trial in group]),
            )
        )
    headings = "fault", "on", "n", "good %", "stops", "zero", "frame", "straps", "drives"
    return PlainTable("One fault of the line at a time [ms, median / max]", headings, tuple(rows))


def notice_table(trials: Sequence[LineTrial]) -> PlainTable:
    """What noticed each fault, and how wrong angles were that were called valid."""
    rows = tuple(
        (name, where, _noticed_by(group), spread([trial.angle_rms_deg for trial in group], 2),
         spread([trial.angle_max_deg for trial in group], 1))
        for (name, where), group in _grouped(trials).items()
    )  # fmt: skip
    headings = "fault", "on", "noticed by", "angles rms [deg]", "angles max [deg]"
    return PlainTable("What noticed it [median / max]", headings, rows)


def _grouped(trials: Sequence[LineTrial]) -> dict[tuple[str, str], list[LineTrial]]:
    """Trials of a kind, by name and boards."""
    groups: dict[tuple[str, str], list[LineTrial]] = {}
    for trial in trials:
        name = trial.fault if trial.share == 1.0 else f"{trial.fault} {trial.share:g}"
        if trial.boot_s:
            name += f", {trial.boot_s:g} s boot"
        groups.setdefault((name, "all" if trial.board == EVERY_BOARD else "one"), []).append(trial)
    return groups


def kill_table(trials: Sequence[KillTrial]) -> PlainTable:
    """One row per node."""
    rows = []
    for node in dict.fromkeys(trial.node for trial in trials):
        group = [trial for trial in trials if trial.node == node]
        driving = "drives on" if all(trial.drove_on for trial in group) else ""
        rows.append(
            (
                node,
                str(len(group)),
                driving or spread([trial.to_zero_ms for trial in group]),
                spread([trial.to_falling_ms for trial in group]),
                spread([trial.to_standing_ms for trial in group]),
                spread([trial.to_start_ms for trial in group]),
                spread([trial.start_to_message_ms for trial in group]),
                driving or spread([trial.start_to_driving_ms for trial in group]),
            )
        )
    headings = "node", "n", "zero", "slower", "stands", "start", "heard", "drives"
    return PlainTable("One node killed [ms, median / max]", headings, tuple(rows))


def soak_table(soak: SoakReport) -> PlainTable:
    """The soak, a line each."""
    slowest = soak.slowest_recovery_ms
    rows = [
        ("length, of which some fault was on [s]", f"{soak.duration_s:.0f}, {soak.faulty_s:.0f}"),
        ("faults, of which stopped the rover", f"{len(soak.spells)}, {sum(one.stopped for one in soak.spells)}"),
        ("slowest from the end of a fault to driving [ms]", _NOTHING if slowest is None else f"{slowest:.0f}"),
        ("way [m]", f"{soak.distance_m:.1f}"),
        ("frames accepted", str(soak.frames)),
        ("counted by the driver", ", ".join(f"{name} {count}" for name, count in soak.counters.items()) or _NOTHING),
    ]
    for node, late in soak.resident_late_mb.items():
        early = soak.resident_early_mb.get(node, 0.0)
        rows.append((f"memory of {node} after {soak.early_s:g} s and at the end [MB]", f"{early:.1f}, {late:.1f}"))
    return PlainTable("Soak", ("what", "measured"), tuple(rows))


def spread(values: Iterable[float | None], decimals: int = 0) -> str:
    """Median and largest of those that are there; of a single one itself."""
    known = [value for value in values if value is not None]
    if len(known) < 2:
        return f"{known[0]:.{decimals}f}" if known else _NOTHING
    return f"{statistics.median(known):.{decimals}f} / {max(known):.{decimals}f}"


def _line_claims(line: Sequence[LineTrial]) -> list[Claim]:
    silenced = [trial for trial in line if trial.fault in _SILENCING]
    partial = [trial for trial in line if trial.good_share is not None and trial.good_share > MOST_FRAMES]
    found = []
    if line:
        found.append(_counted("every fault of the line is noticed", [trial.noticed for trial in line]))
    if silenced:
        found.append(
            _limited(
                "a board falls silent: last good frame to all wheels at zero [ms]",
                STOP_LIMIT_MS,
                [trial.to_zero_ms for trial in silenced],
            )
        )
    if partial:
        what = f"more than {100.0 * MOST_FRAMES:.0f} % of the frames come through: the rover drives on"
        found.append(_counted(what, [trial.to_zero_ms is None for trial in partial]))
    unplugged = [trial for trial in line if trial.fault == LineFault.UNPLUG.value and not trial.boot_s]
    if unplugged:
        found.append(
            _limited(
                "plugged in again: to the first good frame [ms]",
                REPLUG_LIMIT_MS,
                [trial.to_first_frame_ms for trial in unplugged],
            )
        )
    for boot_s in sorted({trial.boot_s for trial in line}):
        resets = [trial for trial in line if trial.fault == LineFault.RESET.value and trial.boot_s == boot_s]
        if resets:
            what = f"a board is reset, and boots for {boot_s:g} s: to the first good frame [ms]"
            found.append(_limited(what, RESTART_LIMIT_MS, [trial.to_first_frame_ms for trial in resets]))
    return found


def _frame_claims(frames: Mapping[str, int]) -> list[Claim]:
    if not frames.get("accepted"):
        return []
    of = f"of {frames['accepted']}"
    return [
        Claim("frames accepted that no board sent", "0", f"{frames['wrong']} {of}", not frames["wrong"]),
        Claim("scans accepted twice", "0", f"{frames['repeated']} {of}", not frames["repeated"]),
    ]


def _kill_claims(kills: Sequence[KillTrial]) -> list[Claim]:
    found = []
    for node in dict.fromkeys(trial.node for trial in kills):
        group = [trial for trial in kills if trial.node == node]
        if node == RECORDER:
            found.append(_counted("recorder killed: the rover drives on", [trial.drove_on for trial in group]))
            found.append(_counted("recorder killed: a new bag begins", [trial.begun_bags > 1 for trial in group]))
            what, times = "recorder killed: new process to its first message [ms]", _of_message
        else:
            what, times = f"{node} killed: new process to driving again [ms]", _of_driving
        found.append(_limited(what, RESTART_LIMIT_MS, [times(trial) for trial in group]))
    return found


def _of_message(trial: KillTrial) -> float | None:
    return trial.start_to_message_ms


def _of_driving(trial: KillTrial) -> float | None:
    return trial.start_to_driving_ms


def _limited(what: str, limit_ms: float, values: Sequence[float | None]) -> Claim:
    """Every one of `values` must be there and within the limit."""
    missing = sum(value is None for value in values)
    measured = f"{spread(values)}, n = {len(values)}" + (f", {missing} never" if missing else "")
    is_met = not missing and all(value is not None and value <= limit_ms for value in values)
    return Claim(what, f"<= {limit_ms:.0f}", measured, is_met)


def _counted(what: str, held: Sequence[bool]) -> Claim:
    """It must have held every time."""
    return Claim(what, "always", f"{sum(held)} of {len(held)}", all(held))


def _noticed_by(group: Sequence[LineTrial]) -> str:
    names = _union(group, lambda trial: trial.counters) + _union(group, lambda trial: trial.line_states)
    names += _union(group, lambda trial: trial.statuses) + _union(group, lambda trial: trial.controller_faults)
    return ", ".join(names) or "NOBODY"


def _union(group: Sequence[LineTrial], names: Callable[[LineTrial], Iterable[str]]) -> list[str]:
    return list(dict.fromkeys(name for trial in group for name in names(trial)))
