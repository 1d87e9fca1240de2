//! Draws the bar at the top: scene, camera, graph, comparison, tools, view menu, and frame time.

use super::controls::{request, see};
use super::hud;
use super::layout::Tool;
use super::number::NumberField;
use super::select::SelectTool;
use super::theme::{self, GRID, Palette};
use super::widgets::{self, Control as _};
use super::{Command, Panels, presets::file_name};
use crate::view::events::RendererId;
use crate::view::paint::Mode;
use crate::view::profile::CAPTURES;
use crate::view::viewer::Viewer;
use egui::color_picker::{Alpha, color_picker_color32};
use egui::{
    Align, Button, Color32, Layout, Popup, PopupCloseBehavior, Rect, Response, RichText, TextStyle, Ui,
    UiBuilder, gui_zoom, pos2,
};
use splatgraph_assets::{Camera, grouped};
use std::path::{Path, PathBuf};

const LIST: f32 = 400.0;

/// Up directions to choose from: y points down in most captures, and z up in maps.
const UPS: [(&str, [f64; 3]); 4] =
    [("-y", [0.0, -1.0, 0.0]), ("+y", [0.0, 1.0, 0.0]), ("-z", [0.0, 0.0, -1.0]), ("+z", [0.0, 0.0, 1.0])];

/// Width of buttons with file titles, in points.
const TITLE: f32 = 132.0;

/// Minimum width for the frame time, in points. With less space, it is hidden.
const TIME: f32 = 120.0;
/// Minimum width for the device name and splat count beside the frame time, in points. With less space, they are
/// hidden.
const DEVICE: f32 = 320.0;

/// Draws a button of a fixed `width` that opens a list below it. The list stays open until a click outside. The title
/// is `start` followed by `text`, which is truncated at its start.
fn drop_down(ui: &mut Ui, start: &str, text: &str, width: f32, contents: impl FnOnce(&mut Ui)) -> Response {
    let room = width - 2.0 * ui.spacing().button_padding.x;
    let font = TextStyle::Button.resolve(ui.style());
    let title = widgets::ending(ui, &font, [start, text, "  ▼"], room);
    // The width does not depend on the text, so that neighbouring controls do not move.
    let button = ui.add_sized([width, theme::ROW], Button::new(title).truncate());
    // The list must not cover its button: the second click of a double click would choose something.
    let room = (ui.ctx().content_rect().bottom() - button.rect.bottom() - 8.0 * GRID).max(40.0);
    Popup::menu(&button).close_behavior(PopupCloseBehavior::CloseOnClickOutside).width(LIST).show(|ui| {
        ui.set_min_width(LIST);
        // By default, egui limits the height of a menu to 400 points.
        egui::ScrollArea::vertical().max_height(room).min_scrolled_height(room).show(ui, |ui| {
            contents(ui);
            widgets::follow_focus(ui);
        });
    });
    widgets::return_focus(ui, &button);
    button
}

impl Panels {
    pub(super) fn top_bar(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let mut compare = viewer.compare;
        ui.horizontal_wrapped(|ui| {
            ui.spacing_mut().item_spacing.x = GRID;
            self.scene_list(ui, viewer);
            self.camera_list(ui, viewer);
            self.graph_list(ui, viewer);
            widgets::divider(ui);
            for (name, mode, control, about) in [
                ("A", Mode::A, "compare:off", "Show A alone"),
                ("A | B", Mode::Split, "compare:split", "A and B side by side; drag the line between them"),
                ("A − B", Mode::Difference, "compare:difference", "The amplified difference of A and B"),
            ] {
                ui.selectable_value(&mut compare, mode, name).named(control).hint(about);
            }
            if compare != viewer.compare {
                viewer.choose_compare(compare);
            }
            if viewer.compare != Mode::A {
                self.comparison_controls(ui, viewer);
            }
            widgets::divider(ui);
            self.tool_toggles(ui);
            widgets::divider(ui);
            self.view_menu(ui, viewer);
            let (start, end) = (ui.cursor().min, ui.max_rect().right());
            if end - start.x > TIME {
                // Drawn in a child that does not affect the bar's size, so that long texts do not resize the picture.
                let rest = Rect::from_min_max(start, pos2(end, start.y + theme::ROW));
                let layout = Layout::right_to_left(Align::Center);
                let mut rest = ui.new_child(UiBuilder::new().max_rect(rest).layout(layout));
                self.readout(&mut rest, viewer);
            }
        });
    }

    fn scene_list(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let selected = self.selected;
        let path = viewer.scene_path_of(selected).to_owned();
        self.remember_scene(&path);
        let (recent, search) = (&self.recent, &mut self.scene_search);
        let mut chosen = None;
        let title = file_name(&path.to_string_lossy());
        let button = drop_down(ui, whose(selected), &title, TITLE, |ui| {
            let rank = |scene: &&PathBuf, wanted: &str| {
                let path = scene.to_string_lossy();
                widgets::rank(wanted, &[&file_name(&path)], &path)
            };
            let is_current = |scene: &&PathBuf| **scene == recent[0];
            let row = |ui: &mut Ui, scene: &&PathBuf| {
                let path = scene.display().to_string();
                let item = ui.selectable_label(is_current(scene), with_folder(scene));
                (format!("scene:{path}"), item.hint(path))
            };
            let search = (search, "scene_search", true);
            chosen = widgets::list(ui, search, recent, rank, is_current, row).cloned();
        });
        let of = if selected == RendererId::B { "Scene of B" } else { "Scene" };
        button.named("scene").hint(format!("{of}: {}", path.display()));
        if let Some(path) = chosen.filter(|path| *path != self.recent[0]) {
            viewer.open_scene_in(selected, &path);
        }
    }

    fn camera_list(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let names: Vec<[String; 2]> = viewer.cameras().iter().enumerate().map(camera_name).collect();
        let (cameras, now) = (viewer.cameras(), viewer.shown_camera());
        let search = &mut self.camera_search;
        let mut chosen = None;
        let [number, name] =
            now.map_or(["", "free camera"], |index| names[index].each_ref().map(String::as_str));
        let button = drop_down(ui, number, name, TITLE, |ui| {
            if names.is_empty() {
                ui.weak("Drop a cameras.json on the window to list its cameras.");
                return;
            }
            let items = names.iter().map(|[number, name]| format!("{number}{name}")).enumerate();
            let rank = |(index, name): &(usize, String), wanted: &str| {
                widgets::rank(wanted, &[name, &cameras[*index].img_name], "")
            };
            let is_current = |(index, _): &(usize, String)| now == Some(*index);
            let row = |ui: &mut Ui, item: &(usize, String)| {
                (format!("camera:{}", item.0), ui.selectable_label(is_current(item), &item.1))
            };
            let search = (search, "camera_search", false);
            let found = widgets::list(ui, search, items, rank, is_current, row);
            chosen = found.map(|(index, _)| index);
        });
        button.named("camera").hint(format!("{number}{name}\nCamera; [ and ] go through the list"));
        if let Some(index) = chosen {
            viewer.look_through(index);
        }
    }

    fn graph_list(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let selected = self.selected;
        let Some(viewport) = viewer.viewport(selected) else { return };
        let presets = &mut self.presets;
        let title = file_name(viewport.renderer.graph());
        let mut chosen = None;
        let button = drop_down(ui, whose(selected), &title, TITLE, |ui| {
            chosen = presets.show(ui, &viewport.renderer);
        });
        let about = viewport.renderer.plan().map_or(String::new(), |plan| format!("\n{}", plan.summary));
        button.named("graph").hint(format!("Graph: {}{about}", viewport.renderer.graph()));
        if let Some(graph) = chosen.filter(|graph| graph != viewport.renderer.graph()) {
            viewer.choose_graph(selected, &graph);
        }
    }

    fn comparison_controls(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        widgets::divider(ui);
        ui.weak("edit");
        for (name, id) in [("A", RendererId::A), ("B", RendererId::B)] {
            let response =
                ui.selectable_value(&mut self.selected, id, name).named(&format!("viewport:{name}"));
            response.hint(format!("All tools show {name}: its graph, parameters and times"));
        }
        if ui.button("Swap").named("swap").hint("Exchange A and B").clicked() {
            viewer.exchange();
        }
        let measure = ui.add_enabled(!viewer.is_comparing(), Button::new("Measure")).named("measure");
        if measure.hint("Compute PSNR, SSIM and the worst pixel of this view").clicked() {
            viewer.measure();
            self.marked = false;
        }
        if viewer.compare == Mode::Difference {
            let field = NumberField::new("gain", "Amplification", 0.0..=65_536.0);
            let field = NumberField { speed: 0.1, prefix: "x ", ..field };
            let (response, gain) = field.show(ui, viewer.gain.into());
            response.hint("Amplification of the difference");
            if let Some(gain) = gain {
                viewer.gain = gain as f32;
            }
        }
    }

    fn tool_toggles(&mut self, ui: &mut Ui) {
        for tool in Tool::ALL {
            let mut open = self.layout.is_open(tool);
            let response = ui.toggle_value(&mut open, tool.title()).named(&format!("panel:{}", tool.title()));
            if response.clicked() {
                self.toggle(tool);
            }
        }
    }

    fn view_menu(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let button = drop_down(ui, "", "View", 72.0, |ui| {
            if ui.button("Open a file… (Ctrl + O)").named("open").clicked() {
                request(ui.ctx(), Command::Open(None));
                ui.close();
            }
            ui.horizontal(|ui| {
                for (name, text, redo, enabled) in [
                    ("undo", "Undo", false, self.undo.can_undo()),
                    ("redo", "Redo", true, self.undo.can_redo()),
                ] {
                    if ui.add_enabled(enabled, Button::new(text)).named(name).clicked() {
                        self.step(viewer, redo);
                    }
                }
            });
            ui.horizontal(|ui| {
                if ui.button("Fit the scene (F)").named("fit").clicked() {
                    let camera = viewer.picture_camera();
                    viewer.navigation.frame([camera.width, camera.height].map(f64::from));
                }
                if ui.button("First view (Home)").named("home").clicked() {
                    viewer.navigation.home();
                }
            });
            ui.horizontal(|ui| {
                ui.label("Up");
                for (name, up) in UPS {
                    let is_up = viewer.navigation.up().abs_diff_eq(up.into(), 1e-3);
                    let button = ui.selectable_label(is_up, name);
                    if button.named(&format!("up:{name}")).clicked() {
                        viewer.show_upright(Some(up));
                    }
                }
                let reset = ui.button("Reset").named("up:reset");
                if reset
                    .hint("The direction of the cameras, or else of the file. Files keep theirs")
                    .clicked()
                {
                    viewer.show_upright(None);
                }
            });
            if ui.button("Select splats (R, B)").named("select").clicked() {
                self.select.toggle(SelectTool::Box);
                ui.close();
            }
            ui.checkbox(&mut self.hud, "Times and messages on the picture");
            let continuous = ui.checkbox(&mut viewer.continuous, "Draw continuously (C)").named("continuous");
            continuous.hint("Draws every frame, even if nothing changes, to measure times");
            ui.checkbox(&mut self.vsync, "Wait for the display (V)");
            let mut light = ui.theme() == egui::Theme::Light;
            let theme = ui.checkbox(&mut light, "Light theme (T)").named("theme");
            if theme.clicked() {
                ui.set_theme(if light { egui::Theme::Light } else { egui::Theme::Dark });
            }
            ui.horizontal(|ui| {
                ui.label("Pixels per pixel of the window");
                let field = NumberField::new("scale", "Pixels per pixel of the window", 0.05..=4.0);
                let field = NumberField { speed: 0.01, ..field };
                if let (_, Some(scale)) = field.show(ui, viewer.scale.into()) {
                    viewer.scale = scale as f32;
                }
            });
            ui.menu_button("Size of texts", gui_zoom::zoom_menu_buttons);
            // A menu: a popup of its own, such as that of egui's button for colours, would close this menu.
            let background = ui.menu_button("Background", |ui| {
                let [r, g, b] = viewer.background.map(|channel| (255.0 * channel).round() as u8);
                let mut colour = Color32::from_rgb(r, g, b);
                if color_picker_color32(ui, &mut colour, Alpha::Opaque) {
                    viewer.background =
                        [colour.r(), colour.g(), colour.b()].map(|byte| f32::from(byte) / 255.0);
                }
                see(ui.ctx(), "background:colours", ui.min_rect());
            });
            background.response.named("background");
            let capture = CAPTURES.map(|with| format!("Capture the next frame with {with}"));
            for (text, command) in [
                (Some("Save the window (F12)".to_owned()), Command::Screenshot),
                (Some("Save the picture (Shift + F12)".to_owned()), Command::SavePicture),
                (capture, Command::Capture),
                (Some("Full screen (F11)".to_owned()), Command::Fullscreen),
            ] {
                if text.is_some_and(|text| ui.button(text).clicked()) {
                    request(ui.ctx(), command);
                    ui.close();
                }
            }
            if ui.button("Keys and mouse (F1)").clicked() {
                self.help = true;
                ui.close();
            }
        });
        button.named("menu");
    }

    fn readout(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let palette = Palette::of(ui);
        let splats = format!("{} splats", grouped(viewer.scene_of(self.selected).count().into()));
        let interval = self.interval();
        let Some(viewport) = viewer.viewport(self.selected) else { return };
        let mut parts = Vec::new();
        if let Some(total) = viewport.history.total() {
            parts.push(widgets::time(total.median));
        }
        parts.extend(interval.map(hud::rate));
        let time = parts.join("  ");
        if ui.available_width() < TIME + DEVICE {
            ui.label(RichText::new(time).family(theme::strong()));
            return;
        }
        let device = viewport.renderer.info().name.clone();
        let rest = ui.add(
            egui::Label::new(RichText::new(format!("{device}   {splats}")).color(palette.soft)).truncate(),
        );
        rest.hint(format!("{device}\n{splats}"));
        ui.label(RichText::new(time).family(theme::strong()));
    }
}

fn whose(selected: RendererId) -> &'static str {
    if selected == RendererId::B { "B: " } else { "" }
}

/// Returns a scene's name with its folder, which distinguishes the `point_cloud.ply` of several captures.
fn with_folder(scene: &Path) -> String {
    let folder = scene.parent().and_then(Path::file_name).map(|name| name.to_string_lossy());
    let name = file_name(&scene.to_string_lossy());
    folder.map_or(name.clone(), |folder| format!("{name}   ({folder})"))
}

/// Returns the two parts of a camera's title: its number, as in `3: `, and its name. For a camera without a name, they
/// are empty and `camera 3`.
fn camera_name((index, camera): (usize, &Camera)) -> [String; 2] {
    match camera.img_name.as_str() {
        "" => [String::new(), format!("camera {index}")],
        name => [format!("{index}: "), name.to_owned()],
    }
}
