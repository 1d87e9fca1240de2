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
    /// Graph with its settings, and identity of the scene, of A and B; `None` without B.
    pub sides: [Option<(Choice, u64)>; 2],
}

pub(super) struct Comparing {
    /// True while a viewport does not draw the requested state yet.
    pub waits: bool,
    /// Inputs of the comparison in progress; `None` if no picture is being read back or compared.
    pub of: Option<Compared>,
    pub worker: Latest<Differences>,
    pub newest: Option<(Differences, Compared)>,
}

impl Comparing {
    pub fn new(wake: Wake) -> Comparing {
        Comparing { waits: false, of: None, worker: Latest::new("compare", wake), newest: None }
    }
}
