//! Applies keyboard shortcuts that are independent of any control.

use super::controls::{Command, request};
use super::keyboard::{Press, is_plain};
use super::{Panels, Tool, cameras, widgets};
use crate::view::viewer::Viewer;
use egui::{Context, Key};

impl Panels {
    /// Applies the shortcuts that were pressed in this frame and reach the viewer.
    pub(super) fn keys(&mut self, ctx: &Context, viewer: &mut Viewer) {
        self.keyboard.read(ctx, self.help);
        for Press { key, modifiers, repeat } in self.keyboard.presses().to_vec() {
            // Some keyboards type brackets with Alt. A held bracket runs through the cameras.
            let is_bracket = matches!(key, Key::OpenBracket | Key::CloseBracket);
            if !is_bracket && (repeat || !modifiers.command && !is_plain(modifiers)) {
                continue;
            }
            match (key, modifiers.command) {
                (Key::Z, true) => self.step(viewer, modifiers.shift),
                (Key::Y, true) => self.step(viewer, true),
                (Key::O, true) => request(ctx, Command::Open(None)),
                (key, command) if self.select.key(key, command, viewer, self.selected) => {}
                (_, true) => {}
                // Not Tab: egui uses it to move the focus between controls.
                (Key::H, _) => self.hidden = !self.hidden,
                (Key::F12, _) if modifiers.shift => request(ctx, Command::SavePicture),
                (Key::F12, _) => request(ctx, Command::Screenshot),
                (Key::F11, _) => request(ctx, Command::Fullscreen),
                (Key::F1, _) => {
                    self.help = !self.help;
                    // Keys scroll the list only while no control has the focus.
                    ctx.memory_mut(|memory| memory.focused().map(|id| memory.surrender_focus(id)));
                }
                (Key::V, _) => {
                    self.vsync = !self.vsync;
                    self.toasts.done(format!("Wait for the display: {}", widgets::on_off(self.vsync)));
                }
                (Key::C, _) => {
                    viewer.continuous = !viewer.continuous;
                    self.toasts.done(format!("Draw continuously: {}", widgets::on_off(viewer.continuous)));
                }
                (Key::T, _) => ctx.set_theme(match ctx.theme() {
                    egui::Theme::Dark => egui::Theme::Light,
                    egui::Theme::Light => egui::Theme::Dark,
                }),
                (Key::K, _) => cameras::record(viewer).into_iter().for_each(|text| self.toasts.done(text)),
                (Key::P, _) => cameras::toggle(viewer),
                (Key::Escape, _) if self.help => self.help = false,
                (Key::Escape, _) if self.select.is_active() => self.select.leave(),
                (Key::Escape, _) => {
                    self.selection = None;
                    viewer.forget_picked();
                    viewer.clear_selection(self.selected);
                }
                (Key::Num1, _) => self.toggle(Tool::Parameters),
                (Key::Num2, _) => self.toggle(Tool::Times),
                (Key::Num3, _) => self.toggle(Tool::Timeline),
                (Key::Num4, _) => self.toggle(Tool::Inspector),
                (Key::OpenBracket, _) => next_camera(viewer, -1),
                (Key::CloseBracket, _) => next_camera(viewer, 1),
                _ => {}
            }
        }
    }

    /// Opens a tool, or closes it if it is open. If all tools are hidden, shows them with this one open.
    pub(super) fn toggle(&mut self, tool: Tool) {
        if !std::mem::take(&mut self.hidden) && self.layout.is_open(tool) {
            self.layout.set_open(tool, false);
        } else {
            self.layout.reveal(tool);
        }
    }
}

/// Selects the camera `step` places further in the list, wrapping around. If none is selected, a step of 1 selects the
/// first camera, and -1 the last.
fn next_camera(viewer: &mut Viewer, step: i64) {
    if !viewer.cameras().is_empty() {
        let now = viewer.camera.map_or(if step > 0 { -1 } else { 0 }, |camera| camera as i64);
        let next = (now + step).rem_euclid(viewer.cameras().len() as i64) as usize;
        viewer.look_through(next);
    }
}
