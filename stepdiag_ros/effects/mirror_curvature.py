"""The mirror is not flat: distance and slope depend on where a beam strikes.

On the zig-zag of a diagonal the mirror wanders sideways through the beams by a step's length, so that
its height ``h(u, v)`` over its plane, positive towards the light, shortens the way by ``h`` and its
slope turns the returning beam: the spot moves by ``−2 L ∇h``.  The same mirror, in the same place on
the tool, shows the same shape in all setups; if it is taken off in between, each has its own.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, by_setup, drawn_size
from stepdiag_ros.model.mirror_form import quadratic_form

CURVATURE = 2e-4
"""Typical curvature [1/m]: a sag of 0.3 µm over 10 cm."""
REACH = 0.1
"""Radius [m] at which a cubic term is as large as a curvature of the same number."""


class MirrorCurvature(Effect):
    name = 'mirror_curvature'
    short = 'Mirror is not flat'
    title = 'The mirror is not flat.'
    parameters = (Parameter('radius', 'm', 500.0, 20000.0, meaning='of curvature; hollow: positive, 0: flat'),
                  Parameter('astigmatism', '1', -1.0, 1.0,
                            meaning='curvature along u more, along v less, as a share of 1/radius'),
                  Parameter('astigmatism_45', '1', -1.0, 1.0, meaning='the same along the diagonals of u and v',
                            detail=True),
                  Parameter('cubic', '1', -3.0, 3.0, 4,
                            'change of its curvatures within 0.1 m, as a share of 1/radius: uuu, uuv, uvv, vvv',
                            detail=True))
    sources = ('Dahlem et al. 2018, mirror flatness', 'Sphere and astigmatism: Born & Wolf, ch. 4')
    remedy = ('Use a flatter or smaller mirror, mount it free of strain, or measure its shape and enter it.')
    signature = 'A fixed shape over the strike point, in length as height and in the spot as slope.'
    neighbours = ('mirror_mount_creep is the same at all strike points and changes with time; '
                  'psd_nonlinearity follows the spot, not the strike; air in layers, warm above cold, bends the beam '
                  'as much as a curved mirror does: measure at another time of day.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'radius': drawn_size(rng, 700.0, 15000.0),
                'astigmatism': float(rng.choice([0.0, rng.uniform(-1.0, 1.0)]))}

    def before_light(self, moment: Moment) -> None:
        if self.radius:
            bent = 1.0 / self.radius
            moment.form = quadratic_form(bent, self.astigmatism * bent, self.astigmatism_45 * bent,
                                         tuple(self.cubic * bent / REACH))

    def appearance(self, view: StopView) -> list[Form]:
        u, v = view.strike[..., 0], view.strike[..., 1]
        zero = np.zeros_like(u)

        def shapes(*terms: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
            return np.stack([self._column(view, *term) for term in terms])

        sphere, _, slanted, *cubic = self._terms(view)
        quadratic = ((0.5 * u * u, u, zero), slanted, (0.5 * v * v, zero, v))
        two, three = ('uu', 'uv', 'vv'), ('uuu', 'uuv', 'uvv', 'vvv')
        forms = [self._form('sphere', shapes(sphere), ('curvature',)),
                 self._form('quadratic', shapes(*quadratic), two),
                 self._form('cubic', shapes(*quadratic, *cubic), two + three)]
        if len(np.unique(view.setup)) > 1:
            forms.append(self._form('sphere, mounted anew in each setup',
                                    *by_setup(view, shapes(sphere), ('curvature',))))
            columns, names = by_setup(view, shapes(*quadratic), two)
            forms.append(self._form('quadratic, mounted anew in each setup', columns, names))
        return forms

    @staticmethod
    def _form(label: str, columns: np.ndarray, names: tuple[str, ...]) -> Form:
        return Form(label, columns, names, np.full(len(names), CURVATURE), '1/m')

    @staticmethod
    def _column(view: StopView, height: np.ndarray, slope_u: np.ndarray,
                slope_v: np.ndarray) -> np.ndarray:
        """What a shape of ``height`` and slopes (n, beams + 1) at the strikes does to the readings."""
        column = np.zeros(view.reading.shape)
        column[:, :view.beams] = -height[:, :-1]
        # Normal (−h_u, −h_v, 1): the mirror turned by −h_v about u and h_u about v, at the PSD's strike.
        spot = slice(view.beams, None)
        column[:, spot] = (view.by_mirror[1, :, spot] * slope_u[:, -1:]
                           - view.by_mirror[0, :, spot] * slope_v[:, -1:])
        return column

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        view = fitted.view
        columns = np.stack([self._column(view, *term) for term in self._terms(view)])
        if fitted.forms[0].names == ('curvature',):
            columns = columns[:1]
        elif not any('uuu' in form.names for form in fitted.forms):
            columns = columns[:3]
        mean, *others = fitted.solve(columns)[0].tolist()
        if not mean:
            return {}
        astigmatism, slanted, *cubic = [other / mean for other in others] + [0.0] * (6 - len(others))
        return {'radius': 1.0 / mean, 'astigmatism': astigmatism, 'astigmatism_45': slanted, 'cubic': cubic}

    @staticmethod
    def _terms(view: StopView) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Height and slopes (n, beams + 1) of each term of the physical face at the strikes, per 1/m."""
        u, v = view.strike[..., 0], view.strike[..., 1]
        zero = np.zeros_like(u)
        return [(0.5 * (u * u + v * v), u, v), (0.5 * (u * u - v * v), u, -v), (u * v, v, u),
                *(tuple(part / REACH for part in term) for term in (
                    (u**3 / 6.0, 0.5 * u * u, zero), (0.5 * u * u * v, u * v, 0.5 * u * u),
                    (0.5 * u * v * v, 0.5 * v * v, u * v), (v**3 / 6.0, zero, 0.5 * v * v)))]
