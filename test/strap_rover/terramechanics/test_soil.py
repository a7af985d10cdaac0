import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_rover.terramechanics.soil import (
    DEFAULT_SHEAR_DEFORMATION_MODULUS,
    MARS_DRY_SAND,
    TABLE_II,
    TABLE_II_CORRECTED,
    Soil,
    soil_from_de_st,
    soil_row_kernel,
)

Rows = list[dict[str, str]]
PRINTED = 1e-6
"""Reference values are given to 1e-6 relative."""
SAME_DECIMAL = 1e-15
"""kN to N: the rounding of one multiplication."""


def good_fields(**changed: object) -> dict[str, object]:
    return {"n": 0.7, "k_c": 7e3, "k_phi": 5e5, "cohesion": 1e3, "friction_angle": 0.5, **changed}


def test_table_ii_is_what_was_printed(authority: Callable[[str], Rows]) -> None:
    printed = {row["soil"]: row for row in authority("soils_table_i_ii.csv") if row["soil"] != "Table I"}
    assert list(TABLE_II) == list(printed)
    for name, soil in TABLE_II.items():
        row = printed[name]
        expected = (float(row["n"]), 1e3 * float(row["k_c_kn"]), 1e3 * float(row["k_phi_kn"]))
        assert (soil.n, soil.k_c, soil.k_phi) == pytest.approx(expected, rel=SAME_DECIMAL), name


def test_table_i_is_what_was_printed(authority: Callable[[str], Rows]) -> None:
    row = authority("soils_table_i_ii.csv")[0]
    sand = MARS_DRY_SAND
    assert (sand.n, sand.k_c / 1e3, sand.k_phi / 1e3) == (float(row["n"]), float(row["k_c_kn"]), float(row["k_phi_kn"]))
    assert (sand.cohesion, sand.shear_deformation_modulus) == (960.0, 0.0114)
    assert math.degrees(float(sand.friction_angle)) == pytest.approx(27.3)


def test_the_corrected_table_differs_in_one_number_only() -> None:
    assert list(TABLE_II_CORRECTED) == list(TABLE_II)
    changed = [name for name in TABLE_II if TABLE_II_CORRECTED[name] != TABLE_II[name]]
    assert changed == ["S16"]
    printed, corrected = TABLE_II["S16"], TABLE_II_CORRECTED["S16"]
    assert (corrected.n, corrected.k_c) == (printed.n, printed.k_c)
    assert corrected.k_phi == pytest.approx(100.0 * printed.k_phi)


def test_tables_cannot_be_written_to() -> None:
    with pytest.raises(TypeError):
        TABLE_II["S1"] = TABLE_II["S2"]  # type: ignore[index]


def test_family_at_a_known_point(authority: Callable[[str], Rows]) -> None:
    soil = soil_from_de_st(0.4, 0.5)
    rows = [row for row in authority("soil_family.csv") if row["quantity"] != "read_back"]
    assert len(rows) == 5
    for row in rows:
        assert getattr(soil, row["quantity"]) == pytest.approx(float(row["value"]), rel=PRINTED), row["quantity"]
    assert soil.shear_deformation_modulus == DEFAULT_SHEAR_DEFORMATION_MODULUS


def test_family_ends() -> None:
    firm, soft = soil_from_de_st(0.0, 0.0), soil_from_de_st(1.0, 1.0)
    assert (firm.n, firm.k_c, firm.k_phi, firm.cohesion) == pytest.approx((0.6, 220.06e3, 3040e3, 0.0))
    assert (soft.n, soft.k_c, soft.k_phi, soft.cohesion) == pytest.approx((1.7, 60.0, 40e3, 3200.0))
    assert math.degrees(float(firm.friction_angle)) == pytest.approx(13.0)
    assert math.degrees(float(soft.friction_angle)) == pytest.approx(50.0)


@given(
    de=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted),
    stick=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted),
)
def test_family_is_monotone(de: list[float], stick: list[float]) -> None:
    low, high = soil_from_de_st(de[0], stick[0]), soil_from_de_st(de[1], stick[1])
    assert low.n <= high.n
    assert low.k_c >= high.k_c
    assert low.k_phi >= high.k_phi
    assert low.cohesion <= high.cohesion
    assert low.friction_angle <= high.friction_angle


def test_family_of_scalars_gives_floats_and_of_arrays_gives_arrays() -> None:
    scalar = soil_from_de_st(0.3, 0.4)
    assert all(type(getattr(scalar, name)) is float for name in ("n", "k_c", "k_phi", "cohesion", "friction_angle"))
    many = soil_from_de_st(np.array([0.1, 0.3]), 0.4)
    assert np.shape(many.n) == (2,)
    assert np.asarray(many.k_phi)[1] == scalar.k_phi


@pytest.mark.parametrize("value", [-1e-9, 1.0 + 1e-9, math.nan, math.inf])
@pytest.mark.parametrize("name", ["de", "st"])
def test_family_refuses_what_is_outside_0_to_1(name: str, value: float) -> None:
    arguments = {"de": 0.5, "st": 0.5, name: value}
    with pytest.raises(ValueError, match=rf"^{name} must lie in \[0, 1\], got {value!r}$"):
        soil_from_de_st(arguments["de"], arguments["st"])
    with pytest.raises(ValueError, match=rf"^{name} must lie in \[0, 1\], got {value!r}$"):
        soil_from_de_st(**{"de": 0.5, "st": 0.5, name: np.array([0.1, value])})  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("n", 0.0),
        ("n", -0.5),
        ("n", math.nan),
        ("k_c", math.inf),
        ("k_phi", math.nan),
        ("cohesion", -1.0),
        ("friction_angle", -0.1),
        ("friction_angle", 0.5 * math.pi),
        ("shear_deformation_modulus", 0.0),
        ("n", np.array([0.7, -3.0])),
    ],
)
def test_soil_refuses_a_bad_field_and_names_it(name: str, value: object) -> None:
    worst = float(np.min(value)) if isinstance(value, np.ndarray) else value
    with pytest.raises(ValueError, match=rf"^{name} must be finite.*, got {worst!r}$"):
        Soil(**good_fields(**{name: value}))  # type: ignore[arg-type]


def test_modulus_is_that_of_a_plate_of_the_given_width() -> None:
    assert Soil(0.7, 6.94e3, 505.8e3, 0.0, 0.0).modulus(0.4) == pytest.approx(523.15e3)
    assert Soil(0.7, 0.0, 505.8e3, 0.0, 0.0).modulus(0.01) == Soil(0.7, 0.0, 505.8e3, 0.0, 0.0).modulus(10.0)


def test_modulus_refuses_a_soil_that_carries_nothing() -> None:
    soil = Soil(0.7, -1e5, 1e5, 0.0, 0.0)
    assert soil.modulus(2.0) == pytest.approx(5e4)
    with pytest.raises(ValueError, match=r"k_c/b \+ k_phi must be positive, got -100000.0 for b = 0.5 m"):
        soil.modulus(0.5)


@given(st.floats(1e-6, 1.0), st.floats(0.0, 1.0), st.floats(0.02, 1.0))
def test_the_row_for_kernels_is_the_soil_itself(de: float, stickiness: float, width: float) -> None:
    soil, row = soil_from_de_st(de, stickiness), np.full(6, np.nan)
    soil_row_kernel(de, stickiness, width, row)
    whole = [
        soil.modulus(width),
        soil.n,
        soil.cohesion,
        math.tan(float(soil.friction_angle)),
        soil.shear_deformation_modulus,
        0.0,
    ]
    assert row == pytest.approx(np.array(whole, dtype=np.float64), rel=1e-9)
