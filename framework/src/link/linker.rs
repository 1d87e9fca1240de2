//! Defines the linked passes, and the linker's state.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;
use std::sync::Arc;

use crate::ir::{
    Accesses, DeviceFacts, FileId, Layout, ParamSet, Pass, ResourceId, Shader, ShaderId, Shape, Span, Stages,
    Use,
};
use crate::lower::Lowered;
use crate::plan::Resource;
use crate::shader::ShaderCompiler;
use crate::source::{Diagnostic, SourceMap};

/// A graph whose passes match their shaders.
#[derive(Clone, Debug)]
pub struct Linked {
    /// The graph; its plan has each distinct compiled shader once.
    pub lowered: Lowered,
    /// Passes of the prologue and of the frame, in file order.
    pub passes: Vec<LinkedPass>,
}

/// A pass with its bindings and uses.
#[derive(Clone, Debug)]
pub struct LinkedPass {
    pub pass: Pass,
    /// Place of the pass's name in the file; of the output's name for passes that the solver adds.
    pub span: Span,
    /// The include that the pass comes from, as an index into [`Lowered::includes`]; `None` for the root graph's own.
    pub include: Option<usize>,
    pub params: PassParams,
}

/// The parameters that a pass depends on, except through the sizes and formats of its resources.
#[derive(Clone, Debug, Default)]
pub struct PassParams {
    /// Parameters with any effect on the pass.
    pub all: ParamSet,
    /// Parameters that decide whether the pass exists, and which resources it uses and how. They can affect other
    /// passes.
    pub structure: ParamSet,
    /// Parameters that the pass's shaders mention only in code that is not compiled.
    pub skipped: ParamSet,
}

/// Maximum number of shader compilations of a graph.
pub(super) const MAX_COMPILATIONS: usize = 500;

pub(super) type Defines = Vec<(String, String)>;

/// Adds the text of `live.glsl`, which shaders include, to the files; an equal text once.
pub(super) fn add_live_glsl(files: &mut SourceMap, text: &str) -> FileId {
    let path = "live.glsl (generated)";
    let is_same = |&(file, known, _): &(FileId, &str, bool)| known == path && files.text(file) == text;
    let known = files.opened().find(is_same).map(|(file, ..)| file);
    known.unwrap_or_else(|| files.add(path, text))
}

pub(super) struct Linker<'a> {
    pub lowered: &'a Lowered,
    pub device: DeviceFacts,
    pub files: &'a mut SourceMap,
    pub compiler: &'a mut dyn ShaderCompiler,
    pub shaders: Vec<Shader>,
    /// Names of the blocks that each shader declares, used or not.
    pub declared: HashMap<ShaderId, Arc<BTreeSet<String>>>,
    /// Identifiers that each shader's compiled text depends on.
    pub reached: HashMap<ShaderId, Arc<BTreeSet<String>>>,
    /// Shaders compiled so far, by file, defines and `live.glsl`; the iterations of a repeat share them. `None` after
    /// errors: a shader that crashes the compiler crashes it only once.
    pub compiled: HashMap<(FileId, Rc<Defines>, Rc<str>), Option<ShaderId>>,
    /// Shader files found so far, by the graph that names them and the name in that graph.
    pub found: HashMap<(FileId, String), FileId>,
    pub errors: Vec<Diagnostic>,
    /// Warnings about dispatches whose rows the shader ignores.
    pub sizes: Vec<Diagnostic>,
}

impl Linker<'_> {
    pub fn error(&mut self, message: impl Into<String>, span: Span, label: impl Into<String>) {
        self.errors.push(Diagnostic::new(message, span, label));
    }

    pub fn resource(&self, id: ResourceId) -> &Resource {
        self.lowered.plan.resource(id)
    }
}

/// Adds accesses to a pass's list, with one entry per resource and set of stages. An existing entry keeps its layout
/// and its `discards`.
pub(super) fn touch(
    uses: &mut Vec<Use>,
    resource: ResourceId,
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

/// Formats a resource's shape: `12 elements of 4 bytes` or `an image of 960 x 540, rgba16f`.
pub(super) fn describe(resource: &Resource) -> String {
    match resource.shape {
        Shape::Buffer { stride, count } => format!("{count} elements of {stride} bytes"),
        Shape::Image { format, width, height } => {
            format!("an image of {width} x {height}, {}", format.name())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_equal_generated_text_is_added_once() {
        let mut files = SourceMap::default();
        let first = add_live_glsl(&mut files, "float a;");
        assert_eq!(add_live_glsl(&mut files, "float a;"), first);
        assert_ne!(add_live_glsl(&mut files, "float b;"), first);
        assert_eq!(files.opened().count(), 2);
    }
}
