//! Converts pointer and key input over the picture to camera motion, moves of the split line, and splat selection.

use super::keyboard::{Keyboard, is_plain};
use super::{hud, select};
use crate::view::events::RendererId;
use crate::view::navigation::Input;
use crate::view::paint::Mode;
use crate::view::viewer::Viewer;
use crate::view::wheel::Wheel;
use egui::{CursorIcon, Key, PointerButton, Pos2, Rect, Sense, Ui};

/// Maximum distance to the split line at which a drag moves it, in points.
const GRIP: f32 = 6.0;

/// Speed of zooming with `+` and `-`, in notches of the wheel.
const NOTCHES_PER_SECOND: f64 = 8.0;

/// Action of a drag that began over the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drag {
    #[default]
    Camera,
    Split,
    Select,
}

impl Drag {
    /// Applies the input of this frame to the camera, the split line or the selection. Returns a click's viewport and
    /// its position, in pixels of the picture; `None` without a click, for the second click of a double click, or if
    /// the brush consumed it.
    pub fn act(
        &mut self,
        ui: &mut Ui,
        view: Rect,
        viewer: &mut Viewer,
        wheel: &mut Wheel,
        select: &mut select::State,
        keyboard: &Keyboard,
    ) -> Option<(RendererId, [f32; 2])> {
        // The view never takes keyboard focus: without a focused control, keys already go to the camera.
        let response = ui.interact(view, ui.scope_id().with("view"), Sense::CLICK | Sense::DRAG);
        let line = view.left() + viewer.split * view.width();
        let pointer = ui.input(|input| input.pointer.latest_pos());
        let splits = viewer.compare == Mode::Split;
        let near = splits && response.hovered() && pointer.is_some_and(|p| (p.x - line).abs() <= GRIP);
        if response.drag_started() {
            let origin = ui.input(|input| input.pointer.press_origin());
            let on_line = splits && origin.is_some_and(|p| (p.x - line).abs() <= GRIP);
            let selects = select.is_active() && response.drag_started_by(PointerButton::Primary);
            *self = match origin {
                _ if on_line => Drag::Split,
                Some(at) if selects => {
                    let id = viewport_at(viewer, view, at);
                    select.begin(id, at, ui.input(|input| input.modifiers));
                    Drag::Select
                }
                _ => Drag::Camera,
            };
        }
        // The beginning of a drag is not a click, so open menus must be closed here.
        if response.is_pointer_button_down_on() {
            egui::Popup::close_all(ui.ctx());
        }
        let dragged = |button| response.dragged_by(button);
        let moves_line = *self == Drag::Split && splits && dragged(PointerButton::Primary);
        if moves_line && let Some(p) = pointer {
            viewer.split = ((p.x - view.left()) / view.width().max(1.0)).clamp(0.0, 1.0);
        }
        let selects = *self == Drag::Select;
        if selects {
            let moved = |event: &egui::Event| match event {
                egui::Event::PointerMoved(at) => Some(*at),
                _ => None,
            };
            select.extend(ui.input(|input| input.events.iter().filter_map(moved).collect::<Vec<_>>()));
            if response.drag_stopped() {
                select.end(view, viewer);
                *self = Drag::Camera;
            }
        }
        if select.is_active() && response.hovered() {
            ui.ctx().set_cursor_icon(CursorIcon::Crosshair);
        }
        if splits {
            let line = view.left() + viewer.split * view.width();
            hud::side(ui, view, line, "A", -1.0);
            hud::side(ui, view, line, "B", 1.0);
        }
        if near || moves_line {
            ui.ctx().set_cursor_icon(CursorIcon::ResizeHorizontal);
        }
        let notch = ui.ctx().options(|options| options.input_options.line_scroll_speed);
        let scrolled = ui.input(|input| wheel.read(input, notch));
        let (moved, modifiers, seconds) =
            ui.input(|input| (input.pointer.delta(), input.modifiers, input.stable_dt));
        let held = |key| f64::from(keyboard.held_plainly(key));
        let along = |more, less| held(more) - held(less);
        // Ctrl slows a flight down.
        let flown = |key| f64::from(keyboard.held(key));
        let flown_along = |more, less| flown(more) - flown(less);
        // With the brush, these keys change its radius.
        let zooms = if select.is_brush() || !is_plain(modifiers) {
            0.0
        } else {
            NOTCHES_PER_SECOND
                * f64::from(seconds)
                * (held(Key::Plus).max(held(Key::Equals)) - held(Key::Minus))
        };
        // While the split line is dragged, flights, paths, keys and the wheel still move the camera.
        let orbits =
            !moves_line && (dragged(PointerButton::Primary) && !selects || dragged(PointerButton::Middle));
        // Flying starts with the button press, without any motion.
        let flies = !moves_line
            && response.is_pointer_button_down_on()
            && ui.input(|input| input.pointer.button_down(PointerButton::Secondary));
        let any = response.dragged() || flies;
        let over = response.hovered() || any;
        // Two fingers on a touchpad act like a drag with the left button.
        let swipes = over && !any && scrolled.swiped != [0.0; 2];
        let moved = if any { [moved.x.into(), moved.y.into()] } else { scrolled.swiped };
        viewer.navigate(&Input {
            size: [view.width().into(), view.height().into()],
            moved: if any || swipes { moved } else { [0.0; 2] },
            drags: orbits || swipes,
            flies,
            shift: modifiers.shift,
            ctrl: modifiers.ctrl,
            scroll: zooms + if over { scrolled.notches } else { 0.0 },
            fly: [flown_along(Key::D, Key::A), flown_along(Key::E, Key::Q), flown_along(Key::W, Key::S)],
            orbit: [along(Key::ArrowRight, Key::ArrowLeft), along(Key::ArrowDown, Key::ArrowUp)],
            frame: keyboard.pressed(Key::F) || response.double_clicked() && !select.is_brush(),
            home: keyboard.pressed(Key::Home),
            seconds: seconds.into(),
        });
        let clicked = response.clicked() && (select.is_brush() || !response.double_clicked());
        let at = response.interact_pointer_pos().filter(|_| clicked)?;
        let id = viewport_at(viewer, view, at);
        if select.is_brush() {
            select.begin(id, at, modifiers);
            select.end(view, viewer);
            return None;
        }
        let camera = viewer.picture_camera();
        let share = (at - view.min) / view.size();
        Some((id, [share.x * camera.width as f32, share.y * camera.height as f32]))
    }
}

fn viewport_at(viewer: &Viewer, view: Rect, at: Pos2) -> RendererId {
    let share = (at.x - view.left()) / view.width().max(1.0);
    if viewer.compare == Mode::Split && share > viewer.split { RendererId::B } else { RendererId::A }
}
