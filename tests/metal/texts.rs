//! The Metal texts of the shaders: every shader has one, with the expected contents, and it is valid C++.

use super::{change, clang, shaders, translated};
use crate::common;
use crate::encoders::page;
use splatgraph::draw::facts;
use splatgraph::draw::planner::Planner;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Domain, Msl, ParamBinding, Shader};
use splatgraph_framework::plan::Plan;
use std::fmt::Write;

struct Bench {
    planner: Planner,
    catalog: Catalog,
}

impl Bench {
    fn new() -> Bench {
        Bench { planner: Planner::default(), catalog: common::catalog() }
    }

    fn plan(&mut self, graph: &str, set: &[(&str, &str)], device: &DeviceFacts) -> Plan {
        let facts = common::facts_of(device);
        let plan = self.planner.plan(graph, &common::settings(set), &facts, &self.catalog);
        translated(plan.unwrap_or_else(|error| panic!("{graph}, {set:?}: {error}")))
    }
}

fn graphs() -> Vec<&'static str> {
    const OTHERS: [&str; 3] = [
        concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/gray_scott/graph.ron"),
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/growing/graph.ron"),
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/two_steps/graph.ron"),
    ];
    common::graphs().into_iter().chain(OTHERS).collect()
}

#[test]
fn every_shader_of_every_graph_on_every_device_is_valid_cpp_with_its_arguments_in_place() {
    let mut bench = Bench::new();
    let devices: Vec<DeviceFacts> = facts::SUBGROUP_SIZES
        .map(facts::portable_device)
        .into_iter()
        .chain([facts::apple_device()])
        .collect();
    let mut plans = Vec::new();
    for graph in graphs() {
        for device in &devices {
            plans.push(bench.plan(graph, &[], device));
        }
        // Also every other choice, and every digit width.
        let apple = facts::apple_device();
        let params = plans.last().expect("a plan").params.clone();
        for param in params.iter().filter(|param| param.binding == ParamBinding::Const) {
            let values = match &param.domain {
                Domain::Choice(names) => names.clone(),
                Domain::Int { .. } if param.name == "digit_bits" => {
                    (1..=11).map(|bits| bits.to_string()).collect()
                }
                _ => continue,
            };
            let others = values.iter().filter(|value| **value != param.value.to_string());
            plans.extend(others.map(|value| bench.plan(graph, &[(&param.name, value)], &apple)));
        }
    }
    let shaders = shaders(&plans);
    let most = shaders.iter().map(|shader| clang::assert_places(shader)).max();
    assert_eq!(most, Some(22), "docs/metal.md has the largest number of buffers");
    let texts = clang::check(&shaders);
    println!("{} plans, {} shaders, {texts} texts", plans.len(), shaders.len());
    let told = format!("{} plans, {texts} different texts.", plans.len());
    assert!(page().contains(&told), "docs/metal.md lacks `{told}`");
}

fn table(shader: &Shader, msl: &Msl) -> String {
    let mut text = format!("{} ({})\n", shader.name, msl.entry);
    for argument in &msl.arguments {
        let bound = shader.reflection.bindings.iter().find(|b| b.binding == argument.binding).expect("bound");
        let table = if argument.texture { "texture" } else { "buffer" };
        let _ = writeln!(text, "  {table} {:2}  {}[{}]", argument.index, bound.name, argument.element);
    }
    let further = [("push constants", msl.push), ("sizes", msl.sizes)];
    for (name, index) in further.into_iter().filter_map(|(name, index)| Some((name, index?))) {
        let _ = writeln!(text, "  buffer {index:2}  {name}");
    }
    text
}

/// Compares texts and arguments with snapshots. After an intended change of texts:
///
/// ```sh
/// INSTA_UPDATE=always cargo test -p splatgraph --test end_to_end metal::texts
/// git diff tests/metal/golden
/// ```
#[test]
fn shaders_of_an_apple_gpu_have_the_texts_and_the_arguments_of_their_snapshots() {
    let mut bench = Bench::new();
    let plans = ["auto", "splat"].map(|graph| bench.plan(graph, &[], &facts::apple_device()));
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("golden");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| {
        for plan in &plans {
            let with_msl =
                plan.shaders.iter().map(|shader| (shader, shader.msl.as_ref().expect("translated")));
            let tables: Vec<String> = with_msl.clone().map(|(shader, msl)| table(shader, msl)).collect();
            insta::assert_snapshot!(format!("arguments_{}", plan.name), tables.join("\n"));
            // One shader of each kind: threadgroup memory and atomics, SIMD-groups, an image, and both stages of a
            // draw.
            let shown = ["sort/histogram.comp", "sort/scan.comp", "compose.comp", "splat.vert", "splat.frag"];
            for (shader, msl) in
                with_msl.filter(|(shader, _)| plan.name == "splat" && shown.contains(&&*shader.name))
            {
                insta::assert_snapshot!(shader.name.replace('/', "_"), msl.source);
            }
        }
    });
}

#[test]
fn an_unknown_function_a_wrong_type_and_a_write_to_constants_fail_the_build_with_shader_and_line() {
    for (from, to, expected) in [
        ("simd_prefix_inclusive_sum(", "simd_prefix_inclusive_total(", "undeclared identifier"),
        ("uint bin = ", "uint2 bin = ", "cannot initialize a variable of type"),
        ("uint bin = ", "_54.mask = 0u; uint bin = ", "cannot assign to variable '_54'"),
    ] {
        let mut plan = Bench::new().plan("splat", &[], &facts::apple_device());
        change(&mut plan, "sort/scan.comp", from, to);
        let text = *std::panic::catch_unwind(|| clang::check(&shaders([&plan])))
            .expect_err("it fails")
            .downcast::<String>()
            .expect("a text");
        assert!(text.contains("sort/scan.comp.metal:") && text.contains(expected), "{text}");
    }
}
