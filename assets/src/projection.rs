//! Defines the projections of a camera: the mappings from view space to the picture.
//!
//! A point in view space is (x, y, z): right, down and forward of the camera. All projections put the camera's axis at
//! the principal point. The focal length scales the picture, and its unit depends on the projection.

use crate::scene::SortKey;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A mapping from view space to the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Projection {
    /// Perspective: (x / z, y / z), times a focal length in pixels.
    #[default]
    Pinhole,
    /// Parallel to the axis: (x, y), times a focal length in pixels per world unit.
    Orthographic,
    /// Equidistant fisheye: the angle from the axis, times a focal length in pixels per radian.
    Fisheye,
    /// Full panorama: longitude and latitude around the camera's y axis. The picture spans 360 by 180 degrees, whatever
    /// the focal length.
    Equirectangular,
}

impl Projection {
    /// All projections.
    pub const ALL: [Projection; 4] =
        [Projection::Pinhole, Projection::Orthographic, Projection::Fisheye, Projection::Equirectangular];

    /// Returns the name that camera files, presets and graph parameters use.
    pub fn name(self) -> &'static str {
        match self {
            Projection::Pinhole => "pinhole",
            Projection::Orthographic => "orthographic",
            Projection::Fisheye => "fisheye",
            Projection::Equirectangular => "equirectangular",
        }
    }

    /// Returns true for [`Projection::Pinhole`]. Takes a reference for serde's `skip_serializing_if`.
    pub fn is_pinhole(&self) -> bool {
        *self == Projection::Pinhole
    }

    /// Returns true if the picture can show points behind the camera. Renderers then cull and sort splats by distance
    /// instead of depth.
    pub fn sees_behind(self) -> bool {
        matches!(self, Projection::Fisheye | Projection::Equirectangular)
    }

    /// Returns the quantity that splats are sorted by. `tag` is that of the scene, which pinholes follow.
    pub fn sort_key(self, tag: SortKey) -> SortKey {
        match self {
            Projection::Pinhole => tag,
            Projection::Orthographic => SortKey::Depth,
            Projection::Fisheye | Projection::Equirectangular => SortKey::Distance,
        }
    }
}

impl fmt::Display for Projection {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Projection {
    type Err = ();

    fn from_str(name: &str) -> Result<Projection, ()> {
        Projection::ALL.into_iter().find(|projection| projection.name() == name).ok_or(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_projection_has_one_name() {
        for projection in Projection::ALL {
            assert_eq!(projection.name().parse(), Ok(projection));
            assert_eq!(serde_json::to_string(&projection).unwrap(), format!("\"{projection}\""));
        }
        assert_eq!("perspective".parse::<Projection>(), Err(()));
    }
}
