//! Moves a camera smoothly through keys, at constant speed.
//!
//! A [`CameraPath`] is a list of cameras, its keys, and a duration. [`CameraPath::at`] computes the camera at a time:
//! it passes through every key without a kink, and its speed is constant. The speed includes translation, rotation and
//! zoom, so that a rotation in place also takes time. Between level keys, it stays level. [`Playback`] is the state of
//! a player.
//!
//! Keys are in the world's coordinates, and a path is saved as a `cameras.json` of its keys. Consecutive equal keys
//! count as one. If the keys are the frames of a film, they keep their times instead, and equal ones are a hold
//! ([`CameraPath::set_frames`]). The path has the projection that all keys share; with several projections, its cameras
//! are pinholes. Between opposite rotations, the path takes one of the two shortest ways, the same in every run.

mod curve;
#[cfg(test)]
mod tests;

use crate::draw::projection::{self, MixedProjections};
use curve::{Curve, View};
use glam::DVec3;
use splatgraph_assets::{Camera, Projection, Scene};
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Range of a path's duration, in seconds.
pub const SECONDS: RangeInclusive<f64> = 0.1..=86_400.0;

/// Duration of a new path, in seconds.
pub const DEFAULT_SECONDS: f64 = 10.0;

/// Error about a camera that cannot be a key.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// The camera is unusable.
    #[error("expected a valid camera as key {index}: {fault}")]
    Unsound {
        /// Index of the key in the list.
        index: usize,
        /// Reason why the camera is unusable; see [`Camera::fault`].
        fault: String,
    },
    /// The cameras of a list have several projections.
    #[error("camera path: {0}")]
    Mixed(#[from] MixedProjections),
}

/// The choices of a user that define a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathSettings {
    /// Keys of the path, shared with the viewer's undo history.
    keys: Arc<Vec<Camera>>,
    closed: bool,
    seconds: f64,
}

/// A smooth path of a camera; see the module's documentation.
#[derive(Clone, Debug)]
pub struct CameraPath {
    settings: PathSettings,
    /// True if the keys are frames, at equal steps of time.
    frames: bool,
    radian: f64,
    /// World's up direction, of length 1.
    up: DVec3,
    projection: Projection,
    curve: Curve,
}

impl CameraPath {
    /// Creates an open path without keys, with a duration of [`DEFAULT_SECONDS`].
    ///
    /// `radian` is the distance, in world units, that takes as long as a rotation by one radian; see
    /// [`length_of_radian`]. A value that is not positive counts as 1. If all keys are level with respect to `up`, a
    /// world direction, so is the path between them.
    pub fn new(radian: f64, up: [f64; 3]) -> CameraPath {
        let mut path = CameraPath {
            settings: PathSettings { keys: Arc::default(), closed: false, seconds: DEFAULT_SECONDS },
            frames: false,
            radian: 1.0,
            up: DVec3::ZERO,
            projection: Projection::Pinhole,
            curve: Curve::default(),
        };
        path.set_space(radian, up);
        path
    }

    /// Returns the keys, the duration, and whether the path is closed.
    pub fn settings(&self) -> &PathSettings {
        &self.settings
    }

    /// Restores earlier settings of this path.
    pub fn restore(&mut self, settings: &PathSettings) {
        if self.settings != *settings {
            self.settings.clone_from(settings);
            self.update();
        }
    }

    /// Returns the keys, in the world's coordinates.
    pub fn keys(&self) -> &[Camera] {
        &self.settings.keys
    }

    /// Replaces all keys.
    ///
    /// # Errors
    /// A camera is unusable (see [`Camera::fault`]), or the cameras have several projections. The previous keys stay.
    pub fn set_keys(&mut self, keys: Vec<Camera>) -> Result<(), KeyError> {
        keys.iter().enumerate().try_for_each(|(index, key)| check(index, key))?;
        projection::shared(&keys)?;
        self.settings.keys = Arc::new(keys);
        self.update();
        Ok(())
    }

    /// Inserts a key before the key at `index`, or at the end if the list is shorter. If the keys then have several
    /// projections, the path's cameras are pinhole cameras.
    ///
    /// # Errors
    /// The camera is unusable; see [`Camera::fault`].
    pub fn insert(&mut self, index: usize, key: Camera) -> Result<(), KeyError> {
        let index = index.min(self.keys().len());
        check(index, &key)?;
        self.keys_mut().insert(index, key);
        self.update();
        Ok(())
    }

    /// Removes the key at this index, if it exists.
    pub fn remove(&mut self, index: usize) {
        if index < self.keys().len() {
            self.keys_mut().remove(index);
            self.update();
        }
    }

    /// Moves a key to another position in the list, at most to its end; the others keep their order. Does nothing if
    /// there is no key `from`.
    pub fn reorder(&mut self, from: usize, to: usize) {
        if from < self.keys().len() {
            let keys = self.keys_mut();
            let key = keys.remove(from);
            keys.insert(to.min(keys.len()), key);
            self.update();
        }
    }

    /// Returns true if the path leads from the last key back to the first.
    pub fn is_closed(&self) -> bool {
        self.settings.closed
    }

    /// Closes or opens the path. Its duration does not change.
    pub fn set_closed(&mut self, closed: bool) {
        self.settings.closed = closed;
        self.update();
    }

    /// Sets whether the keys are the frames of a film. The path then passes them at equal steps of time, instead of at
    /// constant speed.
    pub fn set_frames(&mut self, frames: bool) {
        self.frames = frames;
        self.update();
    }

    /// Returns the duration, in seconds.
    pub fn seconds(&self) -> f64 {
        self.settings.seconds
    }

    /// Sets the duration, in seconds, clamped to [`SECONDS`]; NaN is ignored.
    pub fn set_seconds(&mut self, seconds: f64) {
        if !seconds.is_nan() {
            self.settings.seconds = seconds.clamp(*SECONDS.start(), *SECONDS.end());
        }
    }

    /// Sets the distance in world units that takes as long as a rotation by one radian, and the up direction; see
    /// [`CameraPath::new`].
    pub fn set_space(&mut self, radian: f64, up: [f64; 3]) {
        self.radian = if radian > 0.0 { radian.clamp(1e-18, 1e18) } else { 1.0 };
        self.up = DVec3::from(up).normalize_or_zero();
        self.update();
    }

    /// Computes the time at which the path passes each key, in seconds from the start.
    pub fn key_seconds(&self) -> Vec<f64> {
        let length = self.curve.length();
        let part = |at: &f64| if length > 0.0 { at / length } else { 0.0 };
        self.curve.keys.iter().map(|at| part(at) * self.seconds()).collect()
    }

    /// Computes the camera at a time, in seconds from the start; `None` without keys.
    ///
    /// A closed path repeats; an open one stays at its ends. The camera has the picture size of the first key.
    pub fn at(&self, seconds: f64) -> Option<Camera> {
        let first = self.keys().first()?;
        let part = seconds / self.seconds();
        let part = match self.is_closed() {
            _ if part.is_nan() => 0.0,
            // A closed path has no camera at an infinite time; use the first.
            true => Some(part.rem_euclid(1.0)).filter(|part| part.is_finite()).unwrap_or(0.0),
            false => part.clamp(0.0, 1.0),
        };
        let view = self.curve.at(part * self.curve.length());
        Some(view.map_or_else(|| first.clone(), |view| view.camera(first, self.projection)))
    }

    /// Computes the camera of frame `frame` out of `count` frames at equal steps of time; `None` without keys.
    ///
    /// `frame` counts from 0, and may be fractional. An open path begins at the first frame and ends at the last. If
    /// the keys are frames, and as many as `count`, a whole frame is its key in the picture size of the first, exactly.
    pub fn at_frame(&self, frame: f64, count: u32) -> Option<Camera> {
        if let (true, [first, ..]) = (self.frames && self.keys().len() == count as usize, self.keys())
            && frame >= 0.0
            && frame.fract() == 0.0
            && let Some(key) = self.keys().get(frame as usize)
        {
            return Some(key.resized(first.width, first.height));
        }
        let steps = if self.is_closed() { count } else { count.saturating_sub(1) };
        self.at(self.seconds() * frame / f64::from(steps.max(1)))
    }

    fn keys_mut(&mut self) -> &mut Vec<Camera> {
        Arc::make_mut(&mut self.settings.keys)
    }

    fn update(&mut self) {
        let views: Vec<View> = self.keys().iter().map(View::of).collect();
        self.projection = projection::shared(self.keys()).unwrap_or_default();
        self.curve = Curve::new(&views, self.is_closed(), self.frames, self.radian, self.up);
    }
}

fn check(index: usize, key: &Camera) -> Result<(), KeyError> {
    key.fault().map_or(Ok(()), |fault| Err(KeyError::Unsound { index, fault }))
}

/// Computes a `radian` for [`CameraPath::new`] that suits a scene: half the extent of its robust box, in world units.
///
/// At that viewing distance, a translation by `radian` moves the picture about as much as a rotation by one radian.
pub fn length_of_radian(scene: &Scene) -> f64 {
    0.5 * scene.robust_bounds().extent()
}

/// State of a path's playback.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Playback {
    position: f64,
    playing: bool,
    /// True until the first frame: the time before it does not count.
    starting: bool,
}

impl Playback {
    /// Returns the current time, in seconds from the start of the path.
    pub fn position(&self) -> f64 {
        self.position
    }

    /// Returns true while the path is playing.
    pub fn is_playing(&self) -> bool {
        self.playing
    }

    /// Plays from the current position, or from the start if an open path is at its end. Without keys, pauses.
    pub fn play(&mut self, path: &CameraPath) {
        if !path.is_closed() && self.position >= path.seconds() {
            self.position = 0.0;
        }
        (self.playing, self.starting) = (!path.keys().is_empty(), true);
    }

    /// Pauses at the current position.
    pub fn pause(&mut self) {
        self.playing = false;
    }

    /// Seeks to a time in seconds, clamped to the path's duration; NaN is ignored. A playing path continues from there.
    pub fn seek(&mut self, seconds: f64, path: &CameraPath) {
        if !seconds.is_nan() {
            self.position = seconds.clamp(0.0, path.seconds());
        }
    }

    /// Advances by the seconds since the last frame, and returns the camera; `None` unless the path is playing.
    ///
    /// The first call after [`Self::play`] does not advance. An open path stops at its last camera; a closed path
    /// repeats.
    pub fn advance(&mut self, seconds: f64, path: &CameraPath) -> Option<Camera> {
        if !self.playing {
            return None;
        }
        let passed = if std::mem::take(&mut self.starting) || !seconds.is_finite() { 0.0 } else { seconds };
        self.position = (self.position + passed).max(0.0);
        if path.is_closed() {
            self.position = self.position.rem_euclid(path.seconds());
        } else if self.position >= path.seconds() {
            (self.position, self.playing) = (path.seconds(), false);
        }
        let camera = path.at(self.position);
        self.playing &= camera.is_some();
        camera
    }
}
