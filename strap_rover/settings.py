"""Settings: a frozen dataclass filled from a mapping or a ROS 2 parameter file, every problem listed in one error.

A settings class is a frozen dataclass whose fields are float, int, bool, str or tuples of those. What a value may be
stands in the field's metadata, once, for the reader of YAML, the ROS parameter and the documentation:

    rate_hz: float = field(default=100.0, metadata={"doc": "how often [Hz]", "min": 1.0, "max": 400.0})

Known metadata: `doc` (what it is, with its unit), `min`, `max` (both allowed values), `choices`, and `tunable`
(True when a running node may change it). For a tuple they hold for every element.
"""

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_origin, get_type_hints

import yaml


class Settings(Protocol):
    """Any dataclass instance."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


SettingsT = TypeVar("SettingsT", bound=Settings)

_SCALARS = (float, int, bool, str)
_KIND_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


class SettingsError(ValueError):
    """Everything that is wrong with a set of settings, one line each in `problems`."""

    def __init__(self, problems: Iterable[str]) -> None:
        self.problems: tuple[str, ...] = tuple(problems)
        super().__init__("\n".join(self.problems))


@dataclasses.dataclass(frozen=True, slots=True)
class FieldType:
    """What type a settings field holds: one scalar, or a tuple of them."""

    scalar: type
    """float, int, bool or str."""
    is_tuple: bool = False
    length: int | None = None
    """Number of elements a tuple must have; None: any."""

    def __str__(self) -> str:
        """Say it in words, as in `give ...`."""
        kind = _KIND_NAMES[self.scalar]
        if not self.is_tuple:
            return kind
        return f"a list, each element {kind}" if self.length is None else f"a list of {self.length}, each {kind}"


def field_types(settings_class: type[Settings]) -> dict[str, FieldType]:
    """The type of every field, in order.

    Raises:
        TypeError: the class is no dataclass, or a field is not float, int, bool, str or a tuple of one of those.
    """
    hints = get_type_hints(settings_class)
    return {
        item.name: _field_type(settings_class, item.name, hints[item.name])
        for item in dataclasses.fields(settings_class)
    }


def settings_from_mapping(
    settings_class: type[SettingsT], mapping: Mapping[str, object], source: str | Path = "settings"
) -> SettingsT:
    """Fill `settings_class` from `mapping`; `source` says in the messages where the values come from.

    An int is taken for a float; a bool is never taken for a number.

    Raises:
        SettingsError: with every unknown or missing key, wrong type, NaN or infinity, value out of range or not among
            the choices, and whatever ValueError the class itself raises on construction.
    """
    values, problems = read_fields(settings_class, mapping, source)
    if problems:
        raise SettingsError(problems)
    try:
        return settings_class(**values)
    except SettingsError as error:
        raise SettingsError(f"{source}: {problem}" for problem in error.problems) from error
    except ValueError as error:
        raise SettingsError([f"{source}: {error}"]) from error


def read_fields(
    settings_class: type[Settings],
    mapping: Mapping[str, object],
    source: str | Path = "settings",
    *,
    elsewhere: Sequence[str] = (),
) -> tuple[dict[str, Any], list[str]]:
    """The constructor arguments found in `mapping`, and everything that is wrong with it.

    Fields named in `elsewhere` are read by the caller: they are neither converted nor missed.
    """
    fields = {item.name: item for item in dataclasses.fields(settings_class) if item.name not in elsewhere}
    hints = get_type_hints(settings_class)
    problems = [
        f"{source}: {_unknown_key(key, value, [*fields, *elsewhere])}"
        for key, value in mapping.items()
        if key not in fields and key not in elsewhere
    ]
    values: dict[str, Any] = {}
    for name, item in fields.items():
        expected = _field_type(settings_class, name, hints[name])
        if name in mapping:
            value, wrong = _converted(mapping[name], expected, item.metadata)
            problems += [f"{source}: {name}: {text}" for text in wrong]
            if not wrong:
                values[name] = value
        elif item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING:
            doc = item.metadata.get("doc")
            problems.append(f"{source}: {name}: missing; add it as {expected}" + (f" ({doc})" if doc else ""))
    return values, problems


def check_settings(settings: Settings, *, elsewhere: Sequence[str] = ()) -> None:
    """Hold the fields of a settings object against their own types and metadata; call it from `__post_init__`.

    Raises:
        SettingsError: with everything that is wrong.
    """
    settings_class = type(settings)
    mapping = {
        item.name: getattr(settings, item.name)
        for item in dataclasses.fields(settings_class)
        if item.name not in elsewhere
    }
    _, problems = read_fields(settings_class, mapping, settings_class.__name__, elsewhere=elsewhere)
    if problems:
        raise SettingsError(problems)


def settings_as_mapping(settings: Settings) -> dict[str, Any]:
    """The fields as a plain mapping, tuples as lists: what YAML, JSON and a bag's metadata hold."""
    return {
        item.name: list(value) if isinstance(value, tuple) else value
        for item in dataclasses.fields(settings)
        for value in [getattr(settings, item.name)]
    }


def load_settings(settings_class: type[SettingsT], path: str | Path, node_name: str) -> SettingsT:
    """Read `node_name`'s parameters of the ROS 2 parameter file `path` into `settings_class`.

    Raises:
        SettingsError: as `read_parameters_file` and `settings_from_mapping`.
    """
    return settings_from_mapping(settings_class, read_parameters_file(path, node_name), path)


def read_yaml(path: str | Path) -> object:
    """The content of a YAML file.

    Raises:
        SettingsError: the file cannot be read, is no YAML, or gives one key twice; with file and line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError([f"{path}: cannot be read: {error}"]) from error
    try:
        return yaml.load(text, Loader=_UniqueKeyLoader)  # noqa: S506  the loader derives from SafeLoader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        raise SettingsError([f"{where}: not valid YAML: {error.problem or error.context}"]) from error
    except yaml.YAMLError as error:
        raise SettingsError([f"{path}: not valid YAML: {error}"]) from error


def read_parameters_file(path: str | Path, node_name: str) -> dict[str, object]:
    """The parameters a ROS 2 parameter file gives to the node `node_name`, nested names joined by dots.

    Sections for every node (`/**`) come first, those named after the node override them.

    Raises:
        SettingsError: unreadable file, bad YAML, no section for this node, or one without `ros__parameters`.
    """
    return read_parameters(read_yaml(path), node_name, path)


def read_parameters(content: object, node_name: str, path: str | Path) -> dict[str, object]:
    """As `read_parameters_file`, from what was read of the file; `path` says in the messages which one it was."""
    if not isinstance(content, dict):
        raise SettingsError(
            [f"{path}: must be a mapping `/**:` or `{node_name}:` -> `ros__parameters:`, not {content!r}"]
        )
    bare_name = node_name.rpartition("/")[2]
    everybody = ("/**", "/*")
    own = (bare_name, f"/{bare_name}", f"/**/{bare_name}", node_name)
    problems: list[str] = []
    parameters: dict[str, object] = {}
    found = False
    for group in (everybody, own):
        for section, body in content.items():
            if section not in group:
                continue
            found = True
            inner = body.get("ros__parameters") if isinstance(body, dict) else None
            if not isinstance(inner, dict):
                problems.append(f"{path}: {section}: has no mapping `ros__parameters:`; add it below `{section}:`")
                continue
            parameters.update(_flattened(inner))
    if not found:
        sections = ", ".join(str(section) for section in content) or "none"
        problems.append(f"{path}: no section for node {node_name!r} (found: {sections}); add `{bare_name}:` or `/**:`")
    if problems:
        raise SettingsError(problems)
    return parameters


class _UniqueKeyLoader(yaml.SafeLoader):  # type: ignore[misc,unused-ignore]  # PyYAML may come without types
    """SafeLoader that refuses a key given twice instead of taking the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The mapping of `node`.

        Raises:
            yaml.constructor.ConstructorError: a scalar key stands twice.
        """
        seen: set[str] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag.endswith(":merge"):
                continue
            if key_node.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key_node.value!r} is given twice; keep one", key_node.start_mark
                )
            seen.add(key_node.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        return mapping


def _flattened(mapping: Mapping[object, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in mapping.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flattened(value, f"{name}."))
        else:
            flat[name] = value
    return flat


def _field_type(settings_class: type[Settings], name: str, hint: object) -> FieldType:
    if isinstance(hint, type) and hint in _SCALARS:
        return FieldType(hint)
    if get_origin(hint) is tuple:
        elements = get_args(hint)
        open_ended = len(elements) == 2 and elements[1] is Ellipsis
        kinds = set(elements[:1] if open_ended else elements)
        if len(kinds) == 1 and next(iter(kinds)) in _SCALARS:
            return FieldType(next(iter(kinds)), is_tuple=True, length=None if open_ended else len(elements))
    message = f"{settings_class.__name__}.{name} is {hint}: a settings field is float, int, bool, str or a tuple of one"
    raise TypeError(message)


def _unknown_key(key: object, value: object, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(str(key), known, n=1)
    remedy = f"did you mean {close[0]!r}?" if close else f"remove it; known keys: {', '.join(known) or 'none'}"
    return f"{key}: unknown key (value {value!r}); {remedy}"


def _converted(value: object, expected: FieldType, metadata: Mapping[str, Any]) -> tuple[object, list[str]]:
    if not expected.is_tuple:
        return _converted_scalar(value, expected.scalar, metadata)
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Sequence):
        return None, [f"{value!r} is {_kind_of(value)}; give {expected}"]
    problems: list[str] = []
    elements: list[object] = []
    if expected.length is not None and len(value) != expected.length:
        problems.append(f"{list(value)!r} has {len(value)} elements; give {expected}")
    for index, element in enumerate(value):
        converted, wrong = _converted_scalar(element, expected.scalar, metadata)
        elements.append(converted)
        problems += [f"element {index}: {text}" for text in wrong]
    return tuple(elements), problems


def _converted_scalar(value: object, kind: type, metadata: Mapping[str, Any]) -> tuple[object, list[str]]:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        return None, [f"{value!r} is {_kind_of(value)}; give {_KIND_NAMES[kind]}{_hint(value, kind)}"]
    if isinstance(value, float) and not math.isfinite(value):
        return None, [f"{value!r} is not finite; give a number{_range_in_words(metadata)}"]
    if "choices" in metadata and value not in metadata["choices"]:
        choices = ", ".join(repr(choice) for choice in metadata["choices"])
        close = difflib.get_close_matches(str(value), [str(choice) for choice in metadata["choices"]], n=1)
        return None, [f"{value!r} is not a choice; give one of {choices}" + (f" ({close[0]}?)" if close else "")]
    if ("min" in metadata and value < metadata["min"]) or ("max" in metadata and value > metadata["max"]):
        return None, [f"{value!r} is out of range; give a value{_range_in_words(metadata)}"]
    return value, []


def _range_in_words(metadata: Mapping[str, Any]) -> str:
    low, high = metadata.get("min"), metadata.get("max")
    if low is not None and high is not None:
        return f" from {low} to {high}"
    if low is not None:
        return f" of at least {low}"
    return "" if high is None else f" of at most {high}"


def _kind_of(value: object) -> str:
    if value is None:
        return "empty"
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return _KIND_NAMES[kind]
    return "a mapping" if isinstance(value, Mapping) else "a list" if isinstance(value, Sequence) else "no setting"


def _hint(value: object, kind: type) -> str:
    if kind is int and isinstance(value, float):
        return " without a decimal point"
    if kind is float and isinstance(value, str):
        try:
            number = float(value)
        except ValueError:
            return ""
        return f", without quotes and with a decimal point: {number!r}" if math.isfinite(number) else ""
    return ", in quotes" if kind is str else ""
