"""``prediction.json``: what tables were made for and what they are predicted to do, to check a measurement against."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepdiag_ros.compensate.approach import Reversal
from stepdiag_ros.compensate.compensation import Compensation, K
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.prediction import Prediction
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors

NAME = 'prediction.json'
SCHEMA = 1


def document(found: Compensation, log: str) -> dict[str, Any]:
    """The whole answer for programs; ``log``: name of the log that it follows from."""
    machine, solution = found.place.machine, found.solution
    errors: dict[str, Any] = {}
    for name, curve in found.predicted.curves.items():
        _, _, sigma = solution.curve(name)
        errors[name] = {'position_m': _list(curve.position), 'value': _list(curve.value), 'sigma': _list(sigma)}
    for name in SQUARENESS:
        if solution.has(name):
            errors[name] = {'value': float(found.predicted.square[name]), 'sigma': solution.squareness(name)[1]}
    return {
        'schema': SCHEMA, 'format': found.control.name, 'log': log, 'machine': machine.name, 'k': K,
        'written': not found.refusals, 'refused': list(found.refusals),
        'origin_m': _list(found.place.origin), 'tool_m': _list(found.point.tool),
        'line_m': _list(found.point.line), 'whole_volume': found.whole_volume,
        'before': _volumetric(found, found.before), 'after': _volumetric(found, found.after),
        'after_as_measured': _volumetric(found, found.as_measured),
        'line_alone': _volumetric(found, found.line_alone) if found.line_alone else None,
        'not_carried_m': {name: value for name, value in found.not_carried.items() if value > 1e-9},
        'not_carried_U_m': {name: found.not_carried_spread[name] for name, value in found.not_carried.items()
                            if value > 1e-9},
        'left_out': list(found.left_out), 'not_measured': list(found.unmeasured),
        'reversal_m': {axis: {'value': value, 'U': spread} for axis, (value, spread) in found.reversal.items()},
        'reversal_left_m': {axis: {'value': value, 'U': spread}
                            for axis, (value, spread) in found.reversal_left.items()},
        'traceability': solution.traceability.to_json_dict() if solution.traceability else None,
        'signs_follow': found.control.source, 'open_question': found.control.open_question or None,
        'errors_after': errors,
        'files': {name: hashlib.sha256(text.encode()).hexdigest() for name, text in found.files.items()}}


def _volumetric(found: Compensation, prediction: Prediction) -> dict[str, Any]:
    size, spread, place = found.worst(prediction)
    return {'largest_m': size, 'U_m': spread, 'coverage': 0.95, 'at_m': _list(place),
            'mean_m': float(np.mean(prediction.size_m)), 'places': len(prediction.points)}


def _list(values: np.ndarray) -> list[float]:
    return [float(v) for v in values]


@dataclass(frozen=True)
class Predicted:
    """What is read back of a ``prediction.json``: the errors after, their σ, and the volumetric figure with its U; the
    volume's place (3,) [m]; by name the check sums of the tables; lost motion that they leave."""

    control: str
    tool: np.ndarray
    errors: GeometricErrors
    sigma: Mapping[str, np.ndarray]
    largest_m: float
    spread_m: float
    whole_volume: bool
    origin: np.ndarray
    files: Mapping[str, str]
    reversal: Reversal


def predicted_of(text: str, source: str) -> Predicted:
    """The prediction in ``text``; :class:`StepdiagError` names ``source`` and what is missing."""
    try:
        data = json.loads(text)
        if data['schema'] != SCHEMA:
            raise StepdiagError(f'{source}: schema is {data["schema"]!r}; this version reads {SCHEMA}')
        if not data['written']:
            raise StepdiagError(f'{source}: no tables were written then; nothing was predicted')
        listed = data['errors_after']
        curves = {n: Curve(np.array(listed[n]['position_m'], float), np.array(listed[n]['value'], float))
                  for n in CURVES if n in listed}
        square = {n: float(listed[n]['value']) for n in SQUARENESS if n in listed}
        sigma = {n: np.atleast_1d(np.array(listed[n]['sigma'], float)) for n in listed}
        tool, origin = np.array(data['tool_m'], float), np.array(data['origin_m'], float)
        files = {str(name): str(check) for name, check in data['files'].items()}
        reversal = {axis: (float(one['value']), float(one['U']))
                    for axis, one in data.get('reversal_left_m', {}).items()}
        numbers = [*(v for c in curves.values() for v in (c.position, c.value)), *sigma.values(), tool, origin,
                   np.array([*square.values(), *(v for one in reversal.values() for v in one),
                             data['after_as_measured']['largest_m']], float)]
        lengths = [len(c.position) == len(c.value) == len(sigma[n]) > 0 and c.position.ndim == 1
                   for n, c in curves.items()]
        if not all(lengths) or tool.shape != (3,) or origin.shape != (3,) \
                or not all(np.all(np.isfinite(v)) for v in numbers):
            raise ValueError('a number is missing or not finite')
        return Predicted(str(data['format']), tool, GeometricErrors(curves, square), sigma,
                         float(data['after_as_measured']['largest_m']),
                         float(data['after_as_measured']['U_m']), bool(data['whole_volume']), origin, files,
                         reversal)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise StepdiagError(f'{source}: is not a {NAME} as `stepdiag compensate` writes it '
                            f'({type(error).__name__}: {str(error)[:60]})') from None
