import dataclasses
import math
from dataclasses import dataclass, field

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from strap_rover.settings import (
    SettingsError,
    check_settings,
    field_types,
    load_settings,
    read_parameters_file,
    read_yaml,
    settings_as_mapping,
    settings_from_mapping,
)


@dataclass(frozen=True, slots=True)
class Probe:
    port: str = field(metadata={"doc": "serial port"})
    rate_hz: float = field(default=100.0, metadata={"doc": "rate [Hz]", "min": 1.0, "max": 400.0})
    count: int = field(default=3, metadata={"min": 0})
    mirrored: bool = False
    mode: str = field(default="auto", metadata={"choices": ("auto", "manual")})
    gains: tuple[float, ...] = field(default=(1.0, 2.0), metadata={"max": 10.0})
    span: tuple[int, int] = (1, 2)
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.span[0] > self.span[1]:
            message = f"span: {self.span} is reversed; give low before high"
            raise ValueError(message)


def problems_of(mapping, source="here.yaml"):
    with pytest.raises(SettingsError) as caught:
        settings_from_mapping(Probe, mapping, source)
    assert str(caught.value) == "\n".join(caught.value.problems)
    return caught.value.problems


def test_defaults_fill_what_is_not_given():
    assert settings_from_mapping(Probe, {"port": "/dev/x"}) == Probe(port="/dev/x")


def test_an_int_is_taken_for_a_float_and_becomes_one():
    rate = settings_from_mapping(Probe, {"port": "p", "rate_hz": 20}).rate_hz
    assert rate == 20.0
    assert type(rate) is float


def test_lists_become_tuples_of_the_right_type():
    settings = settings_from_mapping(Probe, {"port": "p", "gains": [1, 2.5], "span": [0, 4], "names": ["a"]})
    assert settings.gains == (1.0, 2.5)
    assert all(type(gain) is float for gain in settings.gains)
    assert settings.span == (0, 4)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("rate_hz", True, "give a number"),
        ("rate_hz", "20", "give a number, without quotes and with a decimal point: 20.0"),
        ("rate_hz", "1e2", "100.0"),
        ("rate_hz", math.nan, "not finite"),
        ("rate_hz", math.inf, "from 1.0 to 400.0"),
        ("rate_hz", 0.5, "from 1.0 to 400.0"),
        ("rate_hz", 400.1, "from 1.0 to 400.0"),
        ("rate_hz", None, "empty"),
        ("rate_hz", [1.0], "is a list; give a number"),
        ("count", 2.0, "without a decimal point"),
        ("count", False, "give a whole number"),
        ("count", -1, "at least 0"),
        ("mirrored", 1, "true or false"),
        ("mirrored", "yes", "true or false"),
        ("port", 3, "text, in quotes"),
        ("mode", "manul", "manual?"),
        ("gains", 3.0, "give a list"),
        ("gains", "3.0", "give a list"),
        ("gains", {"a": 1}, "give a list"),
        ("gains", [1.0, 11.0], "element 1: 11.0 is out of range; give a value of at most 10.0"),
        ("gains", [math.nan], "element 0: nan is not finite"),
        ("span", [1, 2, 3], "list of 2"),
        ("span", [3, 1], "is reversed"),
    ],
)
def test_each_kind_of_wrong_value_is_named_with_source_key_and_remedy(key, value, said):
    (problem,) = problems_of({"port": "p", key: value})
    assert problem.startswith(f"here.yaml: {key}: ")
    assert said in problem


def test_the_ends_of_a_range_are_allowed():
    for rate in (1.0, 400.0):
        assert settings_from_mapping(Probe, {"port": "p", "rate_hz": rate}).rate_hz == rate


def test_every_problem_is_listed_in_one_error():
    problems = problems_of({"rate_hx": 3.0, "count": 1.5, "mode": "x", "gains": [99.0, "a"]})
    assert len(problems) == 6
    text = "\n".join(problems)
    assert "rate_hx: unknown key (value 3.0); did you mean 'rate_hz'?" in text
    assert "port: missing; add it as text (serial port)" in text


def test_an_unknown_key_like_nothing_known_lists_the_known():
    (problem,) = problems_of({"port": "p", "zzzzzz": 1})
    assert "known keys: port, rate_hz" in problem


def test_a_class_of_another_type_is_a_programming_error():
    @dataclass
    class Wrong:
        value: dict = field(default_factory=dict)

    with pytest.raises(TypeError, match=r"Wrong\.value"):
        settings_from_mapping(Wrong, {"value": {}})


def test_check_settings_guards_direct_construction():
    check_settings(Probe(port="p"))
    with pytest.raises(SettingsError, match=r"rate_hz: -1\.0 is out of range"):
        check_settings(Probe(port="p", rate_hz=-1.0))


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.builds(
        Probe,
        port=st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc"))),
        rate_hz=st.floats(1.0, 400.0),
        count=st.integers(0, 2**62),
        mirrored=st.booleans(),
        mode=st.sampled_from(["auto", "manual"]),
        gains=st.lists(st.floats(max_value=10.0, allow_nan=False, allow_infinity=False)).map(tuple),
        span=st.tuples(st.integers(-5, 0), st.integers(1, 5)),
        names=st.lists(st.text("abc0:#- ")).map(tuple),
    )
)
def test_settings_survive_mapping_and_yaml_bit_for_bit(settings):
    text = yaml.safe_dump(settings_as_mapping(settings))
    assert settings_from_mapping(Probe, yaml.safe_load(text)) == settings


def test_field_types_are_said_in_words():
    said = {name: str(kind) for name, kind in field_types(Probe).items()}
    assert said["rate_hz"] == "a number"
    assert said["span"] == "a list of 2, each a whole number"
    assert list(said) == [item.name for item in dataclasses.fields(Probe)]


PARAMETERS = """
/**:
  ros__parameters:
    rate_hz: 10.0
    use: {deep: {er: 1}}
probe:
  ros__parameters:
    rate_hz: 20.0
    port: /dev/ttyACM0
other:
  ros__parameters:
    rate_hz: 30.0
"""


def test_parameters_of_every_node_come_first_and_the_nodes_own_override(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(PARAMETERS, encoding="utf-8")
    assert read_parameters_file(path, "probe") == {"rate_hz": 20.0, "use.deep.er": 1, "port": "/dev/ttyACM0"}
    assert read_parameters_file(path, "/ns/other") == {"rate_hz": 30.0, "use.deep.er": 1}
    assert read_parameters_file(path, "stranger") == {"rate_hz": 10.0, "use.deep.er": 1}


def test_load_settings_names_the_file(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(PARAMETERS, encoding="utf-8")
    with pytest.raises(SettingsError, match=r"p\.yaml: use\.deep\.er: unknown key"):
        load_settings(Probe, path, "probe")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("probe:\n  ros__parameters:\n    a: [1\n", r"p\.yaml:4:1: not valid YAML"),
        ("probe:\n\tx: 1\n", r"p\.yaml:2:1: not valid YAML"),
        ("probe:\n  ros__parameters:\n    a: 1\n    a: 2\n", r"p\.yaml:4:5: .*'a' is given twice"),
        ("- 1\n", "must be a mapping"),
        ("", "must be a mapping"),
        ("other:\n  ros__parameters: {}\n", r"no section for node 'probe' \(found: other\)"),
        ("probe:\n  a: 1\n", "has no mapping `ros__parameters:`"),
        ("probe: 1\n", "has no mapping `ros__parameters:`"),
    ],
)
def test_a_bad_parameter_file_is_reported_with_file_and_line(tmp_path, text, said):
    path = tmp_path / "p.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=said):
        read_parameters_file(path, "probe")


def test_unreadable_files_are_reported(tmp_path):
    with pytest.raises(SettingsError, match="cannot be read"):
        read_yaml(tmp_path / "absent.yaml")
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="cannot be read"):
        read_yaml(path)
    path.write_bytes(b"a: \x01")
    with pytest.raises(SettingsError, match="not valid YAML"):
        read_yaml(path)


def test_merge_keys_are_no_repetition(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text("a: &x {b: 1}\nc: &y {d: 2}\ne:\n  <<: *x\n  f: 3\n", encoding="utf-8")
    assert read_yaml(path)["e"] == {"b": 1, "f": 3}
