//! Runs `splatgraph check`: builds graphs, and replays their barriers.

use super::outcome::Outcome;
use super::outcome::colour;
use super::{known_devices, options};
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Fit, Target, Wanted};
use crate::draw::planner::{GraphErrors, PlainDiagnostic, Planner, without_effect};
use crate::io::output::{say, say_styled};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use splatgraph_api::Heap;
use splatgraph_framework::dump;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Fallback, ReflectedKind, Shader};
use splatgraph_framework::lower::Standing;
use splatgraph_framework::oracle;
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::model::{Replay, mutate, replay};
use splatgraph_vulkan::sync::{self, Barriers};
use std::path::{Path, PathBuf};

pub const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron
  splatgraph check splat --splats 5000000
  splatgraph check my/graph.ron --device raspberry-pi-5 --device webgpu   # devices of the list in --help
  splatgraph check --device other.json    # written by `splatgraph devices --json` on another machine
  splatgraph check my/graph.ron --json    # for an editor, or a pipeline";

/// Check graphs and their shaders, without a GPU
///
/// Builds every graph with its shaders for a nominal scene and the least capable supported device, with subgroups of 4 to 64 lanes.
/// Errors are shown at their line and column. A graph's requirement that this device does not meet is reported, but is not an
/// error. An oracle then replays the barriers of each plan, and reports missing barriers and needless bits. A parameter of --set
/// without an effect gives a warning. With --device, graphs are built for that device instead, and unmet requirements are errors.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graphs: names of built-in ones (see `splatgraph source`), or paths [default: every built-in one]
    #[arg(value_name = "NAME")]
    graphs: Vec<String>,
    /// Set a parameter of the graphs; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Number of splats of the nominal scene
    #[arg(long, value_name = "N", default_value_t = SceneFacts::NOMINAL.count as u32, value_parser = clap::value_parser!(u32).range(1..))]
    splats: u32,
    /// Build for this device: a name listed by --help, a file from `splatgraph devices --json`, or a part of the name or the index of a
    /// device of this machine; may be repeated
    #[arg(long, value_name = "NAME|INDEX|FILE")]
    device: Vec<String>,
    /// Print JSON, or write it to a file: for each graph and each --device, its name, validity, verdict and diagnostics
    ///
    /// `without_effect` lists the settings without an effect, each as a sentence.
    /// A diagnostic has `file`, `line`, `column`, `end_line`, `end_column`, `severity` (`error` or `warning`),
    /// `message`, `label` (the text shown under the span, which may be empty) and `help` (a list). Lines and columns
    /// count from 1, columns in characters.
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let inputs = args.graphs.iter().chain(&args.device).map(|name| ("a graph or a device", Path::new(name)));
    options::claim_json(args.json.as_deref(), inputs)?;
    let graphs: Vec<&str> = if args.graphs.is_empty() {
        options::built_in_graphs()
    } else {
        args.graphs.iter().map(String::as_str).collect()
    };
    let devices = args.device.iter().map(|device| On::named(device)).collect::<Result<Vec<_>>>()?;
    let smallest: Vec<On> = facts::SUBGROUP_SIZES.iter().map(|lanes| On::smallest(*lanes)).collect();
    // Each named device is checked on its own; the smallest device is checked with all subgroup widths together.
    let groups: Vec<&[On]> = if devices.is_empty() { vec![&smallest] } else { devices.chunks(1).collect() };
    // One planner, because graphs share most of their shaders.
    let mut planner = Planner::default();
    let mut outcome = Outcome::Done;
    let mut all = Vec::new();
    for (graph, on) in graphs.iter().flat_map(|graph| groups.iter().map(move |on| (*graph, *on))) {
        let (mut warnings, mut without_effect) = (Vec::new(), Vec::new());
        let mut warn = |warning| match warning {
            Warning::Plan { plain, .. } if args.json.is_some() => warnings.extend(plain),
            Warning::Plan { text, .. } => say_styled(&text),
            Warning::Setting(text) if args.json.is_some() => without_effect.push(text),
            Warning::Setting(text) => say(format!("warning: {graph}, {text}")),
        };
        let result = check(&mut planner, graph, &args.set, args.splats.into(), on, &mut warn);
        if !matches!(result, Ok(Verdict::Right(_))) {
            outcome = Outcome::Failed;
        }
        let device = on[0].is_named.then_some(on[0].name.as_str());
        if args.json.is_some() {
            all.push(as_json(graph, device, &result, warnings, &without_effect));
            continue;
        }
        let title = device.map_or(graph.to_owned(), |device| format!("{graph} on {device}"));
        match result {
            Ok(Verdict::Right(lines) | Verdict::Lacking(lines)) => {
                options::print(&format!("{title}: {lines}"))?
            }
            // A bug of the solver, not of the graph.
            Ok(Verdict::Wrong(violations)) => {
                say(violations);
                options::print(&format!(
                    "{title}: its barriers failed verification; please report this with the graph"
                ))?;
            }
            Err(errors) => {
                say_styled(&format!("{}\n", errors.text(colour()).trim_end()));
                let target = on[0].target();
                if let Some(fit) = too_large(&mut planner, graph, &args.set, args.splats.into(), &target) {
                    say(fit);
                }
                let errors = if errors.found.len() == 1 { "an error" } else { "errors" };
                options::print(&format!("{title}: {errors}"))?;
            }
        }
    }
    if let Some(path) = &args.json {
        options::write_json(path, &Value::from(all))?;
    }
    Ok(outcome)
}

/// A device for which graphs are checked.
struct On {
    /// Name of the device; for the least capable supported device, its number of lanes in a subgroup.
    name: String,
    facts: DeviceFacts,
    storage_buffers: Option<usize>,
    /// True if the command line names the device: unmet requirements are then errors.
    is_named: bool,
}

impl On {
    fn smallest(lanes: u32) -> On {
        let facts = facts::portable_device(lanes);
        On { name: lanes.to_string(), facts, storage_buffers: None, is_named: false }
    }

    fn named(device: &str) -> Result<On> {
        let Some(known) = known_devices::find(device)? else {
            let expected =
                "a device that `splatgraph check --help` lists, a file, or a device of this machine";
            let found = options::target(Some(device))
                .with_context(|| format!("expected {expected}, found `{device}`"))?;
            return Ok(On { name: found.name, facts: found.facts, storage_buffers: None, is_named: true });
        };
        Ok(On {
            name: known.name,
            facts: known.facts,
            storage_buffers: known.storage_buffers,
            is_named: true,
        })
    }

    fn target(&self) -> Target {
        match self.is_named {
            true => Target { name: self.name.clone(), facts: self.facts, heap: Heap::default() },
            false => Target::nominal(),
        }
    }

    /// Describes the shaders that bind more storage buffers than the device allows; `None` if there are none.
    fn too_many_buffers(&self, plan: &Plan) -> Option<String> {
        let most = self.storage_buffers?;
        let buffers = |shader: &Shader| -> usize {
            let bindings = shader.reflection.bindings.iter();
            let storage = bindings.filter(|b| matches!(b.kind, ReflectedKind::StorageBuffer { .. }));
            storage.map(|binding| binding.count as usize).sum()
        };
        let found = plan.shaders.iter().filter(|shader| buffers(shader) > most);
        let found: Vec<String> =
            found.map(|shader| format!("{} binds {}", shader.name, buffers(shader))).collect();
        (!found.is_empty()).then(|| {
            format!("expected at most {most} storage buffers in a shader, found: {}", found.join(", "))
        })
    }
}

fn as_json(
    graph: &str,
    device: Option<&str>,
    result: &CheckResult,
    mut found: Vec<PlainDiagnostic>,
    without_effect: &[String],
) -> Value {
    let verdict = match result {
        Ok(Verdict::Right(verdict) | Verdict::Lacking(verdict)) => verdict.clone(),
        Ok(Verdict::Wrong(violations)) => format!("its barriers failed verification: {violations}"),
        Err(errors) => {
            found.splice(0..0, errors.found.iter().cloned());
            "errors".to_owned()
        }
    };
    let is_right = matches!(result, Ok(Verdict::Right(_)));
    let mut json = json!({
        "graph": graph, "ok": is_right, "verdict": verdict, "diagnostics": found, "without_effect": without_effect,
    });
    if let Some(device) = device {
        json["device"] = device.into();
    }
    json
}

/// The result of checking a graph that has no errors.
#[derive(Debug)]
enum Verdict {
    /// Correct, with a summary.
    Right(String),
    /// A named device does not meet these requirements.
    Lacking(String),
    /// Violations that the oracle found.
    Wrong(String),
}

type CheckResult = Result<Verdict, GraphErrors>;

enum Warning {
    /// Warnings about a plan, as rendered text with source lines and as plain data.
    Plan { text: String, plain: Vec<PlainDiagnostic> },
    /// A setting without an effect, with the devices.
    Setting(String),
}

/// A verified plan, with the subgroup widths for which it was built.
struct Verified {
    lanes: Vec<String>,
    plan: Plan,
    line: String,
}

/// Builds a graph for each device, because graphs may depend on device facts, and verifies each plan.
///
/// Returns a verdict with a line for each group of devices with equal results. If a device has violations or errors,
/// or is named and does not meet the graph's requirements, returns the verdict on the first such device instead. If the
/// smallest device needs a fallback or does not meet the requirements, the line says so and no plan is built.
///
/// Each warning is passed to `warn` once.
fn check(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
    splats: u64,
    devices: &[On],
    warn: &mut dyn FnMut(Warning),
) -> CheckResult {
    let (catalog, scene) = nominal(splats);
    let mut found: Vec<Verified> = Vec::new();
    let mut unsuited: Vec<(Vec<String>, String)> = Vec::new();
    let mut warned = Vec::new();
    let mut idle: Vec<(String, Vec<String>)> = Vec::new();
    for on in devices {
        let lanes = &on.name;
        let facts = facts::facts(&scene, &on.facts, facts::DEFAULT_SIZE);
        let standing = planner.standing(graph, &facts, &catalog)?;
        let is_unmet = !standing.unmet.is_empty();
        let fallback = lacking(standing);
        if let Some(line) = fallback.clone().filter(|_| on.is_named && is_unmet) {
            return Ok(Verdict::Lacking(line));
        }
        // A named device that meets the requirements gets a plan with fallbacks; the smallest device gets no plan.
        if let Some(line) = fallback.clone().filter(|_| !on.is_named) {
            match unsuited.iter_mut().find(|(_, other)| *other == line) {
                Some((all, _)) => all.push(lanes.clone()),
                None => unsuited.push((vec![lanes.clone()], line)),
            }
            continue;
        }
        let plan = planner.plan(graph, set, &facts, &catalog)?;
        if let Some(line) = on.too_many_buffers(&plan) {
            return Ok(Verdict::Lacking(line));
        }
        let warnings = planner.warnings(&plan, colour());
        if !warnings.is_empty() && !warned.contains(&warnings) {
            let text = format!("{}\n", warnings.trim_end());
            warn(Warning::Plan { text, plain: planner.plain_warnings(&plan) });
            warned.push(warnings);
        }
        for (_, text) in without_effect(&plan, set) {
            match idle.iter_mut().find(|(other, _)| *other == text) {
                Some((_, all)) => all.push(lanes.clone()),
                None => idle.push((text, vec![lanes.clone()])),
            }
        }
        // Barriers depend on passes and resources, not on shaders or facts.
        let same = |other: &Verified| is_same(&other.plan, &plan);
        let line = match found.iter().find(|other| same(other)) {
            Some(other) => other.line.clone(),
            None => match sync::barriers(&plan)
                .map_err(|e| e.to_string())
                .and_then(|barriers| verify(&plan, &barriers))
            {
                Ok(line) => line,
                Err(violations) => {
                    let whose = if on.is_named {
                        String::new()
                    } else {
                        format!("with subgroups of {lanes} lanes:\n")
                    };
                    return Ok(Verdict::Wrong(whose + &violations));
                }
            },
        };
        let line = match fallback {
            Some(fallback) => format!("{fallback}; {line}"),
            None => line,
        };
        match found.iter_mut().find(|other| other.line == line) {
            Some(other) => other.lanes.push(lanes.clone()),
            None => found.push(Verified { lanes: vec![lanes.clone()], plan, line }),
        }
    }
    let lanes_of = |lanes: &[String]| match devices.iter().any(|on| on.is_named) {
        true => String::new(),
        false => format!("{} lanes: ", lanes.join(", ")),
    };
    for (text, lanes) in idle {
        warn(Warning::Setting(format!("{}{text}", lanes_of(&lanes))));
    }
    let verdict = if found.is_empty() { "not for the least capable supported device" } else { "OK" };
    let found = found.into_iter().map(|verified| (verified.lanes, verified.line));
    let line = |(lanes, line): (Vec<String>, String)| format!("\n  {}{line}", lanes_of(&lanes));
    Ok(Verdict::Right(verdict.to_owned() + &found.chain(unsuited).map(line).collect::<String>()))
}

/// Describes the requirements that a device does not meet, and the fallbacks; `None` if it meets all.
fn lacking(Standing { fallbacks, unmet }: Standing) -> Option<String> {
    let mut parts: Vec<String> = Fallback::lacking(&fallbacks).map(ToString::to_string).collect();
    if !unmet.is_empty() {
        let needs: Vec<String> = unmet.iter().map(ToString::to_string).collect();
        let whose = fallbacks.last().map_or("the graph".to_owned(), |last| format!("`{}`", last.taken));
        parts.push(format!("{whose} needs {}, and there is no fallback", needs.join(" and ")));
    }
    (!parts.is_empty()).then(|| parts.join("; "))
}

/// Returns true if two plans have the same passes and memory, which implies the same dependencies.
fn is_same(a: &Plan, b: &Plan) -> bool {
    let uses = |plan: &Plan| -> Vec<_> { plan.passes.iter().map(|p| (p.run, p.uses.clone())).collect() };
    (&a.prologue, &a.frame, &a.resources, &a.blocks, &a.stats, &a.culled)
        == (&b.prologue, &b.frame, &b.resources, &b.blocks, &b.stats, &b.culled)
        && a.shaders.len() == b.shaders.len()
        && a.shaders.iter().zip(&b.shaders).all(|(a, b)| a.reflection.bindings == b.reflection.bindings)
        && uses(a) == uses(b)
        && a.passes.iter().zip(&b.passes).all(|(a, b)| a.work == b.work)
}

fn nominal(splats: u64) -> (Catalog, SceneFacts) {
    let catalog = facts::with_count(options::nominal_catalog(), splats);
    (catalog, SceneFacts { count: splats, ..SceneFacts::NOMINAL })
}

/// Returns by how much a graph exceeds the device's limits; `None` if it fits, or if it has other errors.
fn too_large(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
    splats: u64,
    device: &Target,
) -> Option<Fit> {
    let (catalog, scene) = nominal(splats);
    let wanted = Wanted { graph, set, scene, catalog: &catalog, size: facts::DEFAULT_SIZE };
    let (_, fit) = fit::fit(planner, &wanted, device, None).ok()?;
    (!fit.fits).then_some(fit)
}

/// Verifies a plan: checks its dependencies, replays it with its barriers, and tries every mutation of the barriers.
///
/// # Errors
/// The text lists missing and needless barriers.
fn verify(plan: &Plan, barriers: &Barriers) -> Result<String, String> {
    let objections = oracle::dependencies(plan);
    let mut problems: Vec<String> = objections.iter().map(|objection| objection.describe(plan)).collect();
    let violations = replay(plan, barriers, &Replay::default());
    problems.extend(violations.iter().map(|violation| violation.describe(plan)));
    if problems.is_empty() {
        let needless = mutate::needless(plan, barriers);
        problems = needless.iter().map(|m| format!("needless: {}", m.describe(plan, barriers))).collect();
    }
    if !problems.is_empty() {
        return Err(problems.join("\n"));
    }
    let dump = sync::dump::add_barriers(dump::dump(plan), plan, Ok(barriers));
    let frame = &dump.totals.frame;
    let mut line = format!(
        "{} passes ({} once, {} every frame), {} shaders; {} barriers in {} calls: no hazards, and removing any barrier, \
         or any bit of one ({} ways), causes a hazard",
        plan.prologue.len() + plan.frame.len(),
        plan.prologue.len(),
        plan.frame.len(),
        plan.shaders.len(),
        frame.barriers,
        frame.calls,
        mutate::mutations(plan, barriers).len(),
    );
    if !dump.left_out.is_empty() {
        line += &format!("; {}", dump::left_out_counts(&dump));
    }
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(planner: &mut Planner, graph: &str, splats: u64) -> CheckResult {
        let smallest: Vec<On> = facts::SUBGROUP_SIZES.iter().map(|lanes| On::smallest(*lanes)).collect();
        check(planner, graph, &[], splats, &smallest, &mut |_| {})
    }

    fn right(result: CheckResult) -> String {
        match result.expect("no error") {
            Verdict::Right(lines) => lines,
            other => panic!("expected a graph without mistakes, found {other:?}"),
        }
    }

    #[test]
    fn what_a_named_device_lacks_is_an_error_that_names_the_need() {
        let planner = &mut Planner::default();
        let mut on = |graph: &str, device: &str| {
            let device = On::named(device).expect("a device of the catalogue");
            check(planner, graph, &[], 1_000_000, &[device], &mut |_| {}).expect("no error")
        };
        let lacking = |verdict: Verdict| match verdict {
            Verdict::Lacking(line) => line,
            other => panic!("expected a need that is not met, found {other:?}"),
        };
        let line = lacking(on("tiled", "webgpu"));
        assert!(
            line.contains("device.subgroup_") && line.ends_with("= false), and there is no fallback"),
            "{line}"
        );
        let line = lacking(on("splat", "webgpu-subgroups"));
        assert!(
            line.starts_with("expected at most 8 storage buffers in a shader, found: project.comp binds "),
            "{line}"
        );
        for device in ["lavapipe", "raspberry-pi-5", "adreno", "mali", "intel", "amd", "apple"] {
            let verdict = on("auto", device);
            assert!(
                matches!(&verdict, Verdict::Right(lines) if lines.starts_with("OK\n  ")),
                "{device}: {verdict:?}"
            );
        }
        let error = On::named("no-such-device").err().expect("there is none").to_string();
        assert!(error.ends_with("found `no-such-device`"), "{error}");
    }

    fn plan(lanes: u32) -> Plan {
        let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        Planner::default().plan("splat", &[], &facts, &options::nominal_catalog()).expect("a plan")
    }

    #[test]
    fn the_plans_that_are_verified_have_both_sorts() {
        for (lanes, sort) in
            [(4, "serial"), (8, "serial"), (16, "subgroup"), (32, "subgroup"), (64, "subgroup")]
        {
            let plan = plan(lanes);
            let sorter = plan.params.iter().find(|param| param.name == "sorter").expect("a parameter");
            assert_eq!(sorter.value.to_string(), sort, "{lanes} lanes");
            assert!(verify(&plan, &sync::barriers(&plan).expect("some")).is_ok(), "{lanes} lanes");
        }
    }

    #[test]
    fn a_scene_too_large_for_the_smallest_device_is_answered_with_one_that_fits() {
        let planner = &mut Planner::default();
        let errors = checked(planner, "unsorted", 5_000_000).expect_err("the splats exceed a storage buffer");
        assert!(
            errors.to_string().contains("`splats` has 153 MiB, and the device binds at most 128"),
            "{errors}"
        );
        let fit =
            too_large(planner, "unsorted", &[], 5_000_000, &Target::nominal()).expect("it is only too large");
        assert!(
            fit.most_splats
                .is_some_and(|most| matches!(checked(planner, "unsorted", most), Ok(Verdict::Right(_)))),
            "{fit}"
        );
        assert_eq!(too_large(planner, "unsorted", &[], 1_000_000, &Target::nominal()), None);
    }

    #[test]
    fn a_graph_that_needs_more_than_the_smallest_device_is_no_error_and_says_what_and_what_stands_in() {
        let folder = tempfile::tempdir().expect("a folder");
        let written = |name: &str, more: &str| {
            let path = folder.path().join(name);
            let text = format!("Preset(graph: \"unsorted\", summary: \"\", set: {{}}, {more})");
            std::fs::write(&path, text).expect("writable");
            path.display().to_string()
        };
        let wide = r#"require: [("device.max_invocations >= 1024", "workgroups of 1024 invocations")]"#;
        let checked = |graph: &str| right(checked(&mut Planner::default(), graph, 1000));
        assert_eq!(
            checked(&written("wide.ron", wide)),
            "not for the least capable supported device\n  4, 8, 16, 32, 64 lanes: the graph needs workgroups of 1024 \
             invocations (device.max_invocations = 256), and there is no fallback"
        );
        let narrow = r#"require: [("device.subgroup_size <= 32", "narrow subgroups")]"#;
        let narrow = written("narrow.ron", narrow);
        let either = std::path::Path::new(&narrow).with_file_name("either.ron");
        let choice = r#"Choice(summary: "", of: [(graph: "narrow.ron"), (graph: "splat")])"#;
        std::fs::write(&either, choice).expect("writable");
        let text = checked(&either.display().to_string());
        assert!(text.starts_with("OK\n  4, 8"), "{text}");
        let last = text.lines().last().expect("a line");
        assert!(last.starts_with("  64 lanes: `splat` is used instead of `"), "{text}");
        assert!(
            last.ends_with("narrow.ron`, which needs narrow subgroups (device.subgroup_size = 64)"),
            "{text}"
        );
    }

    #[test]
    fn json_has_the_place_of_a_mistake_and_what_helps() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("graph.ron");
        let text = "Graph(version: 1, summary: \"\", output: \"image\",\n  \
                    resources: { \"image\": Image(format: \"RGBA8Unorm\", size: (8, 8)) }, passes: [])";
        std::fs::write(&path, text).expect("writable");
        let graph = path.display().to_string();
        let result = checked(&mut Planner::default(), &graph, 1000);
        let json = as_json(&graph, None, &result, Vec::new(), &[]);
        assert_eq!(json["ok"], false);
        let found = &json["diagnostics"][0];
        assert_eq!((&found["line"], &found["column"]), (&json!(2), &json!(40)), "{json:#}");
        assert_eq!((&found["end_line"], &found["end_column"]), (&json!(2), &json!(50)), "{json:#}");
        assert_eq!(
            (&found["severity"], &found["help"][0]),
            (&json!("error"), &json!("did you mean `rgba8`?"))
        );
        assert!(found["file"].as_str().is_some_and(|file| file.ends_with("graph.ron")), "{json:#}");
    }

    #[test]
    fn a_barrier_too_few_and_a_barrier_too_many_fail() {
        let plan = plan(8);
        let barriers = sync::barriers(&plan).expect("some");
        let at = plan.frame.iter().position(|pass| !barriers.at(Some(*pass)).is_empty());
        let at = Some(plan.frame[at.expect("a barrier")]);
        let mut fewer = barriers.clone();
        fewer.at_mut(at).clear();
        let text = verify(&plan, &fewer).expect_err("a hazard");
        assert!(!text.contains("needless"), "{text}");
        let mut more = barriers.clone();
        let twice = more.at(at)[0].clone();
        more.at_mut(at).push(twice);
        let text = verify(&plan, &more).expect_err("a needless barrier");
        assert!(text.lines().all(|line| line.starts_with("needless: ")), "{text}");
    }
}
