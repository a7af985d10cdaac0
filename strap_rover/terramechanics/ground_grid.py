"""Reading a gridded ground: bilinear between its points, going on unchanged beyond its edges.

A ground is an array of shape (rows, stations, fields): rows lie across (y, left positive), stations along (x), and
`FIELDS` says what is known of every point. One row says that the ground is the same everywhere across.
"""

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.compiled import compiled

FIELDS = (
    "height",
    "slope",
    "cross_slope",
    "k_c",
    "k_phi",
    "n",
    "cohesion",
    "tan_friction",
    "shear_modulus",
    "unit_weight",
    "excavation_depth",
    "refill_ratio",
    "refill_rate",
)
"""Fields of the sampled ground, in this order [m, rad, rad, N/m^(n+1), N/m^(n+2), -, Pa, -, m, N/m^3, m, -, 1/s].

slope is atan(dz/dx), uphill ahead positive; cross_slope is atan(dz/dy), uphill to the left positive.
"""
(
    HEIGHT,
    SLOPE,
    CROSS_SLOPE,
    K_C,
    K_PHI,
    N,
    COHESION,
    TAN_FRICTION,
    SHEAR_MODULUS,
    UNIT_WEIGHT,
    EXCAVATION,
    REFILL_RATIO,
    REFILL_RATE,
) = range(len(FIELDS))


@compiled
def _cell_kernel(count: int, start: float, spacing: float, place: float) -> tuple[int, float]:
    """Index of the point before `place` and the part of the way to the next, for two points or more; ends hold."""
    # A comparison with nan is false: a lost rover stands on the first point, and reads no memory that is not its own.
    position = (place - start) / spacing
    if not position > 0.0:
        return 0, 0.0
    if position >= count - 1:
        return count - 2, 1.0
    index = int(position)
    return index, position - index


@compiled
def ground_kernel(samples: FloatArray, grid: FloatArray, x: float, y: float, out: FloatArray) -> None:
    """Every field at (x, y) into `out`, shape (fields,); grid = x start and spacing, y start and spacing [m]."""
    rows = samples.shape[0]
    station, along = _cell_kernel(samples.shape[1], grid[0], grid[1], x)
    if rows == 1:
        for field in range(samples.shape[2]):
            here = samples[0, station, field]
            out[field] = here + along * (samples[0, station + 1, field] - here)
        return
    row, across = _cell_kernel(rows, grid[2], grid[3], y)
    for field in range(samples.shape[2]):
        right, left = samples[row, station, field], samples[row + 1, station, field]
        right += along * (samples[row, station + 1, field] - right)
        left += along * (samples[row + 1, station + 1, field] - left)
        out[field] = right + across * (left - right)


@compiled
def height_kernel(samples: FloatArray, grid: FloatArray, x: float, y: float) -> float:
    """Height of the surface at (x, y) [m]."""
    rows = samples.shape[0]
    station, along = _cell_kernel(samples.shape[1], grid[0], grid[1], x)
    right = samples[0, station, HEIGHT]
    if rows == 1:
        return float(right + along * (samples[0, station + 1, HEIGHT] - right))
    row, across = _cell_kernel(rows, grid[2], grid[3], y)
    right, left = samples[row, station, HEIGHT], samples[row + 1, station, HEIGHT]
    right += along * (samples[row, station + 1, HEIGHT] - right)
    left += along * (samples[row + 1, station + 1, HEIGHT] - left)
    return float(right + across * (left - right))
