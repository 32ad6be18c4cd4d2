"""Which effects act: evidence for sets of effects, and probabilities from it.

All forms of all effects are judged in one parity space (:mod:`inference.candidates`).  Sets grow by one effect at a
time from the best of those found (a beam search); the evidence for a set is that of its first member plus that of
each further one given those before, the largest over the orders.  A form's coefficients, once its effect is in the
set, are free: what is left is what nothing in the set can explain.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import (
    BEYOND_DOUBT,
    FORM_ERROR,
    GROSS_EVIDENCE,
    MEMBER_ALARM,
    MISFIT,
    MISFIT_MOST,
    STOP_SUPPORT,
    TAKEN_OF_REST,
)
from stepdiag_ros.gap.inference.candidates import Member, Screen

NOTHING = 'nothing'
"""What it is called that no effect acts."""
BEAM = 4
BEAM_OF_NAMELESS = 2
LARGEST = 3
PRIOR_NUMBER = (0.5, 0.32, 0.14, 0.04)
"""Prior probability that none, one, two, three effects act."""
FORMS_OF_ONE = 3
MOST_REPEATS = 4
MOST_FORMS = 6
"""Most forms of one effect, of one that repeats, and of a set."""
LEAN_COLUMNS = 6
"""Columns up to which nameless patterns take no shape that they like: three jumps of a mirror about two axes."""
HOPELESS = 60.0
"""Sets this far behind in log evidence, and by more than what forms may err (``FORM_ERROR``), are not carried on."""
GAIN = 3.0
"""Least growth of log evidence for which a set is carried on with a further member."""


@dataclass(frozen=True)
class EffectSet:
    """A set of effects with ``log_bayes`` against nothing."""

    members: tuple[Member, ...]
    log_bayes: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names in rising order, one for each form."""
        return tuple(sorted(m.effect for m in self.members))

    @property
    def key(self) -> frozenset:
        return frozenset(m.effect for m in self.members)


def search(screen: Screen) -> list[EffectSet]:
    """Sets of effects worth a thought, best first; the empty set is among them."""
    first = screen.by_effect()
    sets: dict[tuple, EffectSet] = {(): EffectSet((), 0.0)}
    front = []
    for member in first.values():
        found = EffectSet((member,), member.log_bayes)
        sets[found.names] = found
        front.append(found)
        for again in _repeated(screen, found):
            sets[again.names] = again
            front.append(again)
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
                if again and not _adds_a_form(found, member):
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
    found = _held_to_names(screen, _each_earned(screen, _best_compositions(sets.values())))
    return sorted(found, key=lambda s: -(s.log_bayes + log_prior(s, len(first))))


def _repeated(screen: Screen, found: EffectSet) -> Iterator[EffectSet]:
    """An effect twice and more often: one that repeats, or one of gross evidence in further forms of its own.

    What repeats explains one run each time: by the first alone it may look hopeless beside a rich form that explains
    a part of all.  And of an effect of gross evidence one form leaves so much that any other effect in its place looks
    better than it alone: it is carried on with all its forms, or it would be laid aside before it has them.
    """
    effect = found.members[0].effect
    if effect == UNKNOWN or found.log_bayes < (MEMBER_ALARM if effect in screen.repeatable else GROSS_EVIDENCE):
        return
    while _may_join(screen, found, effect):
        member = screen.by_effect(found.members, lambda other: other == effect).get(effect)
        if member is None or not _adds_a_form(found, member):
            return
        found = EffectSet((*found.members, member), found.log_bayes + member.log_bayes)
        yield found


def _adds_a_form(found: EffectSet, member: Member) -> bool:
    """Whether one more form of an effect of the set brings enough, and is not one that it has."""
    return member.log_bayes >= least_growth(found) and all(m.candidate != member.candidate for m in found.members)


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
        whole = best[key]
        fewer = [result[key - {name}] for name in key if len(key) > 1 and key - {name} in result]
        least = min((less.log_bayes for less in fewer if not _enough(screen, less, whole)), default=whole.log_bayes)
        result[key] = replace(whole, log_bayes=min(whole.log_bayes, least))
    return list(result.values())


def _best_compositions(sets: Iterable[EffectSet]) -> dict[frozenset, EffectSet]:
    """One set of names counts once, in its best composition."""
    best: dict[frozenset, EffectSet] = {}
    for found in sets:
        if found.key not in best or best[found.key].log_bayes < found.log_bayes:
            best[found.key] = found
    return best


def _leading(sets: list[EffectSet], most: int) -> list[EffectSet]:
    """The best sets, each set of names once: the further forms of one must not crowd out others."""
    leading = sorted(_best_compositions(sets).values(), key=lambda s: -s.log_bayes)[:most]
    behind = max(HOPELESS, FORM_ERROR * leading[0].log_bayes) if leading else 0.0
    return [s for s in leading if s.log_bayes > max(GAIN, leading[0].log_bayes - behind)]


def _held_to_names(screen: Screen, sets: list[EffectSet]) -> list[EffectSet]:
    """The sets, none with a nameless part better than a name that explains nearly as much.

    No form is quite right; where an effect is gross, what its form leaves is far above the noise and
    nameless patterns, which can take any shape, explain that too.  A name holds as long as it explains all
    but ``FORM_ERROR`` of what they do.  Lean patterns from physics may err as little as a name, and nameless ones
    with few columns, and fewer than the name's forms, explain no more by taking any shape: a jump is no drift.
    """
    named = max((s for s in sets if s.members and UNKNOWN not in s.key), key=lambda s: s.log_bayes,
                default=None)
    if named is None:
        return sets
    most = _reach(screen, named) / (1.0 - FORM_ERROR)
    return [replace(s, log_bayes=named.log_bayes)
            if any(m.effect == UNKNOWN and m.doubt > BEYOND_DOUBT for m in s.members)
            and s.log_bayes > named.log_bayes and _reach(screen, s) < most
            and not _leaner(screen, s, named) else s
            for s in sets]


def _leaner(screen: Screen, found: EffectSet, named: EffectSet) -> bool:
    """Whether a set without names has few columns, and fewer than a named one."""
    columns = _columns(screen, found)
    return found.key == {UNKNOWN} and columns <= LEAN_COLUMNS and columns < _columns(screen, named)


def _columns(screen: Screen, found: EffectSet) -> int:
    return sum(len(screen.candidates[m.candidate].form.columns) for m in found.members)


def _reach(screen: Screen, found: EffectSet) -> float:
    """What a set takes off zᵀz beyond what it would take off noise."""
    basis, data = screen.basis(found.members), screen.parity.data
    left = data - (basis @ (basis.T @ screen.data))[:len(data)]
    return float(data @ data - left @ left) - float(np.sum(basis[:len(data)]**2))


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
    explained = _reach(screen, less)
    taken = _reach(screen, more) - explained
    if taken <= growth < MISFIT * less.log_bayes:
        # A cause explains; what is better only by leaner forms must be so by more than a form may leave over.
        return False
    left = float(screen.parity.data @ screen.parity.data) - freedom - explained
    return left < 5.0 * np.sqrt(2.0 * freedom) or taken > TAKEN_OF_REST * left


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
