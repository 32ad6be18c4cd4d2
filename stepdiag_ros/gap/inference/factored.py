"""Forms that are functions of time times a signature, weighed without being written out.

What drifts does p functions of time f times m signatures s: p·m columns x = f(n)·s(n, c), and inside the dwells, at the
rates f′, f′(n)·s(n, c)·τ(n, b).  Directions d of parity space are brought back to the readings, stops d̄(n, c) = L⁻ᵀd
and dwells d̃(n, c) = Σ τ·w·d with the contrasts' weights w; then

    dᵀx = Σₙ f(n) · Σ_c s(n, c) d̄(n, c) + f′(n) · Σ_c s(n, c) d̃(n, c),

so that nothing is kept but the factors, which the forms hold in any case, and the functions of one signature share a
product.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from stepdiag_ros.effects.base import Form
from stepdiag_ros.effects.made import Product
from stepdiag_ros.gap.inference.parity import Parity

AT_A_TIME = 1_000_000
"""Numbers that are written out at a time."""


def is_factored(form: Form) -> bool:
    """Whether a form is nothing but functions times a signature."""
    return form.by_reading is None and isinstance(form.columns, Product) \
        and (form.inside is None or isinstance(form.inside, Product))


@dataclass(frozen=True)
class Back:
    """Directions brought back to the readings: of the ``stops`` (n, c, r), and inside the dwells, by course, of the
    ``dwells`` (n, c, r)."""

    stops: np.ndarray
    dwells: Mapping[int, np.ndarray]


class Factored:
    """Factored ``forms`` by the number of the first of their columns among all."""

    def __init__(self, space: Parity, forms: Mapping[int, Form]):
        self._space, self._forms = space, dict(forms)
        self._groups: dict[tuple, list[int]] = {}
        self._courses: dict[int, sparse.csr_array] = {}
        for place, form in self._forms.items():
            self._groups.setdefault((_where(form.columns.signature), _course(form)), []).append(place)
            if form.inside is not None and _course(form) not in self._courses:
                self._courses[_course(form)] = space.dwells_by(form.inside.course)

    def and_then(self, other: 'Factored', width: int) -> 'Factored':
        """With those of ``other`` behind ``width`` columns."""
        return Factored(self._space, self._forms | {place + width: form for place, form in other._forms.items()})

    def within(self, wanted: slice) -> dict[int, Form]:
        """The forms by place that have columns among the ``wanted`` ones."""
        return {place: form for place, form in self._forms.items()
                if place < wanted.stop and place + len(form.columns) > wanted.start}

    def back(self, directions: np.ndarray) -> Back:
        """Directions (M, r), of the stops and perhaps of the contrasts below them, brought back to the readings."""
        space, below = self._space, len(directions) > self._space.stops
        stops = space.stops_back(directions[:space.stops])
        return Back(stops, {key: (sums @ directions[space.stops:space.size]).reshape(stops.shape)
                            for key, sums in self._courses.items()} if below else {})

    def times(self, back: Back, places: Iterable[int]) -> Iterator[tuple[int, np.ndarray]]:
        """Products (k, r) of the columns of some forms with directions, and where the first of these is."""
        wanted = set(places)
        for (_, course), members in self._groups.items():
            mine = [place for place in members if place in wanted]
            if mine:
                yield from self._of_one_signature(back.stops, back.dwells.get(course), mine)

    def _of_one_signature(self, stops: np.ndarray, dwells: np.ndarray | None,
                          places: Sequence[int]) -> Iterator[tuple[int, np.ndarray]]:
        forms = [self._forms[place] for place in places]
        signature = forms[0].columns.signature
        functions = np.concatenate([form.columns.functions for form in forms])
        if dwells is not None:
            functions = np.concatenate([functions, np.concatenate([form.inside.functions for form in forms])], axis=1)
        size, (m, n, _) = stops.shape[2], signature.shape
        product, by_stop = np.empty((len(functions), m, size)), signature.transpose(1, 0, 2)
        some = max(AT_A_TIME // (2 * n * m), 1)
        for part in (slice(begin, begin + some) for begin in range(0, size, some)):
            seen = [by_stop @ one[:, :, part] for one in (stops, dwells) if one is not None]
            seen = np.concatenate(seen).reshape(functions.shape[1], -1)
            product[:, :, part] = (functions @ seen).reshape(len(functions), m, -1)
        begin = 0
        for place, form in zip(places, forms, strict=True):
            end = begin + len(form.columns.functions)
            yield place, product[begin:end].reshape(len(form.columns), size) * form.scale[:, None]
            begin = end

    def grams_inside(self, place: int) -> np.ndarray | float:
        """Products (k, k) with each other of what a form's columns do inside the dwells."""
        form = self._forms[place]
        if form.inside is None:
            return 0.0
        product = form.inside
        root = np.sqrt(self._courses[_course(form)].power(2).sum(axis=1)).reshape(product.signature.shape[1:])
        columns = np.asarray(Product(product.functions, product.signature * root)).reshape(len(form.scale), -1)
        columns = columns * form.scale[:, None]
        return columns @ columns.T

    def put(self, part: slice, full: np.ndarray) -> None:
        """Write the columns of some forms, ``part`` of all, into ``full`` (M, k)."""
        space = self._space
        for place, form in self.within(part).items():
            at = slice(place - part.start, place - part.start + len(form.columns))
            full[:space.stops, at] = space.white_part(np.asarray(form.columns)) * form.scale
            if form.inside is not None:
                full[space.stops:space.size, at] = space.bin_part(np.asarray(form.inside)) * form.scale


def _where(array: np.ndarray) -> tuple:
    """By what it is known that two arrays are the same numbers in memory."""
    return array.__array_interface__['data'][0], array.shape, array.strides


def _course(form: Form) -> int:
    """The course inside the dwells that a form's columns share; 0 where nothing happens there."""
    return 0 if form.inside is None else _where(form.inside.course)[0]
