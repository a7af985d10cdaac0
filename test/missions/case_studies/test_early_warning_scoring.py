import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.case_studies.early_warning_scoring import (
    Alarm,
    Judgement,
    Scale,
    ScoredRun,
    envelope_of,
    first_of,
    held,
    judge,
    leads_rim_m,
    rate_curve,
    score_alarms,
    score_runs,
    scored_run,
    snag_halts,
    threshold_at,
    truncated_auc,
)
from missions.case_studies.early_warning_trace import Ending, Trace, TraceFacts

ROW_S = 0.05
SPEED_MPS = 0.5
HAZARD_X_M = 3.0
SCALE = Scale(0.0, 0.1, 2.0)


def trace_of(
    scores,
    rows=400,
    halt_row=None,
    *,
    family="B",
    number=0,
    kind="trapping",
    variant="plain",
    snag_time_s=math.nan,
    hazard_x_m=HAZARD_X_M,
    ending=None,
    **facts,
):
    """`scores`: name -> values per row. Its way is 0.025 m per row until the halt, its rims turn 0.03 m per row."""
    row = np.arange(rows, dtype=float)
    moving = row if halt_row is None else np.minimum(row, halt_row)
    if ending is None:
        ending = Ending.PASSED if halt_row is None else Ending.HALTED
    return Trace(
        family,
        number,
        kind,
        variant,
        time_s=ROW_S * row,
        x_m=SPEED_MPS * ROW_S * moving,
        speed_mps=np.where(row <= moving, SPEED_MPS, 0.0),
        rim_m=0.03 * row,
        sinkage_m=np.full(rows, 0.03),
        omega_radps=np.full(rows, 2.4),
        slip=np.where(row <= moving, 1.0 / 6.0, 1.0),
        scores={name: np.asarray(values, dtype=float) for name, values in scores.items()},
        facts=TraceFacts(
            ending, halt_row is not None, -1 if halt_row is None else halt_row, hazard_x_m, snag_time_s, **facts
        ),
    )


def risen(row, rows=400, high=1.0, until=None):
    """A score of 0 that lies at `high` from a row on."""
    values = np.zeros(rows)
    values[row:until] = high
    return values


def run_of(values, halt_row=None, **told):
    trace = trace_of({"s": values}, len(values), halt_row, **told)
    return scored_run(trace, {"s": (trace.scores["s"], SCALE, True)})


def judged(values, halt_row=None, threshold=0.5, **told):
    run = run_of(values, halt_row, **told)
    return judge(run, run.envelopes["s"].alarm(threshold))


def test_an_alarm_is_two_samples_running():
    assert held(np.array([5.0, 1.0, 2.0, math.nan, 4.0, 4.0])).tolist() == [
        -math.inf,
        1.0,
        1.0,
        -math.inf,
        -math.inf,
        4.0,
    ]
    assert judged(risen(200, until=201))[0] is Judgement.QUIET
    assert judged(risen(200, until=202))[0] is Judgement.FALSE


def test_the_first_metre_is_free():
    assert judged(risen(0, until=40))[0] is Judgement.QUIET  # x is 1 m at row 40
    assert judged(risen(0, until=42))[0] is Judgement.FALSE


def test_an_alarm_in_time_has_its_lead():
    judgement, lead = judged(risen(150), halt_row=200)  # seen at row 151: x 3.775 m
    assert judgement is Judgement.IN_TIME
    assert lead.rim_m == pytest.approx(49 * 0.03)
    assert lead.way_m == pytest.approx(49 * 0.025)
    assert lead.time_s == pytest.approx(49 * 0.05)


@pytest.mark.parametrize(
    ("row", "halt_row", "judgement"),
    [
        (110, 200, Judgement.EARLY),  # x 2.775 m: no wheel touches the hazard at 3 m
        (115, 200, Judgement.IN_TIME),  # x 2.9 m: the rim does, ahead of its axle
        (140, 390, Judgement.EARLY),  # 6.225 m before the halt
        (150, 390, Judgement.IN_TIME),  # 5.975 m
        (198, 200, Judgement.IN_TIME),
        (199, 200, Judgement.MISSED),  # the second sample is the halt itself
        (230, 200, Judgement.MISSED),
    ],
)
def test_when_an_alarm_counts(row, halt_row, judgement):
    found, lead = judged(risen(row), halt_row)
    assert found is judgement
    assert (lead.rim_m > 0.0) == (judgement is Judgement.IN_TIME)


def test_no_alarm_is_a_missed_halt_or_a_quiet_pass():
    assert judged(np.zeros(400), 200)[0] is Judgement.MISSED
    assert judged(np.zeros(400))[0] is Judgement.QUIET


def test_after_a_snag_nothing_counts_from_before():
    assert judged(risen(150), 200, snag_time_s=8.0)[0] is Judgement.EARLY
    assert judged(risen(170), 200, snag_time_s=8.0)[0] is Judgement.IN_TIME
    assert judged(risen(50), 60, snag_time_s=2.0)[0] is Judgement.IN_TIME  # before the soft sand, and yet a snag


def full_alarm(trace, values, threshold):
    """What the envelope is to give, from the whole trace."""
    above = np.flatnonzero((held(values) > threshold) & (np.maximum.accumulate(trace.x_m) >= 1.0))
    return None if above.size == 0 else int(above[0])


@given(
    values=st.lists(
        st.floats(-1.0, 3.0) | st.sampled_from([0.1, 0.2, 0.30000000000000004, math.nan]), min_size=60, max_size=90
    ),
    level=st.integers(0, 20),
    between=st.floats(0.0, 1.0),
    halt_row=st.none() | st.integers(30, 59),
)
@settings(max_examples=150, deadline=None)
def test_the_envelope_alarms_as_the_whole_trace_does(values, level, between, halt_row):
    trace = trace_of({}, len(values), halt_row)
    values = np.array(values)
    envelope = envelope_of(trace, values, SCALE)
    levels = SCALE.levels()

    def row_of(threshold):
        alarm = envelope.alarm(threshold)
        return None if alarm is None else round(alarm.time_s / 0.05)

    assert row_of(levels[level]) == full_alarm(trace, values, levels[level])
    if level < 20 and between > 1e-6:  # between two levels: no earlier than the truth, no later than the next level
        threshold = levels[level] + between * (levels[level + 1] - levels[level])
        truth, later = full_alarm(trace, values, threshold), full_alarm(trace, values, levels[level + 1])
        assert row_of(threshold) == later
        assert truth is not None or later is None
        assert truth is None or later is None or truth <= later
    assert np.all(np.diff(envelope.passed) > 0)
    again = type(envelope).from_json(json.loads(json.dumps(envelope.to_json())), SCALE)
    assert again.passed.tolist() == envelope.passed.tolist()
    assert np.allclose(again.time_s, envelope.time_s, atol=6e-4)
    assert np.allclose(again.x_m, envelope.x_m, atol=6e-4)


def test_a_threshold_that_was_not_kept_is_refused():
    envelope = run_of(risen(150)).envelopes["s"]
    for threshold in (-0.1, 2.1):
        with pytest.raises(ValueError, match=r"lies outside of what was kept; choose 0 \.\. 2"):
            envelope.alarm(threshold)


def test_a_score_must_fit_its_trace():
    with pytest.raises(ValueError, match="one value per row"):
        envelope_of(trace_of({}, 50), np.zeros(49), SCALE)


def test_a_category_needs_no_second_sample():
    trace = trace_of({}, 400)
    once = risen(200, until=201)
    assert envelope_of(trace, once, SCALE, is_held=False).alarm(0.5) == Alarm(10.0, 6.0, 5.0)
    assert envelope_of(trace, once, SCALE).alarm(0.5) is None


def test_a_run_comes_back_from_the_ledger_as_it_was():
    for run in (run_of(risen(150), 200, snag_time_s=6.25), run_of(risen(150))):
        again = ScoredRun.from_json(json.loads(json.dumps(run.to_json(), allow_nan=False)), {"s": SCALE})
        assert again.to_json() == run.to_json()
        assert judge(again, again.envelopes["s"].alarm(0.5)) == judge(run, run.envelopes["s"].alarm(0.5))


def five_halts_and_four_passes():
    """Leads of 0.3, 0.6, 0.9 and 1.2 m and a miss; one false alarm in four passes of 9.975 m."""
    halts = [run_of(risen(199 - 10 * number), 200 + 0 * number, number=number) for number in (1, 2, 3, 4)]
    return [
        *halts,
        run_of(np.zeros(400), 200, number=5),
        run_of(risen(300), number=6),
        *[run_of(risen(300, high=0.4), number=number) for number in (7, 8, 9)],
    ]


def test_figures_by_hand():
    runs = five_halts_and_four_passes()
    scoring = score_runs(runs, "s", 0.5, draws=50)
    found = scoring.found
    assert (scoring.passes, scoring.halts) == (4, 5)
    assert found.false_rate == 0.25
    assert found.false_per_km == pytest.approx(1.0 / (4 * 9.975e-3))
    assert found.recall == 0.8
    assert found.recall_long == pytest.approx(3 / 5)
    assert found.early == 0.0
    assert found.lead_rim_m == pytest.approx(0.6)
    assert found.lead_rim_p10_m == pytest.approx(0.4 * 0.3)
    assert found.lead_way_m == pytest.approx(0.5)
    assert found.lead_time_s == pytest.approx(1.0)
    assert sorted(leads_rim_m(runs, "s", 0.5)) == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.2])
    assert scoring.low.recall < found.recall < scoring.high.recall <= 1.0
    assert scoring == score_runs(runs, "s", 0.5, draws=50)  # seeded


def test_an_interval_narrows_with_the_runs():
    runs = five_halts_and_four_passes()
    few, many = score_runs(runs, "s", 0.5), score_runs(runs * 16, "s", 0.5)
    assert few.found.recall == many.found.recall
    assert many.high.recall - many.low.recall < 0.5 * (few.high.recall - few.low.recall)


def test_nothing_but_passes_or_halts():
    runs = five_halts_and_four_passes()
    passes = score_runs([run for run in runs if run.halt is None], "s", 0.5, draws=5)
    assert (passes.halts, passes.found.recall, passes.found.lead_rim_m) == (0, 0.0, 0.0)
    halts = score_runs([run for run in runs if run.halt is not None], "s", 0.5, draws=5)
    assert (halts.passes, halts.found.false_rate, halts.found.false_per_km) == (0, 0.0, 0.0)
    assert score_runs([], "s", 0.5).passes == 0


def test_the_first_of_two_alarms_decides():
    early, late = Alarm(5.0, 3.0, 2.5), Alarm(6.0, 3.6, 3.0)
    assert first_of(late, None, early) is early
    assert first_of(None, late) is late
    assert first_of(None, None) is None
    runs = [run_of(risen(150), 200), run_of(np.zeros(400))]
    found = score_alarms(runs, [Alarm(9.0, 5.4, 4.5), None], draws=3).found
    assert (found.recall, found.false_rate, found.lead_rim_m) == (1.0, 0.0, pytest.approx(0.6))
    with pytest.raises(ValueError, match="zip"):
        score_alarms(runs, [None])


def test_the_threshold_at_a_rate_of_false_alarms():
    runs = [run_of(risen(200, high=0.15 * (number + 1)), number=number) for number in range(10)]  # 0.15 .. 1.5
    assert threshold_at(runs, "s", 0.2) == pytest.approx(1.2)
    assert threshold_at(runs, "s", 0.0) == pytest.approx(1.5)
    assert score_runs(runs, "s", threshold_at(runs, "s", 0.2), draws=1).found.false_rate == 0.2
    with pytest.raises(ValueError, match="no run passes"):
        threshold_at([run_of(risen(150), 200)], "s", 0.02)
    with pytest.raises(ValueError, match="widen its scale"):
        threshold_at([run_of(risen(150, high=5.0))], "s", 0.02)


def test_a_curve_falls_with_its_threshold():
    curve = rate_curve(five_halts_and_four_passes(), "s")
    assert curve.threshold == pytest.approx(SCALE.levels())
    assert curve.false_rate[3] == 1.0
    assert curve.false_rate[4] == curve.false_rate[9] == 0.25  # risen to 0.4 is not above 0.4
    assert curve.recall[5] == 0.8
    assert curve.recall[10] == 0.0
    assert np.all(np.diff(curve.false_rate) <= 0.0)


def test_how_well_half_a_metre_before_tells():
    runs = five_halts_and_four_passes()
    # 0.5 m before, three of five halts are at 1 and two at 0; passes reach 0.4, 0.4, 0.4 and 1
    assert truncated_auc(runs, "s", 0.5) == pytest.approx((3 * (3 + 0.5)) / 20)
    assert truncated_auc(runs, "s", 1.0) == pytest.approx((1 * 3.5) / 20)
    assert math.isnan(truncated_auc(runs[:5], "s", 0.5))


def test_a_halt_is_the_snags_where_the_member_passes_without_it():
    def snag(number, halt_row):
        return run_of(risen(170), halt_row, number=number, variant="snag", snag_time_s=8.0)

    def without(number, halt_row):
        return run_of(risen(170), halt_row, number=number, variant="counterfactual")

    runs = [snag(1, 200), snag(2, 200), snag(3, None), snag(4, 200)]
    found = snag_halts(runs, [without(1, None), without(2, 300), without(3, None)])
    assert [run.number for run in found] == [1]
    assert snag_halts(runs, [replace(without(1, None), kind="refilling")]) == []
