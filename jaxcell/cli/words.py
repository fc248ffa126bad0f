"""Read the words of a command line into the options of a command.

The first wrong word raises a `ValueError` of one sentence, with the option and what to write.
"""

import difflib
import re
import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, get_args, get_origin

from ..base.bundled import bundled_names, with_path
from ..base.formatting import did_you_mean
from ..base.paths import existing
from ..base.units import EXPECTED, number_of
from ..study.parameters import (
    Limit,
    Only,
    Unit,
    choices_and_types,
    inside,
    listed,
    parameters,
    within,
)
from .help import as_options, is_positional, option, page


# A number may begin with a sign, a name of an option not with a digit.
_OPTION = re.compile(r"-+[^\d\W.]|--")
_UNIT = re.compile(r"[^\d\W]+(?:[2²]?/[sh])?|[°%]")


def parsed(
    kind: Any,
    name: str,
    words: Sequence[str],
    commands: Mapping[str, type] = types.MappingProxyType({}),
) -> Any:
    """Read the options `words` of the command `name` into an instance of its class `kind`.

    `commands` are the classes of all commands, of which another may have an option.
    """
    if not {"-h", "--help"}.isdisjoint(words):
        page(kind, name)
    hints = parameters(kind)
    places = [parameter for parameter, hint in hints.items() if is_positional(hint)]
    options = {option(kind, parameter): parameter for parameter in hints.keys() - {*places}}
    given: dict[str, list[str]] = {}
    free: list[str] = []
    queue = list(words)
    while queue:
        if not _OPTION.match(word := queue.pop(0)):
            free.append(word)
            continue
        flag, equals, value = word.partition("=")
        flag = flag.replace("_", "-")
        if (parameter := options.get(flag)) is None:
            alike = [each for each in commands if each.split()[0] == name.split()[0]]
            having = [each for each in alike if _has(commands[each], flag)]
            advice = f"try {listed(tuple(having))}" if having else _advice(flag, options, name)
            raise ValueError(f"there is no option {flag}; {advice}")
        if parameter in given:
            raise ValueError(f"{flag}: it is given twice")
        if equals:
            queue.insert(0, value)
        wants_place = len(free) < sum(_required(kind, places))
        given[parameter] = _taken(flag, hints[parameter], queue, bool(equals), wants_place)
    for place in places:
        many = None if _count(hints[place]) is None else 1
        if taken := free[:many]:
            given[place], free[: len(taken)] = taken, []
    values = {
        parameter: _value(option(kind, parameter), hints[parameter], texts)
        for parameter, texts in given.items()
    }
    for parameter, texts in given.items():
        for condition in _of_unit(hints[parameter]):
            if not (texts[0].isdecimal() or condition.values.keys() <= given.keys()):
                needs = as_options(kind, str(condition))
                flag = option(kind, parameter)
                raise ValueError(f"{flag}: {texts[0]!r} may have a unit only {needs}")
    missing = {
        option(kind, parameter): hints[parameter]
        for parameter, required in zip(hints, _required(kind, hints), strict=True)
        if required and parameter not in given
    }
    if free:
        raise ValueError(f"unexpected word {free[0]!r}; {_place(free[0], missing, options, name)}")
    if missing:
        for place in places:
            if isinstance(file := values.get(place), Path):
                existing(file)
        such = getattr(kind, "example", "") or "--help"
        raise ValueError(f"missing {', '.join(missing)}; for example: jaxcell {name} {such}")
    return kind(**values)


def _has(kind: type, flag: str) -> bool:
    return any(option(kind, parameter) == flag for parameter in parameters(kind))


def _required(kind: Any, names: Iterable[str]) -> list[bool]:
    field = {field.name: field for field in fields(kind)}
    return [
        field[name].default is MISSING and field[name].default_factory is MISSING for name in names
    ]


def _count(hint: Any) -> int | None:
    """Count the words of an option; `None` for any number."""
    parts = [*inside(hint)]
    if bool in parts:
        return 0
    several = next((get_args(part) for part in parts if get_origin(part) is tuple), (str,))
    return None if Ellipsis in several else len(several)


def _taken(flag: str, hint: Any, queue: list[str], joined: bool, wants_place: bool) -> list[str]:
    """Take the words of an option from the `queue`.

    Several numbers may be separated by commas, and a unit may be a word of its own. A last word
    that does not fit is left for a missing argument, as in `--bounce 45 @lab_a`.
    """
    count, (_, kinds) = _count(hint), _types(hint)
    taken: list[str] = []
    if count == 0 and joined:
        raise ValueError(f"{flag}: it takes no value, got {queue[0]!r}")
    while queue and len(taken) != count and (joined or not _OPTION.match(queue[0])):
        if count != 1 and not {int, float}.isdisjoint(kinds):
            queue[:1] = queue[0].split(",")
        last = not queue[1:] or _OPTION.match(queue[1])
        if count is None and taken and last and wants_place and not _fits(hint, queue[0]):
            break
        taken.append(queue.pop(0))
        joined = False
        if _unit(hint) and queue and _UNIT.fullmatch(queue[0]):
            taken[-1] += queue.pop(0) if _fits(hint, taken[-1] + queue[0]) else ""
    if count is not None and len(taken) < count:
        many = _expected(hint) if count == 1 else f"{count} values"
        raise ValueError(f"{flag}: expected {many}, got {len(taken) or 'nothing'}")
    return taken


def _fits(hint: Any, word: str) -> bool:
    try:
        _one(hint, word)
    except (ValueError, FileNotFoundError):
        return False
    return not word.startswith("@")


def _value(flag: str, hint: Any, words: Sequence[str]) -> Any:
    if _count(hint) == 0:
        return True
    try:
        values = tuple(_one(hint, word) for word in words)
    except ValueError as error:
        raise ValueError(f"{flag}: {error}") from None
    return values if any(get_origin(part) is tuple for part in inside(hint)) else values[0]


def _one(hint: Any, word: str) -> Any:
    """Convert a word; the types of a union are tried from left to right."""
    if not word:
        raise ValueError("expected a value, got an empty text")
    choices, kinds = _types(hint)
    if word in choices:
        return word
    for kind in kinds:
        try:
            if kind is float:
                return number_of(word, _unit(hint))
            if kind is int:
                return _whole(word, _unit(hint))
            file = kind is Path or (kind is str and word[1:] in bundled_names())
            return kind(with_path(word) if file else word)
        except ValueError:
            continue
    meant = did_you_mean(word, choices)
    raise ValueError(f"expected {_expected(hint)}, got {word!r}{meant}")


def _whole(word: str, unit: str) -> int:
    try:
        return int(word)
    except ValueError:
        if not (number := number_of(word, unit)).is_integer():
            raise
    return int(number)


def _types(hint: Any) -> tuple[list[str], list[Any]]:
    """List the choices and the other types of the values of an option."""
    choices, kinds = choices_and_types(hint)
    return choices, [kind for kind in dict.fromkeys(kinds) if kind not in (types.NoneType, Any)]


def _unit(hint: Any) -> str:
    unit, limit = within(hint, Unit), within(hint, Limit)
    if unit is not None:
        return unit.suffix or unit.word
    return "share" if limit is not None and 1 in (limit.le, limit.lt) else ""


def _of_unit(hint: Any) -> Iterable[Only]:
    """Yield the conditions for numbers with a unit, if others have none: steps or seconds."""
    for part in [*inside(hint)][1:]:
        yield from (note for note in getattr(part, "__metadata__", ()) if isinstance(note, Only))


def _expected(hint: Any) -> str:
    choices, kinds = _types(hint)
    whole = "a whole number such as 3" + (f", or {EXPECTED[unit]}" if (unit := _unit(hint)) else "")
    words = {int: whole, float: EXPECTED[unit], Path: "a file"}
    return listed((*(words.get(kind, "a text") for kind in kinds), *choices))


def _advice(flag: str, options: Iterable[str], name: str) -> str:
    """Name the option that is most similar to `flag`."""
    known = sorted(options)
    near = difflib.get_close_matches(flag, known, 1)
    near += [each for each in known if each[1:].startswith("-" + flag.strip("-"))]
    return f"did you mean {near[0]}?" if near else f"jaxcell {name} --help lists the options"


def _place(word: str, missing: Mapping[str, Any], options: Iterable[str], name: str) -> str:
    """Advise where a word belongs that follows no option."""
    fitting = [flag for flag, hint in missing.items() if _fits(hint, word)]
    return f"did you mean {fitting[0]} {word}?" if fitting else _advice(f"--{word}", options, name)
