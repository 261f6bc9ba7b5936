"""Checks of the fields of a model card; each raises ModelError that names the field."""
from collections.abc import Callable
from dataclasses import fields, MISSING
import re
from typing import Any

from neo_ros.errors import ModelError, NeoError

# Larger counts describe no picture, and numbers of thousands of digits cannot even be printed.
MAX_WHOLE = (1 << 31) - 1
MAX_NUMBER = 1e300


def check_text(name: str, value: object, pattern: str | None = None) -> None:
    """Refuse what is no text that can be encoded, or does not fit the pattern as a whole."""
    if not isinstance(value, str) or any('\ud800' <= sign <= '\udfff' for sign in value):
        raise _wrong(name, 'a text', value)
    if pattern is not None and not re.fullmatch(pattern, value):
        raise _wrong(name, f'a text like {pattern}', value)


def check_same(name: str, value: object, expected: object) -> None:
    """Refuse all but one value; True is not 1."""
    if type(value) is not type(expected) or value != expected:
        raise _wrong(name, repr(expected), value)


def check_whole(name: str, value: object, low: int = 0, high: int = MAX_WHOLE) -> None:
    """Refuse what is no int in [low, high]."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise _wrong(name, f'a whole number from {low} to {high}', value)


def check_number(name: str, value: object, low: float = -MAX_NUMBER,
                 high: float = MAX_NUMBER) -> None:
    """Refuse what is no int or float in [low, high]; NaN and infinity are in no range."""
    if (not isinstance(value, (int, float)) or isinstance(value, bool)
            or not low <= value <= high):
        raise _wrong(name, f'a finite number from {low:g} to {high:g}', value)


def check_part(name: str, value: object, kind: type) -> None:
    """Refuse what is not of this class."""
    if not isinstance(value, kind):
        raise _wrong(name, f'an object ({kind.__name__})', value)


def read_part(kind: type, value: dict[str, Any],
              **parts: Callable[[dict[str, Any]], object]) -> Any:
    """
    Build a dataclass from a JSON object; `parts` read the fields that are objects or lists.

    Raises ModelError for unknown and missing keys, and whatever the dataclass refuses.
    """
    known = {field.name: field for field in fields(kind)}
    for name in value:
        if name not in known:
            raise ModelError(f'{name:.80}: expected one of {", ".join(known)}, got an unknown key')
    given = {}
    for name, field in known.items():
        if name not in value:
            if field.default is MISSING and field.default_factory is MISSING:
                raise ModelError(f'{name}: expected a value, got none')
            continue
        given[name] = value[name]
        if field.type is int:
            check_whole(name, value[name])
        elif field.type is float:
            check_number(name, value[name])
        elif name in parts and isinstance(value[name], dict):
            try:
                given[name] = parts[name](value[name])
            except NeoError as error:
                raise ModelError(f'{name}.{error}') from None
        elif name in parts and isinstance(value[name], list):
            for item in value[name]:
                check_part(name, item, dict)
            given[name] = tuple(map(parts[name], value[name]))
    return kind(**given)


def _wrong(name: str, expected: str, value: object) -> ModelError:
    got = type(value).__name__ if isinstance(value, int) and abs(value) > 1e18 else repr(value)
    return ModelError(f'{name}: expected {expected}, got {got:.80}')
