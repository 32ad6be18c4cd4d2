"""How much of anything the program takes from outside.

Every limit stands here and nowhere else.  Each is far beyond what a calibration needs and far below what would
exhaust a small computer; sizes are compared with them before memory is taken.
"""

MIB = 1 << 20

# Files.
YAML_BYTES = 4 * MIB
TEXT_BYTES = 64 * MIB
"""Of a table (CSV) or a JSON document."""
BAG_FILES = 1000
"""Files of one bag."""

# YAML: brackets within brackets, and values in one document.
YAML_DEPTH = 24
YAML_VALUES = 200_000
INTEGER_DIGITS = 20

# MCAP: one chunk unpacked; a whole bag unpacked against its size on disk; records that are no messages.
CHUNK_BYTES = 256 * MIB
UNPACKED_LEAST = 64 * MIB
UNPACKED_TIMES = 64
SUMMARY_BYTES = 64 * MIB
DESCRIBING_RECORDS = 100_000
CHANNELS = 2000
SMALLEST_MESSAGE = 64
"""Bytes that a message is counted as at least: what keeping track of it costs."""

# Message definitions.
SCHEMA_BYTES = 1 << 16
SCHEMA_FIELDS = 1000
SCHEMA_DEPTH = 16

# The plan of a calibration.
STEPS = 200
"""Of an axis along a diagonal: 601 stops, 3600 unknowns."""
REPEATS = 1000
SETUPS = 64
STOPS = 3 * STEPS + 1
"""Of a linear setup."""
BEAMS = 3
LENGTH_M = 100.0
"""Of a working volume, a tool, a standoff or an offset."""
ANGLE_RAD = 1.0
"""Of a misalignment."""
BEAM_ANGLE_RAD = 3.2
BY_UNIT = {'m': LENGTH_M, 'rad': ANGLE_RAD, 's': 86_400.0, '°C': 200.0, '°C/h': 100.0}
"""Of what a cell file states in a unit, either sign, where its key says nothing narrower."""
EFFECT_TIMES = 1000.0
"""Of an effect's parameter: so many times beyond the range in which such effects are usually drawn, to either side."""
COURSE_TIMES = 10_000
"""Of an effect's course."""
AIR_DRIFT = {'temperature': 100.0, 'pressure': 1.0e4, 'humidity': 1.0}
"""An hour, either way [K, Pa, 1]."""
IN_POSITION_M = 1.0e-12
"""The narrowest window in which an axis has arrived."""
SLOWEST = 1.0e-9
"""Of feed, acceleration and jerk [m/s, m/s², m/s³]: with less no axis arrives in a lifetime."""
NUMBER, SMALLEST = 1.0e15, 1.0e-30
"""Any number of a cell file; what is smaller is 0."""
NOISE = 1.0
"""Standard deviation [m or rad] that a maker of a log may believe in."""
NAME_LETTERS = 200
RUNS = 2000
"""Traverses of one log."""
LAYOUTS = 2000
"""Of one topic's messages: lengths of their texts and arrays that differ."""
DESCRIPTIONS = 100
FAULTS = 100
"""Places at which a damaged file is taken up again."""
NAMES_LISTED = 3
"""Names of unknown setups and the like that a warning lists."""

LOG_S = 1.0e8
"""Of one log: three years."""

SIMULATED_SAMPLES = 3_000_000
"""Of one sensor in a simulated log, some 150 bytes each: fifty minutes of dwells at 1 kHz."""
SIMULATED_READINGS = 300_000
"""Of each sensor of the air in a simulated log: three days with one a second."""

# Measured values.  What is beyond is no reading of these instruments.
DISPLACEMENT_M = 1000.0
SPOT_M = 10.0
SIGNAL = 1.0e6
INDEX = (0.9, 1.1)
ENVIRONMENT = {'air_temperature': (-60.0, 120.0), 'air_pressure': (1.0e4, 2.0e5), 'humidity': (-0.5, 1.5),
               'scale_temperature': (-60.0, 200.0)}
"""Readings of the surroundings [°C, Pa, 1] by topic; a sensor's own error included."""


def unpacked_most(size: int) -> int:
    """Bytes that a bag of ``size`` bytes may unpack to."""
    return max(UNPACKED_LEAST, UNPACKED_TIMES * size)
