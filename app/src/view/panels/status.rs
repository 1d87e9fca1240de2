//! Draws the status line: progress, warnings, and the newest line of the log.

use super::theme::{Palette, TEXT};
use super::widgets::Control as _;
use super::{Panels, presets};
use crate::view::events::RendererId;
use crate::view::paint::Mode;
use crate::view::viewer::Viewer;
use crate::view::viewport::Viewport;
use egui::{Align, Layout, RichText, Spinner, Ui, UiBuilder};

const LINES: usize = 20;

impl Panels {
    pub(super) fn status(&mut self, ui: &mut Ui, viewer: &mut Viewer) {
        let palette = Palette::of(ui);
        // Drawn in a child that does not affect the panel's size: a growing panel would resize the picture.
        let room = UiBuilder::new().max_rect(ui.max_rect()).layout(Layout::left_to_right(Align::Center));
        let ui = &mut ui.new_child(room);
        for id in [RendererId::A, RendererId::B] {
            if let Some(path) = viewer.loading(id) {
                ui.add(Spinner::new().size(TEXT));
                ui.label(format!("loading {}", path.display()));
            }
            let is_shown = id == RendererId::A || viewer.compare != Mode::A;
            let Some(viewport) = viewer.viewport(id).filter(|_| is_shown) else { continue };
            let progress = viewport.renderer.progress();
            if !progress.is_empty() {
                ui.add(Spinner::new().size(TEXT));
                ui.label(format!("{id}: {progress}"));
            }
            self.states(ui, id, viewport);
        }
        let is_of_hidden = |line: &&String| viewer.compare == Mode::A && line.starts_with("B: ");
        // A failure that persists is already shown as a state.
        let persists = |line: &&String| {
            viewer.viewports().any(|shown| {
                shown
                    .renderer
                    .problem(false)
                    .is_some_and(|text| line.ends_with(text.lines().next().unwrap_or_default()))
            })
        };
        let newest = self.log.iter().rfind(|line| !is_of_hidden(line));
        if let Some(line) = newest.filter(|line| !persists(line)) {
            let log = self.log.iter().rev().take(LINES).rev().cloned().collect::<Vec<_>>().join("\n");
            ui.add(egui::Label::new(RichText::new(line).color(palette.soft)).truncate()).hint(log);
        }
    }

    /// Draws a label for each notable state of a viewport, with the reason as its tooltip.
    fn states(&mut self, ui: &mut Ui, id: RendererId, viewport: &Viewport) {
        let palette = Palette::of(ui);
        let mut state = |name: &str, short: String, colour, reason: String| {
            let label = ui
                .label(RichText::new(format!("{id}: {short}")).color(colour))
                .named(&format!("{name}:{id}"));
            label.hint(reason);
        };
        if let Some(text) = viewport.renderer.problem(false) {
            let first = text.lines().next().unwrap_or_default().to_owned();
            state("problem", first, palette.error, text);
        }
        if let Some(text) = viewport.fallback() {
            state("fallback", "fallback".to_owned(), palette.caution, text);
        }
        if let Some(text) = viewport.in_part() {
            let reason = viewport
                .renderer
                .crowded()
                .unwrap_or("A plan that draws all of it is being built.")
                .to_owned();
            state("in_part", text, palette.caution, reason);
        }
        if let Some(text) = viewport.decisions() {
            let base = viewport.renderer.plan().and_then(|plan| plan.based_on.last().cloned());
            let short = match base {
                Some(base) => format!("draws with {}", presets::file_name(&base)),
                None => "settings chosen by device and scene".to_owned(),
            };
            state("decisions", short, palette.soft, text);
        }
    }
}
