//! Helpers for the tests of this crate: handwritten plans, and a short notation for encoders.

use crate::sync::*;
use splatgraph_framework::{ir::*, plan::*, solve::add_dependencies};

#[allow(dead_code)]
#[path = "../../../framework/src/oracle/tests/sketch.rs"]
mod sketch;

pub use sketch::{Sketch, reads, writes};
use sketch::{dispatch, touch};

impl Sketch {
    pub fn readback(&mut self) -> ResourceId {
        self.resource("readback", Shape::Buffer { stride: 4, count: 16 }, Source::Readback)
    }

    fn add(&mut self, name: &str, run: Run, work: Work, uses: &[Use]) {
        match run {
            Run::Once => self.once_work(name, work, uses),
            Run::Frame => self.frame_work(name, work, uses),
        };
        add_dependencies(&mut self.plan);
    }

    pub fn once(&mut self, name: &str, uses: &[Use]) {
        self.add(name, Run::Once, dispatch(), uses);
    }

    pub fn dispatch(&mut self, name: &str, uses: &[Use]) {
        self.add(name, Run::Frame, dispatch(), uses);
    }

    /// Adds a dispatch that reads its arguments at a byte offset of a buffer.
    pub fn dispatch_from(&mut self, name: &str, buffer: ResourceId, offset: u64, uses: &[Use]) {
        let groups = Groups::Indirect { buffer, offset };
        let uses = [&[arguments(buffer)], uses].concat();
        self.add(name, Run::Frame, Work::Dispatch { shader: ShaderId(0), groups }, &uses);
    }

    /// Adds a draw into an image; `load` says whether the image is cleared first or kept.
    pub fn draw(&mut self, name: &str, image: ResourceId, load: Load, uses: &[Use]) {
        let target = touch(image, Stages::COLOR_OUTPUT, Accesses::COLOR_READ | Accesses::COLOR_WRITE);
        let work = Work::Draw {
            vertex: ShaderId(0),
            fragment: ShaderId(1),
            topology: Topology::TriangleList,
            call: DrawCall::Direct { vertices: 3, instances: 1 },
            targets: vec![Target { image, load, blend: Blend::Replace }],
            depth: None,
        };
        self.add(name, Run::Frame, work, &[&[target], uses].concat());
    }

    /// Adds the export pass, which outputs an image and, if given, reads back the first word of a buffer.
    pub fn export(&mut self, image: ResourceId, word_of: Option<ResourceId>) {
        let mut uses = vec![touch(image, Stages::COPY, Accesses::TRANSFER_READ)];
        if let Some(buffer) = word_of {
            let readback = self.readback();
            self.plan.stats.push(Stat { name: "word".into(), buffer, offset: 0, grows: Vec::new() });
            uses.push(touch(buffer, Stages::COPY, Accesses::TRANSFER_READ));
            uses.push(touch(readback, Stages::COPY, Accesses::TRANSFER_WRITE));
        }
        self.plan.output = image;
        self.add("export", Run::Frame, Work::Export, &uses);
    }

    pub fn host(&mut self, readback: ResourceId) {
        let uses = [touch(readback, Stages::HOST, Accesses::HOST_READ)];
        self.add("host", Run::Frame, Work::Host, &uses);
    }

    /// Formats the encoders of the prologue and those of the frame, each as one line without a line break.
    pub fn told(&self, division: Division) -> (Vec<String>, Vec<String>) {
        let encoders = encoders(&self.plan, division);
        let lines = |of: &[Encoding]| of.iter().map(|encoding| tell(&self.plan, encoding)).collect();
        (lines(&encoders.prologue), lines(&encoders.frame))
    }

    pub fn lines(&self) -> Vec<String> {
        self.told(Division::Merged).1
    }
}

pub const CLEAR: Load = Load::Clear(0.0, 0.0, 0.0, 0.0);

fn arguments(buffer: ResourceId) -> Use {
    touch(buffer, Stages::INDIRECT, Accesses::INDIRECT_READ)
}

pub fn vertices_read(resource: ResourceId) -> Use {
    touch(resource, Stages::VERTEX, Accesses::STORAGE_READ)
}

pub fn fragments_read(resource: ResourceId) -> Use {
    touch(resource, Stages::FRAGMENT, Accesses::STORAGE_READ)
}

/// Formats an encoder: `compute after 0: make, (buffers) use; then 1`. Numbers are fences; `0v` and `0f` are waits
/// before, or updates after, the vertex or fragment stage.
pub fn tell(plan: &Plan, encoding: &Encoding) -> String {
    let fences = |uses: &[FenceUse]| {
        let one = |of: &FenceUse| match of.stages {
            None => of.fence.to_string(),
            Some(RenderStages::Vertex) => format!("{}v", of.fence),
            Some(RenderStages::Fragment) => format!("{}f", of.fence),
        };
        uses.iter().map(one).collect::<Vec<_>>().join(" ")
    };
    let pass = |pass: &EncodedPass| {
        let barrier = match pass.barrier {
            None => "",
            Some(MemoryBarrier { buffers: true, textures: false }) => "(buffers) ",
            Some(MemoryBarrier { buffers: false, textures: true }) => "(textures) ",
            Some(_) => "(both) ",
        };
        format!("{barrier}{}", plan.pass(pass.pass).name)
    };
    let mut line = format!("{:?}", encoding.kind).to_lowercase();
    if !encoding.waits.is_empty() {
        line += &format!(" after {}", fences(&encoding.waits));
    }
    line += &format!(": {}", encoding.passes.iter().map(pass).collect::<Vec<_>>().join(", "));
    if !encoding.updates.is_empty() {
        line += &format!("; then {}", fences(&encoding.updates));
    }
    line
}

/// Returns a plan of a prologue dispatch, two dispatches, a draw and the export. Each depends on the previous one.
pub fn chain() -> Sketch {
    let mut s = Sketch::new();
    let (x, y, image) = (s.buffer("x"), s.buffer("y"), s.image("image"));
    s.once("once", &[writes(y)]);
    s.dispatch("make", &[reads(y), writes(x)]);
    s.dispatch("change", &[reads(x), writes(x)]);
    s.draw("draw", image, CLEAR, &[vertices_read(x)]);
    s.export(image, None);
    s
}

/// Returns a plan whose last dispatch, `end`, needs the first dispatch and the draw between them. The export and the
/// next frame's `first` need `end`, but not each other.
pub fn fork() -> Sketch {
    let mut s = Sketch::new();
    let (x, y, image, last) = (s.buffer("x"), s.buffer("y"), s.image("image"), s.image("last"));
    s.dispatch("first", &[writes(x), writes(y)]);
    s.draw("draw", image, CLEAR, &[vertices_read(x)]);
    s.dispatch("end", &[reads(y), reads(image), writes(last)]);
    s.export(last, None);
    s
}
