//! Draws the tools in tiles and floating windows, and applies clicks on their tabs.

use super::controls::see;
use super::layout::{self, Tool};
use super::selection::Selection;
use super::theme::Palette;
use super::widgets::Control as _;
use super::{Panels, cameras, contents, inspector, splat, timeline, times};
use crate::io::output::shell_word;
use crate::view::history::History;
use crate::view::viewer::Viewer;
use egui::{Frame, Rect, Response, Ui, WidgetText};
use egui_tiles::{SimplificationOptions, TileId, Tiles, UiResponse};

impl Panels {
    /// Draws the docked tools and the picture. Returns the picture's rectangle, in points, or [`Rect::NOTHING`] if a
    /// tool's tab hides it.
    pub(super) fn docked(&mut self, ui: &mut Ui, viewer: &mut Viewer, window: &History) -> Rect {
        self.layout.arrange(ui.max_rect(), self.hidden);
        let empty = egui_tiles::Tree::empty(egui::Id::unique("no layout"));
        let mut tree = std::mem::replace(&mut self.layout.tree, empty);
        let picture = tree.tiles.find_pane(&Tool::Picture).unwrap_or(TileId::from_u64(0));
        let mut tools = Tools { panels: self, viewer, window, view: Rect::NOTHING, resized: false, picture };
        tree.ui(&mut tools, ui);
        let Tools { view, resized, .. } = tools;
        self.layout.tree = tree;
        if resized {
            self.layout.remember_lengths();
        }
        view
    }

    pub(super) fn floating(&mut self, ui: &Ui, viewer: &mut Viewer, window: &History, area: Rect) {
        for tool in self.layout.floating(area.size()) {
            let mut close = false;
            let mut dock = false;
            let shown = layout::float(ui, tool, area, &mut close, |ui| {
                if ui.small_button("Dock").clicked() {
                    dock = true;
                }
                self.tool(ui, tool, viewer, window);
            });
            if let Some(shown) = shown {
                shown.response.named(&format!("float:{}", tool.title()));
            }
            if close {
                self.layout.set_open(tool, false);
            } else if dock {
                // Closing removes the tool from the floating tools. Reopening makes it the most recently opened tool,
                // which is the last to float when space is short.
                self.layout.set_open(tool, false);
                self.layout.reveal(tool);
            }
        }
    }

    fn tool(&mut self, ui: &mut Ui, tool: Tool, viewer: &mut Viewer, window: &History) {
        match tool {
            Tool::Picture => {}
            Tool::Parameters => {
                let scene = viewer.scene_path_of(self.selected).display().to_string();
                let load = viewer.load_options().words();
                let Some(viewport) = viewer.viewport(self.selected) else { return };
                let renderer = &mut viewport.renderer;
                let words = [scene]
                    .into_iter()
                    .chain(load)
                    .chain(["--pipeline".to_owned(), renderer.graph().to_owned()]);
                let command =
                    words.fold("splatgraph render".to_owned(), |line, word| line + " " + &shell_word(&word));
                self.params.show(ui, renderer, &command);
            }
            Tool::Cameras => {
                let selected = self.selected;
                scrolled(ui, |ui| cameras::show(ui, viewer, selected));
            }
            Tool::Times => scrolled(ui, |ui| {
                let interval = self.interval();
                let loaded = viewer.scene_of(self.selected).count();
                if let Some(viewport) = viewer.viewport(self.selected) {
                    times::show(ui, viewport, loaded, interval, window, &mut self.plotted);
                }
            }),
            Tool::Inspector if self.selection == Some(Selection::Splat) => {
                scrolled(ui, |ui| splat::show(ui, viewer));
            }
            Tool::Inspector => {
                let (copy_limit, mut measures_copy) = (viewer.copy_limit(), viewer.is_measuring_copy());
                let Some(viewport) = viewer.viewport(self.selected) else { return };
                let mut target = contents::Target {
                    selection: &mut self.selection,
                    copy_limit,
                    measures_copy: &mut measures_copy,
                };
                inspector::show(ui, viewport, &mut self.dumped, &mut self.contents, &mut target);
                if measures_copy {
                    viewer.measure_copy();
                }
            }
            Tool::Timeline => {
                let Some(viewport) = viewer.viewport(self.selected) else { return };
                let Some(plan) = viewport.renderer.plan().cloned() else { return };
                let measured = viewport.history.is_of(&plan);
                let times = timeline::Times {
                    passes: viewport.history.medians(&plan),
                    unattributed: viewport.history.unattributed().filter(|_| measured),
                    unreliable: measured && viewport.history.is_mostly_unattributed(),
                };
                let dump = self.dumped.of(&plan);
                self.timeline.show(ui, dump, &times, &mut self.selection);
            }
        }
    }
}

fn scrolled(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        // Leave space for the scroll bar.
        ui.set_max_width((ui.available_width() - 10.0).max(0.0));
        contents(ui);
        super::widgets::follow_focus(ui);
    });
}

struct Tools<'a> {
    panels: &'a mut Panels,
    viewer: &'a mut Viewer,
    window: &'a History,
    /// Rectangle of the picture, in points; set when its tile is drawn.
    view: Rect,
    /// True if the user dragged a border in this frame.
    resized: bool,
    picture: TileId,
}

impl egui_tiles::Behavior<Tool> for Tools<'_> {
    fn pane_ui(&mut self, ui: &mut Ui, _: TileId, tool: &mut Tool) -> UiResponse {
        if *tool == Tool::Picture {
            self.view = self.panels.view(ui, self.viewer);
            return UiResponse::None;
        }
        let palette = Palette::of(ui);
        see(ui.ctx(), &format!("tool:{}", tool.title()), ui.max_rect());
        Frame::new().fill(palette.raised).inner_margin(8).show(ui, |ui| {
            ui.set_min_size(ui.available_size());
            self.panels.tool(ui, *tool, self.viewer, self.window);
        });
        UiResponse::None
    }

    fn tab_title_for_pane(&mut self, tool: &Tool) -> WidgetText {
        tool.title().into()
    }

    fn is_tab_closable(&self, tiles: &Tiles<Tool>, id: TileId) -> bool {
        tiles.get_pane(&id).is_some_and(|tool| *tool != Tool::Picture)
    }

    fn on_tab_close(&mut self, tiles: &mut Tiles<Tool>, id: TileId) -> bool {
        if let Some(tool) = tiles.get_pane(&id) {
            self.panels.layout.set_open(*tool, false);
        }
        // Keep the tile, so that the tool reopens at the same place.
        false
    }

    fn top_bar_right_ui(
        &mut self,
        tiles: &Tiles<Tool>,
        ui: &mut Ui,
        _: TileId,
        tabs: &egui_tiles::Tabs,
        _: &mut f32,
    ) {
        let Some(tool) = tabs.active.and_then(|id| tiles.get_pane(&id)).copied() else { return };
        let float = ui.add(egui::Button::new("↗").frame(false));
        if float.hint("Undock: the tool floats over the picture").clicked() {
            self.panels.layout.undock(tool);
        }
    }

    fn is_tab_bar_visible(&self, _: TileId, tabs: &egui_tiles::Tabs) -> bool {
        // The picture needs no title while it has no neighbouring tabs.
        tabs.children.as_slice() != [self.picture]
    }

    fn on_tab_button(&mut self, tiles: &mut Tiles<Tool>, id: TileId, button: Response) -> Response {
        if let Some(tool) = tiles.get_pane(&id) {
            see(&button.ctx, &format!("tab:{}", tool.title()), button.rect);
        }
        button
    }

    fn tab_bar_height(&self, _: &egui::Style) -> f32 {
        28.0
    }

    fn gap_width(&self, _: &egui::Style) -> f32 {
        layout::LINE
    }

    fn min_size(&self) -> f32 {
        96.0
    }

    fn simplification_options(&self) -> SimplificationOptions {
        layout::RULES
    }

    fn on_edit(&mut self, action: egui_tiles::EditAction) {
        self.resized |= action == egui_tiles::EditAction::TileResized;
    }

    fn tab_bar_color(&self, visuals: &egui::Visuals) -> egui::Color32 {
        Palette::in_mode(visuals.dark_mode).band
    }
}
