"""Snapshots as text: what an operator reads, at several widths."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.style import Style
from rich.text import Text

from missions.dashboard import (
    _FAULT_WORDS,
    _MODE_WORDS,
    _SOIL_WORDS,
    _STRAP_WORDS,
    _VERDICT_STYLES,
    Dashboard,
    plain_line,
)
from missions.mode_colours import MODE_COLOURS
from missions.snapshot import Heard, NodeHealth, PartHealth, Snapshot
from soil_flow_estimator.forecast_words import forecast_words
from soil_flow_estimator.soil_state import ForecastVerdict, SoilState, SoilStatus
from strap_rover import topics
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelCommands, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, remedy
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState

WHEELS = ("fl", "ml", "rl", "fr", "mr", "rr")
FIELDS = (
    "contact_angles",
    "soil_state",
    "traction_state",
    "wheel_commands",
    "wheel_states",
    "body_motion",
    "speed_request",
)
ALL_WELL = (
    NodeHealth(
        "strap_sensor_driver", 0.4, (PartHealth("board 1", "OK", "firmware 1"), PartHealth("strap fl", "OK", ""))
    ),
    NodeHealth("traction_controller", 0.9, (PartHealth("traction", "OK", "a speed is asked for"),)),
)


def angles(wheels=WHEELS, status=ContactStatus.VALID, theta_1_deg=25.0, theta_2_deg=-5.0):
    ones = np.ones(len(wheels))
    codes = np.full(len(wheels), int(status))
    return ContactAngles(0, np.radians(theta_1_deg) * ones, np.radians(theta_2_deg) * ones, ones, ones, codes)


def soil(wheels=WHEELS, **values):
    numbers = {
        "slip": 0.12,
        "slip_std": 0.03,
        "de": 0.31,
        "de_std": 0.05,
        "st": 0.5,
        "st_std": 0.29,
        "vc": 1.21,
        "m_ent": 1.0,
        "m_out": 1.0,
        "slip_max": 0.27,
        "status": int(SoilStatus.STATIC_ESTIMATE),
    }
    ones = np.ones(len(wheels))
    return SoilState(0, **{name: value * ones for name, value in (numbers | values).items()})


def traction(wheels=WHEELS, mode=TractionMode.DRIVE, fault=Fault.NONE, limited=0, retries=0):
    ones = np.ones(len(wheels))
    return TractionState(0, 1.62 * ones, 2.17 * ones, (limited * ones).astype(int), mode, retries, fault)


def snapshot(wheels=WHEELS, age_s=0.03, nodes=ALL_WELL, **fields):
    """Everything heard just now, but for `fields`, which replace records or are Heard themselves."""
    ones = np.ones(len(wheels))
    rows = {
        "contact_angles": (topics.CONTACT_ANGLES, angles(wheels)),
        "soil_state": (topics.SOIL_STATE, soil(wheels)),
        "traction_state": (topics.TRACTION_STATE, traction(wheels)),
        "wheel_commands": (topics.TRACTION_COMMANDS, WheelCommands(0, 1.93 * ones)),
        "wheel_states": (topics.WHEEL_STATES, WheelStates(0, ones, 1.87 * ones, ones)),
        "body_motion": (topics.ODOM, BodyMotion(0, 3.0, 0.0, 0.0, 0.44, 0.01)),
        "speed_request": (topics.CMD_VEL, SpeedRequest(0, 0.5, 0.0)),
    }
    heard = {}
    for name, (topic, record) in rows.items():
        given = fields.pop(name, record)
        heard[name] = given if given is None or isinstance(given, Heard) else Heard(topic, given, age_s, wheels)
    return Snapshot(domain_id=7, nodes=nodes, **heard, **fields)


def aged(whole, *names, age_s):
    return replace(whole, **{name: replace(getattr(whole, name), age_s=age_s) for name in names})


def lines(page, width=80, height=None, encoding="utf-8"):
    """The page as plain text, as a log or a terminal without colours gets it."""
    buffer = io.BytesIO()
    file = io.TextIOWrapper(buffer, encoding=encoding)
    Console(file=file, width=width, color_system=None, _environ={}).print(Dashboard(page, height))
    file.flush()
    return [line.rstrip() for line in buffer.getvalue().decode(encoding).split("\n")[:-1]]


def text(page, width=80, **options):
    return "\n".join(lines(page, width, **options))


def styled(page, width=80):
    """(letters, style) of every piece of the page, in order."""
    console = Console(width=width, color_system="truecolor", file=io.StringIO(), force_terminal=True, _environ={})
    return [(piece.text, piece.style or Style()) for piece in console.render(Dashboard(page))]


def style_of(page, letters, width=80):
    found = [style for piece, style in styled(page, width) if piece.strip() == letters.strip()]
    assert found, f"{letters!r} stands nowhere"
    return found[0]


def is_grey(style):
    return style.color is not None and style.color.name == "grey50"


def table_of(page, width=80):
    """The wheels' rows, and whatever else stands between their head and the next empty line."""
    shown = lines(page, width)
    first = next(index for index, line in enumerate(shown) if line.startswith(f"{page.wheels[0]} "))
    return shown[first : shown.index("", first)]


def row_of(page, wheel, width=80):
    (row,) = [row for row in table_of(page, width) if row.startswith(f"{wheel} ")]
    return row


def test_nothing_heard_asks_for_graph_and_domain():
    assert text(Snapshot(domain_id=42)) == ("nothing heard yet on domain 42: is the graph running? same ROS_DOMAIN_ID?")
    assert plain_line(Snapshot(domain_id=42)) == text(Snapshot(domain_id=42))


def test_all_is_well():
    page = text(snapshot())
    for part in ("DRIVE", "body 0.44 m/s", "asked 0.50 m/s", "0.0 s ago", "retries 0", "domain 7", "all 3 parts OK"):
        assert part in page
    for part in ("old", "fault", "LATE", "not heard", "predicted"):
        assert part not in page


@pytest.mark.parametrize("width", [80, 140])
def test_a_row_per_wheel_holds_its_numbers_on_one_line(width):
    page = snapshot()
    rows = table_of(page, width)
    assert [row[:2] for row in rows] == list(WHEELS)
    for row in rows:
        for number in ("25", "-5", "0.12", "0.27", "1.21", "0.31", "1.93", "1.87"):
            assert number in row.split()


@pytest.mark.parametrize("width", [20, 40, 60, 80, 100, 140, 200])
def test_no_line_is_wider_than_the_terminal_and_no_row_is_folded(width):
    page = snapshot(
        contact_angles=angles(status=ContactStatus.FAULT_OPEN_A),
        traction_state=traction(mode=TractionMode.FAULT, fault=Fault.SENSOR_FAULT, retries=3),
    )
    for whole in (page, aged(page, "contact_angles", "soil_state", "wheel_states", age_s=4.2)):
        assert all(len(line) <= width for line in lines(whole, width))
        assert [row[:2] for row in table_of(whole, width)] == list(WHEELS)


def test_more_room_shows_more_columns():
    head = {width: text(snapshot(), width) for width in (40, 80, 140)}
    assert "band" not in head[80]
    assert "de from" not in head[80]
    assert "1.62..2.17" in head[140]
    assert "stood" in head[140]
    assert " de" in head[80]
    assert " de" not in head[40]
    assert all(" set" in page and " is" in page for page in head.values())


def test_columns_stand_under_their_heads_at_every_width():
    for width in range(30, 160):
        page = lines(snapshot(), width)
        head = next(line for line in page if " set" in line)
        row = row_of(snapshot(), "fl", width)
        for title, number in (("set", "1.93"), ("is", "1.87"), ("vc", "1.21"), ("de", "0.31"), ("in", "25")):
            end = head.find(f" {title} ")
            if end >= 0:
                end += len(title) + 1
                assert row[:end].endswith(f" {number}"), (width, title)


def test_wheels_of_any_name():
    names = ("front_left_wheel_joint", "front_right_wheel_joint")
    for width in (80, 140):
        rows = [line for line in lines(snapshot(names), width) if line.startswith(names)]
        assert len(rows) == 2
        assert all(len(row) <= width and "1.93" in row for row in rows)


def test_a_wheel_one_topic_does_not_know_has_no_numbers_from_it():
    page = snapshot(soil_state=Heard(topics.SOIL_STATE, soil(("fl",)), 0.0, ("fl",)))
    assert "0.12" in row_of(page, "fl")
    assert "0.12" not in row_of(page, "rr")
    assert "1.93" in row_of(page, "rr")


def bar(page, wheel="fl", width=80):
    return row_of(page, wheel, width).split()[1]


def test_the_zone_is_drawn_about_bottom_dead_centre():
    drawn = bar(snapshot(contact_angles=angles(theta_1_deg=45.0, theta_2_deg=-20.0)), width=140)
    assert len(drawn) == 37
    per_cell = 180.0 / 37
    first, last = drawn.index("█"), drawn.rindex("█")
    assert first * per_cell - 90.0 == pytest.approx(-20.0, abs=per_cell)
    assert (last + 1) * per_cell - 90.0 == pytest.approx(45.0, abs=per_cell)
    assert set(drawn[first : last + 1]) == {"█"}
    assert drawn[18] == "█"


def test_a_narrow_zone_is_still_seen_and_one_beyond_the_axle_is_marked():
    assert bar(snapshot(contact_angles=angles(theta_1_deg=0.1, theta_2_deg=0.0))).count("█") == 1
    buried = bar(snapshot(contact_angles=angles(theta_1_deg=103.0, theta_2_deg=-95.0)))
    assert (buried[0], buried[-1]) == ("▓", "▓")
    just = bar(snapshot(contact_angles=angles(theta_1_deg=90.0, theta_2_deg=-90.0)))
    assert set(just) == {"█"}


def test_a_terminal_without_unicode_gets_plain_letters():
    page = text(snapshot(), encoding="ascii")
    assert "#" in page
    assert "1.93" in page


def test_a_predicted_zone_is_said_quietly():
    page = snapshot(contact_angles=angles(status=ContactStatus.PREDICTED))
    assert "predicted" in row_of(page, "fl")
    assert "25" in row_of(page, "fl")
    assert is_grey(style_of(page, "predicted"))
    assert is_grey(style_of(page, "25"))
    assert not is_grey(style_of(snapshot(), "25"))
    assert remedy(ContactStatus.PREDICTED) not in text(page)


@pytest.mark.parametrize("status", [status for status in ContactStatus if status.is_fault])
def test_a_faulty_strap_is_loud_has_its_remedy_and_no_number(status):
    page = snapshot(contact_angles=angles(status=status))
    assert remedy(status) in text(page, 200)
    word = _STRAP_WORDS[status]
    assert style_of(page, word).bgcolor is not None
    assert "25" not in row_of(page, "fl").split()
    assert "█" not in row_of(page, "fl")
    assert f"fl {word}" in plain_line(page)


def test_a_long_remedy_is_folded_beside_its_label_and_whole():
    record = replace(angles(), status=np.array([0, 0, int(ContactStatus.FAULT_ORDER), 0, 0, 0]))
    page = lines(snapshot(contact_angles=record))
    start = next(index for index, line in enumerate(page) if line.startswith("ORDER "))
    end = page.index("", start)
    said = " ".join(line[6:].strip() for line in page[start:end])
    assert said == f"rl: {remedy(ContactStatus.FAULT_ORDER)}"
    assert end - start > 1


def test_straps_with_the_same_fault_share_one_line():
    codes = [int(status) for status in (ContactStatus.FAULT_STUCK, ContactStatus.FAULT_SHORT, ContactStatus.VALID)]
    page = text(snapshot(contact_angles=replace(angles(), status=np.array(codes + codes))), 140)
    assert f"STUCK fl, fr: {remedy(ContactStatus.FAULT_STUCK)}" in page
    assert f"SHORT ml, mr: {remedy(ContactStatus.FAULT_SHORT)}" in page


def test_a_wheel_in_the_air_has_no_angles():
    page = snapshot(contact_angles=angles(status=ContactStatus.NO_CONTACT, theta_1_deg=0.0, theta_2_deg=0.0))
    assert "in air" in row_of(page, "fl")
    assert row_of(page, "fl").split()[2:4] == ["-", "-"]


def test_a_status_of_another_version_is_shown_as_a_code():
    page = snapshot(contact_angles=replace(angles(), status=np.full(6, 77)))
    assert "code 77" in row_of(page, "fl")


def test_flow_ratio_and_slip_are_coloured_when_the_wheel_digs():
    for wrong, number in ((soil(vc=0.93), "0.93"), (soil(slip=0.28), "0.28")):
        assert style_of(snapshot(soil_state=wrong), number).color.name == "#d7af00"
    for right in ("1.21", "0.12"):
        assert style_of(snapshot(), right).color is None


def test_the_std_of_slip_and_a_guessed_de_are_grey():
    assert is_grey(style_of(snapshot(), "0.03", 140))
    assert is_grey(style_of(snapshot(soil_state=soil(status=int(SoilStatus.PRIOR))), "0.31"))
    assert not is_grey(style_of(snapshot(), "0.31"))


def test_a_stickiness_that_is_only_the_prior_is_grey():
    assert is_grey(style_of(snapshot(soil_state=soil(st=0.47)), "0.47", 140))
    assert not is_grey(style_of(snapshot(soil_state=soil(st=0.47, st_std=0.04)), "0.47", 140))


def forecast(verdict, margin=-120.0, z_return=-1.0):
    told = {"scout_margin": margin, "scout_margin_std": 80.0, "scout_z": -margin / 80.0, "scout_z_return": z_return}
    return replace(soil(), scout_verdict=int(verdict), **told)


@pytest.mark.parametrize("verdict", list(ForecastVerdict))
def test_the_forecast_is_told_in_words(verdict):
    page = snapshot(soil_state=forecast(verdict))
    shown = " ".join(text(page).split())
    assert f"forecast {verdict.name} " in shown
    assert forecast_words(forecast(verdict)) in shown
    is_calm = verdict in {ForecastVerdict.NONE, ForecastVerdict.CLEAR}
    assert (f"forecast {verdict.name}" in plain_line(page)) is not is_calm


def test_a_forecast_to_stop_is_loud_and_an_old_one_is_grey_with_its_age():
    page = snapshot(soil_state=forecast(ForecastVerdict.STOP))
    assert style_of(page, "forecast STOP").bgcolor.name == "#b2182b"
    old = aged(page, "soil_state", age_s=2.5)
    assert is_grey(style_of(old, "forecast STOP"))
    assert any("forecast STOP 2.5 s old" in line for line in lines(old))


def test_a_forecast_that_is_shown_is_not_said_again_by_the_nodes_health():
    state = forecast(ForecastVerdict.STOP)
    ill = NodeHealth("soil_flow_estimator", 0.2, (PartHealth("forecast", "WARN", forecast_words(state)),))
    shown = text(snapshot(soil_state=state, nodes=(ill,)), 140)
    assert shown.count("stop and back out") == 1
    assert "forecast: see above" in shown
    assert "see above" not in text(snapshot(soil_state=forecast(ForecastVerdict.CLEAR), nodes=(ill,)), 140)


def test_at_rest_there_is_no_slip_and_no_flow_ratio():
    row = row_of(snapshot(soil_state=soil(slip=0.0, slip_std=1.0)), "fl")
    assert "1.21" not in row
    assert "0.00" not in row
    assert "0.31" in row


def test_stand_ins_for_missing_angles_are_not_shown_as_measured():
    row = row_of(snapshot(soil_state=soil(status=int(SoilStatus.NO_DATA))), "fl")
    assert "1.21" not in row
    assert "0.27" not in row


def test_a_limited_wheel_says_so():
    assert "yes" not in row_of(snapshot(), "fl")
    assert row_of(snapshot(traction_state=traction(limited=1)), "fl").endswith("yes")


def test_numbers_that_are_none_or_do_not_fit():
    row = row_of(snapshot(soil_state=soil(vc=np.inf, de=np.nan, slip=-1234567.0)), "fl")
    assert len(row) <= 80
    assert "inf" not in row
    assert "nan" not in row
    assert "<-999" in row
    assert "12.3" in row_of(snapshot(soil_state=soil(vc=12.345)), "fl").split()
    assert "0.00" in row_of(snapshot(soil_state=soil(slip=-0.0001)), "fl").split()


@pytest.mark.parametrize(
    ("names", "number", "others"),
    [
        (("contact_angles",), "25", ("0.12", "1.93", "1.87")),
        (("soil_state",), "0.12", ("25", "1.93", "1.87")),
        (("wheel_commands",), "1.93", ("25", "0.12", "1.87")),
        (("wheel_states",), "1.87", ("25", "0.12", "1.93")),
    ],
)
def test_an_old_number_is_grey_and_bears_its_age(names, number, others):
    page = aged(snapshot(), *names, age_s=3.2)
    assert is_grey(style_of(page, number))
    assert not any(is_grey(style_of(page, other)) for other in others)
    assert "3.2s" in text(page)
    assert "nothing new for 3.2 s" in text(page)
    topic = getattr(page, names[0]).topic
    assert f"LATE {topic.name}" in text(page)
    assert f"{topic.name}: nothing new for 3.2 s; comes from {topic.publisher}" in plain_line(page)


def test_a_number_is_old_only_after_its_topics_period():
    assert "old" not in text(snapshot(age_s=0.49))
    page = snapshot(age_s=0.51)
    assert text(page).count("old") >= 4
    assert "LATE" in text(page)


def test_an_old_zone_is_grey_all_over():
    page = aged(snapshot(), "contact_angles", age_s=5.0)
    assert all(is_grey(style) for piece, style in styled(page) if "█" in piece)
    faulty = aged(snapshot(contact_angles=angles(status=ContactStatus.FAULT_SHORT)), "contact_angles", age_s=5.0)
    assert all(is_grey(style) for piece, style in styled(faulty) if "SHORT" in piece)


def test_an_old_mode_is_no_coloured_mode():
    fresh = style_of(snapshot(), "DRIVE")
    assert fresh.bgcolor.name == MODE_COLOURS[TractionMode.DRIVE]
    page = aged(snapshot(), "traction_state", age_s=12.0)
    old = style_of(page, "DRIVE")
    assert old.bgcolor is None or old.bgcolor.name != MODE_COLOURS[TractionMode.DRIVE]
    assert "DRIVE  12 s old" in text(page)
    assert "mode DRIVE (12 s old)" in plain_line(page)


def test_old_speeds_bear_their_ages():
    page = text(aged(snapshot(), "body_motion", "speed_request", age_s=130.0))
    assert "body 0.44 m/s 2 min old" in page
    assert "asked 0.50 m/s 2 min old" in page


@pytest.mark.parametrize(
    ("age_s", "words"),
    [(0.62, "0.6 s"), (9.94, "9.9 s"), (9.96, "10 s"), (89.4, "89 s"), (91.0, "2 min"), (7200.0, "2 h"), (2e5, "2 d")],
)
def test_ages_in_words(age_s, words):
    assert f"body 0.44 m/s {words} old" in text(aged(snapshot(), "body_motion", age_s=age_s))


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.NONE])
def test_a_fault_is_told_in_words(fault):
    page = snapshot(traction_state=traction(mode=TractionMode.FAULT, fault=fault))
    assert f"fault {fault.name} {_FAULT_WORDS[fault]}" in text(page, 140)
    assert f"fault {fault.name}" in plain_line(page)


def test_every_mode_fault_and_status_has_words_and_every_mode_a_colour():
    assert set(_MODE_WORDS) == set(MODE_COLOURS) == set(TractionMode)
    assert set(_FAULT_WORDS) == set(Fault)
    assert set(_STRAP_WORDS) == set(ContactStatus)
    assert set(_SOIL_WORDS) == set(SoilStatus)
    assert set(_VERDICT_STYLES) == set(ForecastVerdict)


@pytest.mark.parametrize("mode", list(TractionMode))
def test_a_mode_has_its_colour_and_its_words(mode):
    page = snapshot(traction_state=traction(mode=mode))
    assert style_of(page, mode.name).bgcolor.name == MODE_COLOURS[mode]
    assert _MODE_WORDS[mode] in text(page)


def test_a_part_that_is_not_ok_has_a_line_with_its_remedy():
    board = PartHealth("board 2", "WARN", "no HELLO yet: check cable, port and power")
    strap = PartHealth("strap rr", "ERROR", "look at it")
    page = snapshot(nodes=(*ALL_WELL, NodeHealth("driver", 0.1, (board, strap, PartHealth("x", "OK", "fine")))))
    shown = lines(page, 100)
    assert "2 of 6 parts of 3 nodes not OK" in "\n".join(shown)
    error = next(index for index, line in enumerate(shown) if line.startswith("ERROR driver"))
    assert shown[error].endswith("strap rr: look at it")
    assert shown[error + 1].startswith("WARN  driver")
    assert shown[error + 1].endswith("board 2: no HELLO yet: check cable, port and power")
    assert "x: fine" not in "\n".join(shown)
    assert shown[error + 2].split(None, 3)[-1] == "strap_sensor_driver, traction_controller"
    assert "driver: ERROR: strap rr: look at it" in plain_line(page)


def test_parts_of_a_node_that_say_the_same_share_one_line():
    parts = tuple(PartHealth(f"strap {name}", "ERROR", "check the cable") for name in WHEELS)
    page = text(snapshot(nodes=(NodeHealth("driver", 0.1, parts), NodeHealth("other", 0.1, parts[:1]))), 140)
    assert "strap fl, strap ml, strap rl, strap fr, strap mr, strap rr: check the cable" in page
    assert page.count("check the cable") == 2
    assert "7 of 7 parts of 2 nodes not OK" in page


def test_a_remedy_is_not_said_twice():
    said = remedy(ContactStatus.FAULT_STUCK)
    nodes = (NodeHealth("driver", 0.1, (PartHealth("strap fl", "ERROR", said),)),)
    record = replace(angles(), status=np.array([int(ContactStatus.FAULT_STUCK), 0, 0, 0, 0, 0]))
    page = text(snapshot(contact_angles=record, nodes=nodes), 140)
    assert page.count(said) == 1
    assert "strap fl: see above" in page


def test_a_node_that_is_silent_is_stale_whatever_it_said_last():
    fresh = replace(ALL_WELL[0], age_s=2.9)
    assert "STALE" not in text(snapshot(nodes=(fresh,)))
    page = snapshot(nodes=(replace(ALL_WELL[0], age_s=3.1), ALL_WELL[1]))
    shown = text(page)
    assert "STALE strap_sensor_driver" in shown
    assert "not heard for 3.1 s: does it still run?" in shown
    assert "all" not in shown.split("health", 1)[1].split("\n", 1)[0]
    assert "strap_sensor_driver: STALE: not heard for 3.1 s" in plain_line(page)


def test_when_all_is_silent_the_first_line_says_so():
    page = aged(snapshot(), *(name for name in FIELDS if name != "body_motion"), age_s=40.0)
    page = aged(page, "body_motion", age_s=30.0)
    assert "nothing new for" not in lines(page)[0]
    nodes = tuple(replace(node, age_s=35.0) for node in ALL_WELL)
    page = replace(page, nodes=nodes)
    for said in (lines(page)[0], plain_line(page)):
        assert "nothing new for 30 s: has the graph ended, is the network down?" in said
    assert style_of(page, lines(page)[0]).bgcolor is not None
    assert text(page).count("STALE") == 0
    assert "nothing new" not in text(aged(page, "speed_request", age_s=0.1)).splitlines()[0]


def test_what_was_never_heard_is_named_with_where_it_comes_from():
    page = snapshot(soil_state=None, traction_state=None, speed_request=None, nodes=())
    shown = text(page)
    assert "mode not known" in shown
    assert "soil_state" in shown
    assert "not heard yet; comes from soil_flow_estimator" in shown
    assert "no node heard yet on /diagnostics" in shown
    assert "asked -" in shown
    assert "cmd_vel" not in shown
    assert "1.21" not in shown
    assert plain_line(page).startswith("mode -, body 0.44 m/s, asked -, largest slip -")


def test_only_health_was_heard():
    shown = text(Snapshot(domain_id=7, nodes=ALL_WELL))
    assert "all 3 parts OK" in shown
    assert "speed [rad/s]" not in shown


def test_problems_are_shown_and_their_topic_is_not_called_silent():
    problem = "soil_state: 3 names, expected 66"
    page = snapshot(soil_state=None, problems=(problem,))
    assert problem in text(page)
    assert "not heard yet" not in text(page)
    assert problem in plain_line(page)


def test_markup_and_brackets_of_others_are_only_text():
    part = PartHealth("[bold]x[/]", "WARN", "[red]see[/red] [/]")
    assert "[bold]x[/]: [red]see[/red] [/]" in text(snapshot(nodes=(NodeHealth("n[b]", 0.0, (part,)),)))


def test_what_does_not_fit_is_counted():
    parts = tuple(PartHealth(f"part {index}", "WARN", f"no {index}") for index in range(30))
    page = snapshot(nodes=(NodeHealth("n", 0.0, parts),))
    whole, cut = lines(page), lines(page, height=24)
    assert len(cut) == 24
    assert cut[:23] == whole[:23]
    assert cut[23] == f"... {len(whole) - 23} more lines: make the window taller"
    assert lines(page, height=len(whole)) == whole


def test_wheels_are_those_of_the_messages_and_joints_that_are_no_wheels_stay_out():
    ones = np.ones(2)
    states = Heard(topics.WHEEL_STATES, WheelStates(0, ones, ones, ones), 0.0, ("fl", "steering"))
    assert snapshot(("fl",), wheel_states=states).wheels == ("fl",)
    assert Snapshot(0, wheel_states=states).wheels == ("fl", "steering")


def test_the_picture_can_be_exported():
    console = Console(record=True, width=120, file=io.StringIO())
    console.print(Dashboard(snapshot()))
    assert "1.93" in Text.from_ansi(console.export_text()).plain
