"""What a cell file says that its log is to carry on: air, material of scales and workpiece, uncertainty budget, what is
stated of the test."""

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.budget import Budget
from stepdiag_ros.model.statement import STATED, Statement, text_problem
from stepdiag_ros.model.surroundings import LIMITS, QUANTITIES, AirValues, Expansion
from stepdiag_ros.virtual.yamlreader import Reader

MATERIAL = ('scales', 'workpiece')
"""Keys of ``material``."""
EXPANSION = {'expansion': (0.0, 1e-3, '1/K'), 'sigma': (0.0, 1e-3, '1/K'),
             'temperature': (*LIMITS['temperature'], '°C'), 'temperature_sigma': (0.0, 100.0, 'K')}
"""Keys of a material with least, greatest value and unit."""
BELIEVED = ('sigma', 'co2', 'wavelength')
"""Keys of ``air`` that go into the log."""


def believed_air(node: Reader | None) -> AirValues | None:
    """Air as the log will state it: temperature, pressure and humidity only where ``sigma`` says how well they are
    known; a virtual cell's weather alone is no knowledge."""
    if node is None or node.is_null:
        return None
    keys = node.mapping()
    said = {key: keys[key].number(minimum=LIMITS[key][0], maximum=LIMITS[key][1])
            for key in ('co2', 'wavelength') if key in keys}
    if 'sigma' in keys:
        sigma = {key: child.number(minimum=0.0) for key, child in keys['sigma'].mapping(QUANTITIES).items()}
        said |= {key: keys[key].number() for key in sigma if key in keys} | {'sigma': sigma}
    return AirValues(**said) if said else None


def scales(node: Reader | None) -> dict[str, Expansion]:
    """``material.scales`` by axis letter."""
    if node is None or node.is_null:
        return {}
    keys, found = node.mapping(MATERIAL), {}
    for axis, child in keys['scales'].mapping(('x', 'y', 'z')).items() if 'scales' in keys else ():
        found[axis] = _expansion(child)
    return found


def workpiece(node: Reader | None) -> Expansion | None:
    """``material.workpiece``; None where it is not given."""
    keys = {} if node is None or node.is_null else node.mapping(MATERIAL)
    return _expansion(keys['workpiece']) if 'workpiece' in keys else None


def _expansion(node: Reader) -> Expansion:
    own = node.mapping(tuple(EXPANSION))
    if 'expansion' not in own:
        raise node.fail("the key 'expansion' is missing; give the coefficient [1/K], e.g. 1.15e-5")
    return Expansion(**{key: value.number(minimum=EXPANSION[key][0], maximum=EXPANSION[key][1], unit=EXPANSION[key][2])
                        for key, value in own.items()})


def budget(node: Reader | None) -> Budget | None:
    """``budget``: the cell's own contributors, a list as in a budget file."""
    if node is None or node.is_null:
        return None
    entries = node.items()
    if not entries:
        raise node.fail('is empty; list contributors or leave it away')

    def wrong(number: int, key: str, text: str) -> StepdiagError:
        entry = entries[number]
        own = entry.mapping() if key != 'contributors' else {}
        return own.get(key, entry).fail(text if key in own else f'{key}: {text}')
    return Budget.from_list([entry.plain() for entry in entries], wrong, node.source)


def stated(node: Reader | None, feed: float) -> Statement:
    """``test``: what the cell's owner states of the test, and the ``feed`` [m/s] at which the cell moves."""
    if node is None or node.is_null:
        return Statement(feed=feed)
    # A log's description has the feed here; in a cell file the motion tells it.
    said = {key: child.text() for key, child in node.mapping((*STATED, 'feed')).items() if key != 'feed'}
    for key, text in said.items():
        if wrong := text_problem(text):
            raise node.mapping()[key].fail(wrong)
    return Statement(said, feed)
