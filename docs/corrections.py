"""The numbers in docs/corrections.md: what the paper's print gives, and what our reading of it gives.

.venv/bin/python docs/corrections.py
"""

import math

import numpy as np

from missions.core_run import run_cores
from missions.plan import plan_run
from strap_rover import topics
from strap_rover.terramechanics.contact import (
    Wheel,
    deformability_by_linear_rule,
    deformability_from_zone,
    solve_sinkage,
    static_contact_zone,
)
from strap_rover.terramechanics.slip import slip_ratio
from strap_rover.terramechanics.soil import MARS_DRY_SAND, TABLE_II, TABLE_II_CORRECTED, Soil, soil_from_de_st
from strap_rover.terramechanics.spiral_flow import contact_centre, critical_flow_ratio, slip_limit
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.strap import Strap
from traction_controller.speed_band import slowest_without_bulldozing

WHEEL = Wheel(0.25, 0.40)
LOAD = 899.0 * 3.711 / 6.0


def bekker(name: str, table: object = TABLE_II) -> Soil:
    n, k_c, k_phi = table[name]  # type: ignore[index]
    return Soil(n, k_c, k_phi, 0.0, 0.0)


def sensor() -> None:
    strap = Strap(785_398.163, 450e3, 450e3, 5.0)
    v_a, v_b = strap.terminal_voltages(math.radians(200.0), math.radians(255.0))
    printed = 2.0 * math.pi * float(v_a) * 450e3 / 785_398.163 * (5.0 - float(v_a))
    beta_1, _ = strap.strap_angles(v_a, v_b)
    print(f"strap angle: true {math.radians(200):.3f} rad; printed formula {printed:.1f}, inverse {float(beta_1):.3f}")
    entry, leave = StrapMounting(math.radians(50.0)).contact_angles(math.radians(200.0), math.radians(255.0), 0.0)
    print(f"exit angle: printed {270 - 50 - 200:+d} deg (magnitude), here {math.degrees(float(leave)):+.0f} deg "
          f"(entry {math.degrees(float(entry)):+.0f})")  # fmt: skip


def wheel() -> None:
    for omega in (0.4, 0.0):
        printed = 0.2 / (0.25 * omega) - 1.0 if omega else math.inf
        slip = float(slip_ratio(0.2, 0.25, omega))
        print(f"braking slip, v 0.2 m/s, omega {omega}: printed {printed:.2f}, here {slip:.2f}")
    print(f"shear at j = -50 mm, share of the strength: printed {1.0 - math.exp(0.05 / 0.0114):.0f}, "
          f"here {-(1.0 - math.exp(-0.05 / 0.0114)):.2f}")  # fmt: skip
    forces = solve_sinkage(WHEEL, MARS_DRY_SAND, LOAD, 0.2).forces
    print(f"torque, Table I sand, s 0.2: {forces.torque:.2f} N m; r F_t = {0.25 * forces.traction:.2f} N m")
    slips = np.linspace(0.0, 1.0, 101)
    most = np.max(solve_sinkage(WHEEL, MARS_DRY_SAND, LOAD, slips).forces.traction)
    print(f"largest traction of one wheel on Table I sand: {most:.0f} N; of six {6 * most:.0f} N")


def soils() -> None:
    for de in (0.1, 0.3, 0.6):
        zone = static_contact_zone(WHEEL, soil_from_de_st(de, 0.5), LOAD)
        read, linear = float(deformability_from_zone(WHEEL, LOAD, zone)), float(deformability_by_linear_rule(zone))
        print(f"de {de}: zone {math.degrees(float(zone)):.1f} deg reads back as {read:.3f}, linear rule {linear:.3f}")
    zone = static_contact_zone(WHEEL, bekker("S11"), LOAD)
    read, linear = float(deformability_from_zone(WHEEL, LOAD, zone)), float(deformability_by_linear_rule(zone))
    print(f"S11: zone {math.degrees(float(zone)):.1f} deg, de {read:.2f}, by the linear rule {linear:.2f}; printed 0.9")
    for name, table in (("printed", TABLE_II), ("corrected", TABLE_II_CORRECTED)):
        zone_deg = math.degrees(float(static_contact_zone(WHEEL, bekker("S16", table), LOAD)))
        print(f"S16 {name}: k_phi {table['S16'].k_phi:.0f}, zone {zone_deg:.1f} deg")


def flow() -> None:
    slip = 0.2
    w, q = (3.4 * slip - 0.72) * slip + 0.12, (6.0 * slip - 1.2) * slip + 0.19
    print(
        f"vertical flow at s 0.2, q {q:.3f}, w {w:.3f}: soil turns upwards {q / w:.1f} w off centre with q squared, "
        f"{math.sqrt(q) / w:.1f} w as printed; net downward flow {(w**2 - q) / (w**2 - q**2):.1f} times as large"
    )
    entry, leave = np.radians([30.0, -5.0])
    for s in (0.0, 0.1, 0.2, 0.3, 0.4):
        ends = float(critical_flow_ratio(s, entry, leave, "boundary"))
        lobes = float(critical_flow_ratio(s, entry, leave))
        print(f"vc at 30/-5 deg, s {s}: at the contact ends {ends:.2g}, lobes {lobes:.3g}")
    low = np.radians([15.0, -3.0])
    m = float(contact_centre(*low))
    print(
        f"15/-3 deg: m {m:.3f}, vc(0) = {float(critical_flow_ratio(0.0, *low)):.3f} though nothing slips; "
        f"upper root {float(slip_limit(*low)):.3f}"
    )
    print(f"x_c at s 0.45 and 1: {(7.4 * 0.45 - 1.7) * 0.45 + 0.14:.2f}, {7.4 - 1.7 + 0.14:.2f} wheel radii ahead")


def band() -> None:
    cosine = math.cos(math.radians(30.0))
    ours = float(slowest_without_bulldozing(0.2, np.array([0.25]), np.radians([30.0]))[0])
    print(
        f"least wheel speed, v 0.2, theta_1 30 deg: printed {cosine * 0.2 / 0.25:.3f} rad/s, here {ours:.3f}; "
        f"rolling without slip {0.2 / 0.25:.3f}"
    )


def warning() -> None:
    log = run_cores(plan_run("mars_snag", "constant", duration_s=70.0))
    truth_s, soil_s = log.time_s(topics.GROUND_TRUTH), log.time_s(topics.SOIL_STATE)
    caught_s = truth_s[np.argmax(log.of_rover(topics.GROUND_TRUTH, "external_load") > 0.0)]
    zone = log.of_wheels(topics.GROUND_TRUTH, "theta_1") - log.of_wheels(topics.GROUND_TRUTH, "theta_2")
    signs = {
        "vc below 1": (soil_s, log.of_wheels(topics.SOIL_STATE, "vc") < 1.0),
        "slip above 0.3": (soil_s, log.of_wheels(topics.SOIL_STATE, "slip") > 0.3),
        "zone 5 deg wider than before": (truth_s, zone > zone[np.searchsorted(truth_s, caught_s)] + np.radians(5.0)),
    }
    for name, (time_s, is_on) in signs.items():
        after = is_on.any(axis=1) & (time_s > caught_s)
        print(f"mars_snag, constant 2 rad/s: {name} {time_s[np.argmax(after)] - caught_s:.2f} s after the snag catches")


if __name__ == "__main__":
    for part in (sensor, wheel, soils, flow, band, warning):
        part()
