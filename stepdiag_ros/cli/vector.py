"""Three numbers of an option: a place or a direction in metres."""

import math

import numpy as np

from stepdiag_ros.errors import StepdiagError


def vector(text: str, option: str) -> np.ndarray:
    """The numbers (3,) [m] of ``X,Y,Z``; ``option`` is what the user gave them with."""
    try:
        numbers = [float(part) for part in text.split(',')]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise StepdiagError(f'{option} is {text!r}; give three numbers in metres, such as {option}=-0.5,0,0.3')
    return np.array(numbers)
