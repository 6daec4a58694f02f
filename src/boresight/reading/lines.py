"""The lines of a text table: where each begins, and which of them are whole.

A CSV reader that trusts its input loses rows in silence: one stray quote swallows every line up to the next quote, a NUL or
another kind of line end stops it.  So the bytes are looked over first.  A file without such marks goes to the fast reader
as it is; any other is rewritten, one record a line, without what is damaged.
"""

from __future__ import annotations

import codecs
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._types import IntArray
from ..errors import InputError
from ..model import Damage

CHUNK = 1 << 24
# A quoted field that goes on for more lines than this, or a line longer than this, is taken as damaged.
MOST_LINES = 50
LONGEST = 1 << 20
SEPARATORS = (",", ";", "\t", "|")
UTF8_BOM = b"\xef\xbb\xbf"


class Look(NamedTuple):
    """What a look over the bytes shows: where the lines with something in them begin (m,), and whether the file is plain."""

    start: IntArray
    newline: bytes
    quoted: bool
    plain: bool
    why_not: str


def head_of(path: str | Path, count: int = 65536) -> bytes:
    """The first bytes of a file.  Raises InputError for a file that is empty or cannot be read."""
    try:
        with open(path, "rb") as file:
            head = file.read(count)
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})", path=path, remedy="Check the file's name and that you may read it."
        ) from error
    if not head:
        raise InputError("the file is empty", path=path, remedy="Give a file that holds records.")
    return head


def header_line(head: bytes) -> tuple[str, int]:
    """The first line with something in it, without a byte-order mark, and the offset at which the next line begins."""
    offset = len(UTF8_BOM) if head.startswith(UTF8_BOM) else 0
    while offset < len(head):
        ends = [k for k in (head.find(b"\n", offset), head.find(b"\r", offset)) if k >= 0]
        end = min(ends, default=len(head))
        after = end + (2 if head[end : end + 2] == b"\r\n" else 1)
        line = head[offset:end]
        if line.strip():
            try:
                return line.decode("utf-8"), after
            except UnicodeDecodeError:
                return line.decode("latin-1"), after
        offset = after
    return "", len(head)


def fields_of(line: str, separator: str) -> list[str]:
    """The fields of one line, stripped; a line whose quotes do not close gives what can be had."""
    try:
        return [f.strip() for f in next(csv.reader([line], delimiter=separator))]
    except (csv.Error, StopIteration):
        return [f.strip().strip('"') for f in line.split(separator)]


def separator_of(line: str) -> str:
    """The separator that cuts a header line into the most fields; a comma where nothing does."""
    return max(SEPARATORS, key=lambda s: len(fields_of(line, s)))


def look_over(path: str | Path, after: int) -> Look:
    """Look over the bytes of a text file from the offset `after` on."""
    starts: list[IntArray] = []
    decoder = codecs.getincrementaldecoder("utf-8")()
    feeds = pairs = returns = 0
    why_not = ""
    quoted = False
    at = begin = after
    quotes_open = 0
    last = -1
    with open(path, "rb") as file:
        file.seek(after)
        while block := file.read(CHUNK):
            data = np.frombuffer(block, np.uint8)
            ends = np.flatnonzero(data == 10)
            if not data.all():
                why_not = why_not or "bytes that are 0"
            if data.max() >= 128:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:
                    why_not = why_not or "bytes that are not UTF-8"
                    decoder.reset()
            feeds += len(ends)
            returns += int(np.count_nonzero(data == 13))
            before = np.where(ends > 0, data[np.maximum(ends, 1) - 1], last)
            pairs += int(np.count_nonzero(before == 13))
            marks = data == 34
            if marks.any():
                quoted = True
                total = np.concatenate([[0], np.cumsum(marks)])
                of_lines = np.diff(np.concatenate([[0], total[ends], [total[-1]]]))
                of_lines[0] += quotes_open
                if np.any(of_lines[:-1] & 1):
                    why_not = why_not or "quotes that do not close on their line"
                quotes_open = int(of_lines[-1])
            elif len(ends):
                if quotes_open & 1:
                    why_not = why_not or "quotes that do not close on their line"
                quotes_open = 0
            begins = np.concatenate([[begin], ends + at + 1])
            lengths = np.diff(begins)
            if len(lengths) and lengths.max() > LONGEST:
                why_not = why_not or "very long lines"
            # Only what fills the line counts: a lone carriage return does not.
            full = (lengths > 2) | ((lengths == 2) & (before != 13))
            starts.append(begins[:-1][full])
            begin = int(begins[-1])
            last = int(data[-1])
            at += len(block)
    if at > begin:
        starts.append(np.array([begin]))
        if at - begin > LONGEST:
            why_not = why_not or "very long lines"
        if quotes_open & 1:
            why_not = why_not or "quotes that do not close on their line"
    if returns != pairs or (pairs and pairs != feeds):
        why_not = why_not or "line ends of several kinds"
    start = np.concatenate(starts) if starts else np.empty(0, np.int64)
    return Look(start.astype(np.int64), b"\r\n" if pairs else b"\n", quoted, not why_not, why_not)


def _lines(path: str | Path, after: int) -> Iterator[tuple[int, bytes]]:
    """Offsets and lines without their ends; LF, CR LF and CR alike end a line.  A very long line comes in pieces."""
    offset, rest, ended = after, b"", False
    with open(path, "rb") as file:
        file.seek(after)
        while not ended:
            block = file.read(CHUNK)
            ended = not block
            data = rest + block
            # A carriage return at the very end may have its line feed in the next block.
            keep = 0 if ended else (1 if data.endswith(b"\r") else 0)
            whole = data[: len(data) - keep]
            pieces = whole.splitlines(keepends=True) if b"\r" in whole else [p + b"\n" for p in whole.split(b"\n")]
            if b"\r" not in whole:
                pieces[-1] = pieces[-1][:-1]
                if not pieces[-1]:
                    pieces.pop()
            rest = data[len(data) - keep :]
            if not ended and pieces and not pieces[-1].endswith((b"\n", b"\r")) and len(pieces[-1]) <= CHUNK:
                rest = pieces.pop() + rest
            for piece in pieces:
                yield offset, piece.rstrip(b"\r\n")
                offset += len(piece)


def _quoted(text: str, separator: str, columns: int) -> list[str] | None:
    """The fields of the record that `text` is, or None where it is not one whole record."""
    try:
        rows = list(csv.reader([text], delimiter=separator, strict=True))
    except csv.Error:
        return None
    return rows[0] if len(rows) == 1 and len(rows[0]) == columns else None


def rewrite(path: str | Path, out: Path, after: int, separator: str, columns: int) -> tuple[IntArray, list[Damage]]:
    """Write the whole records of a text table to `out`, one a line, without quotes; give their offsets and what is damaged.

    A field in quotes may hold separators and line ends (up to `MOST_LINES`): they become blanks.  Where a quote never closes,
    its own line is damaged and the next one is read as if nothing had been.
    """
    start: list[int] = []
    damaged: list[Damage] = []
    mark = separator.encode()
    blank = str.maketrans({separator: " ", "\n": " ", "\r": " ", '"': "'"})
    lines = _lines(path, after)
    ahead: list[tuple[int, bytes]] = []
    with open(out, "wb") as file:
        while True:
            if ahead:
                offset, line = ahead.pop(0)
            else:
                following = next(lines, None)
                if following is None:
                    break
                offset, line = following
            if not line.strip():
                continue
            if len(line) > LONGEST:
                damaged.append(Damage(offset, f"a line of {len(line)} bytes"))
                continue
            if b"\0" in line:
                damaged.append(Damage(offset, "a line with bytes that are 0"))
                continue
            if b'"' not in line:
                found = line.count(mark) + 1
                if found != columns:
                    damaged.append(Damage(offset, f"{found} fields, the header has {columns}"))
                    continue
                try:
                    line.decode("utf-8")
                except UnicodeDecodeError:
                    line = bytes(c if c < 128 else 63 for c in line)
            else:
                text, taken = line.decode("utf-8", "replace"), 0
                # Quotes that are odd in number go on below; a line there that is a whole record of its own says they do not.
                while text.count('"') % 2 and taken < MOST_LINES and len(text) < LONGEST:
                    if taken == len(ahead):
                        following = next(lines, None)
                        if following is None:
                            break
                        ahead.append(following)
                    below = ahead[taken][1]
                    if b'"' not in below and below.count(mark) + 1 == columns and columns > 1:
                        break
                    text += "\n" + below.decode("utf-8", "replace")
                    taken += 1
                fields = None if text.count('"') % 2 else _quoted(text, separator, columns)
                if fields is None:
                    damaged.append(Damage(offset, f"its quotes do not close, or it has not the header's {columns} fields"))
                    continue
                del ahead[:taken]
                line = separator.join(f.translate(blank).replace("�", "?") for f in fields).encode()
            start.append(offset)
            file.write(line + b"\n")
    return np.array(start, np.int64), damaged
