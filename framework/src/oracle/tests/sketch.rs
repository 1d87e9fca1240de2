//! Hand-made plans for the tests of this crate and of the Vulkan and Metal backends.

use splatgraph_framework::{ir::*, plan::*};

/// A plan under construction. [`Self::buffer`] and [`Self::image`] take 64 bytes; each transient resource has its own
/// memory unless shared.
pub struct Sketch {
    pub plan: Plan,
}

pub const BYTES: u64 = 64;

pub fn origin() -> Origin {
    Origin { file: "graph.ron".into(), line: 1, column: 1 }
}

impl Sketch {
    pub fn new() -> Sketch {
        let plan = Plan { name: "sketch".into(), ..Plan::default() };
        Sketch { plan }
    }

    pub fn resource(&mut self, name: &str, shape: Shape, source: Source) -> ResourceId {
        let id = ResourceId(self.plan.resources.len() as u32);
        let block = (source == Source::Transient).then(|| {
            self.plan.blocks.push(Block { aliases: vec![id] });
            BlockId(self.plan.blocks.len() as u32 - 1)
        });
        let (name, usage) = (name.into(), Usage::all());
        self.plan.resources.push(Resource {
            name,
            shape,
            usage,
            source,
            block,
            history: None,
            origin: origin(),
        });
        id
    }

    pub fn sized(&mut self, name: &str, bytes: u64) -> ResourceId {
        self.resource(name, Shape::Buffer { stride: 4, count: bytes / 4 }, Source::Transient)
    }

    pub fn buffer(&mut self, name: &str) -> ResourceId {
        self.sized(name, BYTES)
    }

    /// Adds an image as large as a buffer.
    pub fn image(&mut self, name: &str) -> ResourceId {
        let shape = Shape::Image { format: Format::Rgba8Unorm, width: 4, height: 4 };
        self.resource(name, shape, Source::Transient)
    }

    pub fn uniform(&mut self, name: &str) -> ResourceId {
        let shape = Shape::Buffer { stride: 4, count: 4 };
        self.resource(name, shape, Source::Frame { uniform: name.into() })
    }

    /// Puts a resource into the memory of another. Its own block remains, without resources.
    pub fn share(&mut self, id: ResourceId, with: ResourceId) {
        let block = self.plan.resource(with).block;
        let old = std::mem::replace(&mut self.plan.resources[id.index()].block, block);
        self.plan.blocks[old.unwrap().index()].aliases.clear();
        self.plan.blocks[block.unwrap().index()].aliases.push(id);
    }

    pub fn history(&mut self, id: ResourceId, name: &str) {
        self.plan.resources[id.index()].history = Some(name.into());
    }

    pub fn pass(&mut self, name: &str, run: Run, work: Work, uses: &[Use]) -> PassId {
        let id = PassId(self.plan.passes.len() as u32);
        self.plan.passes.push(Pass {
            name: name.into(),
            phase: "test".into(),
            run,
            work,
            bindings: vec![],
            push: vec![],
            uses: uses.to_vec(),
            origin: origin(),
        });
        id
    }

    pub fn frame(&mut self, name: &str, uses: &[Use]) -> PassId {
        self.frame_work(name, dispatch(), uses)
    }

    pub fn frame_work(&mut self, name: &str, work: Work, uses: &[Use]) -> PassId {
        let pass = self.pass(name, Run::Frame, work, uses);
        self.plan.frame.push(pass);
        pass
    }

    pub fn once_work(&mut self, name: &str, work: Work, uses: &[Use]) -> PassId {
        let pass = self.pass(name, Run::Once, work, uses);
        self.plan.prologue.push(pass);
        pass
    }
}

pub fn dispatch() -> Work {
    Work::Dispatch { shader: ShaderId(0), groups: Groups::Direct([1; 3]) }
}

pub fn draw() -> Work {
    Work::Draw {
        vertex: ShaderId(0),
        fragment: ShaderId(1),
        topology: Topology::TriangleList,
        call: DrawCall::Direct { vertices: 3, instances: 1 },
        targets: vec![],
        depth: None,
    }
}

pub fn touch(resource: ResourceId, stages: Stages, accesses: Accesses) -> Use {
    Use { resource, stages, accesses, layout: None, discards: false }
}

pub const READ: Accesses = Accesses::STORAGE_READ;
pub const WRITE: Accesses = Accesses::STORAGE_WRITE;
pub const BOTH: Accesses = READ.union(WRITE);
pub const COMPUTE: Stages = Stages::COMPUTE;
pub const VERTEX: Stages = Stages::VERTEX;
pub const FRAGMENT: Stages = Stages::FRAGMENT;
pub const COPY: Stages = Stages::COPY;
pub const CLEAR: Stages = Stages::CLEAR;
pub const NO_ACCESS: Accesses = Accesses::empty();

/// Returns the use of a resource that a compute shader reads as storage.
pub fn reads(resource: ResourceId) -> Use {
    touch(resource, COMPUTE, READ)
}

pub fn writes(resource: ResourceId) -> Use {
    touch(resource, COMPUTE, WRITE)
}

pub fn fills(resource: ResourceId) -> Use {
    touch(resource, CLEAR, Accesses::TRANSFER_WRITE)
}

pub fn in_general(resource: ResourceId, accesses: Accesses) -> Use {
    Use { layout: Some(Layout::General), ..touch(resource, COMPUTE, accesses) }
}
