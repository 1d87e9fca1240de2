//! A compiler that reads only the comments at the head of a generated shader, so that thousands of graphs can be built
//! without C++. The comments state what the real compiler would find:
//!
//! ```text
//! //: local 16                    workgroup size
//! //: buffer 0 In0 r 4            binding, block, how it is accessed (`rwa`: by atomics), bytes of an element
//! //: image 1 Out0 rw r32ui       likewise, format
//! //: push c                      a push constant, a uint
//! //: in 0 tone uint flat         a stage input; `out` likewise
//! ```

use splatgraph_framework::ir::{
    Features, Format, Member, MemberKind, PushBlock, ReflectedBinding, ReflectedKind, Reflection,
    ShaderStage, Varying,
};
use splatgraph_framework::shader::{Compiled, ShaderCompiler, ShaderRequest};
use splatgraph_framework::source::{Diagnostic, SourceMap};
use std::sync::Arc;

pub struct HeaderCompiler;

impl ShaderCompiler for HeaderCompiler {
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

/// Reads the reflection from a shader's header.
///
/// # Panics
/// On a header that the generator should not have written.
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
        features: Features::empty(),
    };
    for line in text.lines().filter_map(|line| line.strip_prefix("//: ")) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |at: usize| -> u32 { words[at].parse().expect("a number") };
        match words[0] {
            "local" => reflection.local_size[0] = number(1),
            "push" => {
                let (name, kind) = (words[1].into(), MemberKind::Uint);
                let member = Member { name, offset: 0, kind, used: true };
                reflection.push = Some(PushBlock { bytes: 4, members: vec![member] });
            }
            kind @ ("buffer" | "image") => reflection.bindings.push(ReflectedBinding {
                name: words[2].into(),
                set: 0,
                binding: number(1),
                count: 1,
                kind: match kind {
                    "buffer" => ReflectedKind::StorageBuffer { stride: Some(number(4)), fixed_bytes: 0 },
                    _ => ReflectedKind::StorageImage {
                        format: Format::ALL.into_iter().find(|format| format.name() == words[4]),
                    },
                },
                reads: words[3].contains('r'),
                writes: words[3].contains('w'),
                atomics: words[3].contains('a'),
                atomics_only: words[3].contains('a'),
                writes_first: !words[3].contains('r'),
                floats: false,
            }),
            way @ ("in" | "out") => {
                let varyings = if way == "in" { &mut reflection.inputs } else { &mut reflection.outputs };
                varyings.push(Varying {
                    name: words[2].into(),
                    location: number(1),
                    glsl_type: words[3].into(),
                    flat: words.get(4) == Some(&"flat"),
                });
            }
            other => panic!("a header of a generated shader says `{other}`"),
        }
    }
    reflection
}
