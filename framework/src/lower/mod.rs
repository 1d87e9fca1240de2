//! From the tree to a flat list of passes.
//!
//! A graph may be a preset of another, include sub-graphs, repeat passes, leave some out and swap ping-pong resources.
//! Lowering walks the tree once, in the order of the file, and resolves all of that: what comes out ([`Flat`]) has
//! only dispatches, draws and fills over numbered resources, every expression is a value, and `front(keys)` is one
//! definite buffer. It knows nothing of shaders yet: whether the names under `bind` exist is for [`crate::link`].
//!
//! The files of this folder: `document` loads files and follows presets; `params` gives parameters their values, and `defines` makes of
//! them what shaders see; `scope` evaluates expressions; `resources` numbers buffers and images; `passes` walks the passes, and
//! `include` goes into other graphs.

mod defines;
mod document;
mod include;
mod params;
mod passes;
mod resources;
mod scope;

use std::collections::BTreeMap;
use std::rc::Rc;

use crate::ir::{DrawCall, FileId, Request, ResourceId, Run, Span, Target, Topology, Value};
use crate::plan::{LeftOut, Param, Resource, Stat};
use crate::source::{Diagnostic, SourceMap};

/// The graph without its constructs. Passes are in the order of the file.
#[derive(Clone, Debug)]
pub struct Flat {
    pub name: String,
    pub summary: String,
    pub facts: BTreeMap<String, Value>,
    pub params: Vec<Param>,
    pub resources: Vec<Resource>,
    /// Where each resource was declared.
    pub resource_spans: Vec<Span>,
    pub passes: Vec<FlatPass>,
    pub left_out: Vec<LeftOut>,
    /// What `last(name)` stands for.
    pub lasts: Vec<Last>,
    /// Transient resources whose writers were removed by a `when`: the resource, the pass and where its `when` is.
    pub unwritten: Vec<(ResourceId, String, Span)>,
    pub output: ResourceId,
    pub output_span: Span,
    pub stats: Vec<Stat>,
    pub stat_spans: Vec<Span>,
    /// The text of the generated include `live.glsl`.
    pub live_glsl: String,
    /// The uniform block of the live parameters.
    pub live: ResourceId,
}

/// A resource with a history. Passes that read what the frame before left name a stand-in, so that order can tell them from
/// those that read what this frame writes.
#[derive(Clone, Copy, Debug)]
pub struct Last {
    pub stand_in: ResourceId,
    /// The resource itself; of a ping-pong resource, the half that is the front when the frame ends.
    pub real: ResourceId,
}

impl Flat {
    /// The resource whose former contents `id` stands for, if it is a stand-in.
    pub fn last(&self, id: ResourceId) -> Option<ResourceId> {
        self.lasts.iter().find(|last| last.stand_in == id).map(|last| last.real)
    }
}

#[derive(Clone, Debug)]
pub struct FlatPass {
    pub name: String,
    pub phase: String,
    pub run: Run,
    /// The graph file that declares it: shaders are looked for beside it.
    pub file: FileId,
    /// Its `name` in the file.
    pub span: Span,
    pub work: FlatWork,
    pub bind: Vec<FlatBind>,
    pub push: Vec<FlatPush>,
    /// What the shaders may be compiled with: the constants of the scope and the pass's own.
    pub defines: Rc<Vec<(String, String)>>,
}

/// A shader's name as written, and where.
#[derive(Clone, Debug)]
pub struct ShaderName {
    pub name: String,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum FlatWork {
    Dispatch {
        shader: ShaderName,
        size: FlatSize,
        size_span: Span,
    },
    Draw {
        vertex: ShaderName,
        fragment: ShaderName,
        topology: Topology,
        call: DrawCall,
        call_span: Span,
        targets: Vec<(Target, Span)>,
    },
    Fill {
        buffer: ResourceId,
        value: u32,
    },
}

#[derive(Clone, Copy, Debug)]
pub enum FlatSize {
    Threads(u64),
    Groups(u64),
    Indirect { buffer: ResourceId, offset: u64 },
}

/// An entry of `bind`: the block's name, and one resource for each element of its array (one where it is none).
#[derive(Clone, Debug)]
pub struct FlatBind {
    pub block: String,
    pub block_span: Span,
    pub resources: Vec<ResourceId>,
    pub resource_span: Span,
}

#[derive(Clone, Debug)]
pub struct FlatPush {
    pub name: String,
    pub value: Value,
    pub name_span: Span,
    pub value_span: Span,
}

/// Lowers the graph that `request` names.
pub fn lower(request: &Request, files: &mut SourceMap) -> Result<Flat, Vec<Diagnostic>> {
    passes::Lowering::new(request, files).run()
}

/// The parameters of a graph with their values, without lowering its passes: for lists and help.
pub fn params(request: &Request, files: &mut SourceMap) -> Result<(String, Vec<Param>), Vec<Diagnostic>> {
    let root = document::open(files, request.graph)?;
    let mut errors = Vec::new();
    let resolved = params::resolve(&root, request, files, &mut errors);
    if errors.is_empty() { Ok((root.summary.clone(), resolved.params)) } else { Err(errors) }
}

/// Values by name.
pub(crate) type Values = BTreeMap<String, Value>;

#[cfg(test)]
mod tests;
