"""What an effect is: one class, one file, two faces.

An effect *acts* in the physical simulator (:meth:`Effect.act`, on a :class:`Moment` of
the virtual cell), and it *appears* in the measurement (:meth:`Effect.appearance`, on the
:class:`StopView` of a log), where the diagnosis looks for it.  The two are written apart
on purpose: the first is physics, the second is what physics leaves in a log to first
order, with forms broad enough for a reality that follows no formula.  A test holds one
against the other.
"""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stepdiag_ros.effects.course import Course, parse_course
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import STOOD
from stepdiag_ros.model.mirror_form import MirrorForm

if TYPE_CHECKING:
    from stepdiag_ros.effects.adoption import Fitted


@dataclass(frozen=True)
class Parameter:
    """A physical parameter: name, unit, plausible range, size (1: a scalar), what it is; a ``detail`` is adopted only
    where the effect without it leaves more than noise."""

    name: str
    unit: str
    low: float
    high: float
    size: int = 1
    meaning: str = ''
    detail: bool = False


# ---- how it acts ------------------------------------------------------------------------------

@dataclass(repr=False)
class Moment:
    """The virtual cell at ``n`` times, on its way from command to reading; an effect changes it.

    Given: ``seconds`` (n,) since the log began; ``mount_seconds`` (n,) since the mirror was mounted
    for this setup; ``arrival`` (n,) number of the move last begun; ``since_arrival`` (n,) [s] since the
    control reported in position (negative while moving); ``moved`` (n,) number of the axis that moved
    last (255: all); ``commanded`` (n, 3) [m]; ``approach`` (n, 3) sign of each axis's last motion;
    ``setup``; ``scale_temperature`` (n, 3) [°C]; ``rng``: random numbers of this cell and effect,
    addressed by a name so that they do not depend on the order of calls.

    To change: ``position`` (n, 3) [m] of the axes; ``shift`` (n, 3) [m] and ``turn`` (n, 3) [rad] of the
    tool against the workpiece, machine frame, added after the machine's own errors; ``laser`` and
    ``mirror`` (n, 2) [rad], further turns about (u, v) of beams and mirror mount; ``form``: the mirror's
    shape; ``index`` (n,): the true index of air over ``divided`` (n,), the one that the instrument
    takes out;
    ``length`` (n, beams) [m] and, after the reading, ``spot`` (n, 2) [m], ``intensity`` (n,) [V],
    ``quality`` (n,).
    """

    description: Description
    setup: str
    seconds: np.ndarray
    mount_seconds: np.ndarray
    arrival: np.ndarray
    since_arrival: np.ndarray
    moved: np.ndarray
    commanded: np.ndarray
    approach: np.ndarray
    scale_temperature: np.ndarray
    rng: object
    position: np.ndarray
    shift: np.ndarray
    turn: np.ndarray
    laser: np.ndarray
    mirror: np.ndarray
    index: np.ndarray
    divided: np.ndarray
    form: MirrorForm | None = None
    length: np.ndarray | None = None
    spot: np.ndarray | None = None
    intensity: np.ndarray | None = None
    quality: np.ndarray | None = None


# ---- how it appears ---------------------------------------------------------------------------

@dataclass(frozen=True, repr=False)
class StopView:
    """A log's stops as an effect sees them; ``n`` stops, ``c = beams + 2`` channels, ``b`` bins a dwell.

    Times [s]: ``time`` (n,) since the log's first dwell, ``run_time`` (n,) since the run's reset,
    ``mount_time`` (n,) since the setup's first dwell.  ``run``, ``setup`` (n,) numbers into
    ``run_ids``, ``setup_names``; ``repeat``, ``direction``, ``index``, ``axis`` (n,) as in the contract;
    ``approach`` (n, 3) sign of each axis's last motion (0: not known).
    ``commanded`` (n, 3) [m]; ``distance`` (n, beams) [m] to the mirror by the model; ``reading``
    (n, c) [m]: displacement of the beams, spot x, spot y; ``model`` (n, c) [m]: the same by the fit.
    ``strike`` (n, beams + 1, 2) [m] along (u, v): where each beam, the PSD's last, meets the mirror
    counted from its reference point.
    Derivatives of the readings [m per m or rad]: ``by_motion`` (18, n, c) along EXX … ECZ of
    :data:`~stepdiag_ros.model.machine.CURVES` at the stop, ``by_laser``, ``by_mirror`` (2, n, c) about u, v;
    ``by_shift`` (3, n, c) by a shift of the tool (or an axis) along X, Y, Z.
    ``intensity`` (n,) [V]; ``quality`` (n,); ``divided_index`` (n,): index that the instrument took out;
    ``air_index`` (n,): index from the environment topics, or None; ``scale_temperature`` (n, 3) [°C] or None
    (NaN for an axis without sensor).  Both as they were when the log began: ``first_air_index``,
    ``first_scale_temperature`` (3,).  ``lead`` [s]: from there to the first dwell.
    ``bin_time`` (n, b) [s]: middle of each bin after the dwell began.
    """

    description: Description
    run_ids: tuple[str, ...]
    setup_names: tuple[str, ...]
    time: np.ndarray
    run_time: np.ndarray
    mount_time: np.ndarray
    run: np.ndarray
    setup: np.ndarray
    repeat: np.ndarray
    direction: np.ndarray
    index: np.ndarray
    axis: np.ndarray
    approach: np.ndarray
    commanded: np.ndarray
    distance: np.ndarray
    reading: np.ndarray
    model: np.ndarray
    strike: np.ndarray
    by_motion: np.ndarray
    by_laser: np.ndarray
    by_mirror: np.ndarray
    by_shift: np.ndarray
    intensity: np.ndarray
    quality: np.ndarray
    divided_index: np.ndarray
    air_index: np.ndarray | None
    scale_temperature: np.ndarray | None
    bin_time: np.ndarray
    first_air_index: float | None = None
    first_scale_temperature: np.ndarray | None = None
    lead: float = 0.0

    @property
    def elapsed(self) -> np.ndarray:
        """Time (n,) [s] since the log began."""
        return self.time - self.time.min() + self.lead

    @property
    def watches(self) -> list[np.ndarray]:
        """Stops (k,) of each watch: a long dwell that was cut, its first piece and those that go on standing."""
        begins = np.flatnonzero(self.axis != STOOD)
        return [watch for watch in np.split(np.arange(len(self.axis)), begins[1:]) if len(watch) > 1]

    @cached_property
    def off_middle(self) -> np.ndarray:
        """Times (n, b) [s] of the bins from the middle of their dwell: along these a slow drift is a slope."""
        return self.bin_time - self.bin_time.mean(axis=1, keepdims=True)

    @property
    def beams(self) -> int:
        return self.distance.shape[1]

    @property
    def spot_model(self) -> np.ndarray:
        """Spots by the fit (n, 2) [m].  Signatures that grow with the spot take these: the readings'
        noise, which is the data too, would look like a gain that explains it."""
        return self.model[:, self.beams:]

    def zeros(self, k: int) -> np.ndarray:
        """Columns (k, n, c) of zeros to fill."""
        return np.zeros((k, *self.reading.shape))


@dataclass(frozen=True, repr=False)
class Form:
    """One way in which an effect may appear, linear in ``k`` coefficients.

    ``label``: the form in words, with its shape parameters.  ``columns`` (k, n, c) [m per unit of the
    coefficient] in the stops' means.  ``names`` (k,) and ``units`` of the coefficients; ``scale`` (k,):
    a typical size of each, in its unit; the evidence is averaged over sizes from ``scale/30`` to
    ``30·scale``.  ``inside`` (k, n, b, c) [m per unit]: the same inside the dwell, bin means minus the
    dwell's mean, or None where nothing happens there.  ``shape``: shape parameters by name with unit
    in the name, e.g. ``{'tau_s': 400.0}``.  ``retune``: the form with other shape parameters, or None where
    there are none to tune; ``tuned_from``: label of the form that it was tuned from, empty if it was not.
    ``process``: whether the coefficients are a random process whose standard deviations go as ``scale``, an
    unknown time profile; it is held to the size that the log shows, other coefficients are free.  ``held``:
    that size, in scales, once it is known.  ``by_reading`` (k, n, c): derivatives of columns that are made of the
    readings themselves, by the reading.  ``source``: what it comes from where a cell has but one, as its
    laser or its dead path; two forms of an effect with different sources do not act together.  ``beside``: what may act
    beside it as large without the log telling; no part of what is found, but of how uncertain the errors are.
    ``family``: forms of an effect of one family share one weight, however many they are, one to each stop.
    ``of_one_arrival``: whether it does no more than the error of a single arrival does.  ``gain`` (k, c): by which
    share of itself a unit of each coefficient makes a reading larger, errors of arrivals in it too; None: by none.
    """

    label: str
    columns: np.ndarray
    names: tuple[str, ...]
    scale: np.ndarray
    units: str = 'm'
    inside: np.ndarray | None = None
    shape: Mapping[str, float] = field(default_factory=dict)
    retune: Callable[[Mapping[str, float]], 'Form'] | None = None
    tuned_from: str = ''
    process: bool = False
    held: float | None = None
    by_reading: np.ndarray | None = None
    source: str = ''
    beside: 'Form | None' = None
    family: str = ''
    of_one_arrival: bool = False
    gain: np.ndarray | None = None

    def at(self, shape: Mapping[str, float]) -> 'Form':
        """The same form with other shape parameters; only where there is something to tune."""
        return replace(self.retune(shape), tuned_from=self.tuned_from or self.label, source=self.source,
                       family=self.family)


class Effect:
    """Base of all effects.  Subclasses set the class attributes and override what applies."""

    name: str = ''
    title: str = ''
    """What happens, for a machinist, in one sentence."""
    short: str = ''
    """The same in a few words, for headlines and tables; empty: made of the name."""
    parameters: tuple[Parameter, ...] = ()
    """Of :meth:`act`; ``Effect(**values)`` takes them by name."""
    sources: tuple[str, ...] = ()
    remedy: str = ''
    """What to do about it at the machine."""
    signature: str = ''
    """By what it shows in a log."""
    neighbours: str = ''
    """What looks alike, and what tells them apart."""
    needs_dwells: bool = False
    """Whether only what happens inside the dwells tells it from its neighbours: without samples, no claim."""
    needs_times: bool = False
    """Whether its time profile is what it is known by: of a log whose times were made up, no claim."""
    file: str = ''
    """The Python file of the user's own that holds it; empty: it is one of the vocabulary."""
    corrected: str = ''
    """By which topics of the environment (``air``, ``scales``) the evaluation takes it out of lengths; empty: none."""
    by_chance: bool = False
    """Whether it acts with a phase of its own in each log, so that a cell that has it cannot take it off."""
    not_adopted: str = ''
    """Why no cell file can hold what a log shows of it, in words; empty: it can."""
    repeatable: bool = False
    """Whether it may act more than once in a log, each time in a form of its own."""
    course_of: tuple[str, ...] = ()
    """Parameters whose amounts a ``course`` may give in place of the formula (:meth:`now`); empty: it has no course."""
    course_keeps: tuple[str, ...] = ()
    """Parameters that a course does not replace."""
    course_begins: bool = True
    """Whether a course counts from the log's beginning, so that it is nothing there."""

    def __init__(self, course: object = None, **values: object):
        known = {p.name: p for p in self.parameters}
        if course is not None and not self.course_of:
            raise ValueError(f'{self.name}: has no course')
        self.course: Course | None = course if course is None or isinstance(course, Course) else parse_course(
            course, len(self.amounts()))
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise ValueError(f'{self.name}: unknown parameter {", ".join(unknown)}; '
                             f'known are {", ".join(known)}')
        for name, parameter in known.items():
            middle = np.full(parameter.size, (parameter.low + parameter.high) / 2.0)
            value = np.broadcast_to(np.asarray(values.get(name, middle), float), (parameter.size,))
            setattr(self, name, value.copy() if parameter.size > 1 else float(value[0]))

    @classmethod
    def amounts(cls) -> list[Parameter]:
        """The parameter of each amount of a course, one as often as it has numbers."""
        known = {p.name: p for p in cls.parameters}
        return [known[name] for name in cls.course_of for _ in range(known[name].size)]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Mapping[str, object]:
        """Plausible parameters for :class:`Effect`, drawn: evenly between the bounds where not overridden."""
        drawn = {}
        for p in cls.parameters:
            value = rng.uniform(p.low, p.high, p.size)
            drawn[p.name] = value.tolist() if p.size > 1 else float(value[0])
        return drawn

    # Physical face, in the order in which the simulator asks.

    def now(self, seconds: np.ndarray, formula: np.ndarray) -> np.ndarray:
        """Its amounts (n, k) ``seconds`` (n,) after the log began: those of its course, or else ``formula`` (n, k)."""
        return formula if self.course is None else self.course.at(seconds)

    def following(self, course: Course) -> 'Effect':
        """The same effect with amounts that follow ``course``."""
        other = copy(self)
        other.course = course
        return other

    def before_pose(self, moment: Moment) -> None:
        """Change ``position``, ``shift``, ``turn``."""

    def before_light(self, moment: Moment) -> None:
        """Change ``laser``, ``mirror``, ``form``, ``index``."""

    def after_light(self, moment: Moment) -> None:
        """Change ``length``, ``spot``, ``intensity``, ``quality``."""

    def clock_offset(self, sensor: str) -> float:
        """Seconds that the stamps of ``'interferometer'`` or ``'psd'`` are late (early: negative)."""
        return 0.0

    def environment(self, seconds: np.ndarray) -> Mapping[str, np.ndarray]:
        """What it adds to the environment (n,) ``seconds`` after the log began, by the names of
        :attr:`~stepdiag_ros.model.log.CalibrationLog.environment`: sensors there will show it."""
        return {}

    # The diagnosis's face.

    imitated_by: str = ''
    """What without a name does exactly what the effect's forms do, in words; '' where nothing does."""

    def size_evidence(self, form: 'Form', values: np.ndarray, sigma: np.ndarray) -> float:
        """Log evidence for the sizes ``values`` (k,) ± ``sigma`` (k,) of a form, in its units, against any others: of
        effects whose sizes physics restricts."""
        return 0.0

    def appearance(self, view: StopView) -> list[Form]:
        """The forms in which the effect may appear in this log; none where it cannot be seen."""
        return []

    def guess(self, fitted: 'Fitted') -> Mapping[str, object]:
        """Rough parameters of the physical face, by name, with which it does what a log was ``fitted`` with; those left
        out begin in the middle of their bounds."""
        return {}

    def negative_controls(self, view: StopView) -> list[Form]:
        """Forms as rich as the effect's that it cannot take: what they explain as well is not its doing.

        Only effects with forms so rich that they may follow anything need some.
        """
        return []
