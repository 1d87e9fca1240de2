//! Draws the cameras tool: field of view or orthographic scale, saved views and the keyframe path. The tool also copies
//! the camera as JSON and the picture as a command line.

use super::controls::{Command, request};
use super::number::{NumberField, Scale};
use super::theme::{self, GRID, ROW};
use super::widgets::{Control as _, fact, heading};
use crate::draw::camera_path::SECONDS;
use crate::view::cameras::write;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::FIELDS_OF_VIEW;
use crate::view::opening::CameraRole;
use crate::view::viewer::Viewer;
use egui::{Button, RichText, Slider, Ui};
use splatgraph_assets::{Camera, Projection};
use std::path::Path;

/// The act of a click on a list, carried out once the list is drawn.
type Act = Option<Box<dyn FnOnce(&mut Viewer)>>;

/// Draws the tool. The copied command line is that of the viewport `selected`.
pub fn show(ui: &mut Ui, viewer: &mut Viewer, selected: RendererId) {
    match viewer.picture_camera().projection {
        Projection::Orthographic => scale(ui, viewer),
        Projection::Equirectangular => {
            ui.label("Panorama, 360 by 180 degrees");
            let text = "Drag with the right button to look around. Pictures have the panel's shape. Players \
                        expect 2:1: change --size in the copied command.";
            ui.weak(text);
        }
        _ => field_of_view(ui, viewer),
    }
    ui.horizontal_wrapped(|ui| {
        if ui
            .button("Copy as JSON")
            .named("copy_camera")
            .hint("The camera in the world's coordinates, as in a cameras.json")
            .clicked()
        {
            let camera = viewer.world_camera();
            ui.copy_text(serde_json::to_string_pretty(&[camera]).unwrap_or_default());
        }
        let command = ui.button("Copy as command").named("copy_command");
        let hint = match viewer.marks(selected).hidden.len() {
            0 => "The `splatgraph render` command that draws this picture".to_owned(),
            hidden => format!(
                "The `splatgraph render` command that draws this picture, with the {hidden} hidden splats: to draw it \
                 without them, save the rest, and open that file"
            ),
        };
        if command.hint(hint).clicked()
            && let Some(line) = viewer.render_command(selected, Path::new("picture.png"))
        {
            ui.copy_text(line);
        }
    });
    views(ui, viewer);
    path(ui, viewer);
}

fn field_of_view(ui: &mut Ui, viewer: &mut Viewer) {
    ui.horizontal(|ui| {
        ui.set_min_height(ROW);
        ui.label("Field of view, vertical");
        let scale = Scale { step: 0.5, ..FIELDS_OF_VIEW.into() };
        let field = NumberField { suffix: "°", ..NumberField::new("field_of_view", "Field of view", scale) };
        let (degrees, width) = (viewer.navigation.field_of_view(), ui.available_width());
        if let Some(degrees) = field.show_with_slider(ui, degrees, width) {
            viewer.navigation.set_field_of_view(degrees);
        }
    });
}

/// Draws the scale of an orthographic view: its height, and the size of a pixel.
fn scale(ui: &mut Ui, viewer: &mut Viewer) {
    let rows = f64::from(viewer.picture_camera().height.max(1));
    for (name, label, rows) in
        [("view_height", "Height of the view", 1.0), ("pixel_size", "Units per pixel", rows)]
    {
        ui.horizontal(|ui| {
            ui.set_min_height(ROW);
            ui.label(label);
            let value = viewer.navigation.height() / rows;
            let scale = Scale { min: f64::MIN_POSITIVE, max: f64::INFINITY, step: 0.0 };
            let field = NumberField { speed: 0.002 * value, ..NumberField::new(name, label, scale) };
            if let (_, Some(value)) = field.show(ui, value) {
                viewer.navigation.set_height(value * rows);
            }
        });
    }
}

fn views(ui: &mut Ui, viewer: &mut Viewer) {
    heading(ui, "Saved views");
    // Above the list: below it, a new row would move under the pointer, and a second click would remove the view.
    ui.horizontal_wrapped(|ui| {
        if ui.button("Save this view").named("save_view").clicked() {
            viewer.save_view("view");
        }
        write_button(ui, viewer, "views", |viewer| viewer.views.list());
        read_button(ui, CameraRole::Views, "Adds the cameras of a cameras.json");
    });
    let mut act: Act = None;
    for (index, view) in viewer.views.list().iter().enumerate() {
        ui.horizontal(|ui| {
            let go = ui.add(Button::new(&view.img_name).truncate()).named(&format!("view:{index}"));
            if go.clicked() {
                act = Some(Box::new(move |viewer| viewer.look_through_view(index)));
            }
            if ui.small_button("✗").hint("Remove this view").clicked() {
                act = Some(Box::new(move |viewer| viewer.views.remove(index)));
            }
        });
    }
    act.into_iter().for_each(|act| act(viewer));
}

fn path(ui: &mut Ui, viewer: &mut Viewer) {
    heading(ui, "Path");
    ui.horizontal_wrapped(|ui| {
        if ui.button("Add this view (K)").named("record_key").clicked() {
            record(viewer);
        }
        write_button(ui, viewer, "path", |viewer| viewer.path.keys());
        read_button(ui, CameraRole::Path, "Replaces the keys by the cameras of a cameras.json");
    });
    let times = viewer.path.key_seconds();
    let mut act: Act = None;
    let count = viewer.path.keys().len();
    for index in 0..count {
        ui.horizontal(|ui| {
            let seconds = times.get(index).copied().unwrap_or(0.0);
            let go = ui.button(format!("Keyframe {}", index + 1)).named(&format!("key:{index}"));
            if go.clicked() {
                act = Some(Box::new(move |viewer| viewer.seek_path(seconds)));
            }
            ui.weak(format!("{seconds:.1} s"));
            if ui.add_enabled(index > 0, Button::new("↑")).hint("Earlier").clicked() {
                act = Some(Box::new(move |viewer| viewer.path.reorder(index, index - 1)));
            }
            if ui.add_enabled(index + 1 < count, Button::new("↓")).hint("Later").clicked() {
                act = Some(Box::new(move |viewer| viewer.path.reorder(index, index + 1)));
            }
            if ui.small_button("✗").hint("Remove this keyframe").clicked() {
                act = Some(Box::new(move |viewer| viewer.path.remove(index)));
            }
        });
    }
    act.into_iter().for_each(|act| act(viewer));
    if count < 2 {
        ui.weak("A path needs at least two keyframes.");
        return;
    }
    ui.horizontal(|ui| {
        let text = if viewer.play.is_playing() { "Pause (P)" } else { "Play (P)" };
        let play = ui.button(text).named("play");
        if play.clicked() {
            toggle(viewer);
        }
        let mut closed = viewer.path.is_closed();
        if ui.checkbox(&mut closed, "closed").changed() {
            viewer.path.set_closed(closed);
        }
        let field = NumberField::new("path_seconds", "Length of the path", SECONDS);
        let field = NumberField { speed: 0.1, suffix: " s", ..field };
        if let (_, Some(seconds)) = field.show(ui, viewer.path.seconds()) {
            viewer.path.set_seconds(seconds);
        }
    });
    let mut at = viewer.play.position();
    ui.spacing_mut().slider_width = (ui.available_width() - 2.0 * GRID).max(60.0);
    let seek = Slider::new(&mut at, 0.0..=viewer.path.seconds()).show_value(false);
    let seek = ui.add(seek.clamping(egui::SliderClamping::Never)).named("seek");
    if seek.changed() {
        viewer.seek_path(at);
    }
    ui.label(RichText::new(format!("{at:.2} s")).family(theme::strong()));
    fact(ui, "Speed", "constant, rotation included");
}

fn read_button(ui: &mut Ui, role: CameraRole, about: &str) {
    if ui.button("Read a file…").hint(about).clicked() {
        request(ui.ctx(), Command::Open(Some(role)));
    }
}

fn write_button(ui: &mut Ui, viewer: &mut Viewer, stem: &str, cameras: fn(&Viewer) -> &[Camera]) {
    let button = ui.add_enabled(!cameras(viewer).is_empty(), Button::new("Write a file"));
    let button = button.named(&format!("write_{stem}"));
    if button.hint(format!("Writes {stem}-1.cameras.json, or the next free name")).clicked() {
        let event = match write(cameras(viewer), &viewer.folder, stem) {
            Ok(path) => {
                let written = cameras(viewer).to_vec();
                viewer.in_files.extend(written);
                Event::Saved { path }
            }
            Err(error) => Event::FileFailed { path: error.path.clone(), error: error.to_string() },
        };
        viewer.report(event);
    }
}

/// Adds the view to the path; returns a confirmation, or reports the error and returns `None`.
pub fn record(viewer: &mut Viewer) -> Option<String> {
    match viewer.record_key() {
        Ok(()) => Some(format!("Keyframe {} added to the path", viewer.path.keys().len())),
        Err(error) => {
            viewer.report(Event::Problem { text: error.to_string() });
            None
        }
    }
}

/// Plays the path, or pauses it. Reports a path that is too short to be played.
pub fn toggle(viewer: &mut Viewer) {
    if viewer.play.is_playing() {
        viewer.play.pause();
    } else if viewer.path.keys().len() > 1 {
        viewer.play.play(&viewer.path);
    } else {
        let count = viewer.path.keys().len();
        let text = format!("expected a path of at least 2 keyframes, found {count}; K adds the view");
        viewer.report(Event::Problem { text });
    }
}
