//! Refuses pictures that do not fit in memory, before any of it is allocated.

use crate::gaussian::Splats;
use crate::mesh::Surface;
use crate::raster::PIXEL_BYTES;
use splatgraph_assets::{Camera, memory};

/// The error of a picture that does not fit in the host's memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected an exact picture that fits in the {} of memory available, found {width} x {height} pixels, which need {}: choose a smaller size",
    memory::display(*.available),
    memory::display(*.needed)
)]
pub struct PictureMemoryError {
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Bytes that the picture needs.
    pub needed: u64,
    /// Bytes that the process can still allocate.
    pub available: u64,
}

/// Checks that [`render`](crate::render) has enough memory for a camera's picture. Accepts every picture if the
/// available memory is unknown.
///
/// # Errors
/// The picture needs more memory than is available now.
pub fn check_memory(splats: &(impl Splats + ?Sized), camera: &Camera) -> Result<(), PictureMemoryError> {
    let surface = if splats.mesh().is_some() { size_of::<Option<Surface>>() } else { 0 };
    check_against(camera, PIXEL_BYTES + surface, memory::available())
}

fn check_against(
    camera: &Camera,
    pixel_bytes: usize,
    available: Option<u64>,
) -> Result<(), PictureMemoryError> {
    let Camera { width, height, .. } = *camera;
    let needed = (u64::from(width) * u64::from(height)).saturating_mul(pixel_bytes as u64);
    match available {
        Some(available) if needed > available => Err(PictureMemoryError { width, height, needed, available }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_larger_than_the_memory_is_refused_with_its_size() {
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (1024, 1024));
        assert_eq!(check_against(&camera, 100, None), Ok(()));
        assert_eq!(check_against(&camera, 100, Some(100 << 20)), Ok(()));
        let said = check_against(&camera, 100, Some(64 << 20)).unwrap_err().to_string();
        assert!(
            said.contains("fits in the 64.0 MiB of memory available, found 1024 x 1024 pixels"),
            "{said}"
        );
        let largest = Camera { width: u32::MAX, height: u32::MAX, ..camera };
        let none: &[crate::Gaussian] = &[];
        assert!(check_memory(none, &largest).is_err());
    }
}
