//! Demonstrates an equation on a scene, as a self-contained page.
//!
//! An experiment changes one parameter of the exact settings ([`exact`]), draws, and compares the pictures with the
//! exact renderer's. [`order`] changes the order in which splats are blended, with a worked example of [`two`] splats.
//! [`sh`] leaves out bands of the spherical harmonics, in the part of the picture that depends on them most, which
//! [`gloss`] finds. Every number on a page is measured or computed when [`study`] makes the page.

pub mod exact;
pub mod gloss;
pub mod order;
pub mod sh;
pub mod two;
pub mod ways;

use crate::io::report::page::Page;
use crate::studies::study::{Listener, StudyError, Subject};

/// The subject of an experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The order of the splats: [`order`].
    Order,
    /// The bands of the spherical harmonics: [`sh`].
    Sh,
}

/// Runs an experiment, and returns its page. `view` describes the scene and the view, in words.
///
/// # Errors
/// The graph has errors, the device fails, a picture cannot be compared or encoded, an exact picture does not fit in
/// memory, no camera sees a splat, or the listener cancels; for [`Kind::Order`], also if the subject has no camera.
pub fn study(
    subject: &Subject,
    kind: Kind,
    view: String,
    listener: &mut dyn Listener,
) -> Result<Page, StudyError> {
    subject.check_views(listener)?;
    let mut session = subject.session(exact::GRAPH, &[])?;
    match kind {
        Kind::Order => order::page(&order::measure(&mut session, subject.first()?, view, listener)?),
        Kind::Sh => sh::page(&sh::measure(&mut session, &subject.cameras, view, listener)?),
    }
}
