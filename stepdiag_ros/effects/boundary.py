"""Where an effect of the user's own enters: what its methods give is checked once, here, and nowhere else.

A wrong shape or a NaN would surface far from where it was written, as a message of NumPy or as a verdict.  So the class
is taken in with its methods wrapped: each either gives what :mod:`~stepdiag_ros.effects.base` promises or raises a
:class:`~stepdiag_ros.errors.StepdiagError` of one line with file, class and method, what came, and what is wanted.
"""

import functools
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.made import Made
from stepdiag_ros.errors import StepdiagError

CHANGED = ('position', 'shift', 'turn', 'laser', 'mirror', 'index', 'divided', 'length', 'spot', 'intensity', 'quality')
"""What of a :class:`~stepdiag_ros.effects.base.Moment` an effect may change."""
ACTING = ('before_pose', 'before_light', 'after_light')


def checked(kind: type[Effect], path: str) -> type[Effect]:
    """``kind``, found in ``path``, with its attributes checked and its methods wrapped."""
    for text in ('title', 'short', 'remedy'):
        if not isinstance(getattr(kind, text), str):
            raise StepdiagError(f'{path}: {kind.__name__}.{text} is {getattr(kind, text)!r}; give a text')
    if not isinstance(kind.parameters, tuple | list):
        raise StepdiagError(f'{path}: {kind.__name__}.parameters is {kind.parameters!r}; give a tuple of '
                            'Parameter(name, unit, low, high)')
    for p in kind.parameters:
        if not isinstance(p, Parameter) or not _is_sound(p):
            raise StepdiagError(f'{path}: {kind.__name__}.parameters holds {p!r}; give '
                                'Parameter(name, unit, low, high, size) with finite low <= high and a size above 0')
    for method in ACTING:
        _wrap(kind, path, method, _acting)
    _wrap(kind, path, 'appearance', _appearing)
    _wrap(kind, path, 'negative_controls', _appearing)
    _wrap(kind, path, 'clock_offset', _offset)
    _wrap(kind, path, 'environment', _environment)
    _wrap(kind, path, 'guess', _guessing)
    return kind


def _is_sound(p: Parameter) -> bool:
    return isinstance(p.name, str) and isinstance(p.size, int) and p.size > 0 \
        and all(isinstance(v, int | float) and np.isfinite(v) for v in (p.low, p.high)) and p.low <= p.high


def _wrap(kind: type[Effect], path: str, method: str, guard: Callable) -> None:
    inner, where = getattr(kind, method), f'{path}: {kind.__name__}.{method}'

    @functools.wraps(inner)
    def outer(self: Effect, given: object) -> object:
        return guard(where, lambda: _run(where, path, inner, self, given), given)
    setattr(kind, method, outer)


def _run(where: str, path: str, function: Callable, *given: object) -> object:
    """What the user's function gives; its exceptions in one line, with the line of the file."""
    try:
        return function(*given)
    except (StepdiagError, MemoryError, KeyboardInterrupt):
        raise
    except BaseException as error:     # sys.exit() would end the command as if all had been done
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
        at = f' (line {lines[-1]})' if lines else ''
        raise StepdiagError(f'{where}{at}: {type(error).__name__}: {" ".join(str(error).split())}; correct this line, '
                            f'then `stepdiag effect check {path}`') from None


# ---- how it acts ------------------------------------------------------------------------------

def _acting(where: str, call: Callable, moment: Moment) -> None:
    before = {name: getattr(moment, name) for name in CHANGED}
    # Kept apart, for a method may write into the arrays themselves.
    before = {name: None if value is None else np.array(value) for name, value in before.items()}
    call()
    for name, old in before.items():
        new = getattr(moment, name)
        if old is None:
            if new is not None:
                raise StepdiagError(f'{where}: moment.{name} is set before there is one; change it in after_light')
            continue
        _array(where, f'moment.{name}', new, old.shape, 'keep its shape, e.g. with [:, None]', ~np.isfinite(old))


def _offset(where: str, call: Callable, sensor: str) -> float:
    value = call()
    if not isinstance(value, int | float | np.floating) or not np.isfinite(value):
        raise StepdiagError(f'{where}: gives {value!r} for {sensor!r}; return a finite number of seconds')
    return float(value)


def _environment(where: str, call: Callable, seconds: np.ndarray) -> Mapping[str, np.ndarray]:
    change = call()
    if not isinstance(change, Mapping):
        raise StepdiagError(f'{where}: gives {type(change).__name__}; return a dict of arrays (n,) by sensor')
    for name, value in change.items():
        _array(where, f'[{name!r}]', value, np.shape(seconds), 'return one number for each of the seconds')
    return change


# ---- how it appears ---------------------------------------------------------------------------

def _appearing(where: str, call: Callable, view: StopView) -> list[Form]:
    forms = call()
    if not isinstance(forms, list | tuple):
        raise StepdiagError(f'{where}: gives {type(forms).__name__}; return a list of Form, empty where the effect '
                            'cannot be seen')
    return [_form(where, form, view) for form in forms]


def _guessing(where: str, call: Callable, fitted: object) -> Mapping[str, object]:
    values = call()
    if not isinstance(values, Mapping) or not all(np.all(np.isfinite(np.asarray(v, float))) for v in values.values()
                                                  if not isinstance(v, str)):
        raise StepdiagError(f'{where}: gives {values!r}; return a dict of finite parameters by name, empty to leave '
                            'them to the fit')
    return values


def _form(where: str, form: object, view: StopView) -> Form:
    if not isinstance(form, Form):
        raise StepdiagError(f'{where}: its list holds a {type(form).__name__}; return Form objects')
    said = f'form {form.label!r}: '
    if not isinstance(form.label, str) or not form.label:
        raise StepdiagError(f'{where}: a form has the label {form.label!r}; say in words how the effect appears')
    named = isinstance(form.names, tuple | list) and form.names and all(isinstance(name, str) for name in form.names)
    if not named:
        raise StepdiagError(f'{where}: {said}names is {form.names!r}; give a tuple with one name for each '
                            'coefficient')
    count, (stops, channels) = len(form.names), view.reading.shape
    meaning = (f'{count} coefficient{"s" * (count > 1)} as in names, {stops} stops, {channels} channels (lengths, spot '
               'x, spot y)')
    _array(where, f'{said}columns', form.columns, (count, stops, channels), f'these are {meaning}')
    _array(where, f'{said}scale', form.scale, (count,), 'give a typical size for each name')
    if np.any(np.asarray(form.scale) <= 0.0):
        raise StepdiagError(f'{where}: {said}scale holds {np.min(form.scale):g}; give sizes above 0')
    if form.inside is not None:
        bins = view.bin_time.shape[1]
        _array(where, f'{said}inside', form.inside, (count, stops, bins, channels),
               f'these are {meaning.replace(" stops,", f" stops, {bins} bins,")}, or None')
    if form.by_reading is not None:
        _array(where, f'{said}by_reading', form.by_reading, (count, stops, channels), f'these are {meaning}, or None')
    if form.gain is not None:
        _array(where, f'{said}gain', form.gain, (count, channels), f'one row for each of {count} names, or None')
    beside = None if form.beside is None else _form(where, form.beside, view)
    retune = form.retune if form.retune is None else _tuned(where, form.retune, view)
    return replace(form, beside=beside, retune=retune)


def _tuned(where: str, retune: Callable, view: StopView) -> Callable[[Mapping[str, float]], Form]:
    """``retune`` with its form checked too."""
    return lambda shape: _form(where, _run(where, where.split(': ')[0], retune, shape), view)


def _array(where: str, what: str, value: object, shape: tuple[int, ...], do: str, spared: np.ndarray | bool = False
           ) -> None:
    """Raises where ``value`` has another shape or is not finite outside ``spared``."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        raise StepdiagError(f'{where}: {what} is {type(value).__name__}, no array of numbers; wanted is the shape '
                            f'{shape}: {do}') from None
    an_array = isinstance(value, np.ndarray | Made)
    if numbers.shape != shape or not an_array:
        got = numbers.shape if an_array else f'{type(value).__name__} of shape {numbers.shape}'
        raise StepdiagError(f'{where}: {what} is {got}, wanted is an array of shape {shape}; {do}')
    bad = ~(np.isfinite(numbers) | spared)
    if np.any(bad):
        place = tuple(int(k) for k in np.argwhere(bad)[0])
        raise StepdiagError(f'{where}: {what} is {numbers[place]} at {list(place)}, {int(bad.sum())} of {numbers.size} '
                            'numbers are not finite; what was not measured (NaN in view.reading, None) needs another '
                            'source, e.g. view.spot_model, or no form')
