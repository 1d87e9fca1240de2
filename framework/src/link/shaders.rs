//! Compiles the shaders of a pass, and checks their features and workgroups against the device.

use std::collections::HashSet;
use std::sync::Arc;

use super::linker::{Linker, MAX_COMPILATIONS, add_live_glsl};
use crate::ir::{
    DeviceFacts, FEATURE_FACTS, Features, Groups, Reflection, Shader, ShaderId, ShaderStage, Span,
};
use crate::lower::{Extent, Lowered, LoweredPass, LoweredSize, ShaderName};
use crate::shader::{Compiled, ShaderRequest};
use crate::source::{Diagnostic, Kind};

/// Rejects a graph that needs too many distinct compilations, before the first compilation.
pub(super) fn count_compilations(passes: &[LoweredPass]) -> Result<(), Vec<Diagnostic>> {
    let mut different = HashSet::new();
    let mut passed = None;
    for pass in passes {
        for shader in pass.pass.work.shaders() {
            different.insert((pass.file, &shader.name, &pass.defines));
            if different.len() > MAX_COMPILATIONS {
                passed.get_or_insert(shader.span);
            }
        }
    }
    let Some(span) = passed else { return Ok(()) };
    let message = format!("this graph needs {} different compilations of its shaders", different.len());
    let diagnostic =
        Diagnostic::new(message, span, format!("the limit of {MAX_COMPILATIONS} is exceeded here"));
    Err(vec![
        diagnostic.with_help("pass values that differ between passes as push constants, not as defines"),
    ])
}

/// Explains an undeclared name that is a live parameter of another graph. `live.glsl` declares only the parameters of
/// the pass's graph.
fn of_another_graph(lowered: &Lowered, error: Diagnostic) -> Diagnostic {
    let unknown =
        error.message.strip_prefix('`').and_then(|rest| rest.strip_suffix("`: undeclared identifier"));
    match unknown.filter(|name| error.help.is_empty() && lowered.live_params.contains_key(*name)) {
        Some(name) => {
            let help = format!(
                "`{name}` is a live parameter of another graph: shaders have those that the graph of their pass \
                 declares or exposes"
            );
            error.with_help(help)
        }
        None => error,
    }
}

impl Linker<'_> {
    /// Compiles a shader, or reuses one compiled for another pass. `None` after at least one error.
    pub(super) fn shader(
        &mut self,
        pass: &LoweredPass,
        name: &ShaderName,
        stage: ShaderStage,
    ) -> Option<ShaderId> {
        if ShaderStage::of_file(&name.name) != Some(stage) {
            let ending = match stage {
                ShaderStage::Compute => ".comp",
                ShaderStage::Vertex => ".vert",
                ShaderStage::Fragment => ".frag",
            };
            let stage = format!("{stage:?}").to_lowercase();
            let message = format!("`{}` is not a {stage} shader", name.name);
            self.error(message, name.span, format!("its name must end in `{ending}`"));
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
        let key = (file, pass.defines.clone(), pass.live_glsl.clone());
        if let Some(known) = self.compiled.get(&key) {
            return *known;
        }
        let live_glsl = Some(add_live_glsl(self.files, &pass.live_glsl));
        let (defines, unfit) = (&pass.defines, &pass.unfit);
        let request = ShaderRequest { file, stage, defines, unfit, live_glsl };
        let id = match self.compiler.compile(self.files, &request) {
            Ok(Compiled { spirv, defines, reached, reflection, declared }) => {
                let (name_in_graph, path) = (name.name.clone(), self.files.shown_path(file).into_owned());
                let shader = Shader { name: name_in_graph, path, defines, spirv, reflection, msl: None };
                let at = self.shaders.iter().position(|s| *s == shader).unwrap_or_else(|| {
                    self.shaders.push(shader);
                    self.shaders.len() - 1
                });
                let id = ShaderId(at as u32);
                self.features(id, name.span);
                self.declared.insert(id, declared);
                // Texts that differ only in uncompiled code give one shader.
                let known = self.reached.entry(id).or_insert_with(|| reached.clone());
                if *known != reached {
                    Arc::make_mut(known).extend(reached.iter().cloned());
                }
                Some(id)
            }
            Err(errors) => {
                let lowered = self.lowered;
                self.errors.extend(errors.into_iter().map(|error| of_another_graph(lowered, error)));
                None
            }
        };
        self.compiled.insert(key, id);
        id
    }

    fn features(&mut self, id: ShaderId, span: Span) {
        let shader = &self.shaders[id.index()];
        let missing = shader.reflection.features.difference(self.device.features);
        if missing.is_empty() {
            return;
        }
        let message = format!("`{}` needs {missing}", shader.name);
        let error = Diagnostic::new(message, span, "the device does not have this");
        let facts = FEATURE_FACTS.iter().filter(|(_, feature)| missing.contains(*feature));
        let stores = Features::FRAGMENT_STORES | Features::VERTEX_STORES;
        let error = match facts.clone().find(|(_, feature)| stores.contains(*feature)) {
            Some((fact, _)) => error.with_help(format!(
                "for every device, let a `Dispatch` write this, or draw it to a target of its own: `targets` takes several \
                 images; or add `require: [(\"{fact}\", \"shaders of draws that write\")]`"
            )),
            None => {
                let facts: Vec<String> =
                    facts.map(|(fact, feature)| format!("(\"{fact}\", \"{feature}\")")).collect();
                match facts.is_empty() {
                    true => error,
                    false => error.with_help(format!(
                        "a graph that needs this requires it: `require: [{}]`",
                        facts.join(", ")
                    )),
                }
            }
        };
        self.errors.push(error);
    }

    pub(super) fn workgroup(&mut self, id: ShaderId, span: Span) {
        let Reflection { local_size, shared_bytes, .. } = self.shaders[id.index()].reflection;
        let invocations: u64 = local_size.iter().map(|s| *s as u64).product();
        let DeviceFacts { max_invocations: most, shared_bytes: room, .. } = self.device;
        if invocations > most.into() {
            let message = format!("the device has workgroups of at most {most} invocations");
            let found = format!("this shader has {invocations}");
            self.lacks(message, span, found, "max_invocations", invocations, "workgroups of that size");
        }
        if shared_bytes > room {
            let message = format!("the device has {room} bytes of shared memory");
            let found = format!("this shader uses {shared_bytes}");
            self.lacks(message, span, found, "shared_bytes", shared_bytes.into(), "that much shared memory");
        }
    }

    /// Adds the error for an exceeded limit of the device, and explains how a graph requires `least` of the `fact`.
    /// `words` describe the requirement.
    fn lacks(&mut self, message: String, span: Span, found: String, fact: &str, least: u64, words: &str) {
        self.errors.push(Diagnostic::new(message, span, found).with_help(format!(
            "a graph that needs more requires it: `require: [(\"device.{fact} >= {least}\", \"{words}\")]`"
        )));
    }

    pub(super) fn groups(&mut self, id: ShaderId, size: LoweredSize, span: Span) -> Option<Groups> {
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
                "`Threads` divides only by `local_size_x`",
                "`Threads(x, y)` divides only by `local_size_x` and `_y`",
            ];
            let message = format!("{}, and a workgroup here is {x} x {y} x {z}", divides[dimensions - 1]);
            self.errors.push(Diagnostic::new(message, span, "too many invocations would run").with_help(
                "give the shader a local size in as many dimensions, or count its workgroups with `Groups`",
            ));
            return None;
        }
        let mut groups: [u64; 3] = std::array::from_fn(|axis| size[axis].div_ceil(each[axis]));
        let limits = self.device.max_groups.map(|most| u64::from(most.max(1)));
        let too_large = "this dispatch is larger than the device can do at once";
        if dimensions == 1 {
            // As few rows as possible, each as short as possible, so that few groups are idle.
            let [all, rows] = [groups[0], groups[0].div_ceil(limits[0]).max(1)];
            if rows > limits[1] {
                let [x, y, _] = limits;
                let found = format!("{all} workgroups; {x} in x and {y} in y are possible");
                self.error(too_large, span, found);
                return None;
            }
            groups = [all.div_ceil(rows), rows, 1];
            let shader = &self.shaders[id.index()];
            if rows > 1 && shader.reflection.ignores_rows {
                let message = format!("`{}` gets the same indices in every row of workgroups", shader.name);
                let label = format!("{all} workgroups are folded into {rows} rows");
                self.sizes.push(Diagnostic::new(message, span, label).with_help(
                    "number workgroups with `group_index()` of `groups.glsl`, and invocations with `group_index() * \
                     gl_WorkGroupSize.x + gl_LocalInvocationID.x`",
                ));
            }
        } else if let Some(axis) = (0..3).find(|axis| groups[*axis] > limits[*axis]) {
            let (name, count, most) = (["x", "y", "z"][axis], groups[axis], limits[axis]);
            self.error(too_large, span, format!("{count} workgroups in {name}; {most} are possible"));
            return None;
        }
        // Shaders number invocations (workgroups, for `Groups`) with a `uint`: all together if there is one dimension,
        // otherwise per dimension.
        let counted = match dimensions {
            1 => (groups[0] * groups[1]).saturating_mul(each[0]),
            _ => (0..3).map(|axis| groups[axis].saturating_mul(each[axis])).max().unwrap_or(0),
        };
        if counted > 1 << 32 {
            let found =
                format!("expected at most 4294967296, including those of unfinished rows, found {counted}");
            self.error("this dispatch has more indices than 32 bits can hold", span, found);
            return None;
        }
        Some(Groups::Direct(groups.map(|n| n as u32)))
    }
}

#[cfg(test)]
mod tests {
    use crate::build;
    use crate::ir::{Request, Span};
    use crate::shader::{Compiled, ShaderCompiler, ShaderRequest};
    use crate::source::{Diagnostic, Library, SourceMap};
    use crate::testing;

    /// Refuses every shader, and counts the attempts.
    struct Refusing(usize);

    impl ShaderCompiler for Refusing {
        fn compile(
            &mut self,
            _: &mut SourceMap,
            request: &ShaderRequest,
        ) -> Result<Compiled, Vec<Diagnostic>> {
            self.0 += 1;
            Err(vec![Diagnostic::new("the compiler crashed", Span::new(request.file, 0..0), "")])
        }
    }

    #[test]
    fn a_shader_with_errors_is_compiled_once_for_all_passes_of_a_repeat() {
        let pass = testing::make();
        let graph = testing::graph("", &format!(r#"Repeat(var: "i", count: 9, body: [{pass}]),"#));
        let memory = [("graph.ron", graph.as_str()), ("make.comp", "w Out 4")];
        let memory = memory.map(|(path, text)| (path.to_string(), text.to_string())).into();
        let mut files = SourceMap::new(Library { memory, ..Library::default() });
        let (facts, catalog, mut compiler) = (testing::facts(), testing::catalog(), Refusing(0));
        let request = Request::new("graph.ron", &facts, &catalog);
        let errors = build(&request, &mut files, &mut compiler).expect_err("the shader is refused");
        let found: Vec<&str> = errors.iter().map(|error| error.message.as_str()).collect();
        assert_eq!((found, compiler.0), (vec!["the compiler crashed"], 1));
    }
}
