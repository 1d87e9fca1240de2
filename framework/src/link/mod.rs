//! Links a graph: compiles the shaders of each pass and checks the graph against them.
//!
//! Every block that a shader uses must be bound, every entry of `bind` and `push` must exist in a shader, and kinds,
//! strides, sizes and formats must match. Linking also derives the accesses of each pass from the compiled code. The
//! result is the list of passes, still in file order.

mod bindings;
mod draws;
mod effects;
mod linker;
mod races;
mod shaders;

use std::collections::HashMap;

use crate::ir::{Accesses, DrawCall, Groups, Pass, Request, Run, ShaderId, ShaderStage, Stages, Work};
use crate::lower::{Lowered, LoweredPass, ShaderName};
use crate::shader::{CANCELLED, ShaderCompiler};
use crate::source::{Diagnostic, Kind, SourceMap};
pub use linker::{Linked, LinkedPass, PassParams};
use linker::{Linker, touch};
use shaders::count_compilations;

/// Compiles the shaders of every pass and validates the pass against them.
///
/// # Errors
/// Errors of shaders, and of passes that do not match them or exceed the device's limits. If there are none, shaders of
/// removed passes that have no file. A graph with too many distinct compilations is refused first. A cancelled compiler
/// gives the error [`CANCELLED`].
pub fn link(
    mut lowered: Lowered,
    request: &Request,
    files: &mut SourceMap,
    compiler: &mut dyn ShaderCompiler,
) -> Result<Linked, Vec<Diagnostic>> {
    count_compilations(&lowered.passes)?;
    let mut linker = Linker {
        device: request.facts.device,
        shaders: Vec::new(),
        declared: HashMap::new(),
        reached: HashMap::new(),
        compiled: HashMap::new(),
        found: HashMap::new(),
        errors: Vec::new(),
        sizes: Vec::new(),
        files,
        compiler,
        lowered: &lowered,
    };
    let mut passes = Vec::with_capacity(lowered.passes.len());
    for pass in &lowered.passes {
        if let Some(pass) = linker.pass(pass) {
            passes.push(pass);
        }
        // Counts duplicates from repeats and shared includes, which are removed below.
        if linker.errors.len() >= 20 {
            break;
        }
        if linker.compiler.is_cancelled() {
            linker.error(CANCELLED, pass.span, "");
            break;
        }
    }
    let Linker { errors, sizes, shaders, files, compiler, .. } = linker;
    if !errors.is_empty() {
        return Err(Diagnostic::distinct(errors));
    }
    // The shaders of removed passes must exist, but their texts only affect messages: the plan does not depend on them.
    let (missing, mentioned) = files.aside(|files| {
        (effects::missing(&lowered, files), effects::mentioned(&lowered, &passes, files, compiler))
    });
    // The repeated search records the paths that it tries, so creating a missing file triggers a rebuild.
    let error = |(file, shader): &(_, ShaderName)| {
        Some(files.find(Some(*file), &shader.name, Kind::Shader).err()?.at(shader.span))
    };
    let missing: Vec<Diagnostic> = missing.into_iter().filter_map(error).collect();
    if !missing.is_empty() {
        return Err(missing);
    }
    lowered.removed.iter_mut().zip(mentioned).for_each(|(removed, params)| removed.named.extend(params));
    lowered.sizes.extend(sizes);
    lowered.plan.shaders = shaders;
    Ok(Linked { lowered, passes })
}

impl Linker<'_> {
    /// Links a pass; returns `None` after at least one error.
    fn pass(&mut self, pass: &LoweredPass) -> Option<LinkedPass> {
        let before = self.errors.len();
        let mut uses = Vec::new();
        let (work, stages): (Work, Vec<(ShaderId, Stages)>) = match &pass.pass.work {
            Work::Dispatch { shader, groups } => {
                let id = self.shader(pass, shader, ShaderStage::Compute)?;
                self.workgroup(id, shader.span);
                let groups = self.groups(id, *groups, pass.size_span)?;
                if let Groups::Indirect { buffer, .. } = groups {
                    touch(&mut uses, buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None, false);
                }
                (Work::Dispatch { shader: id, groups }, vec![(id, Stages::COMPUTE)])
            }
            Work::Draw { vertex, fragment, topology, call, targets, depth } => {
                let vertex_id = self.shader(pass, vertex, ShaderStage::Vertex);
                let fragment_id = self.shader(pass, fragment, ShaderStage::Fragment);
                let (vertex_id, fragment_id) = (vertex_id?, fragment_id?);
                self.interface((vertex_id, vertex.span), (fragment_id, fragment.span));
                self.targets(fragment_id, pass, targets, &mut uses);
                self.depth(pass, targets, *depth, &mut uses);
                if let DrawCall::Indirect { buffer, .. } = *call {
                    touch(&mut uses, buffer, Stages::INDIRECT, Accesses::INDIRECT_READ, None, false);
                }
                let (topology, call, targets, depth) = (*topology, *call, targets.clone(), *depth);
                let (vertex, fragment) = (vertex_id, fragment_id);
                let work = Work::Draw { vertex, fragment, topology, call, targets, depth };
                (work, vec![(vertex_id, Stages::VERTEX), (fragment_id, Stages::FRAGMENT)])
            }
            Work::Fill { buffer, value } => {
                touch(&mut uses, *buffer, Stages::CLEAR, Accesses::TRANSFER_WRITE, None, false);
                (Work::Fill { buffer: *buffer, value: *value }, Vec::new())
            }
            Work::ClearHistory { .. } | Work::Export | Work::Host => unreachable!("the solver adds these"),
        };
        let bindings = self.bindings(pass, &stages, &mut uses);
        let push = self.push(pass, &stages);
        self.races(pass, &stages, &uses);
        if let Some((buffer, span)) = races::arguments(pass)
            && pass.pass.run == Run::Once
            && self.changes_every_frame(&[buffer])
        {
            self.errors.push(bindings::once_every_frame(pass, span, "its arguments"));
        }
        let Pass { name, phase, run, origin, .. } = pass.pass.clone();
        let linked = Pass { name, phase, run, work, bindings, push, uses, origin };
        (self.errors.len() == before).then_some(LinkedPass {
            pass: linked,
            span: pass.span,
            include: pass.include,
            params: self.params(pass, &stages),
        })
    }
}
