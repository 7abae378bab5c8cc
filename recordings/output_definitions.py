"""Definitions of the messages with a stack's outputs, as text: object lists and grid maps are not in rosbags.

Fields and their order are those of the packages: autoware_msgs 1.x and autoware_auto_msgs 1.0, spencer_tracking_msgs,
people_msgs, leg_tracker, obstacle_detector (tysik), vision_msgs 0.0.x (ROS 1) and 4.x (ROS 2), grid_map_msgs.
"""

from __future__ import annotations

_AUTOWARE = {
    "ObjectClassification": "uint8 label\nfloat32 probability",
    "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions",
    "TrackedObject": """unique_identifier_msgs/UUID object_id
float32 existence_probability
ObjectClassification[] classification
TrackedObjectKinematics kinematics
Shape shape""",
    "TrackedObjects": "std_msgs/Header header\nTrackedObject[] objects",
    "PredictedObject": """unique_identifier_msgs/UUID object_id
float32 existence_probability
ObjectClassification[] classification
PredictedObjectKinematics kinematics
Shape shape""",
    "PredictedObjectKinematics": """geometry_msgs/PoseWithCovariance initial_pose_with_covariance
geometry_msgs/TwistWithCovariance initial_twist_with_covariance
geometry_msgs/AccelWithCovariance initial_acceleration_with_covariance
PredictedPath[] predicted_paths""",
    "PredictedPath": "geometry_msgs/Pose[] path\nbuiltin_interfaces/Duration time_step\nfloat32 confidence",
    "PredictedObjects": "std_msgs/Header header\nPredictedObject[] objects",
}
_TRACKED = """geometry_msgs/PoseWithCovariance pose_with_covariance
geometry_msgs/TwistWithCovariance twist_with_covariance
geometry_msgs/AccelWithCovariance acceleration_with_covariance
uint8 orientation_availability
bool is_stationary"""
_TRACKED_AUTO = """geometry_msgs/PoseWithCovariance pose_with_covariance
uint8 orientation_availability
geometry_msgs/TwistWithCovariance twist_with_covariance
geometry_msgs/AccelWithCovariance acceleration_with_covariance
bool is_stationary"""
_OF_BOTH = {
    "spencer_tracking_msgs/msg/TrackedPersons": "std_msgs/Header header\nTrackedPerson[] tracks",
    "spencer_tracking_msgs/msg/TrackedPerson": """uint64 track_id
bool is_occluded
bool is_matched
uint64 detection_id
builtin_interfaces/Duration age
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist""",
    "people_msgs/msg/People": "std_msgs/Header header\nPerson[] people",
    "people_msgs/msg/Person": """string name
geometry_msgs/Point position
geometry_msgs/Point velocity
float64 reliability
string[] tagnames
string[] tags""",
    "leg_tracker/msg/PersonArray": "std_msgs/Header header\nPerson[] people",
    "leg_tracker/msg/Person": "geometry_msgs/Pose pose\nuint32 id",
    "obstacle_detector/msg/Obstacles": """std_msgs/Header header
SegmentObstacle[] segments
CircleObstacle[] circles""",
    "obstacle_detector/msg/SegmentObstacle": "geometry_msgs/Point first_point\ngeometry_msgs/Point last_point",
    "obstacle_detector/msg/CircleObstacle": """geometry_msgs/Point center
geometry_msgs/Vector3 velocity
float64 radius
float64 true_radius""",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
}
_LAYERS = """string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index"""
_MAP_INFO = "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose"

ROS1_OUTPUTS = {
    **_OF_BOTH,
    "vision_msgs/msg/Detection3D": """std_msgs/Header header
ObjectHypothesisWithPose[] results
BoundingBox3D bbox
sensor_msgs/PointCloud2 source_cloud""",
    "vision_msgs/msg/ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "grid_map_msgs/msg/GridMap": f"GridMapInfo info\n{_LAYERS}",
    "grid_map_msgs/msg/GridMapInfo": f"std_msgs/Header header\n{_MAP_INFO}",
}
"""Name of a message -> its definition, for ROS 1."""
ROS2_OUTPUTS = {
    **_OF_BOTH,
    **{f"autoware_perception_msgs/msg/{name}": text for name, text in _AUTOWARE.items()},
    **{f"autoware_auto_perception_msgs/msg/{name}": text for name, text in _AUTOWARE.items()},
    "autoware_perception_msgs/msg/TrackedObjectKinematics": _TRACKED,
    "autoware_auto_perception_msgs/msg/TrackedObjectKinematics": _TRACKED_AUTO,
    "vision_msgs/msg/Detection3D": """std_msgs/Header header
ObjectHypothesisWithPose[] results
BoundingBox3D bbox
string id""",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "grid_map_msgs/msg/GridMap": f"std_msgs/Header header\nGridMapInfo info\n{_LAYERS}",
    "grid_map_msgs/msg/GridMapInfo": _MAP_INFO,
}
"""Name of a message -> its definition, for ROS 2."""
