//! Lists the selectable cameras: those that the user named, or those beside A's scene.
//!
//! Cameras that the user named stay when another scene is opened, because the original, cleaned and compressed files of
//! a capture share them. Cameras beside the new scene replace them.

use splatgraph_assets::Camera;
use std::sync::Arc;

/// Selectable cameras, in world coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraList {
    cameras: Arc<[Camera]>,
    /// True if the cameras were found beside A's scene.
    is_beside: bool,
}

/// Cameras that the user named.
impl From<Vec<Camera>> for CameraList {
    fn from(cameras: Vec<Camera>) -> CameraList {
        CameraList { cameras: cameras.into(), is_beside: false }
    }
}

impl CameraList {
    /// Creates the list of the cameras found beside a scene.
    pub fn beside(cameras: Vec<Camera>) -> CameraList {
        CameraList { cameras: cameras.into(), is_beside: true }
    }

    pub(super) fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Returns the list for another scene that has no cameras beside it: empty if these were beside the former scene.
    pub(super) fn kept(&self) -> CameraList {
        if self.is_beside { CameraList::default() } else { self.clone() }
    }
}
