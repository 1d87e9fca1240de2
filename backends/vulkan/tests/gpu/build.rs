//! Builds small plans by hand.
//!
//! [`Build`] builds a plan; the solver finds its dependencies. [`barriers_everywhere`] replaces the lowering, as simply
//! as possible. Before every pass that uses a written resource, it places a barrier on all memory, from the accesses of
//! all passes, and likewise for layout changes. This may be more than necessary, but is always sufficient.

use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, FrameResult, Loader, SceneData};
use splatgraph_framework::ir::ShaderStage;
use splatgraph_framework::shader::{Glslang, ShaderCompiler, ShaderRequest};
use splatgraph_framework::solve::add_dependencies;
use splatgraph_framework::source::{Library, SourceMap, render};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::sync::{Barrier, Barriers};
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

#[allow(dead_code)]
#[path = "../../../../tests/again.rs"]
mod again;

pub use again::again_comparing_submissions;

pub fn open() -> Vulkan {
    let options = Options { device: None, validation: Validation::Synchronization, ..Options::default() };
    Vulkan::open(&options).expect("these tests need a Vulkan 1.3 driver and the Khronos validation layer")
}

/// Closes the device; the validation layer must have no messages, including about closing.
pub fn finish(vulkan: Vulkan) {
    assert_eq!(vulkan.close(), Vec::<String>::new());
}

pub fn new_context(vulkan: &Vulkan) -> Vulkan {
    vulkan.new_context().expect("there can be another")
}

/// Loads a plan with the given barriers instead of its lowered ones.
pub fn load_with(vulkan: &mut Vulkan, plan: Plan, barriers: Barriers) {
    let loader = vulkan.loader().synchronized_by(barriers);
    let ready = loader.prepare(plan, &Scene::default(), &mut |_| {}).expect("the plan loads");
    vulkan.swap(ready).expect("it is of this device");
}

/// Loads a plan that reads no scene.
pub fn load(vulkan: &mut Vulkan, plan: Plan) {
    vulkan.load(plan, &Scene::default(), &mut |_| {}).expect("the plan loads");
}

pub fn frame(vulkan: &mut Vulkan, inputs: &FrameInputs) -> FrameResult {
    let id = vulkan.submit(inputs).expect("the frame is submitted");
    vulkan.wait(id).expect("the frame is done")
}

pub fn open_with(plan: Plan) -> Vulkan {
    let mut vulkan = open();
    load(&mut vulkan, plan);
    vulkan
}

/// Returns the words of a frame's output.
pub fn output(result: &FrameResult) -> Vec<u32> {
    words(&result.output.as_ref().expect("it was asked for").bytes)
}

/// Waits for a frame; returns the words of its output.
pub fn row(vulkan: &mut Vulkan, frame: FrameId) -> Vec<u32> {
    output(&vulkan.wait(frame).expect("the frame is done"))
}

/// Draws a frame; returns the words of its output.
pub fn shown(vulkan: &mut Vulkan) -> Vec<u32> {
    output(&frame(vulkan, &with_output()))
}

pub fn with_output() -> FrameInputs {
    FrameInputs { read_output: true, ..Default::default() }
}

pub fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect()
}

pub fn floats(bytes: &[u8]) -> Vec<f32> {
    words(bytes).into_iter().map(f32::from_bits).collect()
}

/// Scene data in memory that counts its requests.
#[derive(Default)]
pub struct Scene {
    pub identity: u64,
    pub planes: BTreeMap<(String, u32), Vec<u8>>,
    pub asked: AtomicUsize,
}

impl Scene {
    pub fn new(identity: u64, attribute: &str, plane: u32, bytes: Vec<u8>) -> Scene {
        Scene { identity, planes: [((attribute.to_string(), plane), bytes)].into(), ..Default::default() }
    }

    pub fn and(mut self, attribute: &str, plane: u32, bytes: Vec<u8>) -> Scene {
        self.planes.insert((attribute.to_string(), plane), bytes);
        self
    }

    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }
}

impl SceneData for Scene {
    fn write(&self, attribute: &str, plane: u32, offset: u64, target: &mut [u8]) -> Result<(), String> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let key = (attribute.to_string(), plane);
        let bytes = self.planes.get(&key).ok_or(format!("plane {plane} of `{attribute}`"))?;
        target.copy_from_slice(&bytes[offset as usize..][..target.len()]);
        Ok(())
    }

    fn identity(&self) -> u64 {
        self.identity
    }
}

pub const READ: Accesses = Accesses::STORAGE_READ;
pub const WRITE: Accesses = Accesses::STORAGE_WRITE;
pub const BOTH: Accesses = Accesses::STORAGE_READ.union(Accesses::STORAGE_WRITE);
pub const UNIFORM: Accesses = Accesses::UNIFORM_READ;

/// A binding: resource, binding number, and the shader's accesses.
pub type Bind = (ResourceId, u32, Accesses);

pub struct Build {
    pub plan: Plan,
}

impl Build {
    pub fn new() -> Build {
        Build { plan: Plan { name: "hand-made".to_string(), ..Plan::default() } }
    }

    fn resource(&mut self, name: &str, shape: Shape, usage: Usage, source: Source) -> ResourceId {
        let id = ResourceId(self.plan.resources.len() as u32);
        let block = (source == Source::Transient).then(|| {
            self.plan.blocks.push(Block { aliases: vec![id] });
            BlockId(self.plan.blocks.len() as u32 - 1)
        });
        let name = name.to_string();
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

    /// Puts resources into one block. They must never be alive at once.
    pub fn share(&mut self, aliases: &[ResourceId]) {
        for &id in aliases {
            let block = self.plan.resource(id).block.expect("a transient");
            self.plan.blocks[block.index()].aliases.retain(|alias| *alias != id);
        }
        let block = self.plan.resource(aliases[0]).block;
        for &id in aliases {
            self.plan.resources[id.index()].block = block;
            self.plan.blocks[block.unwrap().index()].aliases.push(id);
        }
    }

    /// Gives a resource a history under its own name. Returns the added prologue pass, which clears it.
    pub fn history(&mut self, id: ResourceId) -> PassId {
        let resource = &mut self.plan.resources[id.index()];
        resource.history = Some(resource.name.clone());
        resource.usage |= Usage::COPY_TARGET;
        let name = format!("start {}", resource.name);
        let image = matches!(resource.shape, Shape::Image { .. });
        let mut touch =
            touch(id, Stages::CLEAR, Accesses::TRANSFER_WRITE, image.then_some(Layout::TransferTarget));
        touch.discards = true;
        self.pass(Run::Once, &name, Work::ClearHistory { resource: id }, &[], vec![touch])
    }

    /// Adds a buffer of 32-bit words that allows every use except as a uniform block.
    pub fn words(&mut self, name: &str, count: u64) -> ResourceId {
        let usage = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_SOURCE | Usage::COPY_TARGET;
        self.resource(name, Shape::Buffer { stride: 4, count }, usage, Source::Transient)
    }

    pub fn scene(&mut self, attribute: &str, plane: u32, stride: u64, count: u64) -> ResourceId {
        let source = Source::Scene { attribute: attribute.to_string(), plane };
        self.resource(attribute, Shape::Buffer { stride, count }, Usage::STORAGE, source)
    }

    /// Adds a host buffer of at least `count` elements.
    pub fn given(&mut self, name: &str, stride: u64, count: u64) -> ResourceId {
        let source = Source::HostBuffer { buffer: name.to_string() };
        let usage = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_SOURCE;
        self.resource(name, Shape::Buffer { stride, count }, usage, source)
    }

    pub fn uniform(&mut self, source: Source, bytes: u64) -> ResourceId {
        self.resource("uniform", Shape::Buffer { stride: bytes, count: 1 }, Usage::UNIFORM, source)
    }

    pub fn image(&mut self, name: &str, format: Format, width: u32, height: u32, usage: Usage) -> ResourceId {
        let usage = usage | Usage::COPY_SOURCE;
        self.resource(name, Shape::Image { format, width, height }, usage, Source::Transient)
    }

    /// Compiles GLSL, without its version; the name's extension is the stage. A group of a compute shader has one
    /// invocation unless the text says otherwise.
    pub fn shader(&mut self, name: &str, glsl: &str) -> ShaderId {
        let mut files = SourceMap::new(Library::default());
        let stage = ShaderStage::of_file(name).expect("a shader's extension");
        let one = stage == ShaderStage::Compute && !glsl.contains("local_size_x");
        let one = if one { "layout(local_size_x = 1) in;\n" } else { "" };
        let file = files.add(name, format!("#version 460\n{one}{glsl}"));
        let request = ShaderRequest { file, stage, defines: &[], unfit: &[], live_glsl: None };
        let compiled = Glslang::new().compile(&mut files, &request);
        let compiled = compiled.unwrap_or_else(|errors| panic!("{}", render(&files, &errors, false)));
        self.plan.shaders.push(Shader {
            name: name.to_string(),
            path: name.to_string(),
            defines: compiled.defines,
            spirv: compiled.spirv,
            reflection: compiled.reflection,
            msl: None,
        });
        ShaderId(self.plan.shaders.len() as u32 - 1)
    }

    fn pass(&mut self, run: Run, name: &str, work: Work, binds: &[Bind], uses: Vec<Use>) -> PassId {
        let bindings = binds.iter().map(|&(resource, binding, accesses)| Binding {
            name: format!("binding {binding}"),
            binding,
            element: 0,
            kind: match self.plan.resource(resource).shape {
                Shape::Image { .. } => DescriptorKind::StorageImage,
                _ if accesses == UNIFORM => DescriptorKind::UniformBuffer,
                _ => DescriptorKind::StorageBuffer,
            },
            resource,
        });
        let pass = Pass {
            name: name.to_string(),
            phase: "test".to_string(),
            run,
            work,
            bindings: bindings.collect(),
            push: Vec::new(),
            uses,
            origin: origin(),
        };
        self.plan.passes.push(pass);
        PassId(self.plan.passes.len() as u32 - 1)
    }

    fn bound(&self, binds: &[Bind], stages: Stages) -> Vec<Use> {
        let touch = |&(resource, _, accesses): &Bind| {
            let image = matches!(self.plan.resource(resource).shape, Shape::Image { .. });
            let touch = touch(resource, stages, accesses, image.then_some(Layout::General));
            // An image that is only written is written completely.
            Use { discards: image && accesses == WRITE, ..touch }
        };
        binds.iter().map(touch).collect()
    }

    pub fn fill(&mut self, run: Run, name: &str, buffer: ResourceId, value: u32) -> PassId {
        let uses = vec![touch(buffer, Stages::CLEAR, Accesses::TRANSFER_WRITE, None)];
        self.pass(run, name, Work::Fill { buffer, value }, &[], uses)
    }

    pub fn dispatch(
        &mut self,
        run: Run,
        name: &str,
        shader: ShaderId,
        groups: u32,
        binds: &[Bind],
    ) -> PassId {
        let uses = self.bound(binds, Stages::COMPUTE);
        let work = Work::Dispatch { shader, groups: Groups::Direct([groups, 1, 1]) };
        self.pass(run, name, work, binds, uses)
    }

    pub fn dispatch_indirect(
        &mut self,
        name: &str,
        shader: ShaderId,
        (buffer, offset): (ResourceId, u64),
        binds: &[Bind],
    ) -> PassId {
        let mut uses = self.bound(binds, Stages::COMPUTE);
        uses.push(touch(buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None));
        let work = Work::Dispatch { shader, groups: Groups::Indirect { buffer, offset } };
        self.pass(Run::Frame, name, work, binds, uses)
    }

    /// Adds a draw whose vertex shader reads `binds`.
    pub fn draw(
        &mut self,
        name: &str,
        [vertex, fragment]: [ShaderId; 2],
        call: DrawCall,
        targets: &[Target],
        binds: &[Bind],
    ) -> PassId {
        let mut uses = self.bound(binds, Stages::VERTEX);
        if let DrawCall::Indirect { buffer, .. } = call {
            uses.push(touch(buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None));
        }
        for target in targets {
            let accesses = Accesses::COLOR_READ | Accesses::COLOR_WRITE;
            let mut touch = touch(target.image, Stages::COLOR_OUTPUT, accesses, Some(Layout::ColorTarget));
            touch.discards = matches!(target.load, Load::Clear(..));
            uses.push(touch);
        }
        let topology = Topology::TriangleList;
        let work = Work::Draw { vertex, fragment, topology, call, targets: targets.to_vec(), depth: None };
        self.pass(Run::Frame, name, work, binds, uses)
    }

    /// Gives the last pass, a draw, a depth attachment.
    pub fn depth(&mut self, image: ResourceId, access: DepthAccess) {
        let pass = self.plan.passes.last_mut().expect("a draw");
        let Work::Draw { depth, .. } = &mut pass.work else { panic!("{} is no draw", pass.name) };
        *depth = Some(DepthTarget { image, access });
        let accesses = match access {
            DepthAccess::Write => Accesses::DEPTH_WRITE,
            DepthAccess::TestAndWrite => Accesses::DEPTH_READ | Accesses::DEPTH_WRITE,
            DepthAccess::Test => Accesses::DEPTH_READ,
        };
        let mut touch = touch(image, Stages::DEPTH_TESTS, accesses, Some(Layout::DepthTarget));
        touch.discards = access == DepthAccess::Write;
        pass.uses.push(touch);
    }

    pub fn stat(&mut self, name: &str, buffer: ResourceId, offset: u64) {
        self.plan.stats.push(Stat { name: name.to_string(), buffer, offset, grows: Vec::new() });
    }

    /// Finishes the plan with the export of `output` and of the statistics, and solves its dependencies.
    pub fn export(mut self, output: ResourceId) -> Plan {
        self.plan.output = output;
        let mut uses =
            vec![touch(output, Stages::COPY, Accesses::TRANSFER_READ, Some(Layout::TransferSource))];
        let stats = self.plan.stats.iter();
        uses.extend(stats.map(|s| touch(s.buffer, Stages::COPY, Accesses::TRANSFER_READ, None)));
        let count = self.plan.stats.len() as u64;
        let readback = (count > 0).then(|| {
            let shape = Shape::Buffer { stride: 4, count };
            self.resource("stats", shape, Usage::COPY_TARGET, Source::Readback)
        });
        uses.extend(readback.map(|id| touch(id, Stages::COPY, Accesses::TRANSFER_WRITE, None)));
        self.pass(Run::Frame, "export", Work::Export, &[], uses);
        if let Some(id) = readback {
            let uses = vec![touch(id, Stages::HOST, Accesses::HOST_READ, None)];
            self.pass(Run::Frame, "host", Work::Host, &[], uses);
        }

        let mut plan = self.plan;
        for (index, pass) in plan.passes.iter().enumerate() {
            let part = if pass.run == Run::Once { &mut plan.prologue } else { &mut plan.frame };
            part.push(PassId(index as u32));
        }
        add_dependencies(&mut plan);
        plan
    }
}

/// Returns barriers before each pass, from the accesses of all passes to the pass's own.
pub fn barriers_everywhere(plan: &Plan) -> Barriers {
    type Side = (Stages, Accesses);
    let all = |uses: &mut dyn Iterator<Item = &Use>| -> Side {
        uses.fold((Stages::empty(), Accesses::empty()), |(s, a), t| (s | t.stages, a | t.accesses))
    };
    let of_device = |touch: &&Use| touch.stages != Stages::HOST;
    let anything = all(&mut plan.passes.iter().flat_map(|pass| &pass.uses).filter(of_device));
    let written = |id: ResourceId| {
        let mut uses = plan.passes.iter().flat_map(|pass| &pass.uses);
        let same = |other| other == id || plan.aliases(id).any(|alias| alias == other);
        uses.any(|touch| same(touch.resource) && touch.accesses.writes())
    };
    let changes = |at: Option<PassId>, target: &dyn Fn(ResourceId) -> Side| -> Vec<Barrier> {
        let change = |change: &LayoutChange| Barrier {
            image: Some(change.transition()),
            ..barrier(anything, target(change.image))
        };
        plan.layout_changes_at(at).map(change).collect()
    };
    let before = |(index, pass): (usize, &Pass)| {
        let target = all(&mut pass.uses.iter().filter(|touch| written(touch.resource)));
        let memory = (!target.0.is_empty()).then(|| barrier(anything, target));
        let uses = |image| all(&mut pass.uses.iter().filter(|touch| touch.resource == image));
        memory.into_iter().chain(changes(Some(PassId(index as u32)), &uses)).collect()
    };
    Barriers {
        before: plan.passes.iter().enumerate().map(before).collect(),
        handover: changes(None, &|_| anything),
    }
}

pub fn barrier(source: (Stages, Accesses), target: (Stages, Accesses)) -> Barrier {
    Barrier { image: None, masks: Masks::new(source, target), causes: Vec::new() }
}

/// Finishes a plan: copies the buffer `words` to an image of one row, and exports the image.
pub fn show(mut build: Build, words: ResourceId) -> Plan {
    let count = build.plan.resource(words).bytes() as u32 / 4;
    let image = build.image("row", Format::R32Uint, count, 1, Usage::STORAGE);
    let shader = build.shader("show.comp", SHOW);
    build.dispatch(Run::Frame, "show", shader, count, &[(words, 0, READ), (image, 1, WRITE)]);
    build.export(image)
}

const SHOW: &str = "layout(set = 0, binding = 0) readonly buffer Words { uint words[]; };
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D row;
void main() { imageStore(row, ivec2(gl_WorkGroupID.x, 0), uvec4(words[gl_WorkGroupID.x])); }";

/// Returns a shader that adds each word's index and a constant to it.
pub fn add(constant: u32) -> String {
    format!(
        "layout(set = 0, binding = 0) buffer Words {{ uint words[]; }};
void main() {{ words[gl_WorkGroupID.x] += gl_WorkGroupID.x + {constant}u; }}"
    )
}

/// Returns a shader that sets the first pixel of `image`, a storage image of 32-bit words, to `value`.
pub fn image_shader(value: &str) -> String {
    format!(
        "layout(set = 0, binding = 0, r32ui) uniform uimage2D image;
void main() {{ imageStore(image, ivec2(0), {value}); }}"
    )
}

pub fn error_of<T>(result: Result<T, BackendError>) -> String {
    match result {
        Ok(_) => panic!("this should have been refused"),
        Err(error) => error.to_string(),
    }
}

fn touch(resource: ResourceId, stages: Stages, accesses: Accesses, layout: Option<Layout>) -> Use {
    Use { resource, stages, accesses, layout, discards: false }
}

fn origin() -> Origin {
    Origin { file: "hand-made".to_string(), line: 1, column: 1 }
}
