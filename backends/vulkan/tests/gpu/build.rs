//! Small plans, built by hand.
//!
//! [`Build`] is a stand-in for the framework's solver, as plain as can be: before every pass it puts a barrier on
//! everything that the pass touches and anything writes, waiting for whatever any pass does to it. That is more than is
//! needed and never less.

use splatgraph_api::{BackendError, Device, FrameInputs, FrameResult, SceneData};
use splatgraph_framework::plan::*;
use splatgraph_framework::shader::{Glslang, ShaderCompiler, ShaderRequest, ShaderStage};
use splatgraph_framework::source::{Library, SourceMap, render};
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

pub fn open() -> Vulkan {
    let options = Options { device: None, validation: Validation::Synchronization };
    Vulkan::open(&options).expect("these tests need a Vulkan 1.3 driver and the Khronos validation layer")
}

/// Closes the device; the validation layer must have had nothing to say, of the closing either.
pub fn finish(vulkan: Vulkan) {
    assert_eq!(vulkan.close(), Vec::<String>::new());
}

/// Loads a plan that reads nothing of a scene.
pub fn load(vulkan: &mut Vulkan, plan: Plan) {
    vulkan.load(plan, &Scene::default(), &mut |_| {}).expect("the plan loads");
}

/// Submits a frame and waits for it.
pub fn frame(vulkan: &mut Vulkan, inputs: &FrameInputs) -> FrameResult {
    let id = vulkan.submit(inputs).expect("the frame is submitted");
    vulkan.wait(id).expect("the frame is done")
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

/// Scene data held in memory, that counts how often it was asked.
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
}

impl SceneData for Scene {
    fn write(&self, attribute: &str, plane: u32, target: &mut [u8]) -> Result<(), String> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let key = (attribute.to_string(), plane);
        let bytes = self.planes.get(&key).ok_or(format!("plane {plane} of `{attribute}`"))?;
        target.copy_from_slice(bytes);
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

/// A binding: resource, binding number, and what the shader does to it.
pub type Bind = (ResourceId, u32, Accesses);

pub struct Build {
    pub plan: Plan,
}

impl Build {
    /// A plan without passes.
    pub fn new() -> Build {
        Build {
            plan: Plan {
                version: PLAN_VERSION,
                name: "hand-made".to_string(),
                summary: String::new(),
                facts: BTreeMap::new(),
                params: Vec::new(),
                resources: Vec::new(),
                shaders: Vec::new(),
                passes: Vec::new(),
                prologue: Vec::new(),
                frame: Vec::new(),
                left_out: Vec::new(),
                output: ResourceId(0),
                stats: Vec::new(),
            },
        }
    }

    fn resource(&mut self, name: &str, shape: Shape, usage: Usage, source: Source) -> ResourceId {
        self.plan.resources.push(Resource { name: name.to_string(), shape, usage, source, origin: origin() });
        ResourceId(self.plan.resources.len() as u32 - 1)
    }

    /// A buffer of 32-bit words that can be used for anything.
    pub fn words(&mut self, name: &str, count: u64) -> ResourceId {
        let usage = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_SOURCE | Usage::COPY_TARGET;
        self.resource(name, Shape::Buffer { stride: 4, count }, usage, Source::Transient)
    }

    pub fn scene(&mut self, attribute: &str, plane: u32, stride: u64, count: u64) -> ResourceId {
        let source = Source::Scene { attribute: attribute.to_string(), plane };
        self.resource(attribute, Shape::Buffer { stride, count }, Usage::STORAGE, source)
    }

    pub fn uniform(&mut self, source: Source, bytes: u64) -> ResourceId {
        self.resource("uniform", Shape::Buffer { stride: bytes, count: 1 }, Usage::UNIFORM, source)
    }

    pub fn image(&mut self, name: &str, format: Format, width: u32, height: u32, usage: Usage) -> ResourceId {
        let usage = usage | Usage::COPY_SOURCE;
        self.resource(name, Shape::Image { format, width, height }, usage, Source::Transient)
    }

    /// Compiles GLSL; the stage is told by the name's extension.
    pub fn shader(&mut self, name: &str, glsl: &str) -> ShaderId {
        let mut files = SourceMap::new(Library::default());
        let file = files.add(name, glsl);
        let stage = ShaderStage::of_file(name).expect("a shader's extension");
        let request = ShaderRequest { file, stage, defines: &[], generated: &[] };
        let compiled = Glslang::new().compile(&mut files, &request);
        let compiled = compiled.unwrap_or_else(|errors| panic!("{}", render(&files, &errors, false)));
        self.plan.shaders.push(Shader {
            name: name.to_string(),
            defines: compiled.defines,
            spirv: compiled.spirv,
            reflection: compiled.reflection,
        });
        ShaderId(self.plan.shaders.len() as u32 - 1)
    }

    fn pass(&mut self, run: Run, name: &str, work: Work, binds: &[Bind], touches: Vec<Touch>) -> PassId {
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
            touches,
            origin: origin(),
        };
        self.plan.passes.push(pass);
        PassId(self.plan.passes.len() as u32 - 1)
    }

    fn bound(&self, binds: &[Bind], stages: Stages) -> Vec<Touch> {
        let touch = |&(resource, _, accesses): &Bind| {
            let image = matches!(self.plan.resource(resource).shape, Shape::Image { .. });
            touch(resource, stages, accesses, image.then_some(Layout::General))
        };
        binds.iter().map(touch).collect()
    }

    pub fn fill(&mut self, run: Run, name: &str, buffer: ResourceId, value: u32) -> PassId {
        let touches = vec![touch(buffer, Stages::CLEAR, Accesses::TRANSFER_WRITE, None)];
        self.pass(run, name, Work::Fill { buffer, value }, &[], touches)
    }

    pub fn dispatch(
        &mut self,
        run: Run,
        name: &str,
        shader: ShaderId,
        groups: u32,
        binds: &[Bind],
    ) -> PassId {
        let touches = self.bound(binds, Stages::COMPUTE);
        let work = Work::Dispatch { shader, groups: Groups::Direct([groups, 1, 1]) };
        self.pass(run, name, work, binds, touches)
    }

    pub fn dispatch_indirect(
        &mut self,
        name: &str,
        shader: ShaderId,
        (buffer, offset): (ResourceId, u64),
        binds: &[Bind],
    ) -> PassId {
        let mut touches = self.bound(binds, Stages::COMPUTE);
        touches.push(touch(buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None));
        let work = Work::Dispatch { shader, groups: Groups::Indirect { buffer, offset } };
        self.pass(Run::Frame, name, work, binds, touches)
    }

    /// `binds` are read by the vertex shader.
    pub fn draw(
        &mut self,
        name: &str,
        [vertex, fragment]: [ShaderId; 2],
        call: DrawCall,
        targets: &[Target],
        binds: &[Bind],
    ) -> PassId {
        let mut touches = self.bound(binds, Stages::VERTEX);
        if let DrawCall::Indirect { buffer, .. } = call {
            touches.push(touch(buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None));
        }
        for target in targets {
            let accesses = Accesses::COLOR_READ | Accesses::COLOR_WRITE;
            let mut touch = touch(target.image, Stages::COLOR_OUTPUT, accesses, Some(Layout::ColorTarget));
            touch.discards = matches!(target.load, Load::Clear(..));
            touches.push(touch);
        }
        let topology = Topology::TriangleList;
        let work = Work::Draw { vertex, fragment, topology, call, targets: targets.to_vec() };
        self.pass(Run::Frame, name, work, binds, touches)
    }

    pub fn stat(&mut self, name: &str, buffer: ResourceId, offset: u64) {
        self.plan.stats.push(Stat { name: name.to_string(), buffer, offset });
    }

    /// Ends the plan with its export of `output`, and puts the barriers in.
    pub fn export(mut self, output: ResourceId) -> Plan {
        self.plan.output = output;
        let mut touches =
            vec![touch(output, Stages::COPY, Accesses::TRANSFER_READ, Some(Layout::TransferSource))];
        let stats = self.plan.stats.iter();
        touches.extend(stats.map(|s| touch(s.buffer, Stages::COPY, Accesses::TRANSFER_READ, None)));
        self.pass(Run::Frame, "export", Work::Export, &[], touches);

        let order = |run: Run| {
            let passes = self.plan.passes.iter().enumerate().filter(move |(_, pass)| pass.run == run);
            passes.map(|(index, _)| PassId(index as u32)).collect::<Vec<_>>()
        };
        let (once, always) = (order(Run::Once), order(Run::Frame));
        // The layout that each image is in, followed through one frame to where the next begins.
        let mut layouts = BTreeMap::new();
        self.steps(&once, &mut layouts);
        let mut steady = layouts.clone();
        self.steps(&always, &mut steady);
        let (prologue, frame) = (self.steps(&once, &mut BTreeMap::new()), self.steps(&always, &mut steady));
        Plan { prologue, frame, ..self.plan }
    }

    fn steps(&self, passes: &[PassId], layouts: &mut BTreeMap<ResourceId, Layout>) -> Vec<Step> {
        let step = |&pass: &PassId| {
            let mut barriers: Vec<Barrier> = Vec::new();
            for touch in &self.plan.pass(pass).touches {
                let all = self.plan.passes.iter().flat_map(|p| &p.touches);
                let all: Vec<_> = all.filter(|t| t.resource == touch.resource).collect();
                if !all.iter().any(|t| t.accesses.writes()) {
                    continue;
                }
                // A resource touched twice by one pass (as arguments and by the shader) has one barrier.
                if let Some(known) = barriers.iter_mut().find(|b| b.resource == touch.resource) {
                    known.target_stages |= touch.stages;
                    known.target_accesses |= touch.accesses;
                    continue;
                }
                let old = layouts.get(&touch.resource).copied().unwrap_or(Layout::Undefined);
                let new = touch.layout;
                if let Some(new) = new {
                    layouts.insert(touch.resource, new);
                }
                barriers.push(Barrier {
                    resource: touch.resource,
                    hazard: Hazard::ReadAfterWrite,
                    after: Vec::new(),
                    across_frames: false,
                    source_stages: all.iter().fold(Stages::empty(), |s, t| s | t.stages),
                    source_accesses: all.iter().fold(Accesses::empty(), |s, t| s | t.accesses),
                    target_stages: touch.stages,
                    target_accesses: touch.accesses,
                    layouts: new.map(|new| (if touch.discards { Layout::Undefined } else { old }, new)),
                });
            }
            Step { barriers, pass }
        };
        passes.iter().map(step).collect()
    }
}

/// A plan that has `words(n)`, ends with a copy of it into an image of one row, and exports that.
pub fn show(mut build: Build, words: ResourceId) -> Plan {
    let count = build.plan.resource(words).bytes() as u32 / 4;
    let image = build.image("row", Format::R32Uint, count, 1, Usage::STORAGE);
    let shader = build.shader("show.comp", SHOW);
    build.dispatch(Run::Frame, "show", shader, count, &[(words, 0, READ), (image, 1, WRITE)]);
    build.export(image)
}

const SHOW: &str = "#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) readonly buffer Words { uint words[]; };
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D row;
void main() { imageStore(row, ivec2(gl_WorkGroupID.x, 0), uvec4(words[gl_WorkGroupID.x])); }";

/// Adds its index, and a constant, to every word.
pub fn add(constant: u32) -> String {
    format!(
        "#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) buffer Words {{ uint words[]; }};
void main() {{ words[gl_WorkGroupID.x] += gl_WorkGroupID.x + {constant}u; }}"
    )
}

pub fn error_of<T>(result: Result<T, BackendError>) -> String {
    match result {
        Ok(_) => panic!("this should have been refused"),
        Err(error) => error.to_string(),
    }
}

fn touch(resource: ResourceId, stages: Stages, accesses: Accesses, layout: Option<Layout>) -> Touch {
    Touch { resource, stages, accesses, layout, discards: false }
}

fn origin() -> Origin {
    Origin { file: "hand-made".to_string(), line: 1, column: 1 }
}
