"""The table of one end: resistance over the pull-down's at knots of the arc, rising and smooth, with an honest 1-sigma.

Generalised least squares: samples come in groups whose arcs err together (a turn of the wheel, a placing of the
presser). Between knots the table is linear, as `EndCurve` reads it. What no sample reaches is held by a prior: the
resistance per arc is a random walk along the strap, so that the 1-sigma grows from where samples end.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from strap_rover.arrays import FloatArray, IntArray
from strap_sensor_driver.strap import FULL_TURN_RAD

KNOTS = 31
"""One per 12 deg: a strap that changes by 5 % within a radian bends between knots by 0.03 deg."""
_SLOPE_WALK = 0.12
"""How the resistance per arc may change along a strap, 1-sigma, relative, per square root of a radian."""
_LEAST_RISE = 0.05
"""Of the mean rise from knot to knot: no strap is so conducting anywhere that less would be."""


@dataclass(frozen=True, slots=True, eq=False)
class ArcSamples:
    """Samples of one end whose arcs err together."""

    arc_rad: FloatArray
    """Arc from the end, shape (N,)."""
    ratio: FloatArray
    """Resistance over the pull-down's, shape (N,)."""
    ratio_std: FloatArray
    """1-sigma of each ratio by itself, shape (N,)."""
    arc_cov: FloatArray
    """Covariance of the errors of the arcs [rad^2], shape (N, N)."""


@dataclass(frozen=True, slots=True, eq=False)
class MonotoneTable:
    """What was fitted."""

    arc_rad: FloatArray
    """Knots, 0 to 2 pi, shape (K,)."""
    ratio: FloatArray
    """Rising, at least 0, shape (K,)."""
    arc_std_rad: FloatArray
    """1-sigma of the table as an arc, shape (K,)."""
    residuals_rad: tuple[FloatArray, ...]
    """Per group: arc of the table at the samples' ratio, less the samples' arc."""
    scatter: tuple[float, ...]
    """Per group: mean square of residuals over what was expected, correlations taken out; about 1."""

    @property
    def residual_rms_rad(self) -> float:
        """Root mean square over all samples."""
        return float(np.sqrt(np.mean(np.concatenate(self.residuals_rad) ** 2)))


def fit_table(groups: Sequence[ArcSamples], knots: int = KNOTS) -> MonotoneTable:
    """The table that fits `groups`; ValueError without two samples at different arcs, or when nothing rises."""
    arcs = np.concatenate([group.arc_rad for group in groups]) if groups else np.empty(0)
    ratios = np.concatenate([group.ratio for group in groups]) if groups else np.empty(0)
    if arcs.size < 2 or np.ptp(arcs) < 0.1:
        raise ValueError(f"{arcs.size} samples over {np.ptp(arcs) if arcs.size else 0.0:.2f} rad of arc: give more")
    slope = float(np.polyfit(arcs, ratios, 1)[0])
    if slope <= 0.0:
        raise ValueError("the resistance does not grow with the arc")
    at = np.linspace(0.0, FULL_TURN_RAD, knots)
    slopes = np.full(knots - 1, slope)
    for _ in range(3):  # the weights hold the slope, and the slope the weights; the second pass changes little
        ratio, precision, scatter = _solve(groups, at, slopes, slope)
        slopes = np.diff(ratio) / np.diff(at)
    excess = max(1.0, float(np.average(scatter, weights=[group.arc_rad.size for group in groups])))
    factor = cho_factor(precision)
    ratio_var = np.diag(cho_solve(factor, np.eye(knots))) * excess
    at_knots = np.concatenate([slopes[:1], 0.5 * (slopes[1:] + slopes[:-1]), slopes[-1:]])
    residuals = tuple(
        (group.ratio - np.interp(group.arc_rad, at, ratio)) / slopes[_interval(group.arc_rad, at)] for group in groups
    )
    return MonotoneTable(at, ratio, np.sqrt(ratio_var) / at_knots, residuals, scatter)


def _interval(arcs: FloatArray, at: FloatArray) -> IntArray:
    return np.asarray(np.clip(np.searchsorted(at, arcs, side="right") - 1, 0, at.size - 2), dtype=np.int64)


def _solve(
    groups: Sequence[ArcSamples], at: FloatArray, slopes: FloatArray, mean_slope: float
) -> tuple[FloatArray, FloatArray, tuple[float, ...]]:
    """(ratio at the knots, its precision matrix, mean square of the whitened residuals of each group)."""
    knots, step = at.size, at[1] - at[0]
    whitened = [_whitened(group, at, slopes) for group in groups]
    walk_std = _SLOPE_WALK * mean_slope * step**1.5
    bends = np.diff(np.eye(knots), n=2, axis=0) / walk_std
    rows = np.vstack([*(matrix for matrix, _ in whitened), bends])
    wanted = np.concatenate([*(values for _, values in whitened), np.zeros(knots - 2)])
    # Unknowns: the first value and the rises, none below its bound.
    rises = np.tril(np.ones((knots, knots)))
    lowest = np.full(knots, _LEAST_RISE * mean_slope * step)
    lowest[0] = 0.0
    orthogonal, triangle = np.linalg.qr(
        rows
    )  # as many rows as unknowns: the bounded solver goes over them again and again
    found = lsq_linear(triangle @ rises, orthogonal.T @ wanted, bounds=(lowest, np.inf), method="bvls").x
    ratio = rises @ found
    scatter = tuple(float(np.mean((matrix @ ratio - values) ** 2)) for matrix, values in whitened)
    return ratio, rows.T @ rows, scatter


def _whitened(group: ArcSamples, at: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows and values of a group's equations with errors of 1-sigma 1, none correlated."""
    interval = _interval(group.arc_rad, at)
    share = (group.arc_rad - at[interval]) / (at[1] - at[0])
    matrix = np.zeros((group.arc_rad.size, at.size))
    lines = np.arange(group.arc_rad.size)
    matrix[lines, interval] = 1.0 - share
    matrix[lines, interval + 1] = share
    slope = slopes[interval]
    covariance = np.diag(group.ratio_std**2) + group.arc_cov * np.outer(slope, slope)
    lower = np.linalg.cholesky(covariance)
    return solve_triangular(lower, matrix, lower=True), solve_triangular(lower, group.ratio, lower=True)
