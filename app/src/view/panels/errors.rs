//! Shows errors over the last good picture until they are corrected or the user closes the card.
//!
//! The text and its colours are the terminal's. Buttons copy the text, open the file in an editor and close the card.

use super::controls::{Command, request};
use super::theme::{HEADING, Palette, TEXT, strong};
use super::widgets::{Control as _, follow_focus};
use super::{failures, hud};
use crate::view::events::RendererId;
use crate::view::viewer::Viewer;
use egui::{Align2, Context, FontId, Rect, RichText};
use splatgraph_framework::ir::Origin;
use std::fmt::Display;
use std::path::Path;

const LAST_PLAN: &str = "Drawing with the last good plan";

/// Texts of the errors that the user closed; the card reappears when an error changes, or with [`State::reopen`].
#[derive(Default)]
pub struct State {
    closed: Option<Vec<String>>,
}

impl State {
    /// Shows the card again: an error that the user closed has occurred once more.
    pub fn reopen(&mut self) {
        self.closed = None;
    }

    pub fn show(&mut self, ctx: &Context, viewer: &mut Viewer, window_failure: Option<&str>, view: Rect) {
        let (mut problems, mut consequences): (Vec<(RendererId, String)>, Vec<_>) = Default::default();
        for id in [RendererId::A, RendererId::B] {
            if let Some(error) = viewer.scene_error(id) {
                problems.push((id, error.to_owned()));
                consequences.push((id, "The last scene stays"));
            }
            let Some(renderer) = viewer.viewport(id).map(|viewport| &viewport.renderer) else { continue };
            let Some(problem) = renderer.problem(true) else { continue };
            problems.push((id, problem));
            let is_retried = renderer.trouble().is_some();
            consequences.push(match renderer.plan() {
                None => (id, "No plan yet"),
                Some(_) if is_retried => (id, "The last picture stays while drawing is retried"),
                Some(_) => (id, LAST_PLAN),
            });
        }
        let has_b = viewer.b.is_some();
        let heading = heading(consequences, has_b);
        let mut texts = named(problems, has_b);
        texts.extend(window_failure.map(str::to_owned));
        if texts.is_empty() {
            self.closed = None;
            return;
        }
        if self.closed.as_ref() == Some(&texts) {
            return;
        }
        let plain: Vec<String> = texts.iter().map(|text| failures::plain(text)).collect();
        let place = plain.iter().find_map(|text| origin(text));
        let mut close = false;
        // An area remembers its size, and a card of other errors has another size.
        let id = egui::Id::unique(("mistakes", &texts));
        let area = hud::area(id, view.left_bottom(), Align2::LEFT_BOTTOM, view, egui::Order::Foreground);
        area.show(ctx, |ui| {
            let error = Palette::of(ui).error;
            // Terminal colours need a dark background, even in the light theme.
            let frame = hud::card(ui, error).fill(egui::Color32::from_rgb(24, 14, 14));
            let shown = frame.show(ui, |ui| {
                // The window may be too small even for the card's margins.
                ui.set_max_width((view.width() - 28.0).max(0.0));
                let whole = (view.height() - 20.0).max(0.0);
                let card = egui::ScrollArea::vertical().max_height(whole).min_scrolled_height(whole);
                card.show(ui, |ui| {
                    ui.horizontal_wrapped(|ui| {
                        let colour = egui::Color32::from_rgb(255, 190, 190);
                        ui.label(RichText::new(heading).family(strong()).size(HEADING).color(colour));
                        if ui.button("Copy").clicked() {
                            ui.copy_text(plain.join("\n"));
                        }
                        if let Some(origin) = &place {
                            let edit = ui
                                .button(format!("Edit {}:{}", origin.file, origin.line))
                                .named("mistakes:edit");
                            if edit.clicked() {
                                request(ui.ctx(), Command::Edit(origin.clone()));
                            }
                        }
                        let button = ui.button("Close").named("mistakes:close");
                        close = button.clicked();
                    });
                    let glyph =
                        ui.fonts_mut(|fonts| fonts.glyph_width(&FontId::monospace(TEXT), ' ')).max(1.0);
                    let columns = ((ui.max_rect().width() / glyph) as usize).max(8);
                    // The buttons stay in view in a small window. In a tiny one, the whole card scrolls.
                    let room = view.height() - ui.min_rect().height() - 32.0;
                    let height = (0.6 * view.height()).min(room).max(40.0);
                    let scroll = egui::ScrollArea::both().max_height(height).min_scrolled_height(height);
                    scroll.show(ui, |ui| {
                        for text in &texts {
                            let text = failures::layout(text, columns, TEXT);
                            ui.add(egui::Label::new(text).extend().selectable(true)).named("mistakes:text");
                            ui.add_space(6.0);
                        }
                        follow_focus(ui);
                    });
                    follow_focus(ui);
                });
            });
            shown.response.named("mistakes");
        });
        if close {
            self.closed = Some(texts);
        }
    }
}

/// Returns the card's heading, which tells what is still drawn.
fn heading(consequences: Vec<(RendererId, &str)>, has_b: bool) -> String {
    // The window's own graph has no viewport.
    if consequences.is_empty() { LAST_PLAN.to_owned() } else { named(consequences, has_b).join(". ") }
}

/// Prefixes each problem with its viewport if there is a B. Merges equal problems of A and B.
fn named<T: PartialEq + Display>(problems: Vec<(RendererId, T)>, has_b: bool) -> Vec<String> {
    if !has_b {
        return problems.iter().map(|(_, problem)| problem.to_string()).collect();
    }
    let mut named: Vec<String> = Vec::new();
    for (id, problem) in &problems {
        let has = |of: RendererId| problems.iter().any(|(id, other)| *id == of && other == problem);
        if !(has(RendererId::A) && has(RendererId::B)) {
            named.push(format!("{id}: {problem}"));
        } else if *id == RendererId::A {
            named.push(format!("A and B: {problem}"));
        }
    }
    named
}

/// Parses the first location of an existing file in an error, such as `  --> pipelines/splat.ron:11:85`. `None` if it
/// has none. A setting and the command line also have locations, but no file to edit.
fn origin(text: &str) -> Option<Origin> {
    let places = text.lines().filter_map(|line| line.trim_start().strip_prefix("--> "));
    let parsed = |place: &str| {
        let mut parts = place.trim().rsplitn(3, ':');
        let (column, line) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
        Some(Origin { file: parts.next()?.to_owned(), line, column })
    };
    places.filter_map(parsed).find(|origin| Path::new(&origin.file).is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_of_a_comparison_names_its_viewport_and_a_shared_one_both() {
        let both = |a, b| vec![(RendererId::A, a), (RendererId::B, b)];
        assert_eq!(named(both("error: x", "error: y"), true), ["A: error: x", "B: error: y"]);
        assert_eq!(named(both("error: x", "error: x"), true), ["A and B: error: x"]);
        let three = [vec![(RendererId::A, "error: the scene")], both("error: x", "error: x")].concat();
        assert_eq!(named(three, true), ["A: error: the scene", "A and B: error: x"]);
        assert_eq!(heading(both("No plan yet", LAST_PLAN), true), format!("A: No plan yet. B: {LAST_PLAN}"));
        assert_eq!(heading(vec![(RendererId::A, "No plan yet")], false), "No plan yet");
        assert_eq!(heading(Vec::new(), true), LAST_PLAN);
    }

    #[test]
    fn the_place_of_an_error_is_found_in_its_text() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a:graph.ron").display().to_string();
        std::fs::write(&file, "").expect("writable");
        let text = format!("error: there is no resource `kesy`\n  --> {file}:11:85\n   |\n");
        let found = origin(&text).expect("the text names a place");
        assert_eq!((found.file.as_str(), found.line, found.column), (file.as_str(), 11, 85));
        assert!(origin("error: out of memory").is_none());
        for elsewhere in ["--set", "command line", "pipelines/built-in.ron"] {
            assert_eq!(origin(&format!("error: no\n --> {elsewhere}:1:7\n")), None);
        }
    }
}
