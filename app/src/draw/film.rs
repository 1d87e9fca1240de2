//! Draws films: pictures of a moving camera at equal steps of time, with motion blur.
//!
//! A [`Film`] computes the camera at any time. Each picture is the mean of its samples, whose times are spread evenly
//! over the interval in which the shutter is open. The mean is computed in linear light, as a sensor integrates it.
//! With one sample, the picture stays as drawn. [`draw`] keeps frames in flight, and passes finished pictures to
//! threads that encode them.

use crate::draw::camera_path::CameraPath;
use crate::draw::orbit::Orbit;
use crate::draw::pictures::{self, Pictures};
use crate::draw::session::{FrameOptions, Session, image_of};
use crate::draw::stats::is_blind;
use crate::io::image::Image;
use anyhow::{Context, Result};
use rayon::prelude::*;
use splatgraph_api::{FRAMES_IN_FLIGHT, FrameId};
use splatgraph_assets::Camera;
use std::collections::VecDeque;

/// Motion of a film's camera.
#[derive(Clone, Debug)]
pub enum Motion {
    /// Through the keys of a path.
    Path(CameraPath),
    /// Once around an axis, at constant speed.
    Orbit(Orbit),
}

/// Motion and timing of a film.
#[derive(Clone, Debug)]
pub struct Film {
    /// Motion of the camera.
    pub motion: Motion,
    /// Number of frames of the film.
    pub frames: u32,
    /// Number of pictures that are averaged for each frame.
    pub samples: u32,
    /// Shutter time, as a fraction of the frame time. At 0, there is no motion blur.
    pub shutter: f64,
}

impl Film {
    /// Computes the cameras of a frame's samples, whose times are centred on the frame's time. Empty for a path without
    /// keys.
    pub fn cameras(&self, frame: u32) -> Vec<Camera> {
        let at = |sample: u32| {
            let share = (f64::from(sample) + 0.5) / f64::from(self.samples) - 0.5;
            f64::from(frame) + self.shutter * share
        };
        (0..self.samples).filter_map(|sample| self.camera(at(sample))).collect()
    }

    /// Computes the camera at a time, counted in frames; `None` for a path without keys.
    pub fn camera(&self, at: f64) -> Option<Camera> {
        match &self.motion {
            Motion::Path(path) => path.at_frame(at, self.frames),
            Motion::Orbit(orbit) => Some(orbit.at(at / f64::from(self.frames))),
        }
    }
}

/// Options of [`draw`] besides the film.
#[derive(Clone, Copy, Debug)]
pub struct DrawOptions {
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// Maximum number of pictures that are drawn but not yet encoded.
    pub jobs: usize,
}

/// Summary of the frames that [`draw`] drew.
pub struct Drawn {
    /// Number of frames.
    pub frames: usize,
    /// Sum of the GPU times of all samples, in milliseconds; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    /// Number of frames whose last sample shows no splat. 0 for a scene without splats, or if the graph does not count
    /// visible splats.
    pub blind: usize,
}

/// Draws frames of a film.
///
/// `encode` runs on threads of the pool; see [`Pictures::start`]. `done` receives its results in the order of the
/// frames. The session must be prepared for the size of the pictures. The film's cameras are in the scene's
/// coordinates.
///
/// # Errors
/// The device fails, the graph's output has no colours, or `encode` or `done` fails.
pub fn draw<T: Send + 'static>(
    session: &mut Session,
    film: &Film,
    frames: &[u32],
    options: &DrawOptions,
    encode: impl Fn(u32, Image) -> Result<T> + Clone + Send + 'static,
    mut done: impl FnMut(T) -> Result<()>,
) -> Result<Drawn> {
    let mut pictures = Pictures::new(options.jobs);
    let (mut exposure, mut ms, mut blind) = (Exposure::default(), Some(0.0), 0);
    let has_splats = session.scene().count() > 0;
    // Waits for a sample in flight. For the last sample of a picture, `samples` is the number of its samples, and the
    // picture is encoded. For all others, it is `None`.
    let mut land =
        |session: &mut Session, (id, frame, samples): (FrameId, u32, Option<usize>)| -> Result<()> {
            let result = session.wait(id)?;
            ms = ms.zip(result.total_ms).map(|(sum, ms)| sum + ms);
            // The last sample stands for its frame.
            blind += usize::from(has_splats && samples.is_some() && is_blind(&result.stats));
            let pixels = result.output.context("the device returned no picture")?;
            let (encode, bytes) = (encode.clone(), pictures::encoding_bytes(&pixels));
            let finished = match samples {
                Some(1) => pictures.start(bytes, move || encode(frame, image_of(&pixels)?))?,
                _ => {
                    exposure.add(&image_of(&pixels)?);
                    if samples.is_none() {
                        return Ok(());
                    }
                    let exposure = std::mem::take(&mut exposure);
                    pictures.start(bytes, move || encode(frame, exposure.developed()))?
                }
            };
            finished.into_iter().try_for_each(&mut done)
        };
    let request =
        FrameOptions { background: options.background, read_output: true, ..FrameOptions::default() };
    let mut flying = VecDeque::new();
    for &frame in frames {
        let cameras = film.cameras(frame);
        for (at, camera) in cameras.iter().enumerate() {
            if flying.len() == FRAMES_IN_FLIGHT
                && let Some(oldest) = flying.pop_front()
            {
                land(session, oldest)?;
            }
            let id = session.submit(camera, &request)?;
            flying.push_back((id, frame, (at + 1 == cameras.len()).then_some(cameras.len())));
        }
    }
    flying.into_iter().try_for_each(|oldest| land(session, oldest))?;
    while let Some(outcome) = pictures.wait()? {
        done(outcome)?;
    }
    Ok(Drawn { frames: frames.len(), gpu_ms: ms, blind })
}

/// Sum of a frame's samples, in linear light.
#[derive(Default)]
struct Exposure {
    size: (usize, usize),
    count: f32,
    sum: Vec<f32>,
}

impl Exposure {
    /// Adds a display-encoded sample to the sum. All samples must have the same size.
    fn add(&mut self, image: &Image) {
        self.size = (image.width, image.height);
        self.count += 1.0;
        let values = image.rgb.as_flattened();
        self.sum.resize(values.len(), 0.0);
        self.sum.par_iter_mut().zip(values).for_each(|(sum, value)| *sum += linear(*value));
    }

    fn developed(self) -> Image {
        let (width, height) = self.size;
        let pixel = |sum: &[f32; 3]| sum.map(|sum| encoded(sum / self.count));
        Image { width, height, rgb: self.sum.as_chunks().0.iter().map(pixel).collect() }
    }
}

/// Decodes sRGB to linear light. Negative values keep their sign.
fn linear(value: f32) -> f32 {
    let size = value.abs();
    let light = if size <= 0.040_45 { size / 12.92 } else { ((size + 0.055) / 1.055).powf(2.4) };
    light.copysign(value)
}

/// Encodes linear light as sRGB, the inverse of [`linear`].
fn encoded(light: f32) -> f32 {
    let size = light.abs();
    let value = if size <= 0.003_130_8 { 12.92 * size } else { 1.055 * size.powf(1.0 / 2.4) - 0.055 };
    value.copysign(light)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(closed: bool) -> CameraPath {
        let key = |x: f64| Camera::looking_at([x, 0.0, -4.0], [x, 0.0, 0.0], 60.0, (32, 18));
        let mut path = CameraPath::new(1.0, [0.0; 3]);
        path.set_keys(vec![key(0.0), key(8.0)]).expect("sound keys");
        path.set_closed(closed);
        path
    }

    fn places(film: &Film, frame: u32) -> Vec<f64> {
        film.cameras(frame).iter().map(|camera| (camera.position[0] * 1e6).round() / 1e6).collect()
    }

    #[test]
    fn samples_lie_evenly_in_the_opening_around_the_time_of_the_frame() {
        let film = Film { motion: Motion::Path(path(false)), frames: 9, samples: 4, shutter: 0.5 };
        assert_eq!(places(&film, 3), [2.8125, 2.9375, 3.0625, 3.1875]);
        // An open path rests at its ends.
        assert_eq!(places(&film, 0), [0.0, 0.0, 0.0625, 0.1875]);
        assert_eq!(places(&film, 8), [7.8125, 7.9375, 8.0, 8.0]);
        let still = Film { samples: 1, ..film };
        assert_eq!((places(&still, 0), places(&still, 8)), (vec![0.0], vec![8.0]));
    }

    #[test]
    fn the_frame_after_the_last_of_an_orbit_and_of_a_closed_path_is_the_first() {
        let start = Camera::looking_at([3.0, -1.0, 0.0], [0.0, 1.0, 0.0], 60.0, (32, 18));
        let orbit = Orbit { start, around: [0.0, 1.0, 0.0], axis: [0.0, -1.0, 0.0] };
        for motion in [Motion::Orbit(orbit), Motion::Path(path(true))] {
            let film = Film { motion, frames: 12, samples: 1, shutter: 0.0 };
            let [first, after] = [0, 12].map(|frame| film.cameras(frame)[0].position);
            assert!((0..3).all(|axis| (first[axis] - after[axis]).abs() < 1e-9), "{first:?} {after:?}");
            let last = film.cameras(11)[0].position;
            assert!((0..3).any(|axis| (first[axis] - last[axis]).abs() > 0.1));
        }
    }

    #[test]
    fn a_blurred_picture_is_the_mean_of_light_and_equal_samples_stay_as_they_are() {
        let mut exposure = Exposure::default();
        exposure.add(&Image { width: 2, height: 1, rgb: vec![[0.0, 0.25, 1.5], [1.0, -0.1, 0.02]] });
        exposure.add(&Image { width: 2, height: 1, rgb: vec![[1.0, 0.25, 1.5], [1.0, -0.1, 0.02]] });
        let image = exposure.developed();
        // Half the light of white has the sRGB value 0.735357.
        for (found, expected) in image.rgb.as_flattened().iter().zip([0.735_357, 0.25, 1.5, 1.0, -0.1, 0.02])
        {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }
}
