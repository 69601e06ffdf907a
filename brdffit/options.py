"""Options of methods: each is a field of a dataclass, with its values, its default and one line that says what it does.

A method names its own type of options. What all methods share stands in ``BakeOptions``, what all that bake lobes
share in ``LobeOptions``; a method with options of its own derives a type from one of them and gives it a ``group``, and
its options are then called ``group.name`` (``fit.loss``) on the command line and in files. In Python the name without
its group is enough.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple, TypeVar

from brdffit.errors import InputError, UnknownNameError
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")
_NOTHING = "none"


class OptionError(UnknownNameError):
    """An option that a method does not know, or a value that it cannot have (a wrong command line: exit code 2)."""

    def __init__(self, sentence: str) -> None:
        Exception.__init__(self, sentence)


class Limits(NamedTuple):
    """The numbers that an option may have: ``least <= value <= most`` and ``above < value``; None sets no limit."""

    least: float | None = None
    most: float | None = None
    above: float | None = None

    def admit(self, value: float) -> bool:
        """Whether a number is within the limits."""
        return (
            (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
        )

    def __str__(self) -> str:
        words = (("at least", self.least), ("above", self.above), ("at most", self.most))
        return " and ".join(f"{word} {limit:g}" for word, limit in words if limit is not None)


def option(
    default: Any, says: str, *, names: Sequence[str] | Callable[[], Sequence[str]] = (), least: float | None = None,
    most: float | None = None, above: float | None = None, check: Callable[[Any], object] | None = None,
) -> Any:  # fmt: skip
    """A field of an options type.

    Args:
        default: its value unless told otherwise.
        says: one line for the user.
        names: values of an option that is one of several names, or a function that lists them.
        least, most, above: limits of a number.
        check: raises an InputError for a value that cannot be.
    """
    metadata = {"says": says, "names": names, "limits": Limits(least, most, above), "check": check}
    return dataclasses.field(default=default, metadata=metadata)


def _models() -> Sequence[str]:
    from brdffit.models import model_names

    return model_names()


def _pixel_filters() -> Sequence[str]:
    from brdffit.footprint import PIXEL_FILTERS

    return PIXEL_FILTERS


@dataclass(frozen=True)
class BakeOptions:
    """What every method understands; ``brdffit methods NAME`` prints each option with its values and its line."""

    #: Prefix of the names of a type's own options; "" for those that methods share.
    group: ClassVar[str] = ""

    pixel_filter: str = option("box", "pixel filter of each level's scale", names=_pixel_filters)
    levels: int | None = option(None, "how many levels, level 0 counted; none: down to 1x1", least=1)
    keep_level_0: bool = option(False, "leave level 0 as authored instead of filtering it for the pixel filter")
    min_roughness: float = option(DEFAULT_MIN_ROUGHNESS, "perceptual roughness floor", above=0.0, most=1.0)
    threads: int | None = option(None, "worker threads, none: all cores; the result does not depend on it", least=1)


@dataclass(frozen=True)
class LobeOptions(BakeOptions):
    """What every method understands whose result is a pyramid of lobes."""

    model: str = option("ggx", "lobe model of the pyramid, see `brdffit models`", names=_models)
    lobe: str = option("anisotropic", "whether lobes may be anisotropic", names=("anisotropic", "isotropic"))
    density: str = option(
        "cosine", "how light and viewer are distributed in the error that is measured", names=("cosine", "uniform")
    )


Options = TypeVar("Options", bound=BakeOptions)


class Described(NamedTuple):
    """One option as a user sees it.

    Attributes:
        name: of the field.
        full_name: with its group, as the command line and files have it.
        kind: its type.
        default: its value unless told otherwise.
        names: its values, where it is one of several names.
        limits: of a number.
        says: one line for the user.
        check: raises an InputError for a value that cannot be; None where all can.
    """

    name: str
    full_name: str
    kind: Any
    default: Any
    names: tuple[str, ...]
    limits: Limits
    says: str
    check: Callable[[Any], object] | None = None

    @property
    def values(self) -> str:
        """What it may be, in a few words."""
        if self.names:
            return "|".join(self.names)
        (kind, *_) = (each for each in _alternatives(self.kind) if each is not type(None))
        if kind is bool:
            return "true|false"
        word = {int: "whole number", float: "number", str: "text"}.get(kind, "values a,b")
        return f"{word} {self.limits}".strip()


def described(kind: type[BakeOptions]) -> dict[str, Described]:
    """The options of a type by the name of their field; those that methods share come first."""
    return _described(typing.cast(Any, kind))


@cache
def _described(kind: Any) -> dict[str, Described]:
    hints = typing.get_type_hints(kind)
    groups = {name: each.__dict__.get("group", "") for each in reversed(kind.__mro__) for name in _own_fields(each)}
    found = {}
    for field in dataclasses.fields(kind):
        group, said = groups[field.name], field.metadata
        names = said.get("names", ())
        found[field.name] = Described(
            field.name, f"{group}.{field.name}" if group else field.name, hints[field.name], field.default,
            tuple(names() if callable(names) else names), said.get("limits", Limits()), said.get("says", ""),
            said.get("check"),
        )  # fmt: skip
    return found


def _alternatives(kind: Any) -> tuple[Any, ...]:
    """The types that a value may be of."""
    return typing.get_args(kind) if typing.get_origin(kind) in (typing.Union, types.UnionType) else (kind,)


def _own_fields(kind: type) -> Iterable[str]:
    return (name for name in kind.__dict__.get("__annotations__", {}) if name != "group")


def make_options(kind: type[Options], given: Mapping[str, Any], method: str) -> Options:
    """Options of a type from what was given, each by its name or its full name; text is read as the option's type.

    Raises:
        OptionError: for an option that the type does not have, with the nearest one; for a value it cannot have.
    """
    known = described(kind)
    found = {}
    for name, value in given.items():
        each = _find(known, name)
        if each is None:
            raise OptionError(_unknown(name, known, method))
        if each.name in found:
            raise OptionError(f"Option '{each.full_name}' is given twice.")
        found[each.name] = _checked(each, value)
    return kind(**found)


def known_options(kind: type[BakeOptions], given: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the given options that a type has."""
    known = described(kind)
    return {name: value for name, value in given.items() if _find(known, name) is not None}


def refuse_unknown(kinds: Mapping[str, type[BakeOptions]], given: Mapping[str, Any]) -> None:
    """Refuse an option that none of several methods has; ``kinds`` holds their types of options by the methods' names.

    Raises:
        OptionError: for one that none of them has.
    """
    for name in given:
        if all(_find(described(kind), name) is None for kind in kinds.values()):
            # The first method wins where several have an option of one name: the default comes first.
            together = {key: each for kind in reversed(list(kinds.values())) for key, each in described(kind).items()}
            raise OptionError(_unknown(name, together, ", ".join(kinds)))


def merged(*given: Mapping[str, Any]) -> dict[str, Any]:
    """Several mappings of options as one; later ones win, also where they spell a name another way."""
    found: dict[str, Any] = {}
    for name, value in (item for mapping in given for item in mapping.items()):
        found = {key: other for key, other in found.items() if not _same(key, name)}
        found[name] = value
    return found


def changed_options(options: BakeOptions) -> dict[str, Any]:
    """The options that differ from their defaults, without the number of threads."""
    usual = type(options)()
    fields = (field.name for field in dataclasses.fields(options) if field.name != "threads")
    return {name: getattr(options, name) for name in fields if getattr(options, name) != getattr(usual, name)}


def parse_settings(pairs: Iterable[str]) -> dict[str, str]:
    """NAME=VALUE, repeated, as a mapping.

    Raises:
        OptionError: for text of another form, or a name that is given twice.
    """
    found: dict[str, str] = {}
    for pair in pairs:
        name, equals, value = (part.strip() for part in pair.partition("="))
        if not (name and equals and value):
            raise OptionError(f"'{pair}' is not of the form NAME=VALUE, for example fit.loss=l1.")
        if name in found:
            raise OptionError(f"Option '{name}' is given twice.")
        found[name] = value
    return found


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(full name, value) of a table of options that may hold tables of groups, as [options.fit]."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _same(one: str, other: str) -> bool:
    """Whether two spellings mean one option: "loss" and "fit.loss" do, "fit.loss" and "ndm.loss" do not."""
    one, other = one.replace("-", "_"), other.replace("-", "_")
    ends = one.rpartition(".")[2] == other.rpartition(".")[2]
    return ends and (one == other or "." not in one or "." not in other)


def _find(known: Mapping[str, Described], name: str) -> Described | None:
    each = known.get(name.rpartition(".")[2].replace("-", "_"))
    return (
        each
        if each is not None and ("." not in name or name.replace("-", "_") == each.full_name.replace("-", "_"))
        else None
    )


def _unknown(name: str, known: Mapping[str, Described], method: str) -> str:
    full = sorted(each.full_name for each in known.values())
    ends = {each.name: each.full_name for each in known.values()}
    end = name.rpartition(".")[2]
    near = difflib.get_close_matches(name, full, n=1, cutoff=0.6) or [
        ends[each] for each in difflib.get_close_matches(end, list(ends), n=1, cutoff=0.6)
    ]
    known_ones = f"did you mean '{near[0]}'?" if near else f"it knows {', '.join(full)}."
    return f"Method {method} has no option '{name}': {known_ones}"


def _checked(each: Described, value: Any) -> Any:
    """The value as the option's type.

    Raises:
        OptionError: when it cannot be read as that type, or is outside the limits.
    """
    nothing = value is None or (isinstance(value, str) and value.strip().lower() == _NOTHING)
    if nothing and type(None) in _alternatives(each.kind):
        return None
    found = _converted(each, value)
    if each.names and found not in each.names:
        near = difflib.get_close_matches(str(value), each.names, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise OptionError(f"Option '{each.full_name}' cannot be '{value}': {hint}known are {', '.join(each.names)}.")
    number = isinstance(found, (int, float)) and not isinstance(found, bool)
    if found is None or (number and not (math.isfinite(found) and each.limits.admit(found))):
        raise OptionError(f"Option '{each.full_name}' is '{value}', expected {_expected(each)}.")
    if each.check is not None:
        try:
            each.check(found)
        except InputError as error:
            raise OptionError(f"Option '{each.full_name}': {error}") from error
    return found


def _expected(each: Described) -> str:
    words = each.values.replace("|", " or ")
    article = "" if words[:4] in ("true", "text") or words.startswith("values") else "a "
    return article + words


def _converted(each: Described, value: Any) -> Any:
    """The value as one of the option's types; None where it is of no such type."""
    if each.names and isinstance(value, str):
        return value
    for kind in _alternatives(each.kind):
        origin = typing.get_origin(kind) or kind
        if origin is tuple:
            return _tuple_of(typing.get_args(kind), value)
        if origin is bool:
            return _bool_of(value)
        if origin is str and isinstance(value, str):
            return value
        if origin in (int, float) and not isinstance(value, bool):
            with_dot = isinstance(value, float) and not float(value).is_integer()
            try:
                return None if origin is int and with_dot else origin(value)
            except (TypeError, ValueError):
                continue
    return None


def _bool_of(value: Any) -> bool | None:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    return True if text in _TRUE else False if text in _FALSE else None


def _tuple_of(kinds: tuple[Any, ...], value: Any) -> tuple[Any, ...] | None:
    parts = value.split(",") if isinstance(value, str) else value
    element = kinds[0] if kinds and kinds[0] in (int, float, str) else str
    try:
        found = tuple(element(part.strip() if isinstance(part, str) else part) for part in parts)
    except (TypeError, ValueError):
        return None
    fixed = kinds and Ellipsis not in kinds
    return None if fixed and len(found) != len(kinds) else found
