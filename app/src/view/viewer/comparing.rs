//! Defines the state of a comparison.

use crate::view::latest::Latest;
use crate::view::renderer::{Choice, Wake};
use splatgraph_assets::Camera;
use splatgraph_reference::metrics::Comparison;

/// Differences between the pictures of A and B, and the width and height of the pictures.
pub type Differences = (Comparison, [usize; 2]);

/// The inputs of a comparison; if they change, its result is out of date.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Compared {
    pub camera: Camera,
    pub background: [f32; 3],
    /// A and B: each graph with its settings, and the identity of its scene. The second is `None` without B.
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
    pub worker: Latest<Differences>,
    pub newest: Option<(Differences, Compared)>,
    /// Inputs of the comparison in progress.
    pub of: Option<Compared>,
}

impl Comparing {
    pub fn new(wake: Wake) -> Comparing {
        Comparing { step: Step::No, worker: Latest::new("compare", wake), newest: None, of: None }
    }
}
