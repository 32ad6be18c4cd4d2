"""What the sequencer knows of the others, and what is missing for a start.

``Watch`` notes the last block of each source and the recorder's word.  It is fed by
callbacks in one thread and asked in another; nothing here waits.
"""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.nodes.runner import Interrupted

#: Longer than any driver pauses between two blocks, shorter than it takes to start one again.
HOLE_S = 1.0


@dataclass
class _Source:
    last_s: float | None = None     # monotonic time of the last message
    begin_ns: int = 0               # stamps of begin and end of the last block
    end_ns: int = 0
    dark_s: float | None = None     # since when there has been no signal; None: there is
    hole_s: float = 0.0             # longest time left out between two blocks since the last zero
    setups: set[str] = field(default_factory=set)   # that blocks since the last zero speak of
    expected: bool = True           # False: nothing is wanted of it, its light is another machine's


@dataclass(frozen=True)
class Recording:
    """The recorder's last status, and when it came (monotonic)."""

    at_s: float
    recording: bool
    bag: str
    receives: frozenset[str]
    received: dict[str, int] = field(default_factory=dict)
    lost: int = 0
    file: int = 0


class Watch:
    """Sources by topic (full names) and the recorder's status.

    A source or the recorder that has said nothing for ``timeout_s`` counts as silent.
    ``received_besides``: topics that the recorder must receive although they are no sources.
    Each listener reports what it has received: that a publisher knows of it, or it of the publisher, does not yet
    mean that samples get through.
    """

    def __init__(self, sources: Sequence[str], received_besides: Sequence[str], timeout_s: float):
        self._lock = threading.Lock()
        self._sources = {topic: _Source() for topic in sources}
        self._besides = tuple(received_besides)
        self._timeout_s = timeout_s
        self._recording: Recording | None = None
        self._listeners: dict[str, tuple[float, frozenset[str]]] = {}
        self._since_ns = 0

    def block(self, topic: str, begin_ns: int, end_ns: int, signal: bool, setup: str) -> None:
        """A block of ``topic`` came with these stamps; ``signal``: it holds light."""
        with self._lock:
            source, now = self._sources[topic], time.monotonic()
            if source.last_s is not None:
                # By the stamps and by the clock on the wall: a step of the system's clock is no hole.
                source.hole_s = max(source.hole_s, min((begin_ns - source.end_ns) * 1e-9, now - source.last_s))
            source.last_s, source.begin_ns, source.end_ns = time.monotonic(), begin_ns, end_ns
            source.dark_s = None if signal else source.dark_s or source.last_s
            if begin_ns > self._since_ns:
                source.setups.add(setup)

    def begin(self) -> None:
        """A setup was mounted or a zero was set: what came before does not count any more."""
        with self._lock:
            self._since_ns = HOST.now_ns()
            for source in self._sources.values():
                source.setups.clear()
                source.hole_s = 0.0
                if source.dark_s is not None:
                    source.dark_s = time.monotonic()

    def expect(self, topic: str, expected: bool) -> None:
        """From now on ``topic`` has to deliver, or need not: a source that machines share serves one at a time."""
        with self._lock:
            source = self._sources[topic]
            if expected and not source.expected:
                # What was left out while it served others is no silence and no hole.
                source.last_s, source.end_ns, source.dark_s = time.monotonic(), HOST.now_ns(), None
                source.setups.clear()
                source.hole_s = 0.0
            source.expected = expected

    def _present(self) -> dict[str, _Source]:
        return {topic: source for topic, source in self._sources.items() if source.expected}

    def recorder(self, recording: Recording) -> None:
        """The recorder's status came."""
        with self._lock:
            self._recording = recording

    def listener(self, name: str, receives: frozenset[str]) -> None:
        """A node that keeps the log reported which topics it has received."""
        with self._lock:
            self._listeners[name] = (time.monotonic(), receives)

    def not_receiving(self, listeners: Sequence[str], since_s: float) -> list[str]:
        """What ``listeners`` would miss of a run that starts now, a phrase each; their word before ``since_s``
        (monotonic) does not count."""
        with self._lock:
            wants = []
            for name in listeners:
                said_s, receives = self._listeners.get(name, (0.0, frozenset()))
                if said_s < since_s:
                    wants.append(f'{name} has not reported what it receives')
                else:
                    wants += [f'{name} does not receive {topic}' for topic in self._present() if topic not in receives]
            return wants

    @property
    def recording(self) -> Recording | None:
        with self._lock:
            return self._recording

    def wants(self, light: bool = False, since_s: float = 0.0) -> list[str]:
        """What is missing for a start, a phrase each; empty: all is well.

        What came before ``since_s`` (monotonic) does not count.

        ``light``: a source must also see its beam, which before the mirror of a setup is
        mounted it cannot.
        """
        now = time.monotonic()
        with self._lock:
            wants = []
            for topic, source in self._present().items():
                if source.last_s is None:
                    wants.append(f'nothing was received on {topic}')
                elif source.last_s < since_s:
                    wants.append(f'{topic} delivers nothing')
                elif now - source.last_s > self._timeout_s:
                    wants.append(f'{topic} has been silent for {now - source.last_s:.1f} s')
                elif light and source.dark_s is not None and now - source.dark_s > self._timeout_s:
                    wants.append(f'{topic} delivers no signal (is the beam interrupted?)')
            said = self._recording
            if said is None or said.at_s < since_s or now - said.at_s > self._timeout_s:
                wants.append('the recorder is silent')
            elif not said.recording:
                wants.append('the recorder is not recording')
            else:
                missing = [t for t in (*self._present(), *self._besides) if t not in said.receives]
                wants += [f'the recorder does not receive {topic}' for topic in missing]
        return wants

    def check(self, bag: str, setup: str) -> None:
        """Raise :class:`Interrupted` if a run of ``setup`` into ``bag`` has lost something.

        A driver that was started again since the last zero knows neither setup nor zero: it
        shows by the setup of any of its blocks or by their want of signal.
        """
        wants = self.wants(light=True)
        said = self.recording
        with self._lock:
            wants += [f'{topic} speaks of setup {other!r} in a run of {setup!r}'
                      for topic, source in self._present().items() for other in sorted(source.setups - {setup})]
            wants += [f'{topic} left out {source.hole_s:.1f} s' for topic, source in self._present().items()
                      if source.hole_s > HOLE_S]
        if not wants and said is not None and said.bag != bag:
            wants = [f'the recorder began another bag ({said.bag}) while a run was under way']
        if wants:
            raise Interrupted('; '.join(wants) + '; stopped, so that no stop goes unmeasured')

    def dark(self) -> bool:
        """A source's last block holds no light."""
        with self._lock:
            return any(source.dark_s is not None for source in self._present().values())

    def delivered_until(self) -> int:
        """All sources have delivered up to this time [ns since the epoch]."""
        with self._lock:
            return min((s.end_ns for s in self._present().values()), default=0)
