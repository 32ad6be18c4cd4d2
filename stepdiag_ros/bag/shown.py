"""Topics that are recorded to be looked at, which no evaluation reads, and texts of their message definitions.

Means of the blocks for plots, frames and markers of the scene, and answers as they stood when they were given.  A log
without them is as good; what is recorded of them is what was shown.
"""

SHOWN_DEFINITIONS = {
    'stepdiag_msgs/msg/DisplacementMean':
        'std_msgs/Header header\nfloat64 displacement\nfloat64 scatter\nuint8 quality\nuint32 samples\n',
    'stepdiag_msgs/msg/SpotMean':
        'std_msgs/Header header\nfloat64 x\nfloat64 y\nfloat64 intensity\nuint32 samples\n',
    'stepdiag_msgs/msg/ErrorCurve':
        'string name\nstring unit\nfloat64[] position\nfloat64[] value\nfloat64[] sigma\n'
        'float64[] sigma_repeatability\n',
    'stepdiag_msgs/msg/GeometricErrors':
        'std_msgs/Header header\nbool complete\nstring status\nfloat64 reduced_chi2\nuint32 dof\n'
        'float64[3] squareness\nfloat64[3] squareness_sigma\nErrorCurve[] curves\nstring[] unidentifiable\n'
        'string[] warnings\nfloat64 reference_temperature\nbool traceable\n',
    'stepdiag_msgs/msg/GapEffect':
        'string name\nfloat64 probability\nstring[] parameters\nfloat64[] value\nfloat64[] sigma\nstring unit\n'
        'float64 closes\n',
    'stepdiag_msgs/msg/GapPlace':
        'string channel\nstring setup\nstring axis\nint8 direction\nfloat64 share\n',
    'stepdiag_msgs/msg/GapReport':
        'std_msgs/Header header\nstring verdict\nstring channel\nfloat64 before\nfloat64 after\n'
        'float64 noise_floor\nGapPlace[] places\nGapEffect[] effects\nstring[] indistinguishable\n'
        'string next_measurement\nstring[] warnings\n',
    'tf2_msgs/msg/TFMessage':
        'geometry_msgs/TransformStamped[] transforms\n',
    'geometry_msgs/msg/TransformStamped':
        'std_msgs/Header header\nstring child_frame_id\nTransform transform\n',
    'geometry_msgs/msg/Transform':
        'Vector3 translation\nQuaternion rotation\n',
    'geometry_msgs/msg/Vector3':
        'float64 x\nfloat64 y\nfloat64 z\n',
    'geometry_msgs/msg/Quaternion':
        'float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n',
    'visualization_msgs/msg/MarkerArray':
        'Marker[] markers\n',
    'visualization_msgs/msg/Marker':
        'int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\nint32 LINE_LIST=5\n'
        'int32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\nint32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\n'
        'int32 TRIANGLE_LIST=11\nint32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\n'
        'int32 DELETEALL=3\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n'
        'geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n'
        'builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n'
        'std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n'
        'UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\nMeshFile mesh_file\n'
        'bool mesh_use_embedded_materials\n',
    'visualization_msgs/msg/UVCoordinate':
        'float32 u\nfloat32 v\n',
    'visualization_msgs/msg/MeshFile':
        'string filename\nuint8[] data\n',
    'geometry_msgs/msg/Pose':
        'Point position\nQuaternion orientation\n',
    'std_msgs/msg/ColorRGBA':
        'float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n',
    'builtin_interfaces/msg/Duration':
        'int32 sec\nuint32 nanosec\n',
    'sensor_msgs/msg/CompressedImage':
        'std_msgs/Header header\nstring format\nuint8[] data\n',
}

DISPLACEMENT_MEAN = 'interferometer/decimated'
SPOT_MEAN = 'psd/decimated'
FRAMES = 'tf'
FIXED_FRAMES = 'tf_static'
SCENE = 'scene'
ERRORS = 'geometric_errors'
ERRORS_SO_FAR = 'geometric_errors/so_far'
GAP = 'gap_report'

#: Relative to a machine's namespace, and their types.
SHOWN = {
    DISPLACEMENT_MEAN: 'stepdiag_msgs/msg/DisplacementMean',
    SPOT_MEAN: 'stepdiag_msgs/msg/SpotMean',
    FRAMES: 'tf2_msgs/msg/TFMessage',
    FIXED_FRAMES: 'tf2_msgs/msg/TFMessage',
    SCENE: 'visualization_msgs/msg/MarkerArray',
    ERRORS: 'stepdiag_msgs/msg/GeometricErrors',
    ERRORS_SO_FAR: 'stepdiag_msgs/msg/GeometricErrors',
    GAP: 'stepdiag_msgs/msg/GapReport',
}
