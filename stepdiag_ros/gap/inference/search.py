"""Which effects act: evidence for sets of effects, and probabilities from it.

All forms of all effects are judged in one parity space (:mod:`inference.candidates`).  Sets grow by one effect at a
time from the best of those found (a beam search); the evidence for a set is that of its first member plus that of
each further one given those before, the largest over the orders.  A form's coefficients, once its effect is in the
set, are free: what is left is what nothing in the set can explain.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import (
    ALARM,
    IMITATION_PENALTY,
    LARGE_EVIDENCE,
    MEMBER_ALARM,
)
from stepdiag_ros.gap.inference.candidates import BEYOND, Member, Screen

NOTHING = 'nothing'
"""What it is called that no effect acts."""
BEAM = 4
BEAM_OF_UNMODELLED = 2
LARGEST = 3
PRIOR_NUMBER = (0.5, 0.32, 0.14, 0.04)
"""Prior probability that none, one, two, three effects act."""
FORMS_OF_ONE = 3
MOST_REPEATS = 4
MOST_FORMS = 6
"""Most forms of one effect, of one that repeats, and of a set."""
HOPELESS = 60.0
"""Sets this far behind the best of no more forms in log evidence, and by more than ``BEHIND`` of it, go no further."""
BEHIND = 0.1
BEYOND_REACH = 30.0
"""Sets this far behind the best whose discrepancies are in place have no part in the answer, wherever theirs are."""
EVEN = 0.5
"""Log odds up to which two sets are about as likely."""
GAIN = 3.0
"""Least growth of log evidence for which a set is carried on with a further member."""


@dataclass(frozen=True)
class EffectSet:
    """A set of effects with ``log_bayes`` against nothing; ``refused``: why it may not be claimed, '' if it may."""

    members: tuple[Member, ...]
    log_bayes: float
    refused: str = ''

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in rising order, one for each form."""
        return tuple(sorted(m.effect for m in self.members))

    @cached_property
    def key(self) -> frozenset:
        return frozenset(m.effect for m in self.members)

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Causes in rising order, one for each form."""
        return tuple(sorted(m.cause for m in self.members))

    @property
    def shapeless(self) -> bool:
        """Whether a pattern that fits anything is among the members."""
        return UNKNOWN in self.causes

    @cached_property
    def penalty(self) -> float:
        """Log prior odds against what has no name among the members."""
        return max((m.penalty for m in self.members if m.effect == UNKNOWN), default=0.0)

    @property
    def claimed_from(self) -> float:
        """The log evidence from which it is claimed: the same odds for all, whatever their prior ones."""
        return ALARM + self.penalty


def joined(screen: Screen, found: EffectSet, member: Member) -> EffectSet:
    """``found`` and one member more, with the evidence that its form brings and, if that is worth a thought, the whole
    Jacobian correction and the discrepancy of it."""
    if member.log_bayes >= GAIN:
        member = screen.with_jacobian((*found.members, member))
        member = screen.with_discrepancy((*found.members, member))
    return EffectSet((*found.members, member), found.log_bayes + member.log_bayes, found.refused or member.refused)


def search(screen: Screen) -> list[EffectSet]:
    """Sets of effects worth a thought: those that may be claimed first, the likeliest first; the empty set is among
    them."""
    first = screen.by_cause()
    sets: dict[tuple, EffectSet] = {(): EffectSet((), 0.0)}
    front = []
    for member in first.values():
        found = joined(screen, sets[()], member)
        sets[found.causes] = found
        front.append(found)
        for again in _repeated(screen, found):
            sets[again.causes] = again
            front.append(again)
    alone = max((s.log_bayes for s in front if not s.shapeless), default=0.0)
    while front:
        # Unmodelled patterns, which fit anything, must not crowd out what competes as names do.
        front = _leading([s for s in front if not s.shapeless], BEAM) \
            + _leading([s for s in front if s.shapeless], BEAM_OF_UNMODELLED)
        grown = []
        for found in front:
            for member in screen.by_cause(found.members, partial(_may_join, screen, found)).values():
                again = member.cause in found.causes
                if again and not _adds_a_form(found, member):
                    continue
                larger = joined(screen, found, member)
                if larger.log_bayes > alone and len(larger.members) == 2 and not again and not larger.shapeless:
                    larger = _recomposed(screen, larger)
                if larger.causes not in sets or sets[larger.causes].log_bayes < larger.log_bayes:
                    sets[larger.causes] = larger
                    if larger.log_bayes > found.log_bayes + GAIN:
                        grown.append(larger)
        front = grown
    found = _each_earned(_best_compositions(_with_imitations(screen, _in_place(screen, sets.values()))))
    found = list(_best_compositions([*found, *_as_one_cause(screen, found)]).values())
    return ranked(found, len({m.effect for m in first.values()}))


def ranked(sets: Iterable[EffectSet], among: int) -> list[EffectSet]:
    """Sets that may be claimed first, the likeliest of ``among`` effects first; of two about as likely
    that with names."""
    def likely(found: EffectSet) -> float:
        return found.log_bayes + log_prior(found, among) + (EVEN if found.key - {UNKNOWN} else 0.0)
    return sorted(sets, key=lambda found: (bool(found.refused), -likely(found)))


def _in_place(screen: Screen, sets: Iterable[EffectSet]) -> Iterator[EffectSet]:
    """The sets, of those worth it each form's discrepancy at what the form does beside all the others.

    A last member that brings too little to be worth a thought leaves the others where they are without it.
    """
    best, placed = 0.0, {}
    for found in sorted(sets, key=lambda s: -s.log_bayes):
        count = next((k for k in range(len(found.members), 0, -1) if found.members[k - 1].log_bayes >= GAIN), 0)
        mattering = found.members[:count]
        if count > 1 and found.log_bayes > best - BEYOND_REACH:
            if mattering not in placed:
                placed[mattering] = tuple(screen.in_place(mattering))
            members = placed[mattering]
            more = sum(m.log_bayes for m in members) - sum(m.log_bayes for m in mattering)
            found = replace(found, members=members + found.members[count:], log_bayes=found.log_bayes + more)
        best = max(best, found.log_bayes)
        yield found


def _with_imitations(screen: Screen, sets: Iterable[EffectSet]) -> Iterator[EffectSet]:
    """The sets, the sizes that physics allows of their effects weighed, and besides them those in which what has no
    name does what an effect does, of any size: alone, or where it does more besides, all of it."""
    sets = list(sets)
    within = max(found.log_bayes for found in sets) - HOPELESS
    for found in sets:
        known = [screen.effects.get(m.effect) for m in found.members]
        restricted = [k for k, effect in enumerate(known) if effect is not None and effect.imitated_by]
        if not restricted or found.log_bayes < within:
            yield found
            continue
        evidence = sum(known[k].size_evidence(screen.candidates[found.members[k].candidate].form,
                                              *screen.with_sigmas(found.members, k)) for k in restricted)
        yield replace(found, log_bayes=found.log_bayes + evidence)
        # As forms of one cause each of them must bring what a further form must.
        if UNKNOWN not in found.key or all(m.log_bayes >= MEMBER_ALARM for m in found.members):
            yield _imitating(found, {found.members[k].effect for k in restricted}, IMITATION_PENALTY)


def _as_one_cause(screen: Screen, sets: Iterable[EffectSet]) -> Iterator[EffectSet]:
    """Sets of names beside a pattern without a name as one cause that has no name and does all of it: what none of the
    forms describes may need those of several, and then a name is one of them by chance."""
    for found in sets:
        names = found.key - {UNKNOWN}
        if names and not found.refused and any(m.effect == UNKNOWN and not screen.candidates[m.candidate].form.
                                               of_one_arrival for m in found.members):
            yield _imitating(found, names, found.penalty + IMITATION_PENALTY * len(names))


def _imitating(found: EffectSet, names: Collection[str], penalty: float) -> EffectSet:
    """The set with what has no name in the place of some ``names``, at log prior odds ``penalty`` against it."""
    return replace(found, members=tuple(replace(m, effect=UNKNOWN, penalty=penalty) if m.effect in names else m
                                        for m in found.members))


def _repeated(screen: Screen, found: EffectSet) -> Iterator[EffectSet]:
    """An effect twice and more often: one that repeats, or one of large evidence in further forms of its own.

    What repeats explains one run each time: by the first alone it may look hopeless beside a rich form that explains
    a part of all.  And of an effect of large evidence one form leaves so much that any other effect in its place looks
    better than it alone: it is carried on with all its forms, or it would be laid aside before it has them.
    """
    cause = found.members[0].cause
    if found.shapeless or found.log_bayes < (MEMBER_ALARM if cause in screen.repeatable else LARGE_EVIDENCE):
        return
    while _may_join(screen, found, cause):
        member = screen.by_cause(found.members, lambda other: other == cause).get(cause)
        if member is None or not _adds_a_form(found, member):
            return
        found = joined(screen, found, member)
        yield found


def _adds_a_form(found: EffectSet, member: Member) -> bool:
    """Whether one more form of an effect of the set brings enough, and is not one that it has."""
    return member.log_bayes >= MEMBER_ALARM and all(m.candidate != member.candidate for m in found.members)


def _recomposed(screen: Screen, pair: EffectSet) -> EffectSet:
    """The pair in other forms, where these together explain it better.

    The form that suits the first effect alone may be a rich one that explains part of the second as well:
    beside the second a leaner one may do.  So the first's form is chosen anew beside that of the second.
    """
    first, second = pair.members
    kept = joined(screen, EffectSet((), 0.0), screen.as_first(second))
    other = screen.by_cause(kept.members, lambda cause: cause == first.cause).get(first.cause)
    if other is None:
        return pair
    found = joined(screen, kept, other)
    return found if found.log_bayes > pair.log_bayes else pair


def _each_earned(best: Mapping[frozenset, EffectSet]) -> list[EffectSet]:
    """The sets; those are refused of which an effect brings less beside the others than a further effect must."""
    result = []
    for key, whole in best.items():
        reason = whole.refused
        for name in sorted(key):
            less = best.get(key - {name})
            if not reason and len(key) > 1 and less is not None and whole.log_bayes - less.log_bayes < MEMBER_ALARM:
                reason = (f'{name}: brings {whole.log_bayes - less.log_bayes:.1f} in log evidence beside '
                          f'{" and ".join(sorted(key - {name}))}; a further effect needs {MEMBER_ALARM:.0f}')
        result.append(replace(whole, refused=reason))
    return result


def _best_compositions(sets: Iterable[EffectSet],
                       key_of: Callable[[EffectSet], frozenset] = lambda s: s.key) -> dict[frozenset, EffectSet]:
    """One set of names, or what else is the ``key_of`` a set, counts once, in its best composition."""
    best: dict[frozenset, EffectSet] = {}
    for found in sets:
        key = key_of(found)
        if key not in best or best[key].log_bayes - best[key].penalty < found.log_bayes - found.penalty:
            best[key] = found
    return best


def _leading(sets: list[EffectSet], most: int) -> list[EffectSet]:
    """The best sets, each set of causes once: the further forms of one must not crowd out others.

    A set is held against those of no more forms than it has: three forms of a rich effect explain much of anything, and
    what a lean one explains would be laid aside before it has the company in which it explains all.
    """
    compositions = list(_best_compositions(sets, lambda s: frozenset(s.causes)).values())
    best = [max((s.log_bayes for s in compositions if len(s.members) <= count), default=0.0)
            for count in range(max((len(s.members) for s in compositions), default=0) + 1)]
    near = [(best[len(s.members)] - s.log_bayes, s) for s in compositions]
    near = [(short, s) for short, s in near
            if s.log_bayes > GAIN and short < max(HOPELESS, BEHIND * (s.log_bayes + short))]
    return [s for _, s in sorted(near, key=lambda pair: (pair[0], -pair[1].log_bayes))[:most]]


def _may_join(screen: Screen, found: EffectSet, cause: str) -> bool:
    """Whether a cause may join a set, or add one more form to it: two time constants, a shape parameter
    between two values of the list.  What only repeats (a slip) may do so more often."""
    if (UNKNOWN in found.key and cause not in (BEYOND, UNKNOWN)) or (found.shapeless and cause == BEYOND):
        return False  # names are sought first, lean patterns before shapeless ones: each is what those before leave
    times = found.causes.count(cause)
    if not times:
        return len(set(found.causes)) < LARGEST and len(found.members) <= MOST_FORMS
    return times < (MOST_REPEATS if cause in {*screen.repeatable, UNKNOWN} else FORMS_OF_ONE)


def log_prior(found: EffectSet, effects: int) -> float:
    """Logarithm of the prior probability of a set among ``effects`` possible ones."""
    number = len(found.key)
    ways = 1.0
    for i in range(number):
        ways *= (effects - i) / (i + 1)
    return float(np.log(PRIOR_NUMBER[number]) - np.log(max(ways, 1.0)) - found.penalty)


def probabilities(sets: Sequence[EffectSet], effects: int) -> tuple[Mapping[str, float], float, list[float]]:
    """Probability of each effect, of nothing, and of each set; sets that may not be claimed have none."""
    logs = np.array([s.log_bayes + log_prior(s, effects) for s in sets])
    logs[[bool(s.refused) for s in sets]] = -np.inf
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    names: dict[str, float] = {}
    for found, weight in zip(sets, weights, strict=True):
        for name in found.key:
            names[name] = names.get(name, 0.0) + float(weight)
    nothing = float(sum(w for s, w in zip(sets, weights, strict=True) if not s.members))
    return names, nothing, [float(w) for w in weights]
