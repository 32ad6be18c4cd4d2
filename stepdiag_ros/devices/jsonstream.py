"""JSON values one behind the other in a byte stream, with or without newlines between.

attocube's own clients send the bare object and read a line; others send lines.  The
framing here needs neither: a value ends where its brackets close.
"""

import json
from typing import Any

LIMIT = 1 << 16
"""A value that has not ended after so many bytes never will; an instrument's answers have some hundreds."""
DEPTH = 32
"""Brackets within brackets; an instrument's answers have two."""


class JsonStream:
    """Feed bytes, take out the values that are complete."""

    def __init__(self) -> None:
        self._text = ''
        self._decode = json.JSONDecoder().raw_decode

    def feed(self, data: bytes) -> list[Any]:
        """Values completed by ``data``; :class:`ValueError` when it cannot become JSON."""
        text = self._text + data.decode('utf-8')
        values, at, end = [], 0, len(text)
        while True:
            while at < end and text[at] in ' \t\r\n\0':
                at += 1
            if at == end:
                break
            if text[at] not in '{[':
                raise ValueError(f'{text[at:at + 40]!r} does not begin a JSON object')
            try:
                value, at = self._decode(text, at)
            except json.JSONDecodeError as error:
                if end - at > LIMIT or _is_closed(text, at):
                    raise ValueError(f'{text[at:at + 40]!r} is not JSON: {error.msg}') from None
                break
            except RecursionError:
                raise ValueError(f'{text[at:at + 40]!r} is nested too deep') from None
            values.append(value)
        self._text = text[at:]
        return values


def _is_closed(text: str, at: int) -> bool:
    """Whether the brackets opened at ``at`` are closed within ``text``, or more are open than an answer has."""
    depth, quoted, escaped = 0, False, False
    for letter in text[at:]:
        if quoted:
            if escaped:
                escaped = False
            elif letter == '\\':
                escaped = True
            elif letter == '"':
                quoted = False
        elif letter == '"':
            quoted = True
        elif letter in '{[':
            depth += 1
            if depth > DEPTH:
                return True
        elif letter in '}]':
            depth -= 1
            if depth == 0:
                return True
    return False
