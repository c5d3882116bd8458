"""Writing what `tomllib` reads: tables of numbers, texts, lists and tables."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_WIDTH = 110


def to_toml(values: Mapping[str, object]) -> str:
    """TOML of a table: its numbers and texts, then its tables, then its lists of tables; what is in them stands in a line.

    Numbers come back as they were, to the last bit.

    Examples
    --------
    >>> from shadowgram.xray._toml import to_toml
    >>> print(to_toml({"title": "two", "world": {"size": [1.0, 2.0]}, "solids": [{"name": "a"}, {"name": "b"}]}), end="")
    title = "two"
    <BLANKLINE>
    [world]
    size = [1.0, 2.0]
    <BLANKLINE>
    [[solids]]
    name = "a"
    <BLANKLINE>
    [[solids]]
    name = "b"
    """
    tables = {name: value for name, value in values.items() if isinstance(value, Mapping)}
    lists = {name: value for name, value in values.items() if _is_tables(value)}
    plain = {name: value for name, value in values.items() if name not in tables and name not in lists}
    blocks = [_lines(plain)] if plain else []
    blocks += [f"[{_key(name)}]\n{_lines(table)}" for name, table in tables.items()]
    blocks += [f"[[{_key(name)}]]\n{_lines(table)}" for name, several in lists.items() for table in several]  # type: ignore[attr-defined]
    return "\n".join(blocks)


def _is_tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(one, Mapping) for one in value)


def _lines(table: Mapping[str, object]) -> str:
    return "".join(f"{_key(name)} = {_value(value)}\n" for name, value in table.items())


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _text(name)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: object) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{_key(name)} = {_value(one)}" for name, one in value.items()) + " }" if value else "{}"
        )
    if isinstance(value, list | tuple):
        parts = [_value(one) for one in value]
        whole = ", ".join(parts)
        return f"[{whole}]" if len(whole) < _WIDTH else _wrapped(parts)
    raise TypeError(f"TOML has no {type(value).__name__}")


def _wrapped(parts: list[str]) -> str:
    """A list over several lines, which are the only line breaks that a table in a line may have."""
    lines = [""]
    for part in parts:
        if lines[-1] and len(lines[-1]) + len(part) > _WIDTH:
            lines.append("")
        lines[-1] += f" {part}," if lines[-1] else f"    {part},"
    return "[\n" + "\n".join(lines) + "\n]"
