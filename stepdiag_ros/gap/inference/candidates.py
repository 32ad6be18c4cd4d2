"""All forms of all effects in one parity space, ready to be judged given a set.

Forms are brought there once, all columns side by side; their products with each other's members, with the
data and with what a set explains are then small matrices.  What was judged is remembered.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.made import Made, Split
from stepdiag_ros.gap.constants import BEYOND_WEIGHT, CONFUSED, CONTROL_SHARE, DISCREPANCY_SHARE, MEMBER_ALARM
from stepdiag_ros.gap.inference.brought import Brought
from stepdiag_ros.gap.inference.discrepancy import LEAST
from stepdiag_ros.gap.inference.discrepancy import columns as discrepancy_of
from stepdiag_ros.gap.inference.evidence import SIZES, judge, log_evidence, log_mean, log_sum
from stepdiag_ros.gap.inference.explained import Explained
from stepdiag_ros.gap.inference.parity import Parity, slopes_of

BEYOND = 'unknown, in few parameters'
"""The cause of what has no name and competes as names do (``own``), beside that of shapeless patterns."""
REMEMBERED = 12
"""Sets of which is remembered what they explain, those last worked out: each takes hundreds of numbers a reading."""


@dataclass(frozen=True)
class Candidate:
    """One form of one effect: ``family`` splits an effect's forms into groups of equal weight.

    ``penalty``: log prior odds against the family where a name explains as much.  ``negative_control``: a form
    that the effect named in ``family`` cannot take.  ``own``: whether the family weighs as much as an effect does,
    instead of sharing the weight of one with the others.
    """

    effect: str
    family: str
    form: Form
    penalty: float = 0.0
    negative_control: bool = False
    own: bool = False


@dataclass(frozen=True)
class Member:
    """An effect in a set, in the form that suits best, and its evidence given those before it; ``size`` of
    its coefficients, in the form's scales, that is allowed for; ``refused``: why it may not be claimed, else ''.
    ``at``: the coefficients, in units of ``size``, of which its form's discrepancy is a share, () for those that it has
    beside the members before it.  ``own``: whether its candidate is."""

    effect: str
    candidate: int
    log_bayes: float
    size: float = float(SIZES[-1])
    penalty: float = 0.0
    refused: str = ''
    at: tuple[float, ...] = ()
    own: bool = False

    @property
    def cause(self) -> str:
        """What counts as one cause in a search."""
        return BEYOND if self.own else self.effect


@dataclass
class Screen:
    """All candidates of a log in one parity space, ready to be judged given a set.

    ``repeatable``: effects that may enter a set more than once; ``modulations`` (m, n): those of
    :mod:`~stepdiag_ros.gap.inference.discrepancy`, None where forms are taken to be exact; ``effects`` by name.
    ``data`` (M,): those of the parity space, and below them those of the Jacobian correction of columns made
    of readings (:meth:`Parity.own_rows`).
    """

    parity: Parity
    candidates: Sequence[Candidate]
    noise_dof: float
    repeatable: frozenset = frozenset()
    modulations: np.ndarray | None = None
    effects: Mapping[str, Effect] = field(default_factory=dict)
    data: np.ndarray = field(init=False)
    _brought: Brought = field(init=False)
    _slices: list = field(init=False)
    _ratios: list = field(init=False)
    _alike: list = field(init=False)
    _judged: dict = field(init=False, default_factory=dict)
    _explained: dict = field(init=False, default_factory=dict)
    _half: dict = field(init=False, default_factory=dict)
    _gains: dict = field(init=False, default_factory=dict)
    _beyond: dict = field(init=False, default_factory=dict)
    _families: list = field(init=False)
    _controls: dict = field(init=False)

    def __post_init__(self):
        forms = [c.form for c in self.candidates]
        first = _among(forms)
        owns = [number for number, (other, _) in enumerate(first) if other == number]
        self.data = np.concatenate([self.parity.data, self.parity.own_data])
        self._brought = Brought.into(self.parity, [forms[i] for i in owns], self.data)
        place = {number: k for k, number in enumerate(owns)}
        within = [slice(begin, begin + len(form.columns)) for form, (_, begin) in zip(forms, first, strict=True)]
        begins = [self._brought.slices[place[i]].start for i, _ in first]
        self._slices = [slice(begin + part.start, begin + part.stop)
                        for begin, part in zip(begins, within, strict=True)]
        self._ratios = [form.scale / forms[i].scale[part]
                        for form, (i, _), part in zip(forms, first, within, strict=True)]
        grams, corrections = self._brought.grams, self._brought.corrections
        by_width: dict[int, list[int]] = {}
        for number, part in enumerate(self._slices):
            by_width.setdefault(part.stop - part.start, []).append(number)
        self._alike = []
        for numbers in by_width.values():
            places = np.stack([np.arange(self._slices[n].start, self._slices[n].stop) for n in numbers])
            ratios = np.stack([self._ratios[n] for n in numbers])
            both = ratios[:, :, None] * ratios[:, None, :]
            gram = np.stack([grams[place[first[n][0]]][within[n], within[n]] for n in numbers]) * both
            along = self._brought.along[places] * ratios
            mine = None
            if any(place[first[n][0]] in corrections for n in numbers):
                none = np.zeros(gram.shape[1:])
                mine = np.stack([corrections.get(place[first[n][0]], none) for n in numbers]) * both
                gram += mine
            self._alike.append(_Alike(np.array(numbers), places, ratios, gram, along, mine))
        self._group()

    def extended(self, more: Sequence[Candidate]) -> 'Screen':
        """The screen with further candidates; what is known of those it has is not worked out again."""
        other = Screen(self.parity, more, self.noise_dof, self.repeatable, self.modulations, self.effects)
        count, width = len(self.candidates), self._brought.width
        self.candidates = [*self.candidates, *more]
        self._brought = self._brought.and_then(other._brought)
        self._ratios += other._ratios
        self._slices += [slice(s.start + width, s.stop + width) for s in other._slices]
        self._alike += [replace(alike, numbers=alike.numbers + count, places=alike.places + width)
                        for alike in other._alike]
        for known in self._judged.values():
            unknown = np.full(len(more), np.nan)
            known.log_bayes, known.size = (np.concatenate([each, unknown]) for each in (known.log_bayes, known.size))
        self._group()
        return self

    def columns_of(self, number: int) -> np.ndarray:
        """Columns (M, k) of one candidate, per unit of its scale."""
        full = self._brought.columns(self._slices[number], len(self.data))
        full[:self.parity.stops] = self.parity.projection.projected(full[:self.parity.stops])
        return full * self._ratios[number]

    def explained(self, members: Sequence[Member]) -> Explained:
        """What several members explain, the discrepancies of their forms included."""
        if not members:
            return Explained.nothing(self.data)
        key = _key(members)
        found = self._explained.pop(key, None)
        if found is None:
            found, own = self._begun(members)
            if own is not None:
                found = found.and_then(own)
        _remember(self._explained, key, found)
        return found

    def _begun(self, members: Sequence[Member]) -> tuple[Explained, np.ndarray | None]:
        """What several members explain but for the discrepancy of the last one's form, and the columns of that."""
        key = _key(members)
        both = self._half.pop(key, None)
        if both is None:
            before, mine = self.explained(members[:-1]), self._block(members[-1])
            free = before.freed(mine)
            both = before.and_then(mine, free), self._discrepancy(members[-1], before, mine, free)
        _remember(self._half, key, both)
        return both

    def _block(self, member: Member) -> np.ndarray:
        """Columns (M, k) of a member, in units of the sizes that are allowed."""
        return self.columns_of(member.candidate) * member.size

    def _discrepancy(self, member: Member, before: Explained, mine: np.ndarray, free: np.ndarray) -> np.ndarray | None:
        """Columns (M, m) of the discrepancy of a member's form, at the coefficients of its columns ``mine`` that it has
        beside those before it, of which these leave ``free``; None where it is below the noise."""
        if self.modulations is None:
            return None
        values = np.array(member.at) if member.at else before.coefficients(mine, free)[0]
        if DISCREPANCY_SHARE * np.linalg.norm(mine @ values) < LEAST:
            return None
        form = self.candidates[member.candidate].form
        sizes = values * member.size * form.scale
        inside = None if form.inside is None else np.tensordot(sizes, form.inside, axes=1)
        below = np.zeros((len(self.data) - self.parity.size, len(self.modulations)))
        return np.concatenate([discrepancy_of(
            self.parity, np.tensordot(sizes, form.columns, axes=1), inside, self.modulations), below])

    def sizes(self, members: Sequence[Member], number: int) -> np.ndarray:
        """Coefficients (k,) of the member ``number`` of some, all others free, in its form's units."""
        return self.explained(members).within(self._block(members[number])) * self._unit(members[number])

    def with_sigmas(self, members: Sequence[Member], number: int) -> tuple[np.ndarray, np.ndarray]:
        """The same, and their standard deviations.

        From what the others leave: of a slip known to a hundred-thousandth of the size that it is allowed, what is left
        once it is explained itself is lost in rounding.
        """
        others = self.explained((*members[:number], *members[number + 1:]))
        values, covariance = others.coefficients(self._block(members[number]))
        unit = self._unit(members[number])
        return values * unit, np.sqrt(np.diag(covariance)) * unit

    def _unit(self, member: Member) -> np.ndarray:
        """What coefficients (k,) of one in a member's columns are, in its form's units."""
        return self.candidates[member.candidate].form.scale * member.size

    def with_jacobian(self, members: Sequence[Member]) -> Member:
        """The last of some members, its evidence with the Jacobian correction whole, not to the second order only: a
        swing so large that the reading hardly grows with the length would seem to cost little."""
        beyond = self._beyond_rows(members)
        if not beyond:
            return members[-1]
        return replace(members[-1], log_bayes=members[-1].log_bayes + beyond - self._beyond_rows(members[:-1]))

    def in_place(self, members: Sequence[Member]) -> list[Member]:
        """The same members, each form's discrepancy a share of what it does beside all the others.

        What came first had, for a part of what those after it do, a coefficient that was none of its own.
        """
        placed: list[Member] = []
        for number, member in enumerate(members):
            there = replace(member, at=tuple(self.explained(members).within(self._block(member))))
            there = replace(there, log_bayes=member.log_bayes + self._weighed((*placed, there))
                            - self._weighed(members[:number + 1]))
            placed.append(there)
        return placed

    def _weighed(self, members: Sequence[Member]) -> float:
        """The evidence that the last of some members brings in its form, the discrepancy of that included."""
        member = members[-1]
        alone = self.judge_all(members[:-1], [member.candidate]).log_bayes[member.candidate]
        return self.with_discrepancy((*members[:-1], replace(member, log_bayes=float(alone)))).log_bayes

    def _beyond_rows(self, members: Sequence[Member]) -> float:
        key = _key(members)
        if key not in self._beyond:
            slopes = slopes_of([self.candidates[m.candidate].form for m in members],
                               lambda number: self.sizes(members, number))
            self._beyond[key] = 0.0 if slopes is None else self.parity.beyond_rows(slopes)
        return self._beyond[key]

    def with_discrepancy(self, members: Sequence[Member]) -> Member:
        """The last of some members, its evidence that of its form together with the discrepancy of that."""
        key = _key(members)
        if key not in self._gains:
            found, own = self._begun(members)
            self._gains[key] = 0.0
            if own is not None:
                cross = found.along(own)
                along = own.T @ self.data - cross.T @ found.taken
                self._gains[key] = log_evidence(own.T @ own - cross.T @ cross, along, self._total(found),
                                                self._dof(found), self.noise_dof)
        return replace(members[-1], log_bayes=members[-1].log_bayes + self._gains[key])

    def _total(self, found: Explained) -> float:
        """The squared data beside what is explained, which say how large noise is."""
        return found.total + self.parity.quiet

    def _dof(self, found: Explained) -> float:
        """Free dimensions of the data beside what is explained."""
        return sum(self.parity.dof) - found.spent(self.parity.size)

    def judge_all(self, members: Sequence[Member], wanted: ArrayLike) -> 'Known':
        """What is known of the candidates given the set ``members``, that of the ``wanted`` ones among it."""
        known = self._judged.get(_key(members))
        if known is None:
            known = self._judged[_key(members)] = Known(np.full(len(self.candidates), np.nan),
                                                        np.full(len(self.candidates), np.nan))
        open_ = np.zeros(len(self.candidates), bool)
        open_[wanted] = True
        open_ &= np.isnan(known.log_bayes)
        if not open_.any():
            return known
        found = self.explained(members)
        basis, taken = found.basis, found.taken
        parts = [self._slices[i] for i in np.flatnonzero(open_)]
        wide = slice(min(p.start for p in parts), max(p.stop for p in parts))
        overlap = self._brought.times(basis, wide)
        correction = _Correction.by(self._brought, basis, found.left, wide)
        total, dof = self._total(found) - correction.total, self._dof(found)
        for alike in self._alike:
            chosen = open_[alike.numbers]
            cross = overlap[alike.places[chosen]] * alike.ratios[chosen][:, :, None]
            gram = alike.grams[chosen] - cross @ cross.transpose(0, 2, 1)
            along = alike.alongs[chosen] - cross @ taken
            judged = judge(gram, along, total, dof, self.noise_dof, correction.of(alike, chosen, cross))
            known.log_bayes[alike.numbers[chosen]] = judged.log_bayes
            known.size[alike.numbers[chosen]] = judged.size
        return known

    def as_first(self, member: Member) -> Member:
        """A member of a set in the same form as if it were the first: the evidence of that form alone, as one
        of all that its cause has."""
        number = member.candidate
        mine = self.candidates[number]
        forms = sum(other.effect == mine.effect and (other.family == mine.family or not mine.own)
                    for other in self.candidates)
        known = self.judge_all((), [number])
        return replace(member, log_bayes=float(known.log_bayes[number] - np.log(forms)),
                       size=self.allowed(number, known))

    def by_cause(self, members: Sequence[Member] = (),
                 asked: Callable[[str], bool] = lambda cause: True) -> dict[str, Member]:
        """The evidence of every cause ``asked`` for given ``members``, averaged over its forms; the best form,
        penalties weighed."""
        present = {m.effect for m in members}
        sources: dict[str, set[str]] = {}
        for m in members:
            if source := self.candidates[m.candidate].form.source:
                sources.setdefault(m.effect, set()).add(source)
        wanted = {cause for cause in {family.cause for family in self._families} if asked(cause)}
        groups: dict[str, list[_Family]] = {}
        for family in self._families:
            # Beside the name its negative controls do not compete.
            if family.cause in wanted and not (family.negative_control and family.name in present):
                some = family.of_source(sources[family.effect]) if family.effect in sources else family
                if len(some.numbers):
                    groups.setdefault(family.cause, []).append(some)
        every = [family.numbers for families in groups.values() for family in families]
        known = self.judge_all(members, np.concatenate([np.zeros(0, np.intp), *every]))
        result = {}
        for cause, families in groups.items():
            effect = families[0].effect
            logs = [known.log_bayes[family.numbers] for family in families]
            penalties = [_penalty(family, mine) for family, mine in zip(families, logs, strict=True)]
            shared = float(np.log(max(len(families) / BEYOND_WEIGHT, 1.0) if cause == BEYOND else len(families)))
            means = [log_mean(mine) - penalty - shared for mine, penalty in zip(logs, penalties, strict=True)]
            # The penalty is that against the family which carries the sum: another's would be paid back unpaid.
            k = int(np.argmax(means))
            best = int(families[k].numbers[logs[k].argmax()])
            member = Member(effect, best, log_sum(means) + penalties[k], self.allowed(best, known), penalties[k],
                            own=cause == BEYOND)
            as_rich = self._controls.get((effect, len(self.candidates[best].form.columns)))
            result[cause] = member if as_rich is None else self._beyond_controls(members, member, as_rich)
        return result

    def beyond(self) -> list[Member]:
        """Of each family without a name that competes as names do the form that suits best, its evidence its own."""
        families = [family for family in self._families if family.own]
        known = self.judge_all((), np.concatenate([np.zeros(0, np.intp), *(family.numbers for family in families)]))
        best = [int(family.numbers[known.log_bayes[family.numbers].argmax()]) for family in families]
        return [Member(self.candidates[number].effect, number, float(known.log_bayes[number]),
                       self.allowed(number, known), own=True) for number in best]

    def allowed(self, number: int, known: 'Known') -> float:
        """The size that a candidate's coefficients are allowed in a set: an unknown profile the one that the log shows
        of it."""
        return float(known.size[number] if self.candidates[number].form.process else SIZES[-1])

    def _beyond_controls(self, members: Sequence[Member], member: Member, controls: np.ndarray) -> Member:
        """A member; refused where its negative ``controls``, as rich, show nearly as much beside it still.

        What a name explains its controls show no more.  What they show beside it is of another cause, and of
        that the name's own forms, as rich, have shown as much; and once more what that is beyond chance,
        for controls are few.
        """
        if member.log_bayes < 0.0:
            return member
        shown = max(0.0, float(self.judge_all((*members, member), controls).log_bayes[controls].max()))
        asked = shown + max(0.0, shown - CONFUSED)
        if member.log_bayes - asked > MEMBER_ALARM:
            return member
        return replace(member, refused=f'{member.effect}: beside it its negative controls show {shown:.1f} in log '
                                       f'evidence, it brings {member.log_bayes:.1f}')

    def _group(self) -> None:
        """Candidates by effect and family; negative controls by the effect they are of and their number of columns."""
        families: dict[tuple[str, str], list[int]] = {}
        controls: dict[tuple[str, int], list[int]] = {}
        for number, candidate in enumerate(self.candidates):
            families.setdefault((candidate.effect, candidate.family), []).append(number)
            if candidate.negative_control:
                controls.setdefault((candidate.family, len(candidate.form.columns)), []).append(number)
        self._families = [_Family.of(self.candidates, numbers) for numbers in families.values()]
        self._controls = {key: np.array(numbers) for key, numbers in controls.items()}


@dataclass
class Known:
    """``log_bayes`` (F,) of all candidates given a set and the ``size`` (F,) that speaks best for each; NaN of those
    that were not judged."""

    log_bayes: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class _Family:
    """Candidates of one family of an effect: their ``numbers`` (m,), ``sources`` (m,) and what they share."""

    effect: str
    name: str
    penalty: float
    negative_control: bool
    own: bool
    numbers: np.ndarray
    sources: np.ndarray

    @property
    def cause(self) -> str:
        return BEYOND if self.own else self.effect

    @classmethod
    def of(cls, candidates: Sequence[Candidate], numbers: Sequence[int]) -> '_Family':
        one = candidates[numbers[0]]
        return cls(one.effect, one.family, one.penalty, one.negative_control, one.own, np.array(numbers),
                   np.array([candidates[n].form.source for n in numbers]))

    def of_source(self, sources: Iterable[str]) -> '_Family':
        """Those of no source, and of some."""
        mine = np.isin(self.sources, ['', *sources])
        return replace(self, numbers=self.numbers[mine], sources=self.sources[mine])


def _penalty(family: _Family, logs: np.ndarray) -> float:
    """Log odds against a family, of the evidence ``logs`` (m,), where a name explains as much.

    What negative controls explain, forms as rich would have explained whatever the cause: a name has earned
    only what it explains beyond, and must beat its controls by a share of what they have.
    """
    return -CONTROL_SHARE * max(0.0, float(logs.max())) if family.negative_control else family.penalty


@dataclass(frozen=True)
class _Alike:
    """Candidates with k columns each: ``numbers`` (F,), ``places`` (F, k) of their columns among all and
    ``ratios`` (F, k) of their scales to those of the columns there, products ``grams`` (F, k, k) with
    themselves and ``alongs`` (F, k) with the data; ``correction`` (F, k, k): what of the first is in the rows of the
    Jacobian correction, None where there are none."""

    numbers: np.ndarray
    places: np.ndarray
    ratios: np.ndarray
    grams: np.ndarray
    alongs: np.ndarray
    correction: np.ndarray | None


@dataclass(frozen=True)
class _Correction:
    """The rows of the Jacobian correction, given a set: what is left of them, squared, in ``total``; products of
    the set's directions there with each other (r, r) and with what is left (r,), and of the columns that are asked for
    with the directions (K, r) and with what is left (K,), zero of the others."""

    total: float
    among: np.ndarray
    among_left: np.ndarray
    with_basis: np.ndarray
    with_left: np.ndarray

    @classmethod
    def by(cls, brought: Brought, basis: np.ndarray, left: np.ndarray, wanted: slice) -> '_Correction':
        total, size = 0.0, basis.shape[1]
        among, among_left = np.zeros((size, size)), np.zeros(size)
        with_basis, with_left = np.zeros((brought.width, size)), np.zeros(brought.width)
        for block in brought.own:
            mine, some = basis[block.rows], block.within(wanted)
            total += float(left[block.rows] @ left[block.rows])
            among += mine.T @ mine
            among_left += mine.T @ left[block.rows]
            with_basis[block.places[some]] += block.columns[:, some].T @ mine
            with_left[block.places[some]] += block.columns[:, some].T @ left[block.rows]
        return cls(total, among, among_left, with_basis, with_left)

    def of(self, alike: _Alike, chosen: np.ndarray, cross: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Products of the ``chosen`` candidates with themselves and with what is left, ``cross`` (F, k, r) of what the
        set explains taken off; None where neither they nor the set need a correction."""
        if alike.correction is None and not np.any(self.among):
            return None
        places, ratios = alike.places[chosen], alike.ratios[chosen]
        mixed = (self.with_basis[places] * ratios[:, :, None]) @ cross.transpose(0, 2, 1)
        gram = cross @ self.among @ cross.transpose(0, 2, 1) - mixed - mixed.transpose(0, 2, 1)
        if alike.correction is not None:
            gram = gram + alike.correction[chosen]
        return gram, self.with_left[places] * ratios - cross @ self.among_left


def _remember(known: dict, key: tuple, value: object) -> None:
    """Put what was worked out or asked for last behind all that is known, and let the first of too many go."""
    while len(known) >= REMEMBERED:
        del known[next(iter(known))]
    known[key] = value


def _key(members: Sequence[Member]) -> tuple:
    """By what it is remembered what some members explain."""
    return tuple((m.candidate, m.size, m.at) for m in members)


def _among(forms: Sequence[Form]) -> list[tuple[int, int]]:
    """For each form the number of that whose columns it shares, and its first among those: its own; or that of the
    process before it, where the two differ in the sizes of their coefficients only (a winding and a smooth profile); or
    that of all places, where it is of some."""
    first, whole = [(number, 0) for number in range(len(forms))], 0
    for number in range(1, len(forms)):
        form, before = forms[number], forms[number - 1]
        if form.process and before.process and _same(form.columns, before.columns) \
                and _same(form.inside, before.inside):
            first[number] = first[number - 1]
        elif _plain(form):
            begin = form.columns.begins_in(forms[whole].columns) if _plain(forms[whole]) else None
            first[number] = (number, 0) if begin is None else (whole, begin)
            whole = first[number][0]
    return first


def _plain(form: Form) -> bool:
    """Whether a form is nothing but split columns at the stops."""
    return isinstance(form.columns, Split) and form.by_reading is None and form.inside is None


def _same(one: np.ndarray | Made | None, other: np.ndarray | Made | None) -> bool:
    if isinstance(one, Made):
        return one.same(other)
    return one is other or (one is not None and other is not None and np.array_equal(one, other))
