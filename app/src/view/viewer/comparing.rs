//! Defines the state of a comparison.

use crate::view::latest::Latest;
use crate::view::renderer::{Choice, Wake};
use splatgraph_assets::Camera;

/// Differences between the pictures of A and B.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// PSNR in decibels; infinite for identical pictures.
    pub psnr: f64,
    /// SSIM; `None` for pictures smaller than its window.
    pub ssim: Option<f64>,
    /// Largest difference in a colour channel, from 0 to 1.
    pub worst: f64,
    /// Column and row of the pixel with the largest difference.
    pub at: [usize; 2],
    /// Width and height of the pictures, in pixels.
    pub size: [usize; 2],
}

/// The inputs of a comparison; if they change, its result is out of date.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Compared {
    pub camera: Camera,
    pub background: [f32; 3],
    /// Graph and scene of A and B; a scene by its identity.
    pub sides: [Option<(Choice, u64)>; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    No,
    /// A viewport does not draw the requested state yet.
    Waiting,
    /// The pictures are being read back.
    Reading,
}

pub(super) struct Comparing {
    pub step: Step,
    pub worker: Latest<Comparison>,
    pub newest: Option<(Comparison, Compared)>,
    /// Inputs of the comparison in progress.
    pub of: Option<Compared>,
}

impl Comparing {
    pub fn new(wake: Wake) -> Comparing {
        Comparing { step: Step::No, worker: Latest::new("compare", wake), newest: None, of: None }
    }
}
