"""Every case study by name, each called in the same way."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from rich.console import Console

Study = Callable[[Path, Console, Callable[[], bool], bool, int | None], bool]
"""(folder, console, stopped, short, runs) -> whether it came to its end, and well; `runs` None: as many as it likes."""


def _mars_snag(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.mars_snag import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, runs or (1 if short else 100), console, stopped, short=short)


def _single_wheel(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.single_wheel import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, members=runs)


def _mars_rover(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.mars_rover import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, runs=runs)


def _live_endurance(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.live_endurance import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, runs=runs)


def _live_faults(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.live_faults import FULL, SHORT, run_live_faults, with_rounds  # noqa: PLC0415

    form = SHORT if short else FULL
    return run_live_faults(folder, console, stopped, form=form if runs is None else with_rounds(form, runs)).is_good


def _slip_sinkage(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.slip_sinkage import SHORT_STARTS, STARTS, run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, starts=runs or (SHORT_STARTS if short else STARTS), is_short=short)


def _strap_bench(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.strap_bench import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, straps=runs or (2 if short else 20))


def _strap_faults(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.strap_faults import FRAMES, SHORT_FRAMES, run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, frames=runs or (SHORT_FRAMES if short else FRAMES))


def _soil_identification(
    folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None
) -> bool:
    from missions.case_studies.soil_identification import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, runs=runs)


def _graph_memory(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.graph_memory import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, minutes=runs)


def _early_warning(folder: Path, console: Console, stopped: Callable[[], bool], short: bool, runs: int | None) -> bool:
    from missions.case_studies.early_warning import run_study  # noqa: PLC0415 - only needed here

    return run_study(folder, console, stopped, short=short, members=runs)


STUDIES: Mapping[str, Study] = MappingProxyType(
    {
        "single_wheel": _single_wheel,
        "mars_rover": _mars_rover,
        "mars_snag": _mars_snag,
        "early_warning": _early_warning,
        "slip_sinkage": _slip_sinkage,
        "strap_bench": _strap_bench,
        "strap_faults": _strap_faults,
        "live_endurance": _live_endurance,
        "live_faults": _live_faults,
        "soil_identification": _soil_identification,
        "graph_memory": _graph_memory,
    }
)
"""In the order in which `all` runs them."""
