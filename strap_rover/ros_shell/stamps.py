"""builtin_interfaces/Time <-> integer nanoseconds, exactly."""

from builtin_interfaces.msg import Time

NS_PER_S = 1_000_000_000


def time_from_ns(ns: int) -> Time:
    """The stamp of `ns` nanoseconds; seconds must fit in 32 bits with sign."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def ns_from_time(stamp: Time) -> int:
    """Nanoseconds of a stamp."""
    total: int = stamp.sec * NS_PER_S + stamp.nanosec
    return total
