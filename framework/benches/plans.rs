//! Measures the time from the text of a graph to its plan, with its files already read and its shaders compiled.
//!
//! `preset` builds two shipped presets. `growth` builds graphs of 100 to 10,000 passes, to show how the time grows with
//! their number.
//!
//! `cargo bench -p splatgraph-framework`

#[path = "../tests/nominal/mod.rs"]
mod nominal;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use splatgraph_framework::build;
use splatgraph_framework::ir::{Catalog, Facts, Request};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::{Library, SourceMap, render};
use std::fmt::Write;
use std::time::Duration;

const COUNT: u32 = 1_000_000;

/// The inputs of repeated builds. The first build reads the files and compiles the shaders.
struct Bench {
    files: SourceMap,
    compiler: Glslang,
    facts: Facts,
    catalog: Catalog,
}

impl Bench {
    fn new(library: Library) -> Bench {
        Bench {
            files: SourceMap::new(library),
            compiler: Glslang::new(),
            facts: nominal::facts(COUNT, (1920, 1080)),
            catalog: nominal::catalog(COUNT),
        }
    }

    fn plan(&mut self, graph: &str) -> Plan {
        let request = Request::new(graph, &self.facts, &self.catalog);
        build(&request, &mut self.files, &mut self.compiler)
            .unwrap_or_else(|errors| panic!("{}", render(&self.files, &errors, false)))
    }
}

/// Returns a graph of `passes` dispatches and a last one that shows the result. Each dispatch but the first reads the
/// output of the previous one and of an earlier one, at most 13 back.
fn chain(passes: usize) -> Library {
    let mut text = String::from("Graph(version: 1, summary: \"a chain\", resources: {\n");
    for i in 0..passes {
        let _ = writeln!(text, "  \"b{i}\": Buffer(stride: 4, count: {}),", 64 + i % 7);
    }
    text += "  \"image\": Image(format: \"r32f\", size: (64, 64)),\n}, passes: [\n";
    text += "  Dispatch(name: \"p0\", shader: \"make.comp\", size: Threads(64), bind: {\"To\": \"b0\"}),\n";
    for i in 1..passes {
        let (near, far) = (i - 1, i.saturating_sub(1 + i % 13).min(i.saturating_sub(2)));
        let _ = writeln!(
            text,
            "  Dispatch(name: \"p{i}\", shader: \"join.comp\", size: Threads(64), bind: {{\"A\": \"b{near}\", \"B\": \"b{far}\", \"To\": \"b{i}\"}}),"
        );
    }
    let _ = writeln!(
        text,
        "  Dispatch(name: \"show\", shader: \"show.comp\", size: Threads(64), bind: {{\"A\": \"b{}\", \"image\": \"image\"}}),\n], output: \"image\")",
        passes - 1
    );
    let head = "#version 460\nlayout(local_size_x = 64) in;\n";
    let buffer = |binding: u32, access: &str, name: &str| {
        format!(
            "layout(set = 0, binding = {binding}) {access} buffer {name} {{ uint {}[]; }};\n",
            name.to_lowercase()
        )
    };
    let shader = |blocks: &[String], body: &str| {
        format!("{head}{}void main() {{ uint i = gl_GlobalInvocationID.x; {body} }}\n", blocks.concat())
    };
    let (a, b, to) = (buffer(0, "readonly", "A"), buffer(1, "readonly", "B"), buffer(2, "writeonly", "To"));
    let image = "layout(set = 0, binding = 3, r32f) writeonly uniform image2D image;\n".to_string();
    let memory = [
        ("chain.ron", text),
        ("make.comp", shader(std::slice::from_ref(&to), "to[i] = i;")),
        ("join.comp", shader(&[a.clone(), b, to], "to[i] = a[i] + b[i];")),
        ("show.comp", shader(&[a, image], "imageStore(image, ivec2(i, 0), vec4(a[i]));")),
    ];
    Library {
        memory: memory.into_iter().map(|(name, text)| (name.to_string(), text)).collect(),
        ..Library::default()
    }
}

fn presets(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("preset");
    let mut bench = Bench::new(Library::default());
    let pipelines = concat!(env!("CARGO_MANIFEST_DIR"), "/../pipelines/");
    for preset in ["splat", "digit4"] {
        let path = format!("{pipelines}{preset}.ron");
        bench.plan(&path);
        group.bench_function(preset, |bencher| bencher.iter(|| bench.plan(&path)));
    }
    group.finish();
}

fn growth(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("growth");
    group.sample_size(10).measurement_time(Duration::from_secs(5));
    for passes in [100, 300, 1000, 3000, 10_000] {
        let mut bench = Bench::new(chain(passes));
        bench.plan("chain.ron");
        group.throughput(Throughput::Elements(passes as u64));
        group.bench_function(BenchmarkId::from_parameter(passes), |bencher| {
            bencher.iter(|| bench.plan("chain.ron"));
        });
    }
    group.finish();
}

criterion_group!(benches, presets, growth);
criterion_main!(benches);
