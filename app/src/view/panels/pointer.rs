//! Converts pointer and keys over the picture to input of the camera and the split line.

use crate::view::navigation::{self, Buttons, Input, Keys, Modifiers};
use crate::view::paint::Mode;
use crate::view::viewer::Viewer;
use egui::{Color32, CursorIcon, Key, PointerButton, Rect, Sense, Ui};
use splatgraph_api::Device;

/// Largest distance to the split line at which a drag moves it, in points.
const GRIP: f32 = 6.0;

/// The object of a drag that began over the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drag {
    /// The camera.
    #[default]
    Camera,
    /// The line between A and B.
    Split,
}

impl Drag {
    /// Applies the input of the last frame.
    pub fn act<D: Device>(&mut self, ui: &mut Ui, view: Rect, viewer: &mut Viewer<D>) {
        // The keyboard is the camera's wherever no control has it: the view takes no focus of its own.
        let response = ui.interact(view, ui.scope_id().with("view"), Sense::CLICK | Sense::DRAG);
        let line = view.left() + viewer.split * view.width();
        let pointer = ui.input(|input| input.pointer.latest_pos());
        let splits = viewer.compare == Mode::Split;
        let near = splits && response.hovered() && pointer.is_some_and(|p| (p.x - line).abs() <= GRIP);
        if response.drag_started() {
            let origin = ui.input(|input| input.pointer.press_origin());
            let on_line = splits && origin.is_some_and(|p| (p.x - line).abs() <= GRIP);
            *self = if on_line { Drag::Split } else { Drag::Camera };
        }
        let dragged = |button| response.dragged_by(button);
        let moves_line = *self == Drag::Split && splits && dragged(PointerButton::Primary);
        if moves_line && let Some(p) = pointer {
            viewer.split = ((p.x - view.left()) / view.width().max(1.0)).clamp(0.0, 1.0);
        }
        if splits {
            let line = view.left() + viewer.split * view.width();
            label(ui, view, line, "A", -1.0);
            label(ui, view, line, "B", 1.0);
        }
        if moves_line {
            ui.ctx().set_cursor_icon(CursorIcon::ResizeHorizontal);
            return;
        }
        if near {
            ui.ctx().set_cursor_icon(CursorIcon::ResizeHorizontal);
        }
        let keyboard = !ui.ctx().egui_wants_keyboard_input();
        let notch = ui.ctx().options(|options| options.input_options.line_scroll_speed);
        let (moved, modifiers, scroll, seconds) = ui.input(|input| {
            // With Shift, egui scrolls to the side; with Ctrl, it makes a zoom factor of it.
            let scrolled = input.smooth_scroll_delta();
            let scrolled = if input.modifiers.shift { scrolled.x + scrolled.y } else { scrolled.y };
            // Two fingers on a touchpad zoom by a factor, too.
            let zoomed = f64::from(input.zoom_delta()).ln() / navigation::ZOOM_PER_NOTCH;
            let notches = f64::from(scrolled / notch) + zoomed;
            (input.pointer.delta(), input.modifiers, notches, input.unstable_dt)
        });
        let held = |key| keyboard && ui.input(|input| input.key_down(key));
        let pressed = |key| keyboard && ui.input(|input| input.key_pressed(key));
        // Flying begins with the press: it need not move the pointer.
        let flies = response.is_pointer_button_down_on()
            && ui.input(|input| input.pointer.button_down(PointerButton::Secondary));
        let any = response.dragged() || flies;
        viewer.navigation.update(&Input {
            size: [view.width().into(), view.height().into()],
            moved: if any { [moved.x.into(), moved.y.into()] } else { [0.0; 2] },
            buttons: Buttons {
                left: dragged(PointerButton::Primary),
                middle: dragged(PointerButton::Middle),
                right: flies,
            },
            modifiers: Modifiers { shift: modifiers.shift, ctrl: modifiers.ctrl },
            scroll: if response.hovered() || any { scroll } else { 0.0 },
            keys: Keys {
                forward: held(Key::W),
                back: held(Key::S),
                left: held(Key::A),
                right: held(Key::D),
                rise: held(Key::E),
                sink: held(Key::Q),
                orbit_left: held(Key::ArrowLeft),
                orbit_right: held(Key::ArrowRight),
                orbit_up: held(Key::ArrowUp),
                orbit_down: held(Key::ArrowDown),
            },
            frame: pressed(Key::F) || response.double_clicked(),
            home: pressed(Key::Home),
            seconds: seconds.into(),
        });
    }
}

/// Draws the name of a viewport next to the split line, on the half `towards`.
fn label(ui: &Ui, view: Rect, line: f32, text: &str, towards: f32) {
    let at = egui::pos2(line + towards * 16.0, view.top() + 16.0);
    if view.contains(at) {
        ui.painter().circle_filled(at, 10.0, Color32::from_black_alpha(140));
        let font = egui::FontId::proportional(13.0);
        ui.painter().text(at, egui::Align2::CENTER_CENTER, text, font, Color32::WHITE);
    }
}
