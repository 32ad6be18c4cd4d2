"""The effects that the rigid-body model leaves out, one file each, and how to find them by name.

A file of the user's own holds a subclass of :class:`~stepdiag_ros.effects.base.Effect` with a name of its
own and may stand anywhere; :func:`effect_in_file` loads it, and it takes part like the others.
"""

import importlib
import importlib.util
from collections.abc import Iterable
from types import ModuleType

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.boundary import checked
from stepdiag_ros.errors import StepdiagError

VOCABULARY = (
    'air_refraction_drift', 'cyclic_nonlinearity', 'count_slip', 'beam_pointing_drift',
    'mirror_curvature', 'mirror_mount_creep', 'psd_zero_offset', 'psd_gain', 'psd_nonlinearity',
    'psd_rotation', 'ambient_light', 'scale_thermal_expansion', 'structural_thermal_drift', 'backlash',
    'servo_settling', 'non_rigid_coupling', 'squareness_drift', 'vibration', 'clock_skew')
"""Names of the wire contract, in its order."""
_OWN: dict[str, type[Effect]] = {}
"""Effects of the user's own by name, as last read from their files: what is reported of them is in the class."""


def effect_class(name: str) -> type[Effect]:
    """The effect of a name of the vocabulary; :class:`~stepdiag_ros.errors.StepdiagError` for another."""
    if name not in VOCABULARY:
        raise StepdiagError(f'{name!r}: there is no effect of this name; names are {", ".join(VOCABULARY)}, '
                            'or give the file of one of your own')
    return _in_module(importlib.import_module(f'stepdiag_ros.effects.{name}'))[0]


def short_title(name: str) -> str:
    """A few words for people for the effect of this name: what its class says, else the name itself."""
    kind = effect_class(name) if name in VOCABULARY else _OWN.get(name)
    return kind.short if kind is not None and kind.short else name.replace('_', ' ').capitalize()


def effects_in_file(path: str) -> list[type[Effect]]:
    """The effects that a Python file of the user's own defines.

    Raises :class:`~stepdiag_ros.errors.StepdiagError` that says what is wrong with the file.
    """
    name = f'stepdiag_effect_{abs(hash(str(path))):x}'
    spec = importlib.util.spec_from_file_location(name, str(path))
    if spec is None or spec.loader is None:
        raise StepdiagError(f'{path}: is no Python file; give the .py file that holds the effect')
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except FileNotFoundError:
        raise StepdiagError(f'{path}: does not exist; give the .py file that holds the effect') from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:     # sys.exit() in the file would end the command as if all had been done
        raise StepdiagError(f'{path}: cannot be run: {type(error).__name__}: {error}') from None
    found = _in_module(module)
    if not found:
        raise StepdiagError(f'{path}: holds no effect; define a subclass of stepdiag_ros.effects.base.Effect '
                            'with a name')
    for kind in found:
        if not isinstance(kind.name, str) or not kind.name.isidentifier():
            raise StepdiagError(f'{path}: {kind.__name__}.name is {kind.name!r}; '
                                'give it a name of letters, digits and underscores')
        if kind.name in VOCABULARY:
            raise StepdiagError(f'{path}: {kind.name} is a name of the vocabulary; give your effect its own')
        kind.file = spec.origin
        _OWN[kind.name] = checked(kind, spec.origin)
    return found


def all_effects(extra_paths: Iterable[str] = ()) -> dict[str, type[Effect]]:
    """Every effect by name: the vocabulary in its order, then those of the files given."""
    found = {name: effect_class(name) for name in VOCABULARY}
    for path in extra_paths:
        for kind in effects_in_file(path):
            if kind.name in found:
                raise StepdiagError(f'{path}: there is an effect named {kind.name} already; '
                                    'give each its own name')
            found[kind.name] = kind
    return found


def _in_module(module: ModuleType) -> list[type[Effect]]:
    return [value for value in vars(module).values()
            if isinstance(value, type) and issubclass(value, Effect) and value.name is not Effect.name
            and value.__module__ == module.__name__]
