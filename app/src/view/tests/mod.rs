//! Drives the viewer on the null device.

mod cameras;
mod compilers;
mod faults;
mod idle;
mod keyboard;
mod panels;
mod room;
mod scene_watch;
mod scenes;
mod script;

use splatgraph_framework::ir::{Format, Origin, Pass, PassId, Run, Shape, Source, Usage, Work};
use splatgraph_framework::plan::{Plan, Resource};
use std::sync::Arc;

/// Makes the press or the release of a key.
pub fn key(key: egui::Key, pressed: bool, modifiers: egui::Modifiers) -> egui::Event {
    egui::Event::Key { key, physical_key: None, pressed, repeat: false, modifiers }
}

/// Makes a plan of passes, given as pairs of name and phase.
pub fn plan(passes: &[(&str, &str)]) -> Arc<Plan> {
    let pass = |(name, phase): &(&str, &str)| Pass {
        name: name.to_string(),
        phase: phase.to_string(),
        run: Run::Frame,
        work: Work::Export,
        bindings: vec![],
        push: vec![],
        uses: vec![],
        origin: Origin { file: "test.ron".into(), line: 1, column: 1 },
    };
    Arc::new(Plan {
        name: "test".into(),
        resources: vec![Resource {
            name: "picture".into(),
            shape: Shape::Image { format: Format::Rgba8Unorm, width: 1, height: 1 },
            usage: Usage::empty(),
            source: Source::Transient,
            block: None,
            history: None,
            origin: Origin { file: "test.ron".into(), line: 1, column: 1 },
        }],
        frame: (0..passes.len() as u32).map(PassId).collect(),
        passes: passes.iter().map(pass).collect(),
        ..Plan::default()
    })
}
