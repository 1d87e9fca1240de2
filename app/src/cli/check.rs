//! Runs `splatgraph check`: builds graphs and replays their barriers.

use super::Outcome;
use super::{colour, options};
use crate::facts::{self, SceneFacts};
use crate::fit::{self, Fit, Target, Wanted};
use crate::output::{say, say_styled};
use crate::planner::{GraphErrors, PlainDiagnostic, Planner, without_effect};
use anyhow::Result;
use serde_json::{Value, json};
use splatgraph_framework::dump;
use splatgraph_framework::ir::{Catalog, Fallback};
use splatgraph_framework::lower::Standing;
use splatgraph_framework::oracle::{self, Replay, mutate};
use splatgraph_framework::plan::Plan;

pub const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron
  splatgraph check splat --splats 5000000
  splatgraph check my/graph.ron --json    # for an editor, or a pipeline";

/// Check graphs and their shaders, without a GPU
///
/// Every graph is built, and its shaders are compiled and checked against it, for a nominal scene and the smallest supported
/// device, with subgroups of 4 to 64 lanes. Errors are shown at their line and column. Where that device lacks what a graph
/// requires, that is said, and is no error. An oracle then replays the barriers of
/// each plan, and tests that they suffice and that none of them, and no bit of one, is needless. A parameter of --set that has no
/// effect gives a warning.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graphs: names of built-in ones (see `splatgraph source`), or paths; without any, every built-in one
    #[arg(value_name = "NAME")]
    graphs: Vec<String>,
    /// Change a parameter of the graphs; can be given several times
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Number of splats of the nominal scene
    #[arg(long, value_name = "N", default_value_t = SceneFacts::NOMINAL.count as u32, value_parser = clap::value_parser!(u32).range(1..))]
    splats: u32,
    /// Print JSON: for each graph its name, whether it is right, the verdict, and its diagnostics with file, line and column
    ///
    /// A diagnostic has `file`, `line`, `column`, `end_line`, `end_column`, `severity` (`error` or `warning`), `message`, `label`, the
    /// words at the place, and `help`, a list. Lines and columns count from 1, columns in characters.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let graphs: Vec<&str> = if args.graphs.is_empty() {
        options::built_in_graphs()
    } else {
        args.graphs.iter().map(String::as_str).collect()
    };
    // One for all: graphs share most of their shaders.
    let mut planner = Planner::default();
    let mut outcome = Outcome::Done;
    let mut all = Vec::new();
    for graph in graphs {
        let mut warnings = Vec::new();
        let result = check(&mut planner, graph, &args.set, args.splats.into(), &mut |warning| {
            if args.json { warnings.extend(warning.plain) } else { say_styled(&warning.text) }
        });
        if !matches!(result, Ok(Ok(_))) {
            outcome = Outcome::Failed;
        }
        if args.json {
            all.push(as_json(graph, &result, warnings));
            continue;
        }
        match result {
            Ok(Ok(lines)) => options::print(&format!("{graph}: {lines}"))?,
            // Not the graph's fault: the solver's.
            Ok(Err(violations)) => {
                say(violations);
                options::print(&format!(
                    "{graph}: its barriers do not hold; please report this with the graph"
                ))?;
            }
            Err(errors) => {
                say_styled(&format!("{}\n", errors.text(colour()).trim_end()));
                if let Some(fit) = too_large(&mut planner, graph, &args.set, args.splats.into()) {
                    say(fit);
                }
                let errors = if errors.found.len() == 1 { "an error" } else { "errors" };
                options::print(&format!("{graph}: {errors}"))?;
            }
        }
    }
    if args.json {
        options::write_text(None, &format!("{:#}\n", Value::from(all)))?;
    }
    Ok(outcome)
}

/// Writes the result of one graph as JSON.
fn as_json(graph: &str, result: &CheckResult, mut found: Vec<PlainDiagnostic>) -> Value {
    let verdict = match result {
        Ok(Ok(verdict)) => verdict.clone(),
        Ok(Err(violations)) => format!("its barriers do not hold: {violations}"),
        Err(errors) => {
            found.splice(0..0, errors.found.iter().cloned());
            "errors".to_owned()
        }
    };
    json!({ "graph": graph, "ok": matches!(result, Ok(Ok(_))), "verdict": verdict, "diagnostics": found })
}

/// The verdict on a graph, the violations that the oracle found, or the graph's errors.
type CheckResult = Result<Result<String, String>, GraphErrors>;

/// Holds a warning, rendered with the source text and as plain data. One of a setting has no place in a file.
struct Warning {
    text: String,
    plain: Vec<PlainDiagnostic>,
}

/// A plan that was verified, with the widths of subgroups that it is for.
struct Verified {
    lanes: Vec<String>,
    plan: Plan,
    line: String,
}

/// Builds a graph for every subgroup size, because graphs may depend on it, and verifies each plan.
///
/// Returns a verdict and a line for the sizes with equal counts, or the violations of the first size that has any; and the errors of
/// the first size that has any. Where the device lacks what the graph requires, the line says so: nothing is built. Warnings are
/// printed once each; those of settings without an effect say for which sizes.
fn check(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
    splats: u64,
    warn: &mut dyn FnMut(Warning),
) -> CheckResult {
    let (catalog, scene) = nominal(splats);
    let mut found: Vec<Verified> = Vec::new();
    let mut unsuited: Vec<(Vec<String>, String)> = Vec::new();
    let mut warned = Vec::new();
    let mut idle: Vec<(String, Vec<String>)> = Vec::new();
    for lanes in facts::SUBGROUP_SIZES {
        let facts = facts::facts(&scene, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        if let Some(line) = lacking(planner.standing(graph, &facts, &catalog)?) {
            match unsuited.iter_mut().find(|(_, other)| *other == line) {
                Some((all, _)) => all.push(lanes.to_string()),
                None => unsuited.push((vec![lanes.to_string()], line)),
            }
            continue;
        }
        let plan = planner.plan(graph, set, &facts, &catalog)?;
        let warnings = planner.warnings(&plan, colour());
        if !warnings.is_empty() && !warned.contains(&warnings) {
            let text = format!("{}\n", warnings.trim_end());
            warn(Warning { text, plain: planner.plain_warnings(&plan) });
            warned.push(warnings);
        }
        for (_, text) in without_effect(&plan, set) {
            match idle.iter_mut().find(|(other, _)| *other == text) {
                Some((_, all)) => all.push(lanes.to_string()),
                None => idle.push((text, vec![lanes.to_string()])),
            }
        }
        // Barriers depend on passes and resources, not on shaders or facts.
        let same = |other: &Verified| is_same(&other.plan, &plan);
        let line = match found.iter().find(|other| same(other)) {
            Some(other) => other.line.clone(),
            None => match verify(&plan) {
                Ok(line) => line,
                Err(violations) => {
                    return Ok(Err(format!("with subgroups of {lanes} lanes:\n{violations}")));
                }
            },
        };
        match found.iter_mut().find(|other| other.line == line) {
            Some(other) => other.lanes.push(lanes.to_string()),
            None => found.push(Verified { lanes: vec![lanes.to_string()], plan, line }),
        }
    }
    for (text, lanes) in idle {
        say(format!("warning: {graph}, {} lanes: {text}", lanes.join(", ")));
    }
    let verdict = if found.is_empty() { "not for the smallest supported device" } else { "OK" };
    let found = found.into_iter().map(|verified| (verified.lanes, verified.line));
    let line = |(lanes, line): (Vec<String>, String)| format!("\n  {} lanes: {line}", lanes.join(", "));
    Ok(Ok(verdict.to_owned() + &found.chain(unsuited).map(line).collect::<String>()))
}

/// Says what a device lacks that a graph requires, and what stands in for the graph.
///
/// None if it lacks nothing.
fn lacking(Standing { fallbacks, unmet }: Standing) -> Option<String> {
    let mut parts: Vec<String> = Fallback::lacking(&fallbacks).map(ToString::to_string).collect();
    if !unmet.is_empty() {
        let needs: Vec<String> = unmet.iter().map(ToString::to_string).collect();
        let whose = fallbacks.last().map_or("the graph".to_owned(), |last| format!("`{}`", last.taken));
        parts.push(format!("{whose} needs {}, and nothing stands in", needs.join(" and ")));
    }
    (!parts.is_empty()).then(|| parts.join("; "))
}

/// Returns true if two plans have the same passes, memory and barriers.
fn is_same(a: &Plan, b: &Plan) -> bool {
    let uses = |plan: &Plan| -> Vec<_> { plan.passes.iter().map(|p| (p.run, p.uses.clone())).collect() };
    (&a.prologue, &a.handover, &a.frame, &a.resources, &a.blocks, &a.stats, &a.culled)
        == (&b.prologue, &b.handover, &b.frame, &b.resources, &b.blocks, &b.stats, &b.culled)
        && a.shaders.len() == b.shaders.len()
        && a.shaders.iter().zip(&b.shaders).all(|(a, b)| a.reflection.bindings == b.reflection.bindings)
        && uses(a) == uses(b)
        && a.passes.iter().zip(&b.passes).all(|(a, b)| a.work == b.work)
}

/// Returns the imports and the facts of a nominal scene of this many splats.
fn nominal(splats: u64) -> (Catalog, SceneFacts) {
    let mut catalog = options::nominal_catalog();
    for attribute in catalog.attributes.values_mut() {
        attribute.count = splats;
    }
    (catalog, SceneFacts { count: splats, ..SceneFacts::NOMINAL })
}

/// Says what would fit, where a graph that cannot be built is sound but too large for the smallest supported device.
fn too_large(planner: &mut Planner, graph: &str, set: &[(String, String)], splats: u64) -> Option<Fit> {
    let (catalog, scene) = nominal(splats);
    let wanted = Wanted { graph, set, scene, catalog: &catalog, size: facts::DEFAULT_SIZE };
    let (_, fit) = fit::fit(planner, &wanted, &Target::nominal()).ok()?;
    (!fit.fits).then_some(fit)
}

/// Checks the dependencies, replays the plan with the oracle, and tries every mutation.
///
/// Returns the counts, or what is missing and what is needless.
fn verify(plan: &Plan) -> Result<String, String> {
    let objections = oracle::dependencies(plan);
    let mut problems: Vec<String> = objections.iter().map(|objection| objection.describe(plan)).collect();
    let violations = oracle::replay(plan, &Replay::default());
    problems.extend(violations.iter().map(|violation| violation.describe(plan)));
    if problems.is_empty() {
        let needless = mutate::needless(plan);
        problems = needless.iter().map(|mutation| format!("needless: {}", mutation.describe(plan))).collect();
    }
    if !problems.is_empty() {
        return Err(problems.join("\n"));
    }
    let dump = dump::dump(plan);
    let frame = &dump.totals.frame;
    let mut line = format!(
        "{} passes once and {} every frame, {} shaders; {} barriers in {} calls: they leave no hazard, and taking away any \
         barrier or any bit of one ({} ways) leaves one",
        plan.prologue.len(),
        plan.frame.len(),
        plan.shaders.len(),
        frame.barriers,
        frame.calls,
        mutate::mutations(plan).len(),
    );
    if !dump.left_out.is_empty() {
        line += &format!("; {}", dump::left_out_counts(&dump));
    }
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert!(verify(&plan).is_ok(), "{lanes} lanes");
        }
    }

    #[test]
    fn a_scene_too_large_for_the_smallest_device_is_answered_with_one_that_fits() {
        let planner = &mut Planner::default();
        let errors = check(planner, "unsorted", &[], 5_000_000, &mut |_| {})
            .expect_err("the splats exceed a storage buffer");
        assert!(
            errors.to_string().contains("`splats` has 153 MiB, and the device binds at most 128"),
            "{errors}"
        );
        let fit = too_large(planner, "unsorted", &[], 5_000_000).expect("it is only too large");
        assert!(
            fit.most_splats.is_some_and(
                |most| check(planner, "unsorted", &[], most, &mut |_| {}).is_ok_and(|r| r.is_ok())
            ),
            "{fit}"
        );
        assert_eq!(too_large(planner, "unsorted", &[], 1_000_000), None);
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
        let checked = |graph: &str| {
            check(&mut Planner::default(), graph, &[], 1000, &mut |_| {})
                .expect("no error")
                .expect("no violation")
        };
        assert_eq!(
            checked(&written("wide.ron", wide)),
            "not for the smallest supported device\n  4, 8, 16, 32, 64 lanes: the graph needs workgroups of 1024 \
             invocations (device.max_invocations = 256), and nothing stands in"
        );
        let narrow = r#"require: [("device.subgroup_size <= 32", "narrow subgroups")]"#;
        let narrow = written("narrow.ron", narrow);
        let either = std::path::Path::new(&narrow).with_file_name("either.ron");
        let choice = r#"Choice(summary: "", of: [(graph: "narrow.ron"), (graph: "splat")])"#;
        std::fs::write(&either, choice).expect("writable");
        let text = checked(&either.display().to_string());
        assert!(text.starts_with("OK\n  4, 8"), "{text}");
        let last = text.lines().last().expect("a line");
        assert!(last.starts_with("  64 lanes: `splat` stands in for `"), "{text}");
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
        let result = check(&mut Planner::default(), &graph, &[], 1000, &mut |_| {});
        let json = as_json(&graph, &result, Vec::new());
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
        let step = plan.frame.iter().position(|step| !step.barriers.is_empty()).expect("a barrier");
        let mut fewer = plan.clone();
        fewer.frame[step].barriers.clear();
        let text = verify(&fewer).expect_err("a hazard");
        assert!(!text.contains("needless"), "{text}");
        let mut more = plan.clone();
        let twice = more.frame[step].barriers[0].clone();
        more.frame[step].barriers.push(twice);
        let text = verify(&more).expect_err("a needless barrier");
        assert!(text.lines().all(|line| line.starts_with("needless: ")), "{text}");
    }
}
