"""What an operator is told of the way ahead."""

import numpy as np
import pytest

from soil_flow_estimator.forecast_words import (
    forecast_verdict,
    forecast_words,
    is_warning,
    is_way_back_closed,
)
from soil_flow_estimator.soil_state import ForecastVerdict, SoilState


def state(verdict, margin=300.0, z_return=-2.0, disturbance=0.0):
    wheels = [np.zeros(6)] * 10
    return SoilState(
        0,
        *wheels,
        status=np.zeros(6, dtype=np.int64),
        scout_margin=margin,
        scout_margin_std=80.0,
        scout_z=-margin / 80.0,
        scout_z_return=z_return,
        scout_disturbance=disturbance,
        scout_verdict=int(verdict),
    )


@pytest.mark.parametrize(
    ("verdict", "margin", "said"),
    [
        (ForecastVerdict.CLEAR, 300.0, ("carries the rover on", "300 N +- 80 N to spare")),
        (ForecastVerdict.CAUTION, -20.0, ("margin is spent", "short of 20 N +- 80 N", "with care")),
        (ForecastVerdict.STOP, -120.0, ("would halt once all its wheels", "short of 120 N +- 80 N", "back out")),
        (ForecastVerdict.SLIPPING, 50.0, ("slip away", "stop before")),
        (ForecastVerdict.NONE, 0.0, ("no forecast yet",)),
    ],
)
def test_a_verdict_is_told_with_its_force_and_what_to_do(verdict, margin, said):
    words = forecast_words(state(verdict, margin))
    assert all(part in words for part in said), words


@pytest.mark.parametrize(("disturbance", "said"), [(612.3, "about 612 N"), (-40.0, "about 0 N")])
def test_a_snag_is_told_with_the_force_it_holds_by(disturbance, said):
    words = forecast_words(state(ForecastVerdict.SNAG, disturbance=disturbance))
    assert "something holds the rover back" in words
    assert said in words


def test_a_way_back_that_cannot_be_climbed_is_told_whatever_lies_ahead():
    closed = state(ForecastVerdict.CLEAR, z_return=1.2)
    assert is_way_back_closed(closed)
    assert "the way back would not be climbable" in forecast_words(closed)
    assert is_warning(closed)
    assert "way back" not in forecast_words(state(ForecastVerdict.STOP, z_return=0.9))


def test_only_what_asks_for_a_deed_is_a_warning():
    calm = {ForecastVerdict.NONE, ForecastVerdict.CLEAR}
    assert {verdict for verdict in ForecastVerdict if not is_warning(state(verdict))} == calm


def test_a_verdict_of_another_version_is_no_verdict():
    assert forecast_verdict(state(17)) is ForecastVerdict.NONE
    assert not is_warning(state(17))
