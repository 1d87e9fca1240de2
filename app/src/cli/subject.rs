//! Loads the subject of a study.

use super::loading;
use crate::draw::backend::Backend;
use crate::draw::fit;
use crate::io::load::LoadOptions;
use crate::studies::study::{Setting, Subject};
use anyhow::Result;
use splatgraph_api::Device;
use splatgraph_assets::Camera;
use std::path::Path;

/// Loads the scene at `path`, or the demo scene, and its cameras; see [`loading::scene_and_cameras`].
///
/// # Errors
/// The scene cannot be loaded, or its header shows that it is too large for one of the settings.
pub fn load(
    device: Backend,
    (path, load): (Option<&Path>, &LoadOptions),
    settings: &[Setting],
    given: Option<Vec<Camera>>,
    size: Option<(u32, u32)>,
) -> Result<Subject> {
    if let Some(path) = path {
        for setting in settings {
            fit::check_header(path, load, device.info(), &setting.pipeline, &setting.set)?;
        }
    }
    let (scene, cameras) = loading::scene_and_cameras(path, load, given, size)?;
    Ok(Subject { device, name: loading::scene_name(path), scene: scene.into(), cameras })
}
