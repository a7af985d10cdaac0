"""What is kept of one run of the early-warning study: the drive, every score beside it, and how it ended.

Scores are judged after the run, by nothing but this record: whoever scores cannot look into the plant.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from strap_rover.arrays import FloatArray

SCOUT_Z = "scout_z"
"""Halting score of the estimator's scout margin; no answer of the estimator: 0."""
SCOUT_Z_RETURN = "scout_z_return"
"""The same of the way back out."""
VERDICT = "verdict"
"""The estimator's ForecastVerdict as a number: a category, not a score."""
SLIP_LOWPASS = "slip_lowpass"
"""Mean measured slip of the wheels, low-passed over 0.3 s."""
ODOMETRY_WINDOW = "odom_window"
"""1 - way by odometry over way of the rim, low-passed over 0.1 m of rim travel: command against odometry."""
THETA_1_FRONT = "theta_1_front"
"""Measured entry angle [rad] of the front wheels, mean, low-passed over 0.05 m of rim travel."""
VC = "vc"
"""Minus the critical flow ratio of the front wheels, low-passed over 0.05 m of rim travel: more is worse."""
DE_TRUE = "de_true"
"""De of the family's soil under the front wheels; NaN where the soil is none of that family, or changes."""
ST_TRUE = "st_true"
DE_ESTIMATED = "de_estimated"
"""De that the estimator says of the left front wheel; likewise st."""
ST_ESTIMATED = "st_estimated"
DE_STD = "de_std"
ST_STD = "st_std"
ALARM_SCORES = (SCOUT_Z, SCOUT_Z_RETURN, SLIP_LOWPASS, ODOMETRY_WINDOW, THETA_1_FRONT, VC)
"""Scores in which more is worse, so that a threshold makes an alarm of them."""
SCORES = (*ALARM_SCORES, VERDICT, DE_TRUE, ST_TRUE, DE_ESTIMATED, ST_ESTIMATED, DE_STD, ST_STD)
"""Every name that a trace holds."""


class Ending(Enum):
    """How a run ended."""

    PASSED = "passed"
    """Reached the goal."""
    BACKED_OUT = "backed out"
    """The controller stopped for what it foresaw, and drove back out (where it is set to; else it just stands)."""
    HALTED = "halted"
    """No progress: 0.1 m of way in 2.5 m of rim travel, or a controller that gave up after its retries."""
    STUCK = "stuck"
    """The controller wanted back out and could not."""
    BURIED = "buried"
    """A wheel stands in the sand up to its hub."""
    UNDECIDED = "undecided"
    """Still under way when the time was over."""


@dataclass(frozen=True, slots=True)
class TraceFacts:
    """How a run ended, and what about it is known from outside."""

    ending: Ending
    halted: bool
    """Whether the rover came to a halt by itself: HALTED, STUCK or BURIED."""
    halt_row: int
    """Last row with v > 0.1 r omega before the halt; -1 where it did not halt."""
    hazard_x_m: float
    """x at which the first wheel touches the hazard: the soft patch, or a slope that is steeper than 3 deg."""
    snag_time_s: float = math.nan
    """When the snag caught; NaN without a snag, or where the rover did not come so far."""
    snag_release_s: float = math.nan
    """When it let go."""
    stop_sinkage_m: float = math.nan
    """Deepest wheel when the controller stopped for good; NaN where it did not (nor did the rover halt)."""
    deepest_m: float = 0.0
    """Deepest any wheel stood at any time."""
    retries: int = 0
    """Stalls of the controller."""
    reason: str = ""
    """What the controller said of its last mode."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One run, one row per sample (20 Hz); arrays of shape (N,)."""

    family: str
    """A, B, C or D."""
    number: int
    """Of the member in its family."""
    kind: str
    """Kind of sand: `trapping` or `refilling`."""
    variant: str
    """`plain`, `snag`, `counterfactual` (the snag's member without its snag) or `dip`."""
    time_s: FloatArray
    """Since the rover was asked to drive, after 0.5 s of standing."""
    x_m: FloatArray
    """Of the front axle, true."""
    speed_mps: FloatArray
    """Of the body, true."""
    rim_m: FloatArray
    """Way of the rims, mean over the wheels, never falling: a wheel that turns back adds to it."""
    sinkage_m: FloatArray
    """Of the deepest wheel, true."""
    omega_radps: FloatArray
    """Mean over the wheels, true."""
    slip: FloatArray
    """Mean over the wheels, true."""
    scores: Mapping[str, FloatArray]
    """Name (one of SCORES) -> value per row."""
    facts: TraceFacts
