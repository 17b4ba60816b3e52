//! Names of topics, as ROS writes them and as DDS carries them.

/// Why a name cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NameError {
    /// Not of the characters that ROS allows.
    #[error(
        "`{0}` is no name of ROS; write parts of a-z, A-Z, 0-9 and _ with slashes between, no part beginning with a digit"
    )]
    Characters(String),
}

/// A topic's full name: one that begins with a slash is full already, any other is within the namespace.
///
/// # Errors
/// [`NameError::Characters`].
pub(crate) fn full(namespace: &str, topic: &str) -> Result<String, NameError> {
    let namespace = namespace.trim_matches('/');
    let full = match topic.strip_prefix('/') {
        Some(_) => topic.to_owned(),
        None if namespace.is_empty() => format!("/{topic}"),
        None => format!("/{namespace}/{topic}"),
    };
    let fits = full.split('/').skip(1).all(|part| {
        !part.is_empty()
            && !part.starts_with(|first: char| first.is_ascii_digit())
            && part.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    });
    if fits { Ok(full) } else { Err(NameError::Characters(full)) }
}

/// The name of a topic in DDS.
pub(crate) fn in_dds(topic: &str) -> String {
    format!("rt{topic}")
}

/// A type of DDS as ROS writes it: `sensor_msgs/Image` of `sensor_msgs::msg::dds_::Image_`.
pub(crate) fn type_in_ros(type_name: &str) -> String {
    type_name.replace("::msg::dds_::", "/").trim_end_matches('_').to_owned()
}

/// A type's name in DDS, of one as in `nav_msgs/msg/Path` or `std_srvs/srv/Trigger_Request`.
pub(crate) fn type_in_dds(ros_type: &str) -> String {
    let of_kind = |name: String, kind: &str| name.replace(&format!("/{kind}/"), &format!("::{kind}::dds_::"));
    format!("{}_", ["msg", "srv", "action"].into_iter().fold(ros_type.to_owned(), of_kind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_topics_are_within_the_namespace() {
        assert_eq!(full("", "camera/image_raw").unwrap(), "/camera/image_raw");
        assert_eq!(full("/robot1", "tf").unwrap(), "/robot1/tf");
        assert_eq!(full("robot1", "/tf").unwrap(), "/tf");
        assert_eq!(in_dds("/robot1/tf"), "rt/robot1/tf");
    }

    #[test]
    fn names_that_ros_refuses_are_refused() {
        for topic in ["", "/", "a//b", "camera-front", "1st", "a/2b", "ä"] {
            assert!(full("", topic).is_err(), "{topic}");
        }
        assert!(full("robot 1", "tf").unwrap_err().to_string().contains("robot 1"));
    }

    #[test]
    fn types_are_told_as_ros_writes_them() {
        assert_eq!(type_in_ros("sensor_msgs::msg::dds_::Image_"), "sensor_msgs/Image");
        assert_eq!(type_in_dds("nav_msgs/msg/Path"), "nav_msgs::msg::dds_::Path_");
        assert_eq!(type_in_dds("std_srvs/srv/Trigger_Request"), "std_srvs::srv::dds_::Trigger_Request_");
    }
}
