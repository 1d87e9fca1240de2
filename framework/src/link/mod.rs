//! Linking: compiles the shaders of each pass and checks the graph against them.
//!
//! Every block that a shader uses must be bound, every entry of `bind` and `push` must exist in a shader, and kinds, strides,
//! sizes and formats must match. Linking also derives the accesses of each pass ([`Use`]) from the compiled code, so that no
//! hand-kept list can go stale. The result is the list of passes, still in the order of the file.

mod bindings;
mod draws;
mod effects;
mod races;

use crate::ir::{
    Accesses, DeviceFacts, DrawCall, Features, FileId, Groups, Layout, Pass, Request, Run, Shader,
    ShaderStage, Shape, Span, Stages, Use, Work,
};
use crate::lower::{
    Extent, Lowered, LoweredPass, LoweredResource, LoweredSize, LoweredWork, ResourceHandle, ShaderName,
};
use crate::shader::{CANCELLED, Compiled, ShaderCompiler, ShaderRequest};
use crate::source::{Diagnostic, Kind, SourceMap};
use std::collections::{BTreeSet, HashMap, HashSet};
use std::rc::Rc;
use std::sync::Arc;

pub use effects::PassParams;

/// Holds a graph whose passes fit their shaders.
#[derive(Clone, Debug)]
pub struct Linked {
    /// Resources, parameters and names of the graph.
    pub lowered: Lowered,
    /// Compiled shaders, one per file and set of defines.
    pub shaders: Vec<Shader>,
    /// Passes in the order of the file, of the prologue and of the frame mixed.
    pub passes: Vec<LinkedPass>,
}

/// Holds a pass with its accesses, over handles of the lowered graph.
#[derive(Clone, Debug)]
pub struct LinkedPass {
    /// The pass.
    pub pass: Pass<ResourceHandle, ShaderHandle>,
    /// Its name in the file.
    pub span: Span,
    /// The include that it comes from, as an index into [`Lowered::includes`].
    pub include: Option<usize>,
    /// The parameters that it depends on.
    pub params: PassParams,
}

/// Indexes [`Linked::shaders`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ShaderHandle(pub u32);

impl ShaderHandle {
    /// Returns the position in the list.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Compiles the shaders of every pass and validates the pass against them.
pub fn link(
    mut lowered: Lowered,
    request: &Request,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Linked, Vec<Diagnostic>> {
    count_compilations(&lowered.passes)?;
    let mut linker = Linker {
        device: request.facts.device,
        generated: vec![("live.glsl".to_string(), lowered.live_glsl.clone())],
        shaders: Vec::new(),
        declared: HashMap::new(),
        reached: HashMap::new(),
        compiled: HashMap::new(),
        found: HashMap::new(),
        errors: Vec::new(),
        files,
        compiler,
        lowered: &lowered,
    };
    let mut passes = Vec::with_capacity(lowered.passes.len());
    for pass in &lowered.passes {
        if let Some(pass) = linker.pass(pass) {
            passes.push(pass);
        }
        // Report a mistake in a repeated pass or a shared include once.
        if linker.errors.len() >= 20 {
            break;
        }
        if linker.compiler.is_cancelled() {
            linker.errors.push(Diagnostic::new(CANCELLED, pass.span, ""));
            break;
        }
    }
    let Linker { mut errors, shaders, files, compiler, .. } = linker;
    if !errors.is_empty() {
        let mut seen: Vec<Diagnostic> = Vec::new();
        errors.retain(|e| {
            let new = !seen.iter().any(|s| s.primary.span == e.primary.span && s.message == e.message);
            if new {
                seen.push(e.clone());
            }
            new
        });
        return Err(errors);
    }
    // Shaders that are not compiled only affect messages: the plan does not depend on their files.
    let mentioned = files.aside(|files| effects::mentioned(&lowered, &passes, files, compiler));
    lowered.removed.iter_mut().zip(mentioned).for_each(|(removed, params)| removed.named.extend(params));
    Ok(Linked { lowered, shaders, passes })
}

/// Maximum number of shader compilations of a graph: far beyond any use, but less than minutes of work.
const MOST_COMPILATIONS: usize = 500;

/// Refuses a graph that needs too many different compilations, before the first one.
fn count_compilations(passes: &[LoweredPass]) -> Result<(), Vec<Diagnostic>> {
    let mut different = HashSet::new();
    let mut passed = None;
    for pass in passes {
        let shaders = match &pass.work {
            LoweredWork::Dispatch { shader, .. } => vec![shader],
            LoweredWork::Draw { vertex, fragment, .. } => vec![vertex, fragment],
            LoweredWork::Fill { .. } => Vec::new(),
        };
        for shader in shaders {
            different.insert((pass.file, &shader.name, &pass.defines));
            if different.len() > MOST_COMPILATIONS {
                passed.get_or_insert(shader.span);
            }
        }
    }
    let Some(span) = passed else { return Ok(()) };
    let message = format!("this graph needs {} different compilations of its shaders", different.len());
    let diagnostic =
        Diagnostic::new(message, span, format!("the limit of {MOST_COMPILATIONS} is passed here"));
    Err(vec![diagnostic.with_help("give what differs from pass to pass as a push constant, not as a define")])
}

type Defines = Vec<(String, String)>;

struct Linker<'a> {
    lowered: &'a Lowered,
    device: DeviceFacts,
    files: &'a mut SourceMap,
    compiler: &'a mut dyn ShaderCompiler,
    generated: Vec<(String, String)>,
    shaders: Vec<Shader>,
    /// Names of the blocks that each shader declares: see [`Compiled::declared`].
    declared: HashMap<ShaderHandle, Arc<BTreeSet<String>>>,
    /// Names that each shader depends on: see [`Compiled::reached`].
    reached: HashMap<ShaderHandle, Arc<BTreeSet<String>>>,
    /// Shaders compiled so far, by file and list of defines; the passes of a repeat share theirs.
    compiled: HashMap<(FileId, Rc<Defines>), ShaderHandle>,
    /// Files of shaders, by the graph that names them and their name there.
    found: HashMap<(FileId, String), FileId>,
    errors: Vec<Diagnostic>,
}

impl Linker<'_> {
    fn resource(&self, handle: ResourceHandle) -> &LoweredResource {
        self.lowered.resource(handle)
    }

    /// Links a pass; returns `None` after at least one error.
    fn pass(&mut self, pass: &LoweredPass) -> Option<LinkedPass> {
        let before = self.errors.len();
        let mut uses = Vec::new();
        let (work, stages): (Work<_, _>, Vec<(ShaderHandle, Stages)>) = match &pass.work {
            LoweredWork::Fill { buffer, value } => {
                touch(&mut uses, *buffer, Stages::CLEAR, Accesses::TRANSFER_WRITE, None, false);
                (Work::Fill { buffer: *buffer, value: *value }, Vec::new())
            }
            LoweredWork::Dispatch { shader, size, size_span } => {
                let id = self.shader(pass, shader, ShaderStage::Compute)?;
                self.workgroup(id, shader.span);
                let groups = self.groups(id, *size, *size_span)?;
                if let Groups::Indirect { buffer, .. } = groups {
                    touch(&mut uses, buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None, false);
                }
                (Work::Dispatch { shader: id, groups }, vec![(id, Stages::COMPUTE)])
            }
            LoweredWork::Draw { vertex, fragment, topology, call, targets, .. } => {
                let vertex_id = self.shader(pass, vertex, ShaderStage::Vertex);
                let fragment_id = self.shader(pass, fragment, ShaderStage::Fragment);
                let (vertex_id, fragment_id) = (vertex_id?, fragment_id?);
                self.interface(vertex_id, fragment_id, fragment.span);
                self.targets(fragment_id, targets, pass.span, &mut uses);
                if let DrawCall::Indirect { buffer, .. } = *call {
                    touch(&mut uses, buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None, false);
                }
                let work = Work::Draw {
                    vertex: vertex_id,
                    fragment: fragment_id,
                    topology: *topology,
                    call: *call,
                    targets: targets.iter().map(|(t, _)| *t).collect(),
                };
                (work, vec![(vertex_id, Stages::VERTEX), (fragment_id, Stages::FRAGMENT)])
            }
        };
        let bindings = self.bindings(pass, &stages, &mut uses);
        let push = self.push(pass, &stages);
        self.races(pass, &stages, &uses);
        if let Some((buffer, span)) = races::arguments(pass)
            && pass.run == Run::Once
            && self.changes_every_frame(&[buffer])
        {
            self.errors.push(bindings::once_every_frame(pass, span, "its arguments"));
        }
        let linked = Pass {
            name: pass.name.clone(),
            phase: pass.phase.clone(),
            run: pass.run,
            work,
            bindings,
            push,
            uses,
            origin: self.files.origin(pass.span),
        };
        (self.errors.len() == before).then_some(LinkedPass {
            pass: linked,
            span: pass.span,
            include: pass.include,
            params: self.params(pass, &stages),
        })
    }

    /// Compiles a shader, or finds it among those compiled for other passes.
    fn shader(&mut self, pass: &LoweredPass, name: &ShaderName, stage: ShaderStage) -> Option<ShaderHandle> {
        if ShaderStage::of_file(&name.name) != Some(stage) {
            let ending = match stage {
                ShaderStage::Compute => ".comp",
                ShaderStage::Vertex => ".vert",
                ShaderStage::Fragment => ".frag",
            };
            self.errors.push(Diagnostic::new(
                format!("`{}` is not a {} shader", name.name, format!("{stage:?}").to_lowercase()),
                name.span,
                format!("the name of one ends in `{ending}`"),
            ));
            return None;
        }
        let known = self.found.get(&(pass.file, name.name.clone())).copied();
        let file = match known.map_or_else(|| self.files.find(Some(pass.file), &name.name, Kind::Shader), Ok)
        {
            Ok(file) => file,
            Err(error) => {
                self.errors.push(error.at(name.span));
                return None;
            }
        };
        self.found.insert((pass.file, name.name.clone()), file);
        let key = (file, pass.defines.clone());
        if let Some(id) = self.compiled.get(&key) {
            return Some(*id);
        }
        let request = ShaderRequest {
            file,
            stage,
            defines: &pass.defines,
            unfit: &pass.unfit,
            generated: &self.generated,
        };
        match self.compiler.compile(self.files, &request) {
            Ok(Compiled { spirv, defines, reached, reflection, declared }) => {
                let shader = Shader { name: name.name.clone(), defines, spirv, reflection, msl: None };
                let at = self.shaders.iter().position(|s| *s == shader).unwrap_or_else(|| {
                    self.shaders.push(shader);
                    self.shaders.len() - 1
                });
                let id = ShaderHandle(at as u32);
                self.features(id, name.span);
                self.declared.insert(id, declared);
                // Texts that differ only in code that is not compiled give one shader.
                let known = self.reached.entry(id).or_insert_with(|| reached.clone());
                if *known != reached {
                    Arc::make_mut(known).extend(reached.iter().cloned());
                }
                self.compiled.insert(key, id);
                Some(id)
            }
            Err(errors) => {
                self.errors.extend(errors);
                None
            }
        }
    }

    /// Checks a shader's optional features against those of the device.
    fn features(&mut self, id: ShaderHandle, span: Span) {
        let shader = &self.shaders[id.index()];
        let missing = shader.reflection.features.difference(self.device.features);
        if missing.is_empty() {
            return;
        }
        let message = format!("`{}` needs {missing}", shader.name);
        let error = Diagnostic::new(message, span, "the device does not have this");
        // There is no fact for stores in draws, so a graph cannot `require` them.
        let error = match missing.intersects(Features::VERTEX_STORES | Features::FRAGMENT_STORES) {
            true => error.with_help(
                "for every device, let a `Dispatch` write this, or draw it to a target of its own: \
                 `targets` takes several images",
            ),
            false => error,
        };
        self.errors.push(error);
    }

    /// Checks a compute shader's workgroup against the device.
    fn workgroup(&mut self, id: ShaderHandle, span: Span) {
        let reflection = &self.shaders[id.index()].reflection;
        let invocations: u64 = reflection.local_size.iter().map(|s| *s as u64).product();
        if invocations > self.device.max_invocations.into() {
            self.errors.push(Diagnostic::new(
                format!("the device has workgroups of at most {} invocations", self.device.max_invocations),
                span,
                format!("this shader has {invocations}"),
            ));
        }
        if reflection.shared_bytes > self.device.shared_bytes {
            self.errors.push(Diagnostic::new(
                format!("the device has {} bytes of shared memory", self.device.shared_bytes),
                span,
                format!("this shader uses {}", reflection.shared_bytes),
            ));
        }
    }

    fn groups(&mut self, id: ShaderHandle, size: LoweredSize, span: Span) -> Option<Groups<ResourceHandle>> {
        let local = self.shaders[id.index()].reflection.local_size.map(|n| u64::from(n.max(1)));
        // Invocations per unit of `size`: 1 for `Groups`, the local size for `Threads`.
        let (extent, each) = match size {
            LoweredSize::Indirect { buffer, offset } => return Some(Groups::Indirect { buffer, offset }),
            LoweredSize::Groups(extent) => (extent, [1; 3]),
            LoweredSize::Threads(extent) => (extent, local),
        };
        let Extent { size, dimensions } = extent;
        if each[dimensions..].iter().any(|n| *n > 1) {
            let [x, y, z] = local;
            let divides = [
                "`Threads` divides by `local_size_x` alone",
                "`Threads(x, y)` divides by `local_size_x` and `_y` alone",
            ];
            let message = format!("{}, and a workgroup here is {x} x {y} x {z}", divides[dimensions - 1]);
            self.errors.push(Diagnostic::new(message, span, "too many invocations would run").with_help(
                "give the shader a local size in as many dimensions, or count its workgroups with `Groups`",
            ));
            return None;
        }
        let mut groups: [u64; 3] = std::array::from_fn(|axis| size[axis].div_ceil(each[axis]));
        let limits = self.device.max_groups().map(|most| u64::from(most.max(1)));
        let mut too_large = |found: String| {
            self.errors.push(Diagnostic::new(
                "this dispatch is larger than the device can do at once",
                span,
                found,
            ));
        };
        if dimensions == 1 {
            // The shortest rows for this number of rows, so that few groups are idle.
            let [all, rows] = [groups[0], groups[0].div_ceil(limits[0]).max(1)];
            if rows > limits[1] {
                too_large(format!(
                    "{all} workgroups; {} in x and {} in y are possible",
                    limits[0], limits[1]
                ));
                return None;
            }
            groups = [all.div_ceil(rows), rows, 1];
        } else if let Some(axis) = (0..3).find(|axis| groups[*axis] > limits[*axis]) {
            too_large(format!(
                "{} workgroups in {}; {} are possible",
                groups[axis],
                ["x", "y", "z"][axis],
                limits[axis]
            ));
            return None;
        }
        // Indices of invocations, or of groups where groups are counted, are `uint`s in shaders: in one dimension all of them, in
        // several those of each.
        let counted = match dimensions {
            1 => (groups[0] * groups[1]).saturating_mul(each[0]),
            _ => (0..3).map(|axis| groups[axis].saturating_mul(each[axis])).max().unwrap_or(0),
        };
        if counted > 1 << 32 {
            let found =
                format!("expected at most 4294967296, those of unfinished rows included, found {counted}");
            self.errors.push(Diagnostic::new(
                "this dispatch has more indices than 32 bits hold",
                span,
                found,
            ));
            return None;
        }
        Some(Groups::Direct(groups.map(|n| n as u32)))
    }
}

/// Adds accesses to a pass's list, with one entry per resource and stage.
fn touch(
    uses: &mut Vec<Use<ResourceHandle>>,
    resource: ResourceHandle,
    stages: Stages,
    accesses: Accesses,
    layout: Option<Layout>,
    discards: bool,
) {
    match uses.iter_mut().find(|t| t.resource == resource && t.stages == stages) {
        Some(touch) => touch.accesses |= accesses,
        None => uses.push(Use { resource, stages, accesses, layout, discards }),
    }
}

/// Formats a shape: "12 x 4 bytes" or "960 x 540 Rgba16Float".
fn describe(resource: &LoweredResource) -> String {
    match resource.shape {
        Shape::Buffer { stride, count } => format!("{count} elements of {stride} bytes"),
        Shape::Image { format, width, height } => format!("an image of {width} x {height}, {format:?}"),
    }
}
