"""The detector bends far from its centre.

A lateral-effect diode is linear in the middle and errs towards its edges: a barrel or pincushion that
grows with the cube of the spot, with the electrodes' shape mixed in.  Duo-lateral types bend each axis
on its own, tetra-lateral ones across.  Sizes are given at 1 mm from the centre.
"""

from collections.abc import Mapping
from itertools import combinations_with_replacement

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size

REFERENCE = 1e-3
"""Distance from the centre [m] at which coefficients are sizes in metres."""
SCALE = 3e-6


class PsdNonlinearity(Effect):
    name = 'psd_nonlinearity'
    short = 'Spot sensor bends far from its centre'
    title = 'The position sensor is not linear: it bends far from its centre.'
    parameters = (Parameter('k3', '1/m²', -3e4, 3e4, meaning='read is s (1 + k3 |s|²)'),
                  Parameter('cross', '1', -1.0, 1.0,
                            meaning='share of k3 by which x takes y² and y takes x² less'),
                  Parameter('apart', '1/m²', -3e4, 3e4, 4,
                            'besides, where x and y bend apart: x³ and x y² in x, y³ and y x² in y', detail=True))
    sources = ('Andersson 2008, Position sensitive detectors', 'Cui & Soh 2010, IEEE Trans. Electron Devices 57, 2310')
    remedy = ('Keep the spot near the centre by aligning better, use a duo-lateral detector, or calibrate '
              'it over its area.')
    signature = 'Grows with the third power of the spot, hardly there near the centre.'
    neighbours = ('psd_gain is a fixed share everywhere; mirror_curvature follows the strike on the mirror, '
                  'not the spot.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'k3': drawn_size(rng, 300.0, 3e4), 'cross': float(rng.choice([0.0, rng.uniform(-1, 1)]))}

    def after_light(self, moment: Moment) -> None:
        square = moment.spot ** 2
        weighed = square + (1.0 - self.cross) * square[:, ::-1]
        own_and_other = self.apart.reshape(2, 2)
        apart = own_and_other[:, 0] * square + own_and_other[:, 1] * square[:, ::-1]
        moment.spot = moment.spot * (1.0 + self.k3 * weighed + apart)

    def appearance(self, view: StopView) -> list[Form]:
        x, y = view.spot_model.T / REFERENCE
        square = x * x + y * y
        radial = [self._both(view, x * square, y * square)]
        fifth = [self._both(view, x * square**2, y * square**2)]
        own = [self._both(view, x**3, None), self._both(view, None, y**3)]
        own5 = [self._both(view, x**5, None), self._both(view, None, y**5)]
        across = [self._both(view, x * y * y, None), self._both(view, None, y * x * x)]
        across5 = [self._both(view, x * y**4, None), self._both(view, x**3 * y * y, None),
                   self._both(view, None, y * x**4), self._both(view, None, y**3 * x * x)]
        free, free_names = self._polynomial(view, x, y, (2, 3))
        names = ('x³', 'y³')
        crossed = (*names, 'x y²', 'y x²')
        return [self._form('radial cubic', radial, ('r³',)),
                self._form('radial cubic and quintic', radial + fifth, ('r³', 'r⁵')),
                self._form('cubic in each axis', own, names),
                self._form('cubic and quintic in each axis', own + own5, (*names, 'x⁵', 'y⁵')),
                self._form('cubic with cross terms', own + across, crossed),
                self._form('cubic and quintic with cross terms', own + across + own5 + across5,
                           (*crossed, 'x⁵', 'y⁵', 'x y⁴', 'x³y²', 'y x⁴', 'y³x²')),
                self._form('all of second and third degree', free, free_names)]

    @staticmethod
    def _form(label: str, columns: list[np.ndarray], names: tuple[str, ...]) -> Form:
        return Form(f'{label}, sizes at 1 mm', np.stack(columns), names, np.full(len(names), SCALE))

    @staticmethod
    def _both(view: StopView, x: np.ndarray | None, y: np.ndarray | None) -> np.ndarray:
        column = np.zeros(view.reading.shape)
        for k, value in enumerate((x, y)):
            if value is not None:
                column[:, view.beams + k] = value
        return column

    def _polynomial(self, view: StopView, x: np.ndarray, y: np.ndarray, degrees: tuple[int, ...]
                    ) -> tuple[list[np.ndarray], tuple[str, ...]]:
        columns, names = [], []
        for degree in degrees:
            for powers in combinations_with_replacement('xy', degree):
                value = x ** powers.count('x') * y ** powers.count('y')
                columns += [self._both(view, value, None), self._both(view, None, value)]
                names += [f'{"".join(powers)} in x', f'{"".join(powers)} in y']
        return columns, tuple(names)

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        view = fitted.view
        x, y = view.spot_model.T
        columns = view.zeros(2)
        columns[0, :, view.beams], columns[0, :, view.beams + 1] = x * (x * x + y * y), y * (x * x + y * y)
        columns[1, :, view.beams], columns[1, :, view.beams + 1] = -x * y * y, -y * x * x
        k3, crossed = fitted.solve(columns)[0]
        return {'k3': float(k3), 'cross': float(crossed / k3) if k3 else 0.0}
