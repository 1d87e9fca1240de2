//! A compiler that reads only the declarations of a generated shader, each on its line. Thousands of graphs can thus be
//! built without C++.

use splatgraph_framework::ir::{
    Features, Format, Member, MemberKind, PushBlock, ReflectedBinding, ReflectedKind, Reflection,
    ShaderStage, Varying,
};
use splatgraph_framework::shader::{Compiled, ShaderCompiler, ShaderRequest};
use splatgraph_framework::source::{Diagnostic, SourceMap};
use std::sync::Arc;

pub struct DeclarationCompiler;

impl ShaderCompiler for DeclarationCompiler {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let reflection = reflection(files.text(request.file), request.stage);
        Ok(Compiled {
            spirv: Arc::new(Vec::new()),
            defines: Vec::new(),
            reached: Arc::default(),
            reflection,
            declared: Arc::default(),
        })
    }
}

/// Reads the reflection from a shader's declarations. A draw accesses what it writes by atomics alone.
///
/// # Panics
/// On a declaration that the generator should not have written.
pub fn reflection(text: &str, stage: ShaderStage) -> Reflection {
    let mut reflection = Reflection {
        stage,
        local_size: [1; 3],
        shared_bytes: 0,
        bindings: Vec::new(),
        push: None,
        inputs: Vec::new(),
        outputs: Vec::new(),
        uses_position: stage == ShaderStage::Vertex,
        ignores_rows: false,
        features: Features::empty(),
    };
    for line in text.lines().filter(|line| line.starts_with("layout(")) {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        let words: Vec<&str> = line.split(|c| !is_word(c)).filter(|word| !word.is_empty()).collect();
        let number = |at: usize| -> u32 { words[at].parse().expect("a number") };
        let name = |at: usize| words[words.len() - 1 - at].to_owned();
        let has = |word: &str| words.contains(&word);
        match words[1] {
            "local_size_x" => reflection.local_size[0] = number(2),
            "push_constant" => {
                let member = Member { name: name(0), offset: 0, kind: MemberKind::Uint, used: true };
                reflection.push = Some(PushBlock { bytes: 4, members: vec![member] });
            }
            "location" => {
                let varyings = if has("in") { &mut reflection.inputs } else { &mut reflection.outputs };
                varyings.push(Varying { name: name(0), location: number(2), glsl_type: name(1) });
            }
            "set" => {
                let (reads, writes, is_buffer) = (!has("writeonly"), !has("readonly"), has("buffer"));
                let atomics = reads && writes && stage != ShaderStage::Compute;
                let names = if has("uvec4") { &["x", "y", "z", "w"][..] } else { &[""] };
                let word = |(name, offset): (&&str, u32)| Member {
                    name: (*name).to_owned(),
                    offset,
                    kind: MemberKind::Uint,
                    used: true,
                };
                let stride = Some(4 * names.len() as u32);
                let format = Format::ALL.into_iter().find(|format| format.name() == words[5]);
                reflection.bindings.push(ReflectedBinding {
                    name: name(if is_buffer { 2 } else { 0 }),
                    set: 0,
                    binding: number(4),
                    count: 1,
                    kind: match is_buffer {
                        true => ReflectedKind::StorageBuffer { stride, fixed_bytes: 0 },
                        false => ReflectedKind::StorageImage { format },
                    },
                    reads,
                    writes,
                    atomics,
                    atomics_only: atomics,
                    writes_first: !reads,
                    scalar: if is_buffer { MemberKind::Uint } else { MemberKind::Other },
                    words: match is_buffer {
                        true => names.iter().zip((0..).step_by(4)).map(word).collect(),
                        false => vec![],
                    },
                });
            }
            other => panic!("a generated shader declares `{other}`"),
        }
    }
    reflection
}
