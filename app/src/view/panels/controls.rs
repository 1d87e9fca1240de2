//! Defines the panels' requests to the window, and the positions of the controls.
//!
//! While the panels are drawn, both are collected in egui's context.

use crate::view::opening::CameraRole;
use egui::{Context, Id, Rect};
use splatgraph_framework::ir::Origin;
use std::collections::BTreeMap;

/// A request to the window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Save the window's picture.
    Screenshot,
    /// Save the picture of A alone, at its own size.
    SavePicture,
    /// Capture the next frame with the available capture tool.
    Capture,
    /// Toggle full screen.
    Fullscreen,
    /// Show the file dialog for a scene, a graph or cameras, or for cameras of one role; open the chosen file.
    Open(Option<CameraRole>),
    /// Open a source location in the user's editor.
    Edit(Origin),
}

/// Positions of a frame's controls, in points, for scripted input; and the user's requests.
#[derive(Clone, Debug, Default)]
pub struct Controls {
    now: BTreeMap<String, Rect>,
    pub(super) commands: Vec<Command>,
    /// Message about text that the user typed into a number field, if it is no number or out of range.
    pub(super) refused: Option<String>,
}

impl Controls {
    /// Returns the position of a control in the last frame; `None` if the control was not drawn.
    pub fn find(&self, name: &str) -> Option<Rect> {
        self.now.get(name).copied()
    }

    /// Iterates over the names and positions of all controls in the last frame.
    pub fn iter(&self) -> impl Iterator<Item = (&str, Rect)> {
        self.now.iter().map(|(name, rect)| (name.as_str(), *rect))
    }
}

/// Calls `access` with the positions and requests that were collected so far.
fn drawn<T>(ctx: &Context, access: impl FnOnce(&mut Controls) -> T) -> T {
    ctx.data_mut(|data| access(data.get_temp_mut_or_default(Id::NULL)))
}

/// Takes what was collected since the last call.
pub fn take(ctx: &Context) -> Controls {
    drawn(ctx, std::mem::take)
}

/// Records the position of a control.
pub fn see(ctx: &Context, name: &str, rect: Rect) {
    drawn(ctx, |controls| controls.now.insert(name.to_owned(), rect));
}

/// Returns the position of a control in this frame; `None` if it was not drawn yet.
pub fn find(ctx: &Context, name: &str) -> Option<Rect> {
    drawn(ctx, |controls| controls.find(name))
}

/// Passes a request to the window.
pub fn request(ctx: &Context, command: Command) {
    drawn(ctx, |controls| controls.commands.push(command));
}

/// Reports text of a number field that is no number, or out of range.
pub fn refuse(ctx: &Context, message: String) {
    drawn(ctx, |controls| controls.refused = Some(message));
}
