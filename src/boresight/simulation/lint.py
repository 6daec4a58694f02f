"""Mistakes of a TOML file, all of them at once, each with its line: where every table and key stands, and tables as structs.

`tomllib` tells values without their lines, and msgspec stops at the first mistake.  So the text is gone through once more for
the lines alone, and the tables are made into structs key by key.
"""

from __future__ import annotations

import datetime
import difflib
import math
import re
import types
from collections.abc import Iterable
from functools import reduce
from operator import or_
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

# The keys and numbers that lead to a value from the root: ("radar", 1, "errors", "range_bias").
Place = tuple[str | int, ...]


class Mistake(NamedTuple):
    """What is wrong, where in the tables, and what to do about it."""

    place: Place
    text: str
    remedy: str = ""


_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_ESCAPED = re.compile(r'"(?:[^"\\]|\\.)*"')
_LITERAL = re.compile(r"'[^']*'")
# At the end of a text of many lines, up to two quotes more belong to it.
_LONG = re.compile(r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})', re.S)
_LONG_LITERAL = re.compile(r"'''.*?'''(?:'{0,2})", re.S)
_PLAIN = re.compile(r"[^,\]}#\r\n]+")


def lines_of(text: str) -> dict[Place, int]:
    """The line (from 1) of every table, key and item of TOML that `tomllib` reads.

    A table's line is its header's, an item of ``[[radar]]`` has the line of its own header; what dotted keys or headers make on
    the way has the line where it first appears.  Keys of inline tables and items of arrays have lines of their own.
    """
    return _Scan(text).lines


class _Scan:
    """One pass over a text that is known to be TOML."""

    def __init__(self, text: str) -> None:
        self.text, self.at, self.lines = text, 0, dict[Place, int]()
        self.counted, self.line = 0, 1
        # How many items each array of tables has so far.
        items: dict[Place, int] = {}
        table: Place = ()
        while self._skip(_BLANK) < len(text):
            if text[self.at] != "[":
                self._pair(table)
                continue
            line = self._line()
            many = text.startswith("[[", self.at)
            self.at += 2 if many else 1
            table = ()
            keys = self._keys()
            for k, key in enumerate(keys):
                table = (*table, key)
                self.lines.setdefault(table, line)
                if many and k == len(keys) - 1:
                    items[table] = items.get(table, 0) + 1
                if table in items:
                    table = (*table, items[table] - 1)
                    self.lines.setdefault(table, line)
            # The header itself is where a table stands, wherever its parts were named before.
            self.lines[table] = line
            self.at += 2 if many else 1

    def _line(self) -> int:
        self.line += self.text.count("\n", self.counted, self.at)
        self.counted = self.at
        return self.line

    def _skip(self, what: re.Pattern[str]) -> int:
        found = what.match(self.text, self.at)
        if found is not None:
            self.at = found.end()
        return self.at

    def _take(self, what: re.Pattern[str]) -> str:
        begin = self.at
        return self.text[begin : self._skip(what)]

    def _keys(self) -> list[str]:
        """The parts of a dotted key."""
        keys: list[str] = []
        while True:
            self._skip(_SPACE)
            quote = self.text[self.at]
            if quote == '"':
                # The escapes of TOML's keys are JSON's, but for \U and \e.
                keys.append(_unescaped(self._take(_ESCAPED)[1:-1]))
            else:
                keys.append(self._take(_LITERAL)[1:-1] if quote == "'" else self._take(_BARE))
            self._skip(_SPACE)
            if self.text[self.at] != ".":
                return keys
            self.at += 1

    def _pair(self, table: Place) -> None:
        line = self._line()
        place = table
        for key in self._keys():
            place = (*place, key)
            self.lines.setdefault(place, line)
        self.at += 1
        self._skip(_SPACE)
        self._value(place)

    def _value(self, place: Place) -> None:
        opening = self.text[self.at]
        if opening in "[{":
            self.at += 1
            number = 0
            while True:
                self._skip(_BLANK)
                if self.text[self.at] in "]}":
                    self.at += 1
                    return
                if self.text[self.at] == ",":
                    self.at += 1
                elif opening == "{":
                    self._pair(place)
                else:
                    self.lines[*place, number] = self._line()
                    self._value((*place, number))
                    number += 1
        elif self.text.startswith('"""', self.at):
            self._skip(_LONG)
        elif self.text.startswith("'''", self.at):
            self._skip(_LONG_LITERAL)
        else:
            self._skip(_ESCAPED if opening == '"' else _LITERAL if opening == "'" else _PLAIN)


_ESCAPES = {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r", "e": "\x1b", '"': '"', "\\": "\\"}


def _unescaped(text: str) -> str:
    def one(found: re.Match[str]) -> str:
        code = found[1]
        return _ESCAPES[code] if code in _ESCAPES else chr(int(code[1:], 16))

    return re.sub(r"\\(x[0-9A-Fa-f]{2}|u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|.)", one, text)


def line_of(lines: dict[Place, int], place: Place) -> int:
    """The line of a place, or of the nearest table about it that the text has; 1 where there is none."""
    while place and place not in lines:
        place = place[:-1]
    return lines.get(place, 1)


def nearest(word: str, known: Iterable[str]) -> str:
    """``Did you mean duration_s? `` where one of the known words is like it, else nothing."""
    close = difflib.get_close_matches(word, list(known), 1, 0.6)
    return f"Did you mean {close[0]}? " if close else ""


class _Nothing:
    """Stands for a value that could not be made."""


_NOTHING = _Nothing()


class Decoded(NamedTuple):
    """A struct made from tables, or None, and the mistakes; `kept`: of lists that lack some tables, the numbers of the others."""

    value: Any
    mistakes: list[Mistake]
    kept: dict[Place, list[int]]

    def in_file(self, place: Place) -> Place:
        """The place in the file of a place in the struct, whose lists lack what could not be made."""
        out: Place = ()
        for part in place:
            out = (*out, self.kept[out][part] if isinstance(part, int) and out in self.kept else part)
        return out


def decode(kind: Any, data: Any) -> Decoded:
    """Make a struct of type `kind` from TOML's tables, with every mistake of names and types.

    Fields with a mistake keep their default, so that what else is wrong can be looked for; a table in which a field that is
    needed is missing or wrong is left out.
    """
    decoder = _Decoder()
    value = decoder.decode(kind, data, ())
    return Decoded(None if value is _NOTHING else value, decoder.mistakes, decoder.kept)


class _Decoder:
    def __init__(self) -> None:
        self.mistakes: list[Mistake] = []
        self.kept: dict[Place, list[int]] = {}

    def say(self, place: Place, text: str, remedy: str = "") -> _Nothing:
        self.mistakes.append(Mistake(place, text, remedy))
        return _NOTHING

    def decode(self, kind: Any, data: Any, place: Place) -> Any:
        origin, parts = get_origin(kind), get_args(kind)
        if origin in (Union, types.UnionType):
            return self.one_of([part for part in parts if part is not types.NoneType], data, place)
        if _is_struct(kind):
            return self.struct(kind, data, place)
        if origin is tuple and isinstance(data, list):
            if parts[-1] is not Ellipsis and len(parts) != len(data):
                return self.say(place, f"{_name(place)} needs {len(parts)} values, not {len(data)}")
            kinds = [parts[0]] * len(data) if parts[-1] is Ellipsis else parts
            made = [self.decode(k, item, (*place, n)) for n, (k, item) in enumerate(zip(kinds, data, strict=True))]
            left = [n for n, item in enumerate(made) if item is not _NOTHING]
            if len(left) < len(made):
                if parts[-1] is not Ellipsis:
                    return _NOTHING
                self.kept[place] = left
            return tuple(made[n] for n in left)
        if origin is dict and isinstance(data, dict):
            values = {key: self.decode(parts[1], item, (*place, key)) for key, item in data.items()}
            return {key: item for key, item in values.items() if item is not _NOTHING}
        return self.plain(kind, data, place)

    def one_of(self, kinds: list[Any], data: Any, place: Place) -> Any:
        """A value of one of several types: which one, its form and its tag tell."""
        if len(kinds) == 1:
            return self.decode(kinds[0], data, place)
        structs = [kind for kind in kinds if _is_struct(kind)]
        if isinstance(data, dict) and structs:
            tags = {kind.__struct_config__.tag: kind for kind in structs if kind.__struct_config__.tag is not None}
            if not tags:
                return self.decode(structs[0], data, place)
            field = str(structs[0].__struct_config__.tag_field)
            given = data.get(field)
            if isinstance(given, str) and given in tags:
                return self.decode(tags[given], data, place)
            known = ", ".join(map(str, tags))
            if given is None:
                return self.say(place, f"{field} is missing", f"Known: {known}.")
            return self.say(
                (*place, field),
                f"{field} = {_shown(given)} is not known",
                f"{nearest(str(given), map(str, tags))}Known: {known}.",
            )
        for kind in kinds:
            if (get_origin(kind) is tuple and isinstance(data, list)) or (get_origin(kind) is dict and isinstance(data, dict)):
                return self.decode(kind, data, place)
        flat = [kind for kind in kinds if not _is_struct(kind)]
        return self.plain(reduce(or_, flat) if flat else kinds[0], data, place)

    def struct(self, kind: Any, data: Any, place: Place) -> Any:
        if not isinstance(data, dict):
            return self.say(place, f"{_name(place)} must be a table, not {_word(data)}")
        hints = get_type_hints(kind)
        tag = kind.__struct_config__.tag_field
        good: dict[str, Any] = {}
        for key, item in data.items():
            if key in kind.__struct_fields__:
                value = self.decode(hints[key], item, (*place, key))
                if value is not _NOTHING:
                    good[key] = value
            elif key != tag:
                keys = [*([tag] if tag else []), *kind.__struct_fields__]
                self.say((*place, key), f"there is no key {key}", f"{nearest(key, keys)}Known keys: {', '.join(keys)}.")
        needed = {field.name for field in msgspec.structs.fields(kind) if field.required}
        for name in kind.__struct_fields__:
            if name in needed and name not in data:
                self.say(place, f"{name} is missing")
        if not needed <= good.keys():
            return _NOTHING
        try:
            return kind(**good)
        except ValueError as error:
            return self.say(place, str(error))

    def plain(self, kind: Any, data: Any, place: Place) -> Any:
        try:
            value = msgspec.convert(data, kind)
        except msgspec.ValidationError as error:
            wanted = re.match(r"Expected `([^`]+)`, got", str(error))
            must = re.sub(r" - at `[^`]*`$", "", str(error))
            if wanted:
                names = [name for name in wanted[1].split(" | ") if name != "null"]
                must = f"must be {' or '.join(_WORDS.get(name, name) for name in names)}, not {_word(data)}"
            return self.say(place, f"{must}: {_name(place)} = {_shown(data)}")
        if isinstance(value, float) and not math.isfinite(value):
            return self.say(place, f"{_name(place)} = {value} is not a finite number")
        return value


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


_WORDS = {
    "array": "a list",
    "bool": "true or false",
    "datetime": "a date with time (datetime), as 2026-03-01T10:00:00Z",
    "float": "a number (float)",
    "int": "a whole number (int)",
    "object": "a table",
    "str": "a text (str)",
}


def _name(place: Place) -> str:
    """What a place is called within its table."""
    numbers = ""
    for part in reversed(place):
        if isinstance(part, str):
            return part + numbers
        numbers = f"[{part + 1}]{numbers}"
    return "the file"


def _word(data: Any) -> str:
    if isinstance(data, bool):
        return "true or false"
    names = {dict: "a table", list: "a list", str: "a text", int: "a whole number", float: "a number"}
    names |= {datetime.date: "a date alone", datetime.time: "a time alone"}
    return names.get(type(data), "a date with time")


def _shown(data: Any) -> str:
    text = (
        str(data).lower()
        if isinstance(data, bool)
        else repr(data)
        if isinstance(data, (str, int, float, list, dict))
        else str(data)
    )
    return text if len(text) <= 60 else text[:57] + "..."
