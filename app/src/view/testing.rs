//! Makes plans for tests that need only names, and drives the viewer on the null device.

mod compilers;
mod faults;
mod room;
mod script;

use splatgraph_framework::ir::{Origin, Pass, PassId, ResourceId, Run, Work};
use splatgraph_framework::plan::{Plan, Step};

/// Makes a plan of passes, each with name and phase.
pub fn plan(passes: &[(&str, &str)]) -> Plan {
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
    Plan {
        name: "test".into(),
        summary: String::new(),
        based_on: vec![],
        stand_ins: vec![],
        facts: Default::default(),
        params: vec![],
        resources: vec![],
        shaders: vec![],
        blocks: vec![],
        handover: vec![],
        prologue: vec![],
        frame: (0..passes.len() as u32).map(|i| Step { barriers: vec![], pass: PassId(i) }).collect(),
        passes: passes.iter().map(pass).collect(),
        culled: vec![],
        warnings: vec![],
        output: ResourceId(0),
        stats: vec![],
    }
}
