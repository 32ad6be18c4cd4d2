"""Texts of the message definitions that a log needs, and the contract's topics.

``DEFINITIONS`` maps ``package/msg/Name`` to the definition without comments, as
``ros2msg`` schemas carry it.  The ones of ``stepdiag_msgs`` say the same as
``msg_defs/msg/*.msg`` (a test compares them); the others are those of
``common_interfaces`` in ROS 2 Jazzy.
"""

from stepdiag_ros.bag.shown import SHOWN_DEFINITIONS

DEFINITIONS = {
    'builtin_interfaces/msg/Time': 'int32 sec\nuint32 nanosec\n',
    'std_msgs/msg/Header': 'builtin_interfaces/Time stamp\nstring frame_id\n',
    'std_msgs/msg/String': 'string data\n',
    'geometry_msgs/msg/Point': 'float64 x\nfloat64 y\nfloat64 z\n',
    'sensor_msgs/msg/Temperature':
        'std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n',
    'sensor_msgs/msg/FluidPressure':
        'std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n',
    'sensor_msgs/msg/RelativeHumidity':
        'std_msgs/Header header\nfloat64 relative_humidity\nfloat64 variance\n',
    'geometry_msgs/msg/Vector3Stamped': 'std_msgs/Header header\nVector3 vector\n',
    'stepdiag_msgs/msg/Displacement':
        'std_msgs/Header header\nfloat64 sample_period\nuint8 beams\nfloat64[] displacement\n'
        'float64 refractive_index\nuint8[] quality\n',
    'stepdiag_msgs/msg/SampleTiming':
        'std_msgs/Header header\nint32[] taken\nuint32[] uncertainty\nuint32 missed\nstring clock\n',
    'stepdiag_msgs/msg/SpotPosition':
        'std_msgs/Header header\nfloat64 sample_period\nfloat64[] x\nfloat64[] y\n'
        'float64[] intensity\n',
    'stepdiag_msgs/msg/ClockOffset':
        'std_msgs/Header header\nstring clock\nstring reference\nfloat64 offset\nfloat64 uncertainty\n',
    'stepdiag_msgs/msg/ClockStep': 'std_msgs/Header header\nfloat64 step\nstring topic\nuint64 published\n',
    'stepdiag_msgs/msg/Step':
        'uint8 MOVE=0\nuint8 DWELL=1\nuint8 DONE=2\nuint8 NONE=255\nstd_msgs/Header header\n'
        'string run_id\nstring setup\nuint16 repeat\nint8 direction\nuint16 index\nuint8 axis\n'
        'geometry_msgs/Point commanded\nuint8 phase\n',
} | SHOWN_DEFINITIONS

DESCRIPTION = 'cell_description'
STEP = 'sequencer/step'
DISPLACEMENT = 'interferometer/displacement'
SPOT = 'psd/spot'
SCALE = 'environment/scale_temperature'
WORKPIECE = 'workpiece'
"""`frame_id` of the workpiece's temperature on the topic of the scales'."""
DISPLACEMENT_TIMING = 'interferometer/timing'
SPOT_TIMING = 'psd/timing'
STEP_TIMING = 'sequencer/timing'
BEAM_ANGLE = 'psd/beam_angle'
CLOCK_STEP = 'clock_step'
CLOCK_OFFSET = 'clock_offset'
#: Topics that several nodes publish, each counting its own messages: every node says that its clock was set.
OF_SEVERAL = (CLOCK_STEP,)
#: Topics that most logs lack and do not miss.
OCCASIONAL = (CLOCK_STEP, CLOCK_OFFSET, BEAM_ANGLE)

#: Contract topics, relative to a machine's namespace, and their types.
TOPICS = {
    DESCRIPTION: 'std_msgs/msg/String',
    STEP: 'stepdiag_msgs/msg/Step',
    DISPLACEMENT: 'stepdiag_msgs/msg/Displacement',
    SPOT: 'stepdiag_msgs/msg/SpotPosition',
    'environment/air_temperature': 'sensor_msgs/msg/Temperature',
    'environment/air_pressure': 'sensor_msgs/msg/FluidPressure',
    'environment/humidity': 'sensor_msgs/msg/RelativeHumidity',
    SCALE: 'sensor_msgs/msg/Temperature',
    DISPLACEMENT_TIMING: 'stepdiag_msgs/msg/SampleTiming',
    SPOT_TIMING: 'stepdiag_msgs/msg/SampleTiming',
    STEP_TIMING: 'stepdiag_msgs/msg/SampleTiming',
    CLOCK_STEP: 'stepdiag_msgs/msg/ClockStep',
    CLOCK_OFFSET: 'stepdiag_msgs/msg/ClockOffset',
    BEAM_ANGLE: 'geometry_msgs/msg/Vector3Stamped',
}

#: The scalar of each environment type, and the key of ``CalibrationLog.environment``.
SCALAR_FIELD = {
    'sensor_msgs/msg/Temperature': 'temperature',
    'sensor_msgs/msg/FluidPressure': 'fluid_pressure',
    'sensor_msgs/msg/RelativeHumidity': 'relative_humidity',
}


def split_topic(topic: str) -> tuple[str, str] | None:
    """``/cell1/psd/spot`` -> ``('/cell1', 'psd/spot')``; ``None`` if it is no contract topic."""
    for relative in TOPICS:
        if topic == relative or topic.endswith('/' + relative):
            return topic[:-len(relative)].rstrip('/'), relative
    return None
