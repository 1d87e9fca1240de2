//! Defines the panels' requests to the window, and the positions of the controls.

use crate::view::opening::CameraRole;
use egui::{Rect, Response};
use splatgraph_framework::ir::Origin;
use std::collections::BTreeMap;

/// A request to the window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Save the window's picture.
    Screenshot,
    /// Save the picture of A alone, at its own size.
    SavePicture,
    /// Turn vsync on if true, off if false.
    Vsync(bool),
    /// Capture the next frame with the available capture tool.
    Capture,
    /// Toggle full screen.
    Fullscreen,
    /// Show the file dialog for a scene, a graph or cameras, and open the chosen file.
    Open,
    /// Show the file dialog for cameras, and use the chosen file's cameras in this role.
    OpenCameras(CameraRole),
    /// Open a source location in the user's editor.
    Edit(Origin),
}

/// Positions of the last frame's controls, in points, for scripted input; and the user's requests.
#[derive(Clone, Debug, Default)]
pub struct Controls {
    now: BTreeMap<String, Rect>,
    /// Requests to the window.
    pub(super) commands: Vec<Command>,
    /// Message about text that the user typed into a number field, if it is not a number.
    pub(super) refused: Option<String>,
}

impl Controls {
    pub(super) fn clear(&mut self) {
        self.now.clear();
    }

    pub(in crate::view) fn see(&mut self, name: &str, rect: Rect) {
        self.now.insert(name.to_owned(), rect);
    }

    /// Records the position of a control, and passes the control through.
    pub(super) fn seen(&mut self, name: &str, control: Response) -> Response {
        self.see(name, control.rect);
        control
    }

    /// Returns the position of a control in the last frame; `None` if the control was not drawn.
    pub fn find(&self, name: &str) -> Option<Rect> {
        self.now.get(name).copied()
    }

    /// Iterates over the names and positions of all controls in the last frame.
    pub fn iter(&self) -> impl Iterator<Item = (&str, Rect)> {
        self.now.iter().map(|(name, rect)| (name.as_str(), *rect))
    }
}
