from hypothesis import given
from hypothesis import strategies as st
from rclpy.time import Time as RclpyTime

from strap_rover.ros_shell.stamps import ns_from_time, time_from_ns


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamps_are_exact_over_the_whole_range(ns):
    stamp = time_from_ns(ns)
    assert 0 <= stamp.nanosec < 10**9
    assert ns_from_time(stamp) == ns


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_are_rclpys(ns):
    assert time_from_ns(ns) == RclpyTime(nanoseconds=ns).to_msg()
