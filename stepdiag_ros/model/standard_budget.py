"""The budget that counts where a cell does not state its own, kind by kind."""

from functools import lru_cache

from stepdiag_ros.model.budget import Budget

TEXT = '''\
# A budget to start from: an attocube IDS3010 and a lateral-effect PSD on a machining centre in a
# workshop.  What a cell's own `budget` does not name is taken from here.  Copy it, put your own
# instruments' numbers in, and run
#     stepdiag uncertainty BAG --budget YOURS.yaml
# value: standard uncertainty for normal, half width for rectangular, triangular and arcsine;
# "from log": the log's own repeats and samples (type A).
schema: 1
contributors:
  - {name: repeatability of position, kind: position_repeatability, type: A, value: from log, unit: m}
  - {name: repeatability of angle, kind: angle_repeatability, type: A, value: from log, unit: rad}
  - {name: interferometer noise, kind: interferometer_noise, type: A, value: from log, unit: m}
  - {name: PSD noise, kind: psd_noise, type: A, value: from log, unit: m}
  # Maker's data, wavelength stability 50 ppb at k = 2.
  - {name: wavelength, kind: scale, type: B, distribution: normal, value: 2.5e-8, unit: m/m}
  # Limits of common sensors.
  - {name: air temperature, kind: air_temperature, type: B, distribution: rectangular, value: 0.1, unit: K}
  - {name: air pressure, kind: air_pressure, type: B, distribution: rectangular, value: 30.0, unit: Pa}
  - {name: humidity, kind: humidity, type: B, distribution: rectangular, value: 0.03, unit: "1"}
  # Ciddor states 2e-8 to 5e-8; with 100 ppm that the CO2 of a workshop differs.
  - {name: index formula, kind: index_formula, type: B, distribution: normal, value: 2.9e-8, unit: "1"}
  # What sensors at one place do not show of the air: 0.05 K along the beam, and 0.1 K at the base unit in a run.
  - {name: air variation, kind: air_variation, type: B, distribution: rectangular, value: 5.0e-8, unit: "1"}
  - {name: dead path, kind: dead_path, type: B, distribution: rectangular, value: 1.0e-7, unit: "1"}
  # Alignment of beam to axis over the travel: 0.1 mm in 0.5 m.
  - {name: cosine, kind: cosine, type: B, distribution: normal, value: 2.0e-4, unit: rad}
  # A few nanometres, at a phase that nobody knows.
  - {name: cyclic error, kind: cyclic, type: B, distribution: arcsine, value: 3.0e-9, unit: m}
  # A mirror of a twentieth of a wavelength.
  - {name: mirror flatness, kind: mirror_flatness, type: B, distribution: normal, value: 1.0e-8, unit: m}
  - {name: mirror slope, kind: mirror_slope, type: B, distribution: normal, value: 2.0e-7, unit: rad}
  # Calibration against a mirror on an autocollimator; the zero by turning the detector by 180°.
  - {name: PSD gain, kind: psd_gain, type: B, distribution: normal, value: 2.0e-3, unit: "1", dof: 10}
  - {name: PSD zero, kind: psd_zero, type: B, distribution: normal, value: 5.0e-6, unit: m}
  - {name: PSD rotation, kind: psd_rotation, type: B, distribution: rectangular, value: 5.0e-3, unit: rad}
  # A ruler: tool, beams and base unit.
  - {name: tool vector, kind: tool, type: B, distribution: rectangular, value: 1.0e-3, unit: m}
  - {name: beam offsets, kind: beam_offset, type: B, distribution: rectangular, value: 5.0e-4, unit: m}
  - {name: standoff, kind: standoff, type: B, distribution: rectangular, value: 5.0e-3, unit: m}
  # Sensors on the scales, and the coefficient to which errors are referred to 20 °C.
  - {name: scale temperature, kind: scale_temperature, type: B, distribution: rectangular, value: 0.1,
     unit: K, coefficient: 1.15e-5}
  - {name: expansion coefficient, kind: expansion_coefficient, type: B, distribution: rectangular,
     value: 1.0e-6, unit: 1/K}
'''


@lru_cache(maxsize=1)
def standard_budget() -> Budget:
    """The standard budget, parsed."""
    return Budget.from_yaml(TEXT, 'standard budget')
