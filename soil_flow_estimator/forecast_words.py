"""The halting forecast in words for whoever drives."""

from soil_flow_estimator.soil_state import ForecastVerdict, SoilState

NO_WAY_BACK_Z = 1.0
"""`scout_z_return` above which the way back counts as not climbable: its margin is short by more than its 1-sigma."""

_WARNED = frozenset({ForecastVerdict.CAUTION, ForecastVerdict.STOP, ForecastVerdict.SLIPPING, ForecastVerdict.SNAG})


def forecast_verdict(state: SoilState) -> ForecastVerdict:
    """The verdict of a state; NONE for a code that this version does not know."""
    known = state.scout_verdict in ForecastVerdict.__members__.values()
    return ForecastVerdict(state.scout_verdict) if known else ForecastVerdict.NONE


def is_way_back_closed(state: SoilState) -> bool:
    """Whether the rover could not climb back over what it now stands in."""
    return forecast_verdict(state) is not ForecastVerdict.NONE and state.scout_z_return > NO_WAY_BACK_Z


def is_warning(state: SoilState) -> bool:
    """Whether the operator should hear of it."""
    return forecast_verdict(state) in _WARNED or is_way_back_closed(state)


def forecast_words(state: SoilState) -> str:
    """What the forecast says and what to do, in one sentence or two; forces in N."""
    words = _verdict_words(state)
    if is_way_back_closed(state):
        words += "; the way back would not be climbable: go no further"
    return words


def _verdict_words(state: SoilState) -> str:
    match forecast_verdict(state):
        case ForecastVerdict.CLEAR:
            return f"the soil ahead carries the rover on ({_margin(state)})"
        case ForecastVerdict.CAUTION:
            return f"the margin is spent ({_margin(state)}): drive on with care"
        case ForecastVerdict.STOP:
            return (
                "the soil ahead is too soft: the rover would halt once all its wheels are in it "
                f"({_margin(state)}); stop and back out"
            )
        case ForecastVerdict.SLIPPING:
            return "the wheels slip away: stop before they dig themselves in"
        case ForecastVerdict.SNAG:
            return (
                f"something holds the rover back (about {max(state.scout_disturbance, 0.0):.0f} N): "
                "ease off and wait, or go round"
            )
        case ForecastVerdict.NONE:
            return "no forecast yet: it takes a rolling rover and its imu"


def _margin(state: SoilState) -> str:
    """E.g. `120 N +- 80 N to spare`, `short of 120 N +- 80 N`."""
    force = f"{abs(state.scout_margin):.0f} N +- {state.scout_margin_std:.0f} N"
    return f"short of {force}" if state.scout_margin < 0.0 else f"{force} to spare"
