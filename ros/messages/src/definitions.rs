//! How ROS defines the messages that are recorded or shown: what a reader needs that does not know them.

use std::fmt::Write;

/// The fields of a type, in their order. Constants and comments are left out: nothing on the wire depends on them.
const FIELDS: [(&str, &str); 29] = [
    ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    (
        "diagnostic_msgs/DiagnosticArray",
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    ),
    (
        "diagnostic_msgs/DiagnosticStatus",
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
    ),
    ("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n"),
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
    (
        "geometry_msgs/PoseWithCovarianceStamped",
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
    ),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"),
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
    ),
    ("nav_msgs/Path", "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n"),
    (
        "sensor_msgs/CameraInfo",
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n\
         float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n\
         sensor_msgs/RegionOfInterest roi\n",
    ),
    ("sensor_msgs/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data\n"),
    (
        "sensor_msgs/RegionOfInterest",
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
    ),
    ("std_msgs/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"),
    ("std_msgs/Float64", "float64 data\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "visualization_msgs/Marker",
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n\
         geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n\
         bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n\
         sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n\
         string mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    ),
    ("visualization_msgs/MarkerArray", "visualization_msgs/Marker[] markers\n"),
    ("visualization_msgs/MeshFile", "string filename\nuint8[] data\n"),
    ("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
];

/// The fields of a type, as in `nav_msgs/msg/Path`, and behind a line of `=` those of each type within it, as
/// [`ros2msg`](https://mcap.dev/spec/registry#ros2msg) has them. Empty for a type that is not among them.
#[must_use]
pub fn definition(ros_type: &str) -> String {
    let of = |wanted: &str| FIELDS.iter().find(|(name, _)| *name == wanted).map(|(_, fields)| *fields);
    let mut told = String::new();
    let mut names = vec![ros_type.replace("/msg/", "/")];
    let mut next = 0;
    while let Some(name) = names.get(next).cloned() {
        let fields = of(&name).unwrap_or_default();
        if next > 0 {
            // A `String` takes whatever is written to it.
            let _ = write!(told, "{}\nMSG: {name}\n", "=".repeat(80));
        }
        told.push_str(fields);
        for field in fields.lines() {
            let within = field.split([' ', '[']).next().unwrap_or_default();
            if of(within).is_some() && !names.iter().any(|known| known == within) {
                names.push(within.to_owned());
            }
        }
        next += 1;
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definition_has_each_type_within_once() {
        let told = definition("nav_msgs/msg/Path");
        let parts: Vec<&str> = told.split(&format!("{}\n", "=".repeat(80))).collect();
        let names: Vec<&str> = parts[1..].iter().map(|part| part.lines().next().unwrap()).collect();
        assert_eq!(parts[0], "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n");
        let expected =
            ["std_msgs/Header", "geometry_msgs/PoseStamped", "builtin_interfaces/Time", "geometry_msgs/Pose"];
        assert_eq!(names[..4], expected.map(|name| format!("MSG: {name}")));
        assert_eq!(names.len(), 6, "{names:?}");
    }

    #[test]
    fn all_that_is_within_a_type_is_defined() {
        for (name, fields) in FIELDS {
            for field in fields.lines() {
                let within = field.split([' ', '[']).next().unwrap();
                let known = !within.contains('/') || FIELDS.iter().any(|(name, _)| *name == within);
                assert!(known, "{within} of {name}");
            }
        }
    }
}
