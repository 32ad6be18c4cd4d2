"""Who has a shared source, who waits for it and for how long.  Pure: no ROS, no threads, the clock is given.

:class:`SourceQueue` is the owner's side: requests in order of priority and arrival, one lease, which ends when it is
released or has not been renewed for ``lease_s``.  :class:`Hold` is the side of one who asks: it counts the lease from
the moment at which it *sent* the last renewal that the owner confirmed, the owner from the moment at which that
renewal *arrived*.  So whatever is lost or late in between, the holder stops before the owner grants anew, and no two
hold the source at once; both clocks only have to run at the same rate (decision 0310).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from stepdiag_ros.errors import StepdiagError


@dataclass
class Request:
    """One who asks for the source: its key, machine, priority, time of holding [s]; times by the queue's clock [s]."""

    key: bytes
    machine: str
    priority: int
    expected_s: float
    asked_s: float
    renewed_s: float
    renewal: int = 0
    granted_s: float = 0.0
    ended: bool = False


@dataclass(frozen=True)
class Standing:
    """Where a request stands: ``place`` 0 has the source, 1 is the next; ``wait_s`` until it is expected to have it."""

    granted: bool
    place: int
    wait_s: float
    renewal: int


@dataclass
class Usage:
    """Times [s] since the queue was made: source held; nobody had it though somebody waited; number of grants."""

    held_s: float = 0.0
    idle_s: float = 0.0
    grants: int = 0

    @property
    def idle_share(self) -> float:
        """The part of the time in which the source was wanted and nobody had it."""
        return self.idle_s / (self.held_s + self.idle_s) if self.idle_s else 0.0


@dataclass
class SourceQueue:
    """The owner's book of one source.

    :meth:`next` picks who is to have the source; once the light is on that machine :meth:`granted` says so, or
    :meth:`failed` that it could not be put there.  From the pick on nobody else is picked.
    """

    lease_s: float
    now: Callable[[], float]
    usage: Usage = field(default_factory=Usage)
    #: Mean time of putting the light from one machine to another [s].
    handover_s: float = 0.0
    _waiting: list[Request] = field(default_factory=list)
    _holder: Request | None = None
    _picked: Request | None = None
    _picked_s: float = 0.0
    _seen_s: float | None = None

    @property
    def holder(self) -> Request | None:
        """Who has the source."""
        return self._holder

    @property
    def waiting(self) -> tuple[Request, ...]:
        """Who waits, the next first."""
        picked = () if self._picked is None or self._picked.ended else (self._picked,)
        return (*picked, *sorted(self._waiting, key=lambda request: -request.priority))

    def ask(self, key: bytes, machine: str, priority: int, expected_s: float) -> None:
        """Put a request at the end of those with its priority; :class:`StepdiagError` where the key is known."""
        if self._find(key) is not None:
            raise StepdiagError(f'{machine} asks twice with one key')
        self._account()
        now = self.now()
        self._waiting.append(Request(key, machine, priority, max(0.0, expected_s), now, now))

    def renew(self, key: bytes, number: int) -> None:
        """A sign of life arrived; one that is older than the last, or of nobody known, changes nothing."""
        request = self._find(key)
        if request is not None and number > request.renewal and not self._over(request):
            request.renewal, request.renewed_s = number, self.now()

    def release(self, key: bytes) -> Request | None:
        """A request is over, whether it waits or holds; it, or ``None`` where it is not known."""
        request = self._find(key)
        if request is None:
            return None
        self._account()
        self._waiting = [other for other in self._waiting if other is not request]
        self._holder = None if self._holder is request else self._holder
        request.ended = True     # one that was picked stays so until the light has arrived: nobody else is picked
        return request

    def expire(self) -> list[Request]:
        """Take back what has not been renewed in time; those requests."""
        return [request for request in self._all() if self._over(request) and self.release(request.key)]

    def next(self) -> Request | None:
        """Pick who is to have the source now; ``None``: nobody waits, or it is held or on its way."""
        self.expire()
        if self._holder is not None or self._picked is not None or not self._waiting:
            return None
        self._picked = self.waiting[0]
        self._waiting.remove(self._picked)
        self._picked_s = self.now()
        return self._picked

    def granted(self, request: Request) -> bool:
        """The light is on the machine that was picked; False where its request ended in the meantime."""
        self._account()
        self.handover_s += 0.2 * (self.now() - self._picked_s - self.handover_s)
        self._picked = None
        if request.ended or self._over(request):
            return False
        self._holder, request.granted_s = request, self.now()
        self.usage.grants += 1
        return True

    def failed(self, request: Request) -> None:
        """The light could not be put there: the request waits again, at its old place."""
        self._account()
        self._picked = None
        if not request.ended:
            self._waiting.append(request)
            self._waiting.sort(key=lambda other: other.asked_s)

    def standing(self, key: bytes) -> Standing | None:
        """Where a request stands; ``None``: it is over."""
        request = self._find(key)
        if request is None:
            return None
        if request is self._holder:
            return Standing(True, 0, 0.0, request.renewal)
        now, wait_s, place = self.now(), 0.0, 1
        if self._holder is not None:
            wait_s = max(0.0, self._holder.granted_s + self._holder.expected_s - now)
        for other in self.waiting:
            wait_s += self.handover_s
            if other is request:
                break
            wait_s, place = wait_s + other.expected_s, place + 1
        return Standing(False, place, wait_s, request.renewal)

    def measure(self) -> Usage:
        """How the source was used until now."""
        self._account()
        return self.usage

    def _over(self, request: Request) -> bool:
        return self.now() - request.renewed_s > self.lease_s

    def _all(self) -> list[Request]:
        return [request for request in (self._holder, *self.waiting) if request is not None]

    def _find(self, key: bytes) -> Request | None:
        return next((request for request in self._all() if request.key == key), None)

    def _account(self) -> None:
        """Add the time since the last change to what it was."""
        now = self.now()
        since_s = 0.0 if self._seen_s is None else now - self._seen_s
        self._seen_s = now
        if self._holder is not None:
            self.usage.held_s += since_s
        elif self.waiting:
            self.usage.idle_s += since_s


@dataclass
class Hold:
    """One request as seen by who made it; ``sent()`` numbers the renewals, ``confirmed()`` takes the owner's word."""

    now: Callable[[], float]
    _sent_s: dict[int, float] = field(default_factory=dict)
    _number: int = 0
    _until_s: float = float('-inf')
    _ended: bool = False

    def sent(self) -> int:
        """The number of a renewal that is sent now."""
        self._number += 1
        self._sent_s[self._number] = self.now()
        return self._number

    def confirmed(self, renewal: int, granted: bool, lease_s: float) -> None:
        """The owner has received ``renewal`` and says whether the source is this one's."""
        at_s = self._sent_s.get(renewal)
        if at_s is None or self._ended:
            return
        for number in [n for n in self._sent_s if n < renewal]:
            del self._sent_s[number]
        if granted:
            self._until_s = max(self._until_s, at_s + lease_s)

    def end(self) -> None:
        """The source is not used any more; to be called before it is released."""
        self._ended = True

    @property
    def holds(self) -> bool:
        """The source is this one's, now."""
        return not self._ended and self.now() < self._until_s
