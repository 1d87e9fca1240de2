//! Draws the panels around the picture.
//!
//! Parameters and presets are at the left, times and memory at the right, the graph and its resources below, and errors over the
//! picture. Panels read and change a [`Viewer`]; they do not depend on a window, so tests can click through them.

mod failures;
mod graph;
mod inspector;
mod params;
mod performance;
mod pointer;
mod presets;

use super::events::{Event, RendererId};
use super::history::History;
use super::paint::Mode;
use super::profile::CAPTURES;
use super::viewer::Viewer;
use egui::{Align2, CentralPanel, Color32, Context, Frame, Panel, Rect, RichText, Ui};
use presets::{Presets, file_name};
use splatgraph_api::Device;
use splatgraph_framework::plan::Plan;
use splatgraph_framework::reload::WatchKind;
use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

pub use params::set_line;

/// Height of the status line, also when it is empty, in points.
const STATUS: f32 = 20.0;

/// Colour of what works in part, in the status line.
const PARTIAL: Color32 = Color32::from_rgb(230, 200, 120);

/// Number of lines in the log.
const LOG: usize = 200;

/// A request to the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Save the window's picture.
    Screenshot,
    /// Save the picture of A alone, in its own size.
    SavePicture,
    /// Turn waiting for the display's refresh on or off.
    Vsync(bool),
    /// Capture the next frame.
    Capture,
    /// Switch full screen on or off.
    Fullscreen,
}

/// Places of the controls in the last frame, by name, in points, for scripted input.
#[derive(Clone, Debug, Default)]
pub struct Controls {
    now: BTreeMap<String, Rect>,
}

impl Controls {
    /// Records the place of a control.
    pub(super) fn see(&mut self, name: &str, rect: Rect) {
        self.now.insert(name.to_owned(), rect);
    }

    /// Returns the place of a control in the last frame.
    pub fn find(&self, name: &str) -> Option<Rect> {
        self.now.get(name).copied()
    }

    /// Iterates over all controls.
    pub fn iter(&self) -> impl Iterator<Item = (&str, Rect)> {
        self.now.iter().map(|(name, rect)| (name.as_str(), *rect))
    }
}

/// The results of a frame of the panels.
#[derive(Clone, Debug)]
pub struct PanelOutput {
    /// Place of the picture, in points.
    pub view: Rect,
    /// Requests to the window.
    pub commands: Vec<Command>,
}

/// The state of the panels.
pub struct Panels {
    /// True to show the picture alone.
    pub hidden: bool,
    /// True to show the left panel.
    pub settings: bool,
    /// True to show the right panel.
    pub performance: bool,
    /// True to show the bottom panel.
    pub graph: bool,
    /// True if frames wait for the display.
    pub vsync: bool,
    /// Renderer of the shown parameters and times.
    pub selected: RendererId,
    /// Places of the controls.
    pub controls: Controls,
    /// True to show the list of keys.
    pub help: bool,
    /// Text over the picture until it is dismissed.
    notice: Option<String>,
    presets: Presets,
    log: VecDeque<String>,
    graph_state: graph::State,
    inspector: inspector::State,
    drag: pointer::Drag,
    /// Milliseconds between recent frames.
    frame_ms: VecDeque<f64>,
    /// Phase with plotted passes.
    plotted: Option<String>,
    /// Start of the last frame.
    before: Option<Instant>,
    /// Number of frames of A at that time.
    drawn: u64,
}

impl Default for Panels {
    fn default() -> Panels {
        Panels {
            hidden: false,
            settings: true,
            performance: true,
            graph: false,
            vsync: true,
            selected: RendererId::A,
            controls: Controls::default(),
            help: false,
            notice: None,
            presets: Presets::new(),
            log: VecDeque::new(),
            graph_state: graph::State::default(),
            inspector: inspector::State::default(),
            drag: pointer::Drag::default(),
            frame_ms: VecDeque::new(),
            plotted: None,
            before: None,
            drawn: 0,
        }
    }
}

impl Panels {
    /// Adds an event to the log.
    pub fn log_event(&mut self, event: &Event) {
        if event.is_for_people() {
            if self.log.len() == LOG {
                self.log.pop_front();
            }
            self.log.push_back(event.to_string());
        }
    }

    /// Shows a text over the picture until it is dismissed.
    pub fn show_notice(&mut self, text: String) {
        self.notice = Some(text);
    }

    /// Draws the panels and applies the user's input to the viewer.
    pub fn show<D: Device>(
        &mut self,
        ui: &mut Ui,
        viewer: &mut Viewer<D>,
        (window, window_plan): (&History, Option<&Plan>),
        window_failure: Option<&str>,
    ) -> PanelOutput {
        self.controls.now.clear();
        let mut commands = Vec::new();
        self.time(viewer.a.history.frames());
        self.keys(ui.ctx(), viewer, &mut commands);
        if viewer.b.is_none() {
            self.selected = RendererId::A;
        }
        if !self.hidden {
            Panel::top("menu").show(ui, |ui| self.menu(ui, viewer, &mut commands));
            Panel::bottom("status").show(ui, |ui| self.status(ui, viewer));
            if self.graph {
                Panel::bottom("graph")
                    .resizable(true)
                    .default_size(280.0)
                    .show(ui, |ui| self.graph_panel(ui, viewer));
            }
            // Part of the picture must stay visible in small windows.
            let most = 0.45 * ui.available_width();
            if self.settings {
                Panel::left("settings")
                    .resizable(true)
                    .default_size(290.0)
                    .max_size(most)
                    .show(ui, |ui| self.settings_panel(ui, viewer));
            }
            if self.performance {
                let panel = Panel::right("performance").resizable(true).default_size(310.0);
                panel.max_size(most).show(ui, |ui| {
                    // As wide as the panel, which would shrink to its contents otherwise.
                    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                        // Room for the scroll bar.
                        ui.set_max_width((ui.available_width() - 10.0).max(0.0));
                        let frame_ms: Vec<f64> = self.frame_ms.iter().copied().collect();
                        let loaded = viewer.scene().count();
                        if let Some(viewport) = viewer.viewport(self.selected) {
                            performance::show(
                                ui,
                                viewport,
                                loaded,
                                &frame_ms,
                                (window, window_plan),
                                &mut self.plotted,
                            );
                        }
                    });
                });
            }
        }
        let view = CentralPanel::no_frame().show(ui, |ui| self.view(ui, viewer)).inner;
        self.mistakes(ui.ctx(), viewer, window_failure, view);
        self.notice(ui.ctx(), view);
        self.help_window(ui.ctx());
        PanelOutput { view, commands }
    }

    /// Records the time since the last frame.
    fn time(&mut self, drawn: u64) {
        let now = Instant::now();
        // Frames without a picture of the scene do not count.
        if std::mem::replace(&mut self.drawn, drawn) == drawn {
            return;
        }
        if let Some(before) = self.before.replace(now) {
            if self.frame_ms.len() == super::history::WINDOW {
                self.frame_ms.pop_front();
            }
            self.frame_ms.push_back((now - before).as_secs_f64() * 1e3);
        }
    }

    fn keys<D: Device>(&mut self, ctx: &Context, viewer: &mut Viewer<D>, commands: &mut Vec<Command>) {
        if ctx.egui_wants_keyboard_input() {
            return;
        }
        let pressed = |key| ctx.input(|input| input.key_pressed(key));
        let shift = ctx.input(|input| input.modifiers.shift);
        // (Tab and Shift + Tab go from control to control.)
        if pressed(egui::Key::H) {
            self.hidden = !self.hidden;
        }
        if pressed(egui::Key::F12) {
            commands.push(if shift { Command::SavePicture } else { Command::Screenshot });
        }
        if pressed(egui::Key::F11) {
            commands.push(Command::Fullscreen);
        }
        if pressed(egui::Key::F1) {
            self.help = !self.help;
        }
        if pressed(egui::Key::V) {
            self.vsync = !self.vsync;
            commands.push(Command::Vsync(self.vsync));
        }
        let step = i64::from(pressed(egui::Key::CloseBracket)) - i64::from(pressed(egui::Key::OpenBracket));
        if step != 0 && !viewer.cameras.is_empty() {
            let now = viewer.camera.map_or(if step > 0 { -1 } else { 0 }, |camera| camera as i64);
            let next = (now + step).rem_euclid(viewer.cameras.len() as i64) as usize;
            viewer.look_through(next);
        }
    }

    fn menu<D: Device>(&mut self, ui: &mut Ui, viewer: &mut Viewer<D>, commands: &mut Vec<Command>) {
        let mut compare = viewer.compare;
        ui.horizontal_wrapped(|ui| {
            for (name, open) in [
                ("Settings", &mut self.settings),
                ("Performance", &mut self.performance),
                ("Graph", &mut self.graph),
            ] {
                let response = ui.toggle_value(open, name);
                self.controls.see(&format!("panel:{name}"), response.rect);
            }
            ui.separator();
            ui.label("Compare");
            for (name, mode) in [("off", Mode::A), ("split", Mode::Split), ("difference", Mode::Difference)] {
                let response = ui.selectable_value(&mut compare, mode, name);
                self.controls.see(&format!("compare:{name}"), response.rect);
            }
            if compare != Mode::A {
                ui.selectable_value(&mut self.selected, RendererId::A, "A")
                    .on_hover_text("Settings and times of A");
                let b = ui
                    .selectable_value(&mut self.selected, RendererId::B, "B")
                    .on_hover_text("Settings and times of B");
                self.controls.see("viewport:B", b.rect);
                if ui.button("swap").on_hover_text("Exchange A and B").clicked() {
                    viewer.exchange();
                }
                let measure = ui.button("measure").on_hover_text("Compute PSNR and SSIM of A and B");
                self.controls.see("measure", measure.rect);
                if measure.clicked() {
                    viewer.measure();
                }
            }
            if compare == Mode::Difference {
                ui.add(egui::Slider::new(&mut viewer.gain, 1.0..=256.0).logarithmic(true).text("x"))
                    .on_hover_text("Amplification of the difference");
            }
            ui.separator();
            let scale = egui::DragValue::new(&mut viewer.scale).range(0.1..=2.0).speed(0.01).prefix("scale ");
            let scale = ui.add(scale.update_while_editing(false));
            self.controls.see("scale", scale.rect);
            scale.on_hover_text("Pixels of the picture per pixel of the window, across and down");
            if ui.toggle_value(&mut self.vsync, "vsync").on_hover_text("V").changed() {
                commands.push(Command::Vsync(self.vsync));
            }
            if let Some(with) = CAPTURES {
                let hover = format!("Capture the next frame with {with}");
                if ui.button("Capture").on_hover_text(hover).clicked() {
                    commands.push(Command::Capture);
                }
            }
            if ui.button("?").on_hover_text("Keys and mouse (F1)").clicked() {
                self.help = !self.help;
            }
        });
        if compare != viewer.compare {
            viewer.choose_compare(compare);
        }
    }

    fn status<D: Device>(&mut self, ui: &mut Ui, viewer: &mut Viewer<D>) {
        ui.horizontal(|ui| {
            ui.set_min_height(STATUS);
            if let Some(path) = viewer.loading() {
                ui.spinner();
                ui.label(format!("loading {}", path.display()));
            }
            for id in [RendererId::A, RendererId::B] {
                let Some(viewport) = viewer.viewport(id) else { continue };
                let progress = viewport.renderer.progress();
                if !progress.is_empty() {
                    ui.spinner();
                    ui.label(format!("{id}: {progress}"));
                }
                if let Some(text) = viewport.stand_in() {
                    let label = ui.add(
                        egui::Label::new(RichText::new(format!("{id}: {text}")).color(PARTIAL)).truncate(),
                    );
                    self.controls.see(&format!("stand_in:{id}"), label.on_hover_text(text).rect);
                }
                if let Some(text) = viewport.in_part() {
                    let label = ui.colored_label(PARTIAL, format!("{id}: {text}"));
                    self.controls.see(&format!("in_part:{id}"), label.rect);
                    if let Some(reason) = viewport.renderer.crowded() {
                        label.on_hover_text(reason);
                    }
                }
                if let Some(text) = viewport.unordered() {
                    let hint =
                        "Too many splats of a bin have nearly the same depth; `sorted=splats` orders them all.";
                    let label = ui.colored_label(PARTIAL, format!("{id}: {text}")).on_hover_text(hint);
                    self.controls.see(&format!("unordered:{id}"), label.rect);
                }
            }
            let watching = viewer.a.renderer.watching();
            if watching != WatchKind::Events {
                ui.colored_label(PARTIAL, format!("files are watched by {watching}"));
            }
            for id in [RendererId::A, RendererId::B] {
                let Some(text) = viewer.viewport(id).and_then(|viewport| viewport.decisions()) else {
                    continue;
                };
                let label = RichText::new(format!("{id}: {text}")).weak();
                let label = ui.add(egui::Label::new(label).truncate());
                self.controls.see(&format!("decisions:{id}"), label.on_hover_text(text).rect);
            }
            if let Some(line) = self.log.back() {
                let log = self.log.iter().cloned().collect::<Vec<_>>().join("\n");
                ui.add(egui::Label::new(line).truncate()).on_hover_text(log);
            }
        });
    }

    fn settings_panel<D: Device>(&mut self, ui: &mut Ui, viewer: &mut Viewer<D>) {
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            let scene = file_name(&viewer.scene_path().to_string_lossy());
            let command = format!("splatgraph render {}", viewer.scene_path().display());
            let cameras: Vec<String> = viewer.cameras.iter().enumerate().map(camera_name).collect();
            ui.label(RichText::new(scene).strong()).on_hover_text(viewer.scene_path().display().to_string());
            let mut chosen = None;
            if !cameras.is_empty() {
                let now = viewer.camera.and_then(|index| cameras.get(index)).cloned().unwrap_or_default();
                egui::ComboBox::from_label("camera").selected_text(now).show_ui(ui, |ui| {
                    for (index, name) in cameras.iter().enumerate() {
                        if ui.selectable_label(viewer.camera == Some(index), name).clicked() {
                            chosen = Some(index);
                        }
                    }
                });
            }
            if let Some(index) = chosen {
                viewer.look_through(index);
            }
            let Some(viewport) = viewer.viewport(self.selected) else { return };
            let title = match self.selected {
                RendererId::B => "Graph of B",
                _ => "Graph",
            };
            egui::CollapsingHeader::new(format!("{title}: {}", file_name(viewport.renderer.graph())))
                .id_salt("presets")
                .default_open(true)
                .show(ui, |ui| {
                    self.presets.show(ui, &mut viewport.renderer, &mut self.controls);
                });
            let command = format!("{command} --pipeline {}", viewport.renderer.graph());
            egui::CollapsingHeader::new("Parameters").default_open(true).show(ui, |ui| {
                params::show(ui, &mut viewport.renderer, &command, &mut self.controls);
            });
        });
    }

    fn graph_panel<D: Device>(&mut self, ui: &mut Ui, viewer: &mut Viewer<D>) {
        let Some(viewport) = viewer.viewport(self.selected) else { return };
        let width = ui.available_width();
        Panel::right("inspector").resizable(true).default_size(0.45 * width).min_size(0.3 * width).show(
            ui,
            |ui| {
                self.inspector.show(ui, viewport, &mut self.controls);
            },
        );
        self.graph_state.show(ui, viewport, &mut self.controls);
    }

    /// Draws the view and applies camera input to it; returns its place.
    fn view<D: Device>(&mut self, ui: &mut Ui, viewer: &mut Viewer<D>) -> Rect {
        let rect = ui.max_rect();
        self.controls.see("view", rect);
        self.drag.act(ui, rect, viewer);
        if viewer.a.renderer.plan().is_none() && viewer.a.renderer.failure().is_none() {
            let text = match viewer.a.renderer.progress() {
                progress if progress.is_empty() => "building the plan".to_owned(),
                progress => progress,
            };
            ui.painter().text(
                rect.center(),
                Align2::CENTER_CENTER,
                text,
                egui::FontId::proportional(16.0),
                Color32::LIGHT_GRAY,
            );
        }
        rect
    }

    /// Shows errors over the last good picture until they are corrected.
    fn mistakes<D: Device>(
        &mut self,
        ctx: &Context,
        viewer: &mut Viewer<D>,
        window_failure: Option<&str>,
        view: Rect,
    ) {
        let mut texts: Vec<String> = Vec::new();
        let mut goes_on = "Drawing with the last good plan";
        for id in [RendererId::A, RendererId::B] {
            let Some(renderer) = viewer.viewport(id).map(|viewport| &viewport.renderer) else { continue };
            let Some(problem) = renderer.problem(true) else { continue };
            // Both may have the same problem.
            if !texts.contains(&problem) {
                texts.push(problem);
            }
            if renderer.plan().is_none() {
                goes_on = "No plan yet";
            } else if renderer.trouble().is_some() {
                goes_on = "The last picture stays, and drawing is tried again";
            }
        }
        texts.extend(window_failure.map(str::to_owned));
        if texts.is_empty() {
            return;
        }
        let frame = Frame::popup(&ctx.global_style()).fill(Color32::from_rgba_unmultiplied(24, 12, 12, 235));
        egui::Area::new(egui::Id::unique("mistakes"))
            .fixed_pos(view.left_bottom())
            .pivot(Align2::LEFT_BOTTOM)
            .constrain_to(view)
            .order(egui::Order::Foreground)
            .show(ctx, |ui| {
                let shown = frame.show(ui, |ui| {
                    // A window may be smaller than the frame around the text.
                    ui.set_max_width((view.width() - 24.0).max(0.0));
                    ui.label(RichText::new(goes_on).strong().color(Color32::from_rgb(255, 190, 190)));
                    let height = (0.6 * view.height()).max(60.0);
                    egui::ScrollArea::both().max_height(height).show(ui, |ui| {
                        for text in &texts {
                            ui.add(egui::Label::new(failures::layout(text, 12.0)).extend().selectable(true));
                            ui.add_space(6.0);
                        }
                    });
                });
                self.controls.see("mistakes", shown.response.rect);
            });
    }

    /// Shows what happened and cannot be undone, until it is dismissed.
    fn notice(&mut self, ctx: &Context, view: Rect) {
        let Some(text) = self.notice.clone() else { return };
        let frame = Frame::popup(&ctx.global_style()).fill(Color32::from_rgba_unmultiplied(30, 26, 12, 240));
        egui::Area::new(egui::Id::unique("notice"))
            .fixed_pos(view.center_top() + egui::vec2(0.0, 12.0))
            .pivot(Align2::CENTER_TOP)
            .constrain_to(view)
            .order(egui::Order::Foreground)
            .show(ctx, |ui| {
                let shown = frame.show(ui, |ui| {
                    ui.set_max_width((view.width() - 48.0).clamp(0.0, 560.0));
                    ui.label(RichText::new(text).color(Color32::from_rgb(255, 226, 160)));
                    let dismiss = ui.button("Dismiss");
                    self.controls.see("notice:dismiss", dismiss.rect);
                    if dismiss.clicked() {
                        self.notice = None;
                    }
                });
                self.controls.see("notice", shown.response.rect);
            });
    }

    fn help_window(&mut self, ctx: &Context) {
        const KEYS: [(&str, &str); 19] = [
            ("drag", "orbit"),
            ("Shift + drag", "pan"),
            ("wheel, Ctrl + middle drag", "zoom"),
            ("right drag + W A S D, Q E", "fly; Shift faster, Ctrl slower, wheel sets the speed"),
            ("middle drag", "orbit, as in Blender; with Shift pan"),
            ("arrows", "orbit"),
            ("F, double click", "frame the scene"),
            ("Home", "back to the first view"),
            ("[ ]", "previous and next camera"),
            ("drag the line", "move the split"),
            ("H", "show or hide the panels"),
            ("V", "vsync on and off"),
            ("F12", "save the window"),
            ("Shift + F12", "save the picture alone"),
            ("F11", "full screen"),
            ("F1", "this list"),
            ("drop a .ply", "open a scene"),
            ("drop a .ron", "open a graph"),
            ("drop a cameras.json", "load cameras"),
        ];
        let window =
            egui::Window::new("Keys and mouse").open(&mut self.help).resizable(false).collapsible(false);
        let middle = ctx.content_rect().center();
        window.pivot(Align2::CENTER_CENTER).default_pos(middle).show(ctx, |ui| {
            egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
                for (keys, what) in KEYS {
                    ui.strong(keys);
                    ui.label(what);
                    ui.end_row();
                }
            });
        });
    }
}

fn camera_name((index, camera): (usize, &splatgraph_assets::Camera)) -> String {
    match camera.img_name.as_str() {
        "" => format!("camera {index}"),
        name => format!("{index}: {name}"),
    }
}
