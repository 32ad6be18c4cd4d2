"""Which effects act: evidence for sets of effects, and probabilities from it.

All forms of all effects are brought into parity space once.  Sets grow by one effect at a time
from the best of those found (a beam search); the evidence for a set is that of its first member plus
that of each further one given those before, the largest over the orders.  A form's coefficients, once
its effect is in the set, are free: what is left is what nothing in the set can explain.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from stepdiag_ros.effects.base import Form
from stepdiag_ros.gap.evidence import SIZES, Judged, judge, log_mean
from stepdiag_ros.gap.parity import Parity
from stepdiag_ros.gap.thresholds import (
    BEYOND_DOUBT,
    DECOY_SHARE,
    FORM_ERROR,
    GROSS_EVIDENCE,
    MEMBER_ALARM,
    MISFIT,
    MISFIT_MOST,
    STOP_SUPPORT,
    TAKEN_OF_REST,
)
from stepdiag_ros.gap.unknown import NAME as UNKNOWN

BEAM = 4
BEAM_OF_NAMELESS = 2
LARGEST = 3
PRIOR_NUMBER = (0.5, 0.32, 0.14, 0.04)
"""Prior probability that none, one, two, three effects act."""
FORMS_OF_ONE = 3
MOST_REPEATS = 4
MOST_FORMS = 6
"""Most forms of one effect, of one that repeats, and of a set."""
LEAST_EXPLAINED = 0.02
"""Directions of a set with less variance than this against the noise's are left out."""
HOPELESS = 60.0
"""Sets this far behind in log evidence are not carried on."""
GAIN = 3.0
"""Least growth of log evidence for which a set is carried on with a further member."""


@dataclass(frozen=True)
class Candidate:
    """One form of one effect: ``family`` splits an effect's forms into groups of equal weight.

    ``doubt``: log odds against the family where a name explains as much.  ``decoy``: a form that the effect
    named in ``family`` cannot take.
    """

    effect: str
    family: str
    form: Form
    doubt: float = 0.0
    decoy: bool = False


@dataclass(frozen=True)
class Member:
    """An effect in a set, in the form that suits best, and its evidence given those before it; ``size`` of
    its coefficients, in the form's scales, that is allowed for."""

    effect: str
    candidate: int
    log_bayes: float
    size: float = float(SIZES[-1])
    doubt: float = 0.0


@dataclass(frozen=True)
class EffectSet:
    """A set of effects with ``log_bayes`` against nothing; ``fall`` of zᵀz by all its columns."""

    members: tuple[Member, ...]
    log_bayes: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names in rising order, one for each form."""
        return tuple(sorted(m.effect for m in self.members))

    @property
    def key(self) -> frozenset:
        return frozenset(m.effect for m in self.members)


@dataclass
class Screen:
    """All candidates of a log in one parity space, ready to be judged given a set.

    ``repeatable``: effects that may enter a set more than once; ``in_dwells``: those that only the
    dwells' insides tell from their neighbours.
    """

    parity: Parity
    candidates: Sequence[Candidate]
    noise_dof: float
    repeatable: frozenset = frozenset()
    in_dwells: frozenset = frozenset()
    _white: np.ndarray = field(init=False)
    _inside: np.ndarray = field(init=False)
    _with_inside: np.ndarray = field(init=False)
    _along: np.ndarray = field(init=False)
    _slices: list = field(init=False)
    _ratios: list = field(init=False)
    _alike: list = field(init=False)
    _judged: dict = field(init=False, default_factory=dict)

    def __post_init__(self):
        stops, data, forms = self.parity.stops, self.parity.data, [c.form for c in self.candidates]
        first = _first_alike(forms)
        owns = [number for number, other in enumerate(first) if other == number]
        edges = np.concatenate([[0], np.cumsum([len(forms[i].columns) for i in owns])]).astype(int)
        parts = {i: slice(a, b) for i, a, b in zip(owns, edges[:-1], edges[1:], strict=True)}
        self._slices = [parts[i] for i in first]
        self._ratios = [form.scale / forms[i].scale for form, i in zip(forms, first, strict=True)]
        stacked = np.empty((edges[-1], *forms[0].columns.shape[1:]))
        for i, part in parts.items():
            np.multiply(forms[i].columns, forms[i].scale[:, None, None], out=stacked[part])
        # The data are projected, so are products with them: the columns need not be, which would
        # be the dearest step.  Their own products are put right by what the fit absorbs.
        self._white = self.parity.white_part(stacked)
        absorbed = self.parity.absorbed(self._white)
        self._along = self._white.T @ data[:stops]
        inside = {i: self.parity.bin_part(forms[i].inside) * forms[i].scale
                  for i in owns if forms[i].inside is not None}
        self._with_inside = _indices([parts[i] for i in inside])
        self._inside = np.concatenate([np.zeros((self.parity.size - stops, 0)), *inside.values()], axis=1)
        self._along[self._with_inside] += self._inside.T @ data[stops:]
        grams = {}
        for i, part in parts.items():
            columns, lost = self._white[:, part], absorbed[:, part]
            grams[i] = columns.T @ columns - lost.T @ lost
            if i in inside:
                grams[i] += inside[i].T @ inside[i]
        by_width: dict[int, list[int]] = {}
        for number, part in enumerate(self._slices):
            by_width.setdefault(part.stop - part.start, []).append(number)
        self._alike = []
        for numbers in by_width.values():
            places = np.stack([_indices([self._slices[n]]) for n in numbers])
            ratios = np.stack([self._ratios[n] for n in numbers])
            gram = np.stack([grams[first[n]] for n in numbers]) * ratios[:, :, None] * ratios[:, None, :]
            along = self._along[places] * ratios
            for place, n in enumerate(numbers):
                if forms[n].by_reading is not None:
                    owed, width = self.parity.own_noise(forms[n])
                    gram[place] += width
                    along[place] -= owed
            self._alike.append(_Alike(np.array(numbers), places, ratios, gram, along))

    def extended(self, more: Sequence[Candidate]) -> 'Screen':
        """The screen with further candidates; what is known of those it has is not worked out again."""
        other = Screen(self.parity, more, self.noise_dof, self.repeatable, self.in_dwells)
        count, width = len(self.candidates), self._white.shape[1]
        self.candidates = [*self.candidates, *more]
        self._white = np.concatenate([self._white.T, other._white.T]).T
        self._inside = np.concatenate([self._inside, other._inside], axis=1)
        self._with_inside = np.concatenate([self._with_inside, other._with_inside + width])
        self._along = np.concatenate([self._along, other._along])
        self._ratios += other._ratios
        self._slices += [slice(s.start + width, s.stop + width) for s in other._slices]
        self._alike += [replace(alike, numbers=alike.numbers + count, places=alike.places + width)
                        for alike in other._alike]
        return self

    def columns_of(self, number: int) -> np.ndarray:
        """Columns (N, k) of one candidate, per unit of its scale."""
        part = self._slices[number]
        full = np.zeros((self.parity.size, part.stop - part.start))
        white = self._white[:, part]
        full[:self.parity.stops] = white - self.parity._basis @ self.parity.absorbed(white)
        mine = np.flatnonzero((self._with_inside >= part.start) & (self._with_inside < part.stop))
        if len(mine):
            full[self.parity.stops:] = self._inside[:, mine]
        return full * self._ratios[number]

    def basis(self, members: Sequence[Member]) -> np.ndarray:
        """Directions ``B`` (N, r) that several members explain: given them, products are taken with 1 − BBᵀ."""
        if not members:
            return np.zeros((self.parity.size, 0))
        return _explained(np.concatenate([self.columns_of(m.candidate) * m.size for m in members], axis=1))

    def judge_all(self, members: Sequence[Member], wanted: Sequence[int]) -> dict[int, Judged]:
        """The ``wanted`` candidates given the set ``members``; what was judged before is remembered."""
        known = self._judged.setdefault(tuple((m.candidate, m.size) for m in members), {})
        open_ = np.zeros(len(self.candidates), bool)
        open_[[i for i in wanted if i not in known]] = True
        if not open_.any():
            return known
        basis, data, stops = self.basis(members), self.parity.data, self.parity.stops
        taken = basis.T @ data
        total = float(data @ data - taken @ taken)
        dof = sum(self.parity.dof) - float(np.sum(basis**2))
        overlap = basis[:stops].T @ self._white
        overlap[:, self._with_inside] += basis[stops:].T @ self._inside
        for alike in self._alike:
            chosen = open_[alike.numbers]
            cross = (overlap[:, alike.places[chosen]] * alike.ratios[chosen]).transpose(1, 2, 0)
            gram = alike.grams[chosen] - cross @ cross.transpose(0, 2, 1)
            along = alike.alongs[chosen] - cross @ taken
            known.update(zip(alike.numbers[chosen].tolist(), judge(gram, along, total, dof, self.noise_dof),
                             strict=True))
        return known

    def stop_support(self, members: Sequence[Member], number: int) -> float:
        """Log evidence for one candidate given a set from the stops' means alone."""
        stops, data = self.parity.stops, self.parity.data[:self.parity.stops]
        columns = self.columns_of(number)[:stops]
        if members:
            given = _explained(np.concatenate(
                [self.columns_of(m.candidate)[:stops] * m.size for m in members], axis=1))
            seen, taken = given.T @ columns, given.T @ data
        else:
            seen, taken = np.zeros((0, columns.shape[1])), np.zeros(0)
        return judge((columns.T @ columns - seen.T @ seen)[None],
                     (columns.T @ data - seen.T @ taken)[None], float(data @ data - taken @ taken),
                     self.parity.dof[0], self.noise_dof)[0].log_bayes

    def as_first(self, member: Member) -> Member:
        """A member of a set in the same form as if it were the first: the evidence of that form alone, as one
        of all that the effect has."""
        number, form = member.candidate, self.candidates[member.candidate].form
        forms = sum(candidate.effect == member.effect for candidate in self.candidates)
        alone = self.judge_all((), [number])[number]
        return replace(member, log_bayes=alone.log_bayes - float(np.log(forms)),
                       size=alone.size if form.process else float(SIZES[-1]))

    def shared(self, less: Sequence[Member], more: Sequence[Member]) -> float:
        """Overlap (0 … 1) of the channels, lengths or spot, in which ``less`` explains the data with those in
        which ``more`` explains what it adds."""
        data, spot = self.parity.data, self.parity.of_spot
        first, both = (basis @ (basis.T @ data) for basis in (self.basis(less), self.basis(more)))
        shares = [np.array([part[~spot] @ part[~spot], part[spot] @ part[spot]]) for part in (first, both - first)]
        return float(np.minimum(*(power / max(power.sum(), 1e-300) for power in shares)).sum())

    def by_effect(self, members: Sequence[Member] = (),
                  asked: Callable[[str], bool] = lambda effect: True) -> dict[str, Member]:
        """The evidence of every effect ``asked`` for given ``members``, averaged over its forms; the best form,
        doubts weighed."""
        groups: dict[str, dict[str, list[int]]] = {}
        present = {m.effect for m in members}
        sources = {(m.effect, self.candidates[m.candidate].form.source) for m in members
                   if self.candidates[m.candidate].form.source}
        settled = {effect for effect, _ in sources}
        for number, candidate in enumerate(self.candidates):
            if not asked(candidate.effect):
                continue
            if candidate.decoy and candidate.family in present:
                continue  # beside the name its decoys are no rivals
            if (candidate.effect in settled and candidate.form.source
                    and (candidate.effect, candidate.form.source) not in sources):
                continue
            groups.setdefault(candidate.effect, {}).setdefault(candidate.family, []).append(number)
        judged = self.judge_all(members, [i for families in groups.values()
                                          for numbers in families.values() for i in numbers])
        result = {}
        for effect, families in groups.items():
            doubts = {family: self._doubt(numbers, judged) for family, numbers in families.items()}
            logs = [log_mean([judged[i].log_bayes for i in numbers]) - doubts[family]
                    for family, numbers in families.items()]
            family, best = max(((family, i) for family, numbers in families.items() for i in numbers),
                               key=lambda at: judged[at[1]].log_bayes - doubts[at[0]])
            size = judged[best].size if self.candidates[best].form.process else float(SIZES[-1])
            result[effect] = Member(effect, best, log_mean(logs) + doubts[family], size, doubts[family])
        return result

    def _doubt(self, numbers: Sequence[int], judged: Mapping[int, Judged]) -> float:
        """Log odds against a family where a name explains as much.

        What decoys explain, forms as rich would have explained whatever the cause: a name has earned
        only what it explains beyond, and must beat its decoys by a share of what they have.
        """
        first = self.candidates[numbers[0]]
        return -DECOY_SHARE * max(0.0, *(judged[i].log_bayes for i in numbers)) if first.decoy else first.doubt


@dataclass(frozen=True)
class _Alike:
    """Candidates with k columns each: ``numbers`` (F,), ``places`` (F, k) of their columns among all and
    ``ratios`` (F, k) of their scales to those of the columns there, products ``grams`` (F, k, k) with
    themselves and ``alongs`` (F, k) with the data."""

    numbers: np.ndarray
    places: np.ndarray
    ratios: np.ndarray
    grams: np.ndarray
    alongs: np.ndarray


def _explained(columns: np.ndarray) -> np.ndarray:
    """Directions ``B`` (N, r), ``1 − BBᵀ = (1 + ZZᵀ)⁻¹``, for columns ``Z`` (N, k) in units of the sizes
    that are allowed for: what is as large as allowed is taken away, what is far below the noise left."""
    value, vector = np.linalg.eigh(columns.T @ columns)
    keep = value > LEAST_EXPLAINED
    return columns @ (vector[:, keep] / np.sqrt(1.0 + value[keep]))


def _first_alike(forms: Sequence[Form]) -> list[int]:
    """For each form the number of that whose columns it shares: its own, or that of the process before it
    where the two differ in the sizes of their coefficients only (a winding and a smooth course)."""
    first = list(range(len(forms)))
    for number in range(1, len(forms)):
        form, before = forms[number], forms[number - 1]
        if form.process and before.process and _same(form.columns, before.columns) \
                and _same(form.inside, before.inside):
            first[number] = first[number - 1]
    return first


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is other or (one is not None and other is not None and np.array_equal(one, other))


def _indices(parts: Sequence[slice]) -> np.ndarray:
    """All indices (k,) of some slices."""
    return np.concatenate([np.arange(0), *(np.arange(p.start, p.stop) for p in parts)])


def search(screen: Screen) -> list[EffectSet]:
    """Sets of effects worth a thought, best first; the empty set is among them."""
    first = screen.by_effect()
    sets: dict[tuple, EffectSet] = {(): EffectSet((), 0.0)}
    front = []
    for member in first.values():
        found = EffectSet((member,), member.log_bayes)
        sets[found.names] = found
        front.append(found)
    alone = max((m.log_bayes for m in first.values() if m.effect != UNKNOWN), default=0.0)
    while front:
        # Nameless patterns, which fit anything, must not crowd out the names.
        front = _leading([s for s in front if UNKNOWN not in s.key], BEAM) \
            + _leading([s for s in front if UNKNOWN in s.key], BEAM_OF_NAMELESS)
        grown = []
        for found in front:
            for member in screen.by_effect(found.members, partial(_may_join, screen, found)).values():
                larger = EffectSet((*found.members, member), found.log_bayes + member.log_bayes)
                again = member.effect in found.names
                in_reach = larger.log_bayes > alone
                if again and (member.log_bayes < least_growth(found)
                              or any(m.candidate == member.candidate for m in found.members)):
                    continue
                if not again and member.log_bayes > GAIN and not _supported(screen, found, member):
                    member = replace(member, log_bayes=0.0)
                if not again and not _enough(screen, found, larger):
                    # Too weak to be claimed beside the others: a thought, not a way on.
                    member = replace(member, log_bayes=min(member.log_bayes, 0.0))
                    larger = EffectSet((*found.members, member), found.log_bayes + member.log_bayes)
                if in_reach and len(larger.members) == 2 and not again and UNKNOWN not in larger.key:
                    larger = _recomposed(screen, larger)
                if larger.names not in sets or sets[larger.names].log_bayes < larger.log_bayes:
                    sets[larger.names] = larger
                    if larger.log_bayes > found.log_bayes + GAIN:
                        grown.append(larger)
        front = grown
    # One set of names counts once, in its best composition.
    best: dict[frozenset, EffectSet] = {}
    for found in sets.values():
        if found.key not in best or best[found.key].log_bayes < found.log_bayes:
            best[found.key] = found
    found = _held_to_names(screen, _each_earned(screen, best))
    return sorted(found, key=lambda s: -(s.log_bayes + log_prior(s, len(first))))


def _recomposed(screen: Screen, pair: EffectSet) -> EffectSet:
    """The pair in other forms, where these together explain it better.

    The form that suits the first effect alone may be a rich one that explains part of the second as well:
    beside the second a leaner one may do.  So the first's form is chosen anew beside that of the second.
    """
    first, second = pair.members
    kept = screen.as_first(second)
    other = screen.by_effect((kept,), lambda effect: effect == first.effect).get(first.effect)
    if other is None:
        return pair
    found = EffectSet((kept, other), kept.log_bayes + other.log_bayes)
    better = found.log_bayes > pair.log_bayes and _supported(screen, EffectSet((kept,), kept.log_bayes), other)
    return found if better else pair


def _each_earned(screen: Screen, best: Mapping[frozenset, EffectSet]) -> list[EffectSet]:
    """The sets; none is better than one without an effect that brings less to it than a further effect must,
    in whichever order they were found."""
    result: dict[frozenset, EffectSet] = {}
    for key in sorted(best, key=len):
        found = best[key]
        for name in key if len(key) > 1 else ():
            less = result.get(key - {name})
            if less is not None and not _enough(screen, less, found):
                found = replace(found, log_bayes=min(found.log_bayes, less.log_bayes))
        result[key] = found
    return list(result.values())


def _leading(sets: list[EffectSet], most: int) -> list[EffectSet]:
    sets = sorted(sets, key=lambda s: -s.log_bayes)[:most]
    return [s for s in sets if s.log_bayes > max(GAIN, sets[0].log_bayes - HOPELESS)]


def _held_to_names(screen: Screen, sets: list[EffectSet]) -> list[EffectSet]:
    """The sets, none with a nameless part better than a name that explains nearly as much.

    No form is quite right; where an effect is gross, what its form leaves is far above the noise and
    nameless patterns, which can take any shape, explain that too.  A name holds as long as it explains all
    but ``FORM_ERROR`` of what they do.  Lean patterns from physics may err as little as a name.
    """
    named = max((s for s in sets if s.members and UNKNOWN not in s.key), key=lambda s: s.log_bayes,
                default=None)
    if named is None:
        return sets
    most = _reach(screen, named) / (1.0 - FORM_ERROR)
    return [replace(s, log_bayes=named.log_bayes)
            if any(m.effect == UNKNOWN and m.doubt > BEYOND_DOUBT for m in s.members)
            and s.log_bayes > named.log_bayes and _reach(screen, s) < most else s
            for s in sets]


def _reach(screen: Screen, found: EffectSet) -> float:
    """What a set takes off zᵀz beyond what it would take off noise."""
    basis, data = screen.basis(found.members), screen.parity.data
    left = data - basis @ (basis.T @ data)
    return float(data @ data - left @ left) - float(np.sum(basis**2))


def _supported(screen: Screen, found: EffectSet, member: Member) -> bool:
    """Whether a further slow effect shows in the stops' means too.

    The slopes inside the dwells are seen to nanometres, far better than any course in time is known:
    what one drift's form leaves of them is not yet another drift.
    """
    candidate = screen.candidates[member.candidate]
    if candidate.form.inside is None or not np.any(candidate.form.columns):
        return True
    if candidate.effect in screen.in_dwells:
        return True
    return screen.stop_support(found.members, member.candidate) > STOP_SUPPORT


def least_growth(found: EffectSet, shared: float = 1.0) -> float:
    """Log evidence that one more effect must bring.

    No form fits reality to the last part: of what the set explains so far, a few percent may be left
    over by its own forms, and a further effect must bring more than that; ``shared``: the part of that in
    channels that speak for the further effect too.
    """
    return MEMBER_ALARM + min(MISFIT * shared * found.log_bayes, MISFIT_MOST)


def _enough(screen: Screen, less: EffectSet, more: EffectSet) -> bool:
    """Whether ``more`` brings enough beside ``less``, of which it has all names and another.

    What a form leaves over is a share of what it explains, in the channels where it explains it: a drift of
    the tool cannot leave a pattern of the spot.
    """
    growth = more.log_bayes - less.log_bayes
    if growth < least_growth(less) and (growth < MEMBER_ALARM or UNKNOWN in more.key or growth < least_growth(
            less, screen.shared(less.members, more.members))):
        return False
    if less.log_bayes < GROSS_EVIDENCE:
        return True
    # Of what a gross effect's form leaves any other takes some part, however large in log evidence; the
    # effect that made it takes most.
    freedom = sum(screen.parity.dof)
    explained, further = _reach(screen, less), _reach(screen, more)
    left = float(screen.parity.data @ screen.parity.data) - freedom - explained
    return left < 5.0 * np.sqrt(2.0 * freedom) or further - explained > TAKEN_OF_REST * left


def _may_join(screen: Screen, found: EffectSet, effect: str) -> bool:
    """Whether an effect may join a set, or add one more form to it: two time constants, a shape parameter
    between two values of the list.  What only repeats (a slip) may do so more often."""
    if UNKNOWN in found.names and effect != UNKNOWN:
        return False  # names are sought first: what has none is what they leave
    times = found.names.count(effect)
    if not times:
        return len(found.key) < LARGEST and len(found.members) <= MOST_FORMS
    return times < (MOST_REPEATS if effect in {*screen.repeatable, UNKNOWN} else FORMS_OF_ONE)


def log_prior(found: EffectSet, effects: int) -> float:
    """Logarithm of the prior probability of a set among ``effects`` possible ones."""
    number = len(found.key)
    doubt = next((m.doubt for m in found.members if m.effect == UNKNOWN), 0.0)
    ways = 1.0
    for i in range(number):
        ways *= (effects - i) / (i + 1)
    return float(np.log(PRIOR_NUMBER[number]) - np.log(max(ways, 1.0)) - doubt)


def probabilities(sets: Sequence[EffectSet], effects: int,
                  temper: float = 1.0) -> tuple[Mapping[str, float], float, list[float]]:
    """Probability of each effect, of nothing, and of each set.

    ``temper`` below 1 flattens: evidence counts only as far as forms are known to hold.
    """
    logs = np.array([temper * s.log_bayes + log_prior(s, effects) for s in sets])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    names: dict[str, float] = {}
    for found, weight in zip(sets, weights, strict=True):
        for name in found.key:
            names[name] = names.get(name, 0.0) + float(weight)
    nothing = float(sum(w for s, w in zip(sets, weights, strict=True) if not s.members))
    return names, nothing, [float(w) for w in weights]
