//! Disturbances of the viewer: file edits and user input.

use super::{SCALE, SIZE, Soak};
use crate::place::shipped;
use egui::{Key, Modifiers, PointerButton, Pos2};
use indexmap::IndexMap;
use splatgraph::view::events::RendererId;
use splatgraph_framework::ir::ParamBinding;
use std::fs;

/// Graphs to draw with; the first is that of the reference state.
pub(super) const GRAPHS: [&str; 8] = [
    "pipelines/splat.ron",
    "pipelines/digit4.ron",
    "pipelines/digit11.ron",
    "pipelines/unsorted.ron",
    "pipelines/key16.ron",
    "pipelines/stale_order.ron",
    "pipelines/front_to_back.ron",
    "pipelines/front_to_back_naive.ron",
];

/// Edits after which the file still builds: file, text and its replacement.
const CONSTANTS: [(&str, &str, &str); 6] = [
    ("shaders/compose.comp", "blended.a * camera", "0.5 * blended.a * camera"),
    ("shaders/splat.frag", "min(alpha_cap,", "min(0.5 * alpha_cap,"),
    ("shaders/window/compose.frag", "shown = vec4(colour, 1.0)", "shown = vec4(0.5 * colour, 1.0)"),
    (
        "pipelines/parts/depth_order.ron",
        "default: \"ceil_div(key_bits, ceil_div(key_bits, 9))\"",
        "default: 6",
    ),
    ("pipelines/splat.ron", "Float(default: 3.33,", "Float(default: 2.5,"),
    ("pipelines/view/window.ron", "history: true", "history: false"),
];

/// Edits after which the file does not build: file, text and its replacement.
const MISTAKES: [(&str, &str, &str); 5] = [
    ("shaders/project.comp", "void main() {", "void main() {\n    int i = undeclared;"),
    ("shaders/camera.glsl", "uniform", "uniförm"),
    ("shaders/window/ui.frag", "void main() {", "void main() { return 1;"),
    ("pipelines/splat.ron", "\"Splats\": \"splats\"", "\"Splats\": \"splatz\""),
    ("pipelines/view/window.ron", "phase: \"ui\",", "phase: ,"),
];

/// Files to which comments are added.
const COMMENTED: [&str; 8] = [
    "shaders/compose.comp",
    "shaders/splat.vert",
    "shaders/covariance.comp",
    "shaders/camera.glsl",
    "shaders/sort/serial_scatter.comp",
    "shaders/window/ui.vert",
    "pipelines/splat.ron",
    "pipelines/view/window.ron",
];

#[derive(Clone, Copy, Debug)]
pub(super) enum Deed {
    Comment,
    Constant,
    Mistake,
    Cut,
    Empty,
    Replace,
    Mend,
    /// Sets a live parameter, or a constant.
    Param {
        live: bool,
    },
    Graph,
    Resize,
    Minimise,
    Scale,
    Compare,
    Exchange,
    Measure,
    Inspect,
    InspectNothing,
    Scene,
    Drag,
    Scroll,
    Key,
    Panel,
}

pub(super) const DEEDS: [(usize, Deed); 23] = [
    (10, Deed::Comment),
    (6, Deed::Constant),
    (5, Deed::Mistake),
    (2, Deed::Cut),
    (1, Deed::Empty),
    (4, Deed::Replace),
    (12, Deed::Mend),
    (8, Deed::Param { live: false }),
    (12, Deed::Param { live: true }),
    (4, Deed::Graph),
    (4, Deed::Resize),
    (2, Deed::Minimise),
    (2, Deed::Scale),
    (4, Deed::Compare),
    (3, Deed::Exchange),
    (2, Deed::Measure),
    (4, Deed::Inspect),
    (3, Deed::InspectNothing),
    (1, Deed::Scene),
    (12, Deed::Drag),
    (8, Deed::Scroll),
    (6, Deed::Key),
    (8, Deed::Panel),
];

impl Soak {
    pub(super) fn act(&mut self, deed: Deed) {
        let who = if self.dice.below(3) == 0 { RendererId::B } else { RendererId::A };
        match deed {
            Deed::Comment => {
                let name = *self.dice.of(&COMMENTED);
                self.number += 1;
                let text = format!("{}\n// Number {}.\n", shipped(name), self.number);
                self.edit(name, text);
            }
            Deed::Constant => {
                let edit = *self.dice.of(&CONSTANTS);
                self.exchange_text(edit);
            }
            Deed::Mistake => {
                let edit = *self.dice.of(&MISTAKES);
                self.exchange_text(edit);
            }
            Deed::Cut => {
                let name = *self.dice.of(&COMMENTED);
                let text = shipped(name);
                let text = text[..text.floor_char_boundary(text.len() / 2)].to_owned();
                self.edit(name, text);
            }
            Deed::Empty => {
                let name = *self.dice.of(&COMMENTED);
                self.edit(name, String::new());
            }
            Deed::Replace => {
                // Many editors save by replacing the file.
                let name = *self.dice.of(&COMMENTED);
                self.number += 1;
                let text = format!("{}\n// Replaced, number {}.\n", shipped(name), self.number);
                self.viewer.place.write("new", text);
                fs::rename(self.viewer.place.at("new"), self.viewer.place.at(name))
                    .expect("the file is replaced");
                self.edited.insert(name.to_owned());
            }
            Deed::Mend => {
                for name in std::mem::take(&mut self.edited) {
                    self.viewer.place.write(&name, shipped(&name));
                }
            }
            Deed::Param { live } => self.set_param(who, live),
            Deed::Graph => {
                let graph = self.viewer.place.at(self.dice.of::<&str>(&GRAPHS));
                if let Some(viewport) = self.viewer.shell.viewer.viewport(who) {
                    viewport.renderer.choose(&graph.to_string_lossy(), IndexMap::new());
                }
            }
            Deed::Resize => {
                self.viewer.size = *self.dice.of(&[SIZE, (320, 200), (500, 180), (401, 226), (350, 350)])
            }
            Deed::Minimise => {
                let size = std::mem::take(&mut self.viewer.size);
                for _ in 0..1 + self.dice.below(5) {
                    self.frame();
                }
                self.viewer.size = size;
            }
            Deed::Scale => self.viewer.shell.viewer.scale = *self.dice.of(&[SCALE, 0.1, 0.2, 0.25]),
            Deed::Compare => {
                let mode = *self.dice.of(&["compare:off", "compare:split", "compare:difference"]);
                _ = self.viewer.click(mode);
            }
            Deed::Exchange => self.viewer.shell.viewer.exchange(),
            Deed::Measure => _ = self.viewer.click("measure"),
            Deed::Inspect => self.inspect(who),
            Deed::InspectNothing => {
                if let Some(viewport) = self.viewer.shell.viewer.viewport(who) {
                    viewport.inspection = None;
                }
            }
            Deed::Scene => {
                let path = self.viewer.place.at(self.dice.of::<&str>(&self.scenes));
                self.viewer.shell.viewer.open(&path);
            }
            Deed::Drag => self.drag(),
            Deed::Scroll => {
                let Some(at) = self.somewhere() else { return };
                self.viewer.scroll(at, if self.dice.below(2) == 0 { 50.0 } else { -50.0 });
            }
            Deed::Key => {
                let key =
                    *self.dice.of(&[Key::F, Key::Home, Key::ArrowLeft, Key::ArrowUp, Key::F1, Key::Tab]);
                self.viewer.key(key, Modifiers::NONE);
            }
            Deed::Panel => {
                let panel = *self.dice.of(&[
                    "panel:Parameters",
                    "panel:Times",
                    "panel:Timeline",
                    "panel:Inspector",
                    "panel:Cameras",
                    "viewport:B",
                    "keys_sorted",
                ]);
                _ = self.viewer.click(panel);
            }
        }
    }

    fn edit(&mut self, name: &str, text: String) {
        self.viewer.place.write(name, text);
        self.edited.insert(name.to_owned());
    }

    fn exchange_text(&mut self, (name, from, to): (&str, &str, &str)) {
        let text = shipped(name);
        assert!(text.contains(from), "{name} has no `{from}`");
        let text = text.replacen(from, to, 1);
        self.edit(name, text);
    }

    /// Sets a live parameter, or else a constant, to a random value or sometimes to its default.
    ///
    /// Does nothing if the viewport is not shown or the plan has none.
    fn set_param(&mut self, who: RendererId, live: bool) {
        let Some(viewport) = self.viewer.shell.viewer.viewport(who) else { return };
        let params = viewport.renderer.controls().iter().map(|control| &control.param);
        let params = params.filter(|param| (param.binding != ParamBinding::Const) == live);
        let params: Vec<_> = params.cloned().collect();
        if params.is_empty() {
            return;
        }
        let param = self.dice.of(&params).clone();
        let value = self.dice.value(&param.domain, i64::MAX);
        let value = Some(value).filter(|_| self.dice.below(4) > 0);
        viewport.renderer.set_param(&param.name, value);
    }

    /// Inspects, once or in every frame, a resource that a pass accesses.
    fn inspect(&mut self, who: RendererId) {
        let Some(viewport) = self.viewer.shell.viewer.viewport(who) else { return };
        let Some(plan) = viewport.renderer.plan().cloned() else { return };
        let passes: Vec<_> = plan.order().collect();
        let pass = plan.pass(*self.dice.of(&passes));
        if pass.uses.is_empty() {
            return;
        }
        let resource = &plan.resource(self.dice.of(&pass.uses).resource).name;
        viewport.look_at(resource, &pass.name);
        if let Some(inspection) = &mut viewport.inspection {
            inspection.follow = self.dice.below(2) == 0;
        }
    }

    /// Returns a random position in the view, in points; `None` if the view is not shown.
    fn somewhere(&mut self) -> Option<Pos2> {
        let view = self.viewer.shell.panels.controls.find("view")?;
        Some(self.dice.within(view))
    }

    fn drag(&mut self) {
        let (Some(from), Some(to)) = (self.somewhere(), self.somewhere()) else { return };
        let button =
            *self.dice.of(&[PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary]);
        let places = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| from + (to - from) * share);
        self.viewer.drag(button, &places);
    }
}
