//! What one server asks another to look at, and what that one saw, as bytes.

use prost::Message;

use super::panoramic::PanoramicOptics;
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::map_settings::Keep;

/// Where a server is asked to look at an image.
pub(crate) const PATH: &str = "/fleet/look";

/// An image, and what to see in it.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Look {
    /// Hash of the model whose words are seen.
    #[prost(string, tag = "1")]
    pub(crate) model: String,
    /// Whether somebody will look at a small picture of it.
    #[prost(bool, tag = "2")]
    pub(crate) thumbnail: bool,
    #[prost(bytes = "bytes", tag = "3")]
    pub(crate) image: bytes::Bytes,
    /// The camera, as it is stored with sessions, if it sees all around; else empty.
    #[prost(bytes = "vec", tag = "4")]
    pub(crate) panoramic_camera: Vec<u8>,
}

/// What was seen; or why not, which is the image's fault.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Seen {
    /// Features with their words, as maps keep them.
    #[prost(bytes = "vec", tag = "1")]
    pub(crate) features: Vec<u8>,
    /// JPEG; empty if none was asked for.
    #[prost(bytes = "vec", tag = "2")]
    pub(crate) thumbnail: Vec<u8>,
    #[prost(double, tag = "3")]
    pub(crate) extract_s: f64,
    #[prost(double, tag = "4")]
    pub(crate) quantize_s: f64,
    /// Empty if it was seen.
    #[prost(string, tag = "5")]
    pub(crate) refusal: String,
}

impl Look {
    /// What is to be known to make a panorama of the image; `None` if it is none.
    ///
    /// # Errors
    /// Internal, if the camera is none that sees all around.
    pub(crate) fn optics(&self) -> Result<Option<PanoramicOptics>, ServiceError> {
        if self.panoramic_camera.is_empty() {
            return Ok(None);
        }
        let camera = Camera::from_bytes(&self.panoramic_camera).map_err(ServiceError::internal)?;
        let optics = PanoramicOptics::of_camera(&camera);
        optics.map(Some).ok_or_else(|| ServiceError::internal("a camera that sees all around is none"))
    }

    /// What is to be kept of an image at the one that looks at it for another: the owner has the image itself.
    pub(crate) fn keep(&self) -> Keep {
        if self.thumbnail { Keep::Features } else { Keep::Words }
    }
}
