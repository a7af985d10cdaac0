"""What the halting forecast asks the controller to do, held against a single odd estimate."""

from soil_flow_estimator.soil_state import ForecastVerdict, SoilState

STATES_RUNNING = 2
"""Caution and the way back are heeded once so many soil states running say so. One is enough to stop, for
which the estimator has waited itself, and to slip, which it judges by a low-pass."""


class ForecastWatch:
    """The last soil states' view of the way ahead and of the way back."""

    def __init__(self, return_z_max: float) -> None:
        self.retune(return_z_max)
        self.forget()

    def retune(self, return_z_max: float) -> None:
        """Judge the way back by another bound from the next soil state on; 0: not at all."""
        self._return_z_max = return_z_max

    def forget(self) -> None:
        """Nothing has been foreseen."""
        self._verdict = int(ForecastVerdict.NONE)
        self._cautious_states = 0
        self._trapped_states = 0

    def take(self, soil: SoilState) -> None:
        """Take a soil state that follows the last one without a gap."""
        self._verdict = soil.scout_verdict
        self._cautious_states = self._cautious_states + 1 if self._verdict == ForecastVerdict.CAUTION else 0
        is_known = self._verdict != ForecastVerdict.NONE
        is_trap = is_known and 0.0 < self._return_z_max < soil.scout_z_return
        self._trapped_states = self._trapped_states + 1 if is_trap else 0

    @property
    def halts_ahead(self) -> bool:
        """The soil ahead would halt the rover."""
        return self._verdict == ForecastVerdict.STOP

    @property
    def slips(self) -> bool:
        """The wheels slip away already."""
        return self._verdict == ForecastVerdict.SLIPPING

    @property
    def is_cautious(self) -> bool:
        """The margin is spent, though not beyond its uncertainty."""
        return self._cautious_states >= STATES_RUNNING

    @property
    def no_way_back(self) -> bool:
        """The way back would not be climbable."""
        return self._trapped_states >= STATES_RUNNING
