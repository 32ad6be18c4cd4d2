"""A progress bar on the terminal, a line now and then elsewhere."""

import shutil
import sys
import threading
import time
from collections.abc import Sequence
from typing import TextIO

from stepdiag_ros.guard.show import escaped

WIDTH = 28
PLAIN_PERIOD_S = 10.0


class Bar:
    """Shows how far something is; writes to ``stream`` (stderr), so that stdout stays clean.

    ``quiet`` shows nothing.  On a terminal one line is rewritten; in a file a line is
    written every ten seconds.  Work that is done within ``after_s`` shows nothing either.
    """

    def __init__(self, title: str, quiet: bool = False, stream: TextIO | None = None, after_s: float = 0.0):
        self._title, self._quiet = title, quiet
        self._from_s = time.monotonic() + after_s
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._last_s = float('-inf')
        self._open = False

    def show(self, done: int, total: int, text: str = '', left_s: float | None = None) -> None:
        """``done`` of ``total``; ``text`` says what is going on."""
        if self._quiet:
            return
        now = time.monotonic()
        if now < self._from_s:
            return
        if not self._terminal and now - self._last_s < PLAIN_PERIOD_S and done < total:
            return
        self._last_s = now
        line = f'{self._title} {drawn(done, total)}{_left(left_s)}  {text}'
        if self._terminal:
            self._clear()
            self._stream.write(escaped(line))
            self._open = True
        else:
            self._stream.write(escaped(line) + '\n')
        self._stream.flush()

    def say(self, text: str) -> None:
        """A line above the bar."""
        if self._quiet:
            return
        if self._open:
            self._clear()
        self._stream.write(escaped(text) + '\n')
        self._stream.flush()

    def _clear(self) -> None:
        """Back to the begin of the line, and empty it."""
        getattr(self._stream, 'control', self._stream.write)('\r\x1b[K')

    def close(self) -> None:
        """Leave the bar as it stands and go to the next line."""
        if self._open:
            self._stream.write('\n')
            self._stream.flush()
            self._open = False


class Lines:
    """One line of progress for each of several things; may be written from several threads.

    On a terminal the lines stand still and are rewritten; in a file a line is written every ten seconds for each.
    """

    def __init__(self, names: Sequence[str], quiet: bool = False, stream: TextIO | None = None):
        self._width = max(map(len, names))
        self._texts = dict.fromkeys(names, '')
        self._stream = sys.stderr if stream is None else stream
        self._quiet, self._terminal = quiet, self._stream.isatty()
        self._last_s = dict.fromkeys(names, float('-inf'))
        self._lock, self._drawn = threading.Lock(), False

    def show(self, name: str, done: int, total: int, text: str = '', left_s: float | None = None,
             final: bool = False) -> None:
        """``name`` has ``done`` of ``total`` and does what ``text`` says; ``final``: it is the last word."""
        if self._quiet:
            return
        with self._lock:
            self._texts[name] = f'{name:{self._width}} {drawn(done, total)}{_left(left_s)}  {text}'
            now = time.monotonic()
            if not final and now - self._last_s[name] < (0.1 if self._terminal else PLAIN_PERIOD_S):
                return
            self._last_s[name] = now
            if self._terminal:
                self._draw()
            else:
                self._stream.write(escaped(self._texts[name]) + '\n')
            self._stream.flush()

    def _draw(self) -> None:
        control = getattr(self._stream, 'control', self._stream.write)
        if self._drawn:
            control(f'\x1b[{len(self._texts)}A')
        for text in self._texts.values():
            control('\r\x1b[K')
            self._stream.write(escaped(text)[:shutil.get_terminal_size().columns - 1] + '\n')
        self._drawn = True

    def close(self) -> None:
        """Show the last state of all."""
        if self._terminal and not self._quiet:
            with self._lock:
                self._draw()
                self._stream.flush()


def drawn(done: float, total: float, width: int = WIDTH) -> str:
    """``done`` of ``total`` as a bar and as numbers."""
    full = round(width * done / total) if total else 0
    return f'[{"█" * full}{"·" * (width - full)}] {done:.0f}/{total:.0f}'


def _left(seconds: float | None) -> str:
    if seconds is None:
        return ''
    seconds = max(0, round(seconds))
    return f'  {seconds // 60}:{seconds % 60:02d} left'
