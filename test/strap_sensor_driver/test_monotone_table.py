"""The table of one end: found where samples are, held where none are, always rising."""

import numpy as np
import pytest

from strap_sensor_driver.monotone_table import KNOTS, ArcSamples, fit_table
from strap_sensor_driver.strap import FULL_TURN_RAD


def samples(arcs, ratios, std=1e-3, arc_std=0.0):
    arcs = np.asarray(arcs, dtype=np.float64)
    return ArcSamples(
        arcs, np.asarray(ratios, dtype=np.float64), np.full(arcs.size, std), arc_std**2 * np.ones((arcs.size,) * 2)
    )


def smooth(arc):
    return 0.01 + 0.27 * (arc + 0.07 * np.sin(2.0 * arc + 0.4) - 0.07 * np.sin(0.4))


def test_a_smooth_curve_is_found():
    rng = np.random.default_rng(0)
    arcs = np.linspace(0.0, FULL_TURN_RAD, 200)
    table = fit_table([samples(arcs, smooth(arcs) + 1e-3 * rng.standard_normal(200))])
    assert table.arc_rad.size == KNOTS
    assert np.abs(table.ratio - smooth(table.arc_rad)).max() < 3e-3
    assert table.residual_rms_rad == pytest.approx(1e-3 / 0.27, rel=0.15)
    assert table.scatter[0] == pytest.approx(1.0, abs=0.3)


def test_the_sigma_of_the_table_is_that_of_its_errors():
    scores = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        groups = []
        for _ in range(5):
            arcs = np.linspace(0.05, FULL_TURN_RAD, 40)
            shifted = arcs - 0.01 * rng.standard_normal()
            groups.append(samples(arcs, smooth(shifted) + 2e-3 * rng.standard_normal(40), 2e-3, 0.01))
        table = fit_table(groups)
        slope = np.gradient(smooth(table.arc_rad), table.arc_rad)
        scores.append((table.ratio - smooth(table.arc_rad)) / slope / table.arc_std_rad)
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.15


def test_it_rises_even_where_noise_falls():
    rng = np.random.default_rng(1)
    arcs = np.linspace(0.0, FULL_TURN_RAD, 300)
    table = fit_table([samples(arcs, 0.27 * arcs + 0.3 * rng.standard_normal(300), 0.01)])
    assert np.all(np.diff(table.ratio) > 0.0)
    assert table.ratio[0] >= 0.0


def test_the_sigma_grows_from_where_samples_end():
    arcs = np.linspace(0.0, 4.0, 200)
    table = fit_table([samples(arcs, smooth(arcs))])
    beyond = table.arc_std_rad[table.arc_rad > 4.2]
    assert np.all(np.diff(beyond) > 0.0)
    assert beyond[-1] > 10.0 * table.arc_std_rad[table.arc_rad < 3.8].max()


def test_scatter_beyond_what_was_expected_widens_the_sigma():
    rng = np.random.default_rng(2)
    arcs = np.linspace(0.0, FULL_TURN_RAD, 200)
    noisy = smooth(arcs) + 4e-3 * rng.standard_normal(200)
    honest, boasting = fit_table([samples(arcs, noisy, 4e-3)]), fit_table([samples(arcs, noisy, 1e-3)])
    assert boasting.scatter[0] > 10.0
    assert boasting.arc_std_rad[10] > 0.5 * honest.arc_std_rad[10]


@pytest.mark.parametrize(
    ("arcs", "ratios", "says"),
    [([], [], "0 samples"), ([1.0], [0.3], "1 samples"), ([1.0, 1.01], [0.3, 0.31], "give more")],
)
def test_too_little_is_refused(arcs, ratios, says):
    with pytest.raises(ValueError, match=says):
        fit_table([samples(arcs, ratios)] if arcs else [])


def test_what_falls_is_refused():
    with pytest.raises(ValueError, match="does not grow with the arc"):
        fit_table([samples([0.5, 2.0, 5.0], [1.5, 1.0, 0.2])])
