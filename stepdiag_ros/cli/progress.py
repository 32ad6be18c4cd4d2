"""A progress bar on the terminal, a line now and then elsewhere."""

import sys
import time
from typing import TextIO

from stepdiag_ros.guard.show import escaped

WIDTH = 28
PLAIN_PERIOD_S = 10.0


class Bar:
    """Shows how far something is; writes to ``stream`` (stderr), so that stdout stays clean.

    ``quiet`` shows nothing.  On a terminal one line is rewritten; in a file a line is
    written every ten seconds.
    """

    def __init__(self, title: str, quiet: bool = False, stream: TextIO | None = None):
        self._title, self._quiet = title, quiet
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._last_s = float('-inf')
        self._open = False

    def show(self, done: int, total: int, text: str = '', left_s: float | None = None) -> None:
        """``done`` of ``total``; ``text`` says what is going on."""
        if self._quiet:
            return
        now = time.monotonic()
        if not self._terminal and now - self._last_s < PLAIN_PERIOD_S and done < total:
            return
        self._last_s = now
        share = done / total if total else 0.0
        left = '' if left_s is None else f'  {_minutes(left_s)} left'
        full = round(WIDTH * share)
        line = f'{self._title} [{"█" * full}{"·" * (WIDTH - full)}] {done}/{total}{left}  {text}'
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


def _minutes(seconds: float) -> str:
    seconds = max(0, round(seconds))
    return f'{seconds // 60}:{seconds % 60:02d}'
