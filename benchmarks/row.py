"""One line of the result: what was measured, beside what, and whether that is what was asked."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal


@dataclass(frozen=True, slots=True)
class Goal:
    """What the ratio should be. `unit` "x" says times, "%" says a share of the reference."""

    sense: Literal[">=", "<="]
    value: float
    unit: Literal["x", "%"] = "x"

    def __str__(self) -> str:
        return f"{self.sense} {ratio_text(self.value, self.unit)}"

    def is_met(self, ratio: float) -> bool:
        """Whether a ratio is on the right side."""
        return ratio >= self.value if self.sense == ">=" else ratio <= self.value


@dataclass(frozen=True, slots=True)
class Row:
    """The outcome of one benchmark. Ratios are judged; absolute numbers are for information."""

    name: str
    what: str
    ours: str
    reference: str
    ratios: tuple[float, ...] = ()
    """One per round: ours over the reference, by whatever `what` says is compared. Empty: nothing to compare with."""
    goal: Goal | None = None
    unit: Literal["x", "%"] = "x"
    notes: tuple[str, ...] = ()

    @property
    def ratio(self) -> float | None:
        """Median over the rounds."""
        return median(self.ratios) if self.ratios else None

    @property
    def met(self) -> bool | None:
        """None where no goal was set."""
        ratio = self.ratio
        return None if self.goal is None or ratio is None else self.goal.is_met(ratio)

    @property
    def verdict(self) -> str:
        """`met` in words."""
        return {True: "yes", False: "NO", None: ""}[self.met]

    @property
    def ratio_text(self) -> str:
        """Median and, of several rounds, the range."""
        if self.ratio is None:
            return ""
        text = ratio_text(self.ratio, self.unit)
        if len(self.ratios) == 1:
            return text
        return f"{text} ({figures(self._scaled(min(self.ratios)))} to {figures(self._scaled(max(self.ratios)))})"

    def _scaled(self, ratio: float) -> float:
        return 100.0 * ratio if self.unit == "%" else ratio


def ratio_text(ratio: float, unit: Literal["x", "%"]) -> str:
    """`13.6 x`, `4.2 %`."""
    return f"{figures(100.0 * ratio)} %" if unit == "%" else f"{figures(ratio)} x"


def figures(value: float) -> str:
    """Three significant figures, thousands set apart."""
    size = abs(value)
    digits = 0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 1.0 else 3
    rounded = round(value, -max(len(str(int(size))) - 3, 0)) if size >= 1000.0 else value
    return f"{rounded:,.{digits}f}".replace(",", " ")


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which `share` of all values lie, no interpolation."""
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)]
