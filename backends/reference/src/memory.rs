//! Refuses pictures that do not fit in memory, before anything is allocated for them.

use crate::gaussian::Splats;
use crate::mesh::Surface;
use crate::project::{SPLAT_BYTES, visible_count};
use crate::raster::PIXEL_BYTES;
use crate::rules::Rules;
use splatgraph_assets::{Camera, memory};

/// The error of a picture that does not fit in the host's memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected an exact picture that fits in the {} of memory available, found {width} x {height} pixels and {splats} visible splats, which need {}: choose a smaller size or fewer splats",
    memory::display(*.available),
    memory::display(*.needed)
)]
pub struct PictureMemoryError {
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Number of splats that are visible in the picture.
    pub splats: usize,
    /// Bytes that the picture and the splats need.
    pub needed: u64,
    /// Bytes that the process can still allocate.
    pub available: u64,
}

/// Checks that [`render`](crate::render) has enough memory for a camera's picture. Accepts every picture if the
/// available memory is unknown.
///
/// # Errors
/// The picture and its visible splats need more memory than is available now.
pub fn check_memory(
    splats: &(impl Splats + ?Sized),
    camera: &Camera,
    rules: &Rules,
) -> Result<(), PictureMemoryError> {
    let surface = if splats.mesh().is_some() { size_of::<Option<Surface>>() } else { 0 };
    let (pixel_bytes, available) = (PIXEL_BYTES + surface, memory::available());
    // Counting the visible splats takes time, so they are counted only if all splats would not fit.
    check_against(camera, pixel_bytes, splats.count(), available)
        .or_else(|_| check_against(camera, pixel_bytes, visible_count(splats, camera, rules), available))
}

fn check_against(
    camera: &Camera,
    pixel_bytes: usize,
    splats: usize,
    available: Option<u64>,
) -> Result<(), PictureMemoryError> {
    let Camera { width, height, .. } = *camera;
    let pixels = (u64::from(width) * u64::from(height)).saturating_mul(pixel_bytes as u64);
    let needed = pixels.saturating_add((splats * SPLAT_BYTES) as u64);
    match available {
        Some(available) if needed > available => {
            Err(PictureMemoryError { width, height, splats, needed, available })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::visible;
    use splatgraph_assets::synth;

    #[test]
    fn a_picture_larger_than_the_memory_is_refused_with_its_size() {
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (1024, 1024));
        assert_eq!(check_against(&camera, 100, 0, None), Ok(()));
        assert_eq!(check_against(&camera, 100, 0, Some(100 << 20)), Ok(()));
        assert!(check_against(&camera, 100, 1, Some(100 << 20)).is_err());
        let said = check_against(&camera, 100, 7, Some(64 << 20)).unwrap_err().to_string();
        let expected =
            "fits in the 64.0 MiB of memory available, found 1024 x 1024 pixels and 7 visible splats";
        assert!(said.contains(expected), "{said}");
        let largest = Camera { width: u32::MAX, height: u32::MAX, ..camera };
        let none: &[crate::Gaussian] = &[];
        assert!(check_memory(none, &largest, &Rules::PUBLISHED).is_err());
    }

    #[test]
    fn splats_out_of_sight_need_no_memory() {
        let scene = synth::generate("uniform", 500, 0).expect("a scene");
        let camera = Camera::framing(&scene, 64, 48);
        let count = |camera: &Camera| visible_count(&scene, camera, &Rules::PUBLISHED);
        assert_eq!(count(&camera), visible(&scene, &camera, &Rules::PUBLISHED).0.len());
        assert!(count(&camera) > 400);
        let away = Camera::looking_at([1e3, 0.0, 0.0], [2e3, 0.0, 0.0], 60.0, (64, 48));
        assert_eq!(count(&away), 0);
    }
}
