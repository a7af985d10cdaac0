import numpy as np
import pytest

from missions.run_log import LOGGED, RunLogBuilder
from strap_rover import topics


def test_rows_are_stacked_per_topic():
    builder = RunLogBuilder(("l", "r"))
    for index in range(3):
        builder.add(topics.TRACTION_STATE, 20_000_000 * index, np.full((2, 3), index), np.array([index, 7.0, 0.0]))
        builder.add(topics.TRACTION_COMMANDS, 10_000_000 * index, np.array([[index], [2.0 * index]]), np.empty(0))
    log = builder.build()
    np.testing.assert_allclose(log.time_s(topics.TRACTION_STATE), [0.0, 0.02, 0.04])
    assert log.of_wheels(topics.TRACTION_STATE, "omega_max").tolist() == [[0, 0], [1, 1], [2, 2]]
    assert log.of_rover(topics.TRACTION_STATE, "retries").tolist() == [7, 7, 7]
    assert log.commands().tolist() == [[0, 0], [1, 2], [2, 4]]


def test_a_topic_that_said_nothing_has_no_rows_but_its_shape():
    log = RunLogBuilder(("l", "r")).build()
    for row in LOGGED:
        series = log.series[row.name]
        assert series.stamp_ns.shape == (0,)
        assert series.per_wheel.shape == (0, 2, len(row.per_wheel))
        assert series.whole_rover.shape == (0, len(row.whole_rover))
    assert log.commands().shape == (0, 2)


def test_later_rows_do_not_change_a_log_that_was_built():
    builder = RunLogBuilder(("l",))
    builder.add(topics.TRACTION_COMMANDS, 0, np.array([[1.0]]), np.empty(0))
    log = builder.build()
    builder.add(topics.TRACTION_COMMANDS, 1, np.array([[2.0]]), np.empty(0))
    assert log.commands().tolist() == [[1.0]]
    assert builder.build().commands().tolist() == [[1.0], [2.0]]


def test_unknown_quantities_name_the_known_ones():
    log = RunLogBuilder(("l",)).build()
    with pytest.raises(KeyError, match="theta_1"):
        log.of_wheels(topics.CONTACT_ANGLES, "theta")
    with pytest.raises(KeyError, match="retries"):
        log.of_rover(topics.TRACTION_STATE, "tries")
    with pytest.raises(KeyError, match="no quantity 'sinkage'"):
        log.of_rover(topics.GROUND_TRUTH, "sinkage")  # it is per wheel
