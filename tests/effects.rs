//! Checks the effects that plans claim for parameters: changing a parameter without an effect must not change the plan.

use crate::common;
#[cfg(target_os = "linux")]
use crate::place::{DRAW, Place};
use splatgraph::draw::builtin;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph_framework::build;
use splatgraph_framework::ir::{Catalog, Domain, Facts, LIVE_BLOCK, Param, ReflectedKind, Request};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::{Compiled, Glslang, ShaderCompiler, ShaderRequest};
use splatgraph_framework::source::{Diagnostic, SourceMap, render};
use std::collections::BTreeSet;

/// Compiles every shader again with other values for the defines that it claims not to depend on. The results must be
/// equal.
#[derive(Default)]
struct Poisoning {
    compiler: Glslang,
    poisoned: usize,
}

impl ShaderCompiler for Poisoning {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let before = self.compiler.compiled_count();
        let compiled = self.compiler.compile(files, request)?;
        if self.compiler.compiled_count() == before {
            return Ok(compiled);
        }
        let unused = |name: &String| !compiled.reached.contains(name);
        self.poisoned += compiled.defines.iter().filter(|(name, _)| unused(name)).count();
        for number in ["7919", "0"] {
            let other = |(name, value): &(String, String)| {
                (name.clone(), if unused(name) { number.into() } else { value.clone() })
            };
            let defines: Vec<(String, String)> = compiled.defines.iter().map(other).collect();
            let other = self.compiler.compile(files, &ShaderRequest { defines: &defines, ..*request });
            let other = other.unwrap_or_else(|errors| panic!("{}", render(files, &errors, false)));
            assert!(other.spirv == compiled.spirv, "{}: {defines:?}", files.path(request.file));
        }
        Ok(compiled)
    }

    fn identifiers(&mut self, files: &mut SourceMap, request: &ShaderRequest) -> BTreeSet<String> {
        self.compiler.identifiers(files, request)
    }
}

struct Builds {
    files: SourceMap,
    catalog: Catalog,
    poisoning: Poisoning,
}

impl Builds {
    fn new() -> Builds {
        let (files, catalog) = (builtin::source_map(), common::catalog());
        Builds { files, catalog, poisoning: Poisoning::default() }
    }

    fn plan(&mut self, graph: &str, set: &[(String, String)], facts: &Facts) -> Result<Plan, String> {
        let catalog = &self.catalog;
        let request = Request { set, ..Request::new(graph, facts, catalog) };
        build(&request, &mut self.files, &mut self.poisoning)
            .map_err(|errors| render(&self.files, &errors, false))
    }
}

/// Returns other values to try. They are all values of a choice, or the ends and the middle of a range, and an
/// integer's neighbours.
fn others(param: &Param) -> Vec<String> {
    let mut values: Vec<String> = match &param.domain {
        Domain::Bool => vec!["true".into(), "false".into()],
        Domain::Choice(of) => of.clone(),
        Domain::Int { min, max } => {
            let own = param.value.to_string().parse::<i64>().expect("an integer");
            let near = [own - 1, own + 1, *min, *max, min + (max - min) / 2].into_iter();
            near.filter(|v| (min..=max).contains(&v)).map(|v| v.to_string()).collect()
        }
        Domain::Float { min, max, .. } => {
            [*min, *max, (min + max) / 2.0].iter().map(|v| format!("{v:?}")).collect()
        }
    };
    values.retain(|value| *value != param.value.to_string());
    values.sort();
    values.dedup();
    values
}

/// Returns the byte offsets in the live block that the plan's shaders read.
fn live_offsets(plan: &Plan) -> BTreeSet<u32> {
    let blocks = plan.shaders.iter().flat_map(|shader| &shader.reflection.bindings);
    let members = blocks.filter(|block| block.name == LIVE_BLOCK).flat_map(|block| match &block.kind {
        ReflectedKind::UniformBuffer { members, .. } => members.as_slice(),
        _ => &[],
    });
    members.filter(|member| member.used).map(|member| member.offset).collect()
}

fn assert_same(a: &Plan, b: &Plan, what: &str) {
    assert_eq!(a.passes, b.passes, "{what}");
    assert_eq!(a.resources, b.resources, "{what}");
    assert_eq!((&a.blocks, a.output, &a.stats), (&b.blocks, b.output, &b.stats), "{what}");
    let steps = |plan: &Plan| (plan.prologue.clone(), plan.frame.clone(), plan.dependencies.clone());
    assert_eq!(steps(a), steps(b), "{what}");
    let shaders = |plan: &Plan| -> Vec<_> {
        plan.shaders.iter().map(|s| (s.name.clone(), s.spirv.clone(), s.reflection.clone())).collect()
    };
    assert!(shaders(a) == shaders(b), "{what}: the shaders differ");
    let (of_a, of_b) = (a.live_bytes(), b.live_bytes());
    for offset in live_offsets(a) {
        let word = offset as usize..offset as usize + 4;
        assert_eq!(of_a[word.clone()], of_b[word], "{what}: the live parameter at {offset}");
    }
}

/// Checks every parameter of a plan; returns the names of the parameters without an effect.
fn check(builds: &mut Builds, graph: &str, set: &[(String, String)], facts: &Facts) -> Vec<String> {
    let lanes = facts.device.subgroup_size;
    let plan = builds.plan(graph, set, facts).unwrap_or_else(|error| panic!("{graph}, {set:?}: {error}"));
    assert_eq!(plan.effects.len(), plan.params.len());
    let mut without = Vec::new();
    for (param, effect) in plan.params.iter().zip(&plan.effects) {
        let text = plan.effect_text(&param.name).expect("it is a parameter");
        assert!(
            text.starts_with(&format!("`{}` ", param.name)) && text.len() > param.name.len() + 8,
            "{text}"
        );
        assert_eq!(effect.none.is_some(), effect.passes.is_empty() && !effect.shape, "{text}");
        if effect.none.is_none() {
            continue;
        }
        let mut built = 0;
        for value in others(param) {
            let setting = [set, &[(param.name.clone(), value.clone())]].concat();
            // Some values make the graph invalid: then there is no plan to compare.
            let Ok(other) = builds.plan(graph, &setting, facts) else { continue };
            built += 1;
            assert_same(
                &plan,
                &other,
                &format!("{graph} {set:?}, {lanes} lanes, {}={value}: {text}", param.name),
            );
        }
        assert!(built > 0, "{graph}: no other value of {} can be built", param.name);
        without.push(param.name.clone());
    }
    without
}

fn facts_of(lanes: u32, count: u64) -> Facts {
    let scene = SceneFacts { count, ..SceneFacts::NOMINAL };
    facts::facts(&scene, &facts::portable_device(lanes), facts::DEFAULT_SIZE)
}

#[test]
fn no_value_of_a_parameter_without_an_effect_changes_a_plan() {
    let mut builds = Builds::new();
    for graph in common::graphs() {
        for lanes in [8, 32] {
            check(&mut builds, graph, &[], &facts_of(lanes, 1_000_000));
        }
    }
    // Which parameters lack an effect depends on the other parameters, so vary those too.
    let counts: &[u64] = if common::long() { &[100, 1_000_000, 3_000_000] } else { &[1_000_000] };
    let mut found = BTreeSet::new();
    for graph in ["splat", "tiled", "tiled_cpu", "bench/pairs"] {
        let lanes: &[u32] = match graph {
            _ if common::long() => &[8, 32],
            "tiled_cpu" => &[8],
            _ => &[32],
        };
        for (lanes, count) in lanes.iter().flat_map(|lanes| counts.iter().map(|count| (*lanes, *count))) {
            let facts = facts_of(lanes, count);
            let plan = builds.plan(graph, &[], &facts).unwrap_or_else(|error| panic!("{graph}: {error}"));
            let choices = plan.params.iter().filter(|p| matches!(p.domain, Domain::Bool | Domain::Choice(_)));
            for (param, value) in choices.flat_map(|p| others(p).into_iter().map(move |v| (p, v))) {
                let set = [(param.name.clone(), value)];
                if builds.plan(graph, &set, &facts).is_ok() {
                    found.extend(check(&mut builds, graph, &set, &facts));
                }
            }
        }
    }
    for name in ["budget", "block_keys", "digit_bits", "pair_bits"] {
        assert!(found.contains(name), "{name} is used in every variant: {found:?}");
    }
    assert!(builds.poisoning.poisoned > 50, "{} defines were changed", builds.poisoning.poisoned);
}

#[test]
fn tiles_on_a_gpu_name_the_parameters_that_the_sort_of_splats_alone_has() {
    let mut builds = Builds::new();
    let mut said = |graph: &str, lanes: u32| -> Vec<String> {
        let plan = builds.plan(graph, &[], &facts_of(lanes, 1_000_000)).expect("a plan");
        let idle = plan.params.iter().filter(|param| plan.no_effect(&param.name).is_some());
        let without = |text: String| {
            text.split(".ron:").map(|part| part.trim_start_matches(char::is_numeric)).collect()
        };
        idle.filter_map(|param| plan.effect_text(&param.name)).map(without).collect()
    };
    let none = |name: &str| {
        format!(
            "`{name}` has no effect: nothing in this plan depends on it; it is used where `sorts_splats` \
             (pipelines/parts/tile_bins), and here sorted = pairs, tied_pairs = 0, key_of = depth, key_bits = 32, \
             key_map = float_bits"
        )
    };
    assert_eq!(said("auto", 32), [none("block_keys"), none("budget")]);
    assert_eq!(said("auto", 8), [""; 0]);
}

#[test]
fn the_switch_of_the_mesh_has_no_effect_for_a_loaded_scene_without_one() {
    let mut builds = Builds::new();
    for (graph, lanes) in [("splat", 32), ("tiled", 32), ("tiled_cpu", 8), ("auto", 8)] {
        let scene = SceneFacts { mesh_possible: false, ..SceneFacts::NOMINAL };
        let facts = facts::facts(&scene, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        for set in [&[][..], &[("mesh".to_owned(), "true".to_owned())]] {
            assert!(check(&mut builds, graph, set, &facts).contains(&"mesh".to_owned()), "{graph}, {set:?}");
        }
        let plan = builds.plan(graph, &[], &facts).expect("a plan");
        let text = plan.effect_text("mesh").expect("it is a parameter");
        assert!(
            text.contains("; `with_mesh` (pipelines/")
                && text.ends_with(") leaves it out, as mesh.possible = false"),
            "{text}"
        );
        // Without a loaded scene, a mesh is possible.
        let plan = builds.plan(graph, &[], &facts_of(lanes, 1_000_000)).expect("a plan");
        assert_eq!(plan.no_effect("mesh"), None);
    }
}

/// Runs a command, which must succeed; returns the lines of standard error about parameters without an effect.
#[cfg(target_os = "linux")]
fn told(place: &Place, line: &str) -> Vec<String> {
    place.said(line).1.lines().filter(|line| line.contains("has no effect")).map(str::to_string).collect()
}

#[cfg(target_os = "linux")]
#[test]
fn check_warns_of_a_setting_without_an_effect_and_says_for_which_devices() {
    let place = Place::new();
    let found = told(&place, "check tiled --set budget=0.5 --set sh_degree=1");
    let [line] = &found[..] else { panic!("{found:?}") };
    assert!(
        line.starts_with("warning: tiled, 4, 8, 16, 32, 64, 128 lanes: `budget` has no effect: nothing in"),
        "{line}"
    );
    let (json, errors) = place.said("check tiled --set budget=0.5 --json");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let text = json[0]["without_effect"][0].as_str().expect("a sentence");
    assert!(line.ends_with(text) && errors.is_empty(), "{text} {errors}");
}

#[cfg(target_os = "linux")]
#[test]
fn render_says_once_that_a_setting_has_no_effect_and_draws() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let draw = format!("{DRAW} out --set sh_degree=1");
    let found = told(&place, &format!("{draw} --set digit_bits=4 --set digit_bits=5"));
    let [line] = &found[..] else { panic!("{found:?}") };
    assert!(
        line.starts_with("unsorted: `digit_bits` has no effect: nothing in this plan depends on it;"),
        "{line}"
    );
    assert!(place.at("out/two.png").exists());
    assert!(told(&place, &draw).is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn bench_says_once_that_a_setting_has_no_effect() {
    let place = Place::new();
    let found = told(
        &place,
        "bench scene.ply --rounds 1 --frames 1 --sizes 32x32,48x32 --pipelines unsorted,splat --set digit_bits=4",
    );
    let [line] = &found[..] else { panic!("{found:?}") };
    assert!(line.starts_with("unsorted: `digit_bits` has no effect"), "{line}");
}

#[cfg(target_os = "linux")]
#[test]
fn trade_does_not_measure_a_parameter_without_an_effect_and_says_so() {
    let place = Place::new();
    place.cameras(&["one"]);
    let idle = r#"Graph(version: 1, summary: "", output: "scene.picture",
        params: { "idle": Const(Int(default: 1, range: (0, 2), exact: 1)) },
        passes: [Include(graph: "auto", name: "scene", expose: All)],
    )"#;
    place.write("idle.ron", idle);
    let (table, errors) = place.said(
        "trade scene.ply -c cameras.json --rounds 1 --frames 1 --pipeline idle.ron --only idle --only low_pass",
    );
    let told: Vec<&str> = errors.lines().filter(|line| line.contains("has no effect")).collect();
    // The scene has no mesh, so `mesh` has no effect either.
    let [mesh, idle] = ["mesh", "idle"]
        .map(|name| format!("not measured: `{name}` has no effect: nothing in this plan depends on it"));
    let is_told = |begin: &String| told.iter().any(|line| line.starts_with(begin));
    assert!(told.len() == 2 && is_told(&mesh) && is_told(&idle), "{errors}");
    assert!(table.contains("low_pass = none") && !table.contains("idle = "), "{table}");
}
