"""Specs: settings shared by TOML files, command-line flags and forms on the page.

A spec validates itself on creation: every field against its declared type and the limit in its annotation, with a
sentence that names field, value and limit.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import re
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import msgspec

from wafer_viewer.model.errors import PlanError, WaferViewerError


@dataclass(frozen=True, slots=True)
class Within:
    """Limit of a number: ``low <= value <= high``; an open end excludes its own value."""

    low: float | None = None
    high: float | None = None
    open_low: bool = False
    odd: bool = False

    def __contains__(self, value: float) -> bool:
        if self.low is not None and (value < self.low or (self.open_low and value == self.low)):
            return False
        if self.high is not None and value > self.high:
            return False
        return not self.odd or value % 2 == 1

    def __str__(self) -> str:
        parts: list[str] = []
        if self.low is not None and self.high is not None:
            parts.append(f"between {self.low:g} and {self.high:g}")
        elif self.low is not None:
            parts.append(f"{'over' if self.open_low else 'at least'} {self.low:g}")
        elif self.high is not None:
            parts.append(f"at most {self.high:g}")
        if self.odd:
            parts.append("odd")
        return " and ".join(parts) or "a number"


Positive = Annotated[float, Within(0, open_low=True)]
NonNegative = Annotated[float, Within(0)]
Fraction = Annotated[float, Within(0, 1)]
Count = Annotated[int, Within(1)]


class Spec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of all specs: frozen, rejects unknown keys, validates itself on creation."""

    error: ClassVar[type[WaferViewerError]] = PlanError

    def __post_init__(self) -> None:
        for name, check in _checks(type(self)):
            if (wrong := check(getattr(self, name))) is not None:
                self.refuse(name, wrong)

    def refuse(self, name: str, limit: str) -> typing.NoReturn:
        """Raise this spec's error: `limit` completes the sentence 'it must be ...'."""
        value = _shortened(repr(getattr(self, name)))
        raise self.error(f"{type(self).__name__}.{name} is {value}: it must be {limit}.")


def require_choice(name: str, value: object, choices: Any, error: type[WaferViewerError]) -> None:
    """Raise an error that names the argument and what may be given, unless the value is one of a Literal's choices."""
    if (wrong := _type_check(choices)(value)) is not None:
        raise error(f"{name} is {_shortened(repr(value))}: it must be {wrong}.")


S = TypeVar("S", bound=Spec)
R = TypeVar("R")
Form = Literal["toml", "json"]


def replace(item: R, **changes: Any) -> R:
    """Return a copy of a spec or a frozen dataclass with some fields changed; a spec is validated again."""
    if dataclasses.is_dataclass(item):
        return dataclasses.replace(item, **changes)  # type: ignore[return-value]
    return msgspec.structs.replace(item, **changes)  # type: ignore[type-var]


def with_field(item: R, path: str, value: Any) -> R:
    """Return a copy of a spec with one field changed; a path such as ``levy.mode`` leads into the specs it holds."""
    name, _, inner = path.partition(".")
    return replace(item, **{name: with_field(getattr(item, name), inner, value) if inner else value})


def decode(text: str | bytes, kind: type[S], name: str, form: Form = "toml") -> S:
    """Read a spec from TOML or JSON `text`; errors refer to the text by `name`, usually a file name."""
    try:
        if form == "json":
            return msgspec.json.decode(text, type=kind)
        return msgspec.convert(_parsed_toml(text.decode() if isinstance(text, bytes) else text), kind)
    except (tomllib.TOMLDecodeError, msgspec.DecodeError, UnicodeDecodeError) as fault:
        raise kind.error(f"{name}: {_plain(str(fault))}{_choices_at(kind, str(fault))}.") from fault
    except RecursionError as fault:
        raise kind.error(f"{name}: it has too many levels of brackets: check what it is.") from fault
    except (ValueError, OverflowError) as fault:  # a number of thousands of digits, a date that does not exist
        raise kind.error(f"{name}: a value cannot be read ({_plain(str(fault))}).") from fault
    except WaferViewerError as fault:
        raise type(fault)(f"{name}: {fault}") from fault


MOST_TOML_BYTES = 8_000_000
"""Largest TOML text: a plan of 100 000 fields one by one; larger ones take minutes to parse."""
MOST_TOML_LEVELS = 32
"""Deepest nesting of brackets, and most parts of a dotted key, in TOML. The parser needs memory with their square."""
_ESCAPED = r"\\(?:.|\Z)"
_TOML_TEXTS = re.compile(
    rf"\"{{3}}(?:[^\\]|{_ESCAPED})*?(?:\"{{3}}|\Z)|'{{3}}.*?(?:'{{3}}|\Z)"
    rf"|\"(?:[^\"\\\n]|{_ESCAPED})*+(?:[\"\n]|\Z)|'[^'\n]*+(?:['\n]|\Z)|#[^\n]*+",
    re.DOTALL,
)
"""Texts and comments. One that is not closed ends with its line or the file, so that each letter is looked at once."""
_DOTTED_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{MOST_TOML_LEVELS},}}")


def _parsed_toml(text: str) -> dict[str, Any]:
    """Parse TOML after a check of its size and its nesting. Raises TOMLDecodeError."""
    if len(text) > MOST_TOML_BYTES:
        raise tomllib.TOMLDecodeError(f"it has more than {MOST_TOML_BYTES // 1_000_000} MB, too much for settings")
    plain = _TOML_TEXTS.sub("x", text)
    depth = 0
    for bracket in re.finditer(r"[\[\]{}]", plain):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > MOST_TOML_LEVELS:
            raise tomllib.TOMLDecodeError(f"it has more than {MOST_TOML_LEVELS} levels of brackets")
    if _DOTTED_KEY.search(plain):
        raise tomllib.TOMLDecodeError(f"a key in it has more than {MOST_TOML_LEVELS} parts")
    return tomllib.loads(text)


def encode(spec: Spec, form: Form = "toml") -> str:
    """Return a spec as TOML or JSON text; None values are omitted from TOML."""
    if form == "json":
        return msgspec.json.format(msgspec.json.encode(spec, enc_hook=_plain_number), indent=2).decode()
    import tomli_w

    return tomli_w.dumps(_without_none(msgspec.to_builtins(spec, enc_hook=_plain_number)))


def _plain_number(value: Any) -> Any:
    """Convert a NumPy scalar to the Python number for serialisation."""
    if isinstance(value, numbers.Number) and hasattr(value, "item"):
        return typing.cast(Any, value).item()
    raise NotImplementedError(f"{type(value).__name__} cannot be written to a file")


def _plain(message: str) -> str:
    """Return the message of a parser in the words of the house, on one line and shortened."""
    plain = (
        message.replace("Object contains unknown field", "unknown key")
        .replace("`", "'")
        .replace(" - at '$", " at '")
        .rstrip(".")
    )
    return _shortened(" ".join(plain.split()))


_WRONG_CHOICE = re.compile(r"Invalid enum value .* - at `\$(?P<path>[^`]*)`")


def _choices_at(kind: Any, message: str) -> str:
    """Return what may stand where a parser found another word, as an addition to its message; else nothing."""
    found = _WRONG_CHOICE.search(message)
    if found is None:
        return ""
    for key in re.findall(r"\.(\w+)|\[\S*?\]", found["path"]):
        parts = _parts_of(kind)
        hints = (typing.get_type_hints(part) for part in parts if isinstance(part, type) and issubclass(part, Spec))
        kind = next((h[key] for h in hints if key in h), None) if key else next(map(_item_of, parts), None)
    words = [word for part in _parts_of(kind) if typing.get_origin(part) is Literal for word in typing.get_args(part)]
    return f": it must be one of {', '.join(map(repr, words))}" if words else ""


def _parts_of(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the type itself."""
    return typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)


def _item_of(hint: Any) -> Any:
    return next(iter(typing.get_args(hint)), None)


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_QUOTE else f"{text[: _LONGEST_QUOTE // 2]} … {text[-_LONGEST_QUOTE // 2 :]}"


_LONGEST_QUOTE = 300
"""Letters of a value or of the message of a parser that a sentence contains."""


def _without_none(data: Any) -> Any:
    if isinstance(data, dict):
        return {k: _without_none(v) for k, v in typing.cast(dict[str, Any], data).items() if v is not None}
    if isinstance(data, list | tuple):
        return [_without_none(v) for v in typing.cast(list[Any], data)]
    return data


@dataclass(frozen=True, slots=True)
class Setting:
    """Label of a field that a person sets, in its annotation.

    title: with the unit behind a comma; about: sentence of the tooltip, without the limit; empty: meaning of an empty
    field; titles: of the values of a choice; decimals and step: of a number; unit: of a number whose title has none.
    """

    title: str
    about: str
    empty: str = ""
    titles: Mapping[Any, str] = field(default_factory=dict[Any, str], hash=False)
    decimals: int = 0
    step: float = 1.0
    unit: str = ""


@dataclass(frozen=True, slots=True)
class SettingField:
    """A field that a person sets: its label, its type without the annotation, and its limit."""

    setting: Setting
    kind: Any
    limit: Within | None

    @property
    def hint(self) -> str:
        """Tooltip: the sentence, and the limit if there is one."""
        return f"{self.setting.about}; {self.limit}" if self.limit is not None else self.setting.about


@cache
def settings_of(kind: type[Spec]) -> dict[str, SettingField]:
    """Return the labelled fields of a spec and, by a path with dots, those of the specs in it."""
    found: dict[str, SettingField] = {}
    for name, hint in typing.get_type_hints(kind, include_extras=True).items():
        marks = _marks(hint)
        plain = _plain_type(hint)
        if (setting := next((mark for mark in marks if isinstance(mark, Setting)), None)) is not None:
            limit = next((mark for mark in marks if isinstance(mark, Within)), None)
            found[name] = SettingField(setting, plain, limit)
        for part in typing.get_args(plain) or (plain,):
            if isinstance(part, type) and issubclass(part, Spec) and part is not kind:
                found |= {f"{name}.{inner}": one for inner, one in settings_of(part).items()}
    return found


def value_at(spec: Spec, path: str) -> Any:
    """Return the value of a field by its path with dots."""
    return functools.reduce(getattr, path.split("."), spec)


def _marks(hint: Any) -> tuple[Any, ...]:
    """Return the metadata of an annotation, that of the members of a union or a pair last."""
    own = getattr(hint, "__metadata__", ())
    plain = hint.__origin__ if typing.get_origin(hint) is Annotated else hint
    members = typing.get_args(plain) if _is_union(plain) or typing.get_origin(plain) is tuple else ()
    return (*own, *(mark for member in members for mark in getattr(member, "__metadata__", ())))


def _plain_type(hint: Any) -> Any:
    """Return a type without metadata, also that of the members of a union."""
    if typing.get_origin(hint) is Annotated:
        return _plain_type(hint.__origin__)
    return typing.Union[tuple(map(_plain_type, typing.get_args(hint)))] if _is_union(hint) else hint  # noqa: UP007


def _is_union(hint: Any) -> bool:
    return typing.get_origin(hint) in (typing.Union, types.UnionType)


Check = typing.Callable[[Any], str | None]


@cache
def _checks(kind: type[Spec]) -> tuple[tuple[str, Check], ...]:
    hints = typing.get_type_hints(kind, include_extras=True)
    return tuple((name, _check_of(hints[name])) for name in kind.__struct_fields__)


def _check_of(hint: Any) -> Check:
    limit = next((m for m in getattr(hint, "__metadata__", ()) if isinstance(m, Within)), None)
    plain = hint.__origin__ if typing.get_origin(hint) is Annotated else hint
    of_type = _type_check(plain)
    if limit is None:
        return of_type

    def check(value: Any) -> str | None:
        wrong = of_type(value)
        if wrong is not None or isinstance(value, str) or value is None:
            return wrong
        return None if value in limit else str(limit)

    return check


def _type_check(hint: Any) -> Check:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint in (int, float):
        return _number_check(hint)
    if origin is Annotated:
        return _check_of(hint)
    if origin is Literal:
        choices = ", ".join(repr(a) for a in args)
        return lambda v: None if v in args else f"one of {choices}" if len(args) > 1 else choices
    if origin in (typing.Union, types.UnionType):
        return _union_check([_type_check(a) for a in args])
    if origin is tuple and len(args) == 2 and args[1] is Ellipsis:
        return _sequence_check(_type_check(args[0]), args[0])
    return lambda v: None if _is_a(v, hint) else _type_name(hint)


def _number_check(kind: type) -> Check:
    def check(value: Any) -> str | None:
        if type(value) is int:  # nearly all values are of a plain type, and a plan has a million of them
            return None
        if type(value) is float and kind is float:
            return None if math.isfinite(value) else "a finite number"
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else int):
            return "a number" if kind is float else "a whole number"
        return None if math.isfinite(value) else "a finite number"

    return check


def _union_check(checks: list[Check]) -> Check:
    def check(value: Any) -> str | None:
        wrongs = [c(value) for c in checks]
        return None if any(w is None for w in wrongs) else " or ".join(dict.fromkeys(w for w in wrongs if w))

    return check


def _sequence_check(item: Check, kind: Any) -> Check:
    of_structs = isinstance(kind, type) and issubclass(kind, msgspec.Struct)

    def check(value: Any) -> str | None:
        if not isinstance(value, tuple):
            return "a list"
        if of_structs and {type(v) for v in typing.cast(tuple[Any, ...], value)} <= {kind}:
            return None  # valid since they were made; a plan has a million of them
        wrong = next((w for v in typing.cast(tuple[Any, ...], value) if (w := item(v)) is not None), None)
        return None if wrong is None else f"a list, each {wrong}"

    return check


def _is_a(value: Any, hint: Any) -> bool:
    try:
        msgspec.convert(value, hint, strict=True)
    except msgspec.ValidationError:
        return False
    return True


def _type_name(hint: Any) -> str:
    return {str: "a text", bool: "true or false", type(None): "left out"}.get(
        hint, f"a {getattr(hint, '__name__', hint)}"
    )
