//! Runs `splatgraph check`: builds graphs, and replays their barriers.

use super::options;
use super::outcome::Outcome;
use super::outcome::colour;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Fit, Target, Wanted};
use crate::draw::inspect;
use crate::draw::planner::{GraphErrors, PlainDiagnostic, Planner, new_warnings, without_effect};
use crate::draw::requirements::{self, Case, Unchecked};
use crate::io::output::{say, say_styled};
use crate::lsp;
use anyhow::Result;
use serde_json::{Value, json};
use splatgraph_framework::dump;
use splatgraph_framework::ir::{Catalog, Fallback, Unmet};
use splatgraph_framework::lower::{self, Standing};
use splatgraph_framework::oracle;
use splatgraph_framework::plan::{self, Plan};
use splatgraph_vulkan::sync::model::{Replay, mutate, replay};
use splatgraph_vulkan::sync::{self, Barriers};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron
  splatgraph check splat --splats 5000000
  splatgraph check my/graph.ron --device raspberry-pi-5 --device webgpu   # devices of the list in --help
  splatgraph check --device other.json    # written by `splatgraph devices --json` on another machine
  splatgraph check my/graph.ron --json    # for an editor, or a pipeline";

/// Check graphs and their shaders, without a GPU
///
/// Builds every graph with its shaders for a nominal scene and the least capable supported device, with subgroups of 4
/// to 128 lanes, images of at most 16384 pixels a side, and 31 storage buffers in a shader. Errors are shown at their
/// line and column. A graph's requirement that this device does not meet is reported, but is not an error: the graph is
/// then checked with other facts of the device or the scene, with which its requirements are met. So are the graphs of
/// a choice that are not drawn. If no such facts are found, this is an error, or a warning for one of several graphs of
/// a choice. An oracle replays the barriers of each plan, and reports missing barriers and needless bits. A parameter
/// of --set without an effect gives a warning, and so does a parameter of the graph's file that neither the file nor
/// its shaders mention. With --device, graphs are built for that device instead, and unmet requirements are errors.
/// Graphs with outputs besides the picture are also built with all of them requested.
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
    /// Build for this device: a name listed by --help, a file from `splatgraph devices --json`, or a part of the name
    /// or the index of a device of this machine; may be repeated
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
    let devices =
        args.device.iter().map(|device| options::target(Some(device))).collect::<Result<Vec<_>>>()?;
    let (nominal, smallest) = (Target::nominal(), facts::SUBGROUP_SIZES.map(smallest));
    // Each named device is checked on its own; the smallest device is checked with all subgroup widths together.
    let groups: Vec<On> = match devices.is_empty() {
        true => vec![On::Smallest(&smallest)],
        false => devices.iter().map(On::Named).collect(),
    };
    // One planner, because graphs share most of their shaders.
    let mut planner = Planner::default();
    let mut outcome = Outcome::Done;
    let mut all = Vec::new();
    for (graph, on) in graphs.iter().flat_map(|graph| groups.iter().map(move |on| (*graph, *on))) {
        let (mut warnings, mut without_effect) = (Vec::new(), Vec::new());
        let mut warn = |warning| match warning {
            Warning::Plan { plain, .. } if args.json.is_some() => warnings.extend(plain),
            Warning::Plan { text, .. } => say_styled(&text),
            Warning::Unchecked(plain) => warnings.extend(plain),
            Warning::Setting(text) if args.json.is_some() => without_effect.push(text),
            Warning::Setting(text) => say(format!("warning: {graph}, {text}")),
        };
        let result = check(&mut planner, graph, &args.set, args.splats.into(), on, &mut warn);
        if !matches!(result, Ok(Verdict::Right(_))) {
            outcome = Outcome::Failed;
        }
        let (device, target) = match on {
            On::Named(device) => (Some(device.name.as_str()), device),
            On::Smallest(_) => (None, &nominal),
        };
        if args.json.is_some() {
            all.push(as_json(graph, device, &result, warnings, &without_effect));
            continue;
        }
        let title = device.map_or(graph.to_owned(), |device| format!("{graph} on {device}"));
        match result {
            Ok(Verdict::Right(lines) | Verdict::Lacking(lines)) => {
                options::print(&format!("{title}: {lines}"))?
            }
            Ok(Verdict::Unchecked(lines, errors)) => {
                say_styled(&format!("{}\n", errors.text(colour()).trim_end()));
                options::print(&format!("{title}: {lines}"))?;
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
                if let Some(fit) = too_large(&mut planner, graph, &args.set, args.splats.into(), target) {
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

/// The devices for which a graph is checked together.
#[derive(Clone, Copy)]
enum On<'a> {
    /// A device of the command line: unmet requirements are errors.
    Named(&'a Target),
    /// The least capable supported device, with each subgroup width.
    Smallest(&'a [Target]),
}

/// Returns the least capable supported device, named after the number of lanes in a subgroup.
fn smallest(lanes: u32) -> Target {
    Target { name: lanes.to_string(), facts: facts::portable_device(lanes), ..Target::nominal() }
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
        Ok(Verdict::Unchecked(verdict, errors)) => {
            found.extend(errors.found.iter().cloned());
            verdict.clone()
        }
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
    /// The requirements that a device does not meet, or the limits that the plan exceeds.
    Lacking(String),
    /// No facts were found that meet the requirements; with a summary, and the requirements as errors.
    Unchecked(String, GraphErrors),
    /// The problems that [`verify`] found.
    Wrong(String),
}

type CheckResult = Result<Verdict, GraphErrors>;

enum Warning {
    /// Warnings about a plan, as rendered text with source lines and as plain data.
    Plan { text: String, plain: Vec<PlainDiagnostic> },
    /// Unmet requirements of the unchecked graphs of a choice; may be empty. The summary names the graphs, too.
    Unchecked(Vec<PlainDiagnostic>),
    /// A setting without an effect, after the subgroup widths to which this applies.
    Setting(String),
}

/// Builds a graph for each device, because graphs may depend on device facts, and verifies each plan. Graphs of a
/// choice that are drawn on none of the devices, and graphs whose requirements the smallest device does not meet, are
/// built for a device or a scene that meets them.
///
/// Returns a verdict with a line for each group of devices with equal results. The first device with errors,
/// violations, exceeded limits or, if it is named, unmet requirements decides the result alone. If no graph was built
/// at all, returns [`Verdict::Unchecked`].
///
/// Each warning is passed to `warn` once.
fn check(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
    splats: u64,
    on: On,
    warn: &mut dyn FnMut(Warning),
) -> CheckResult {
    let (catalog, scene) = nominal(splats);
    let (devices, is_named) = match on {
        On::Named(device) => (std::slice::from_ref(device), true),
        On::Smallest(widths) => (widths, false),
    };
    let case = |device: &Target| Case { device: device.facts, scene, size: facts::DEFAULT_SIZE };
    let cases: Vec<Case> = devices.iter().map(case).collect();
    let mut checked = Checked { graph, set, is_named, ..Checked::default() };
    let mut drawn = Vec::new();
    let mut unsuited = Lines::default();
    for (device, case) in devices.iter().zip(&cases) {
        let facts = case.facts();
        let standing = planner.ask((graph, &[]), &facts, &catalog, lower::standing)?;
        let (is_unmet, index) = (!standing.unmet.is_empty(), standing.fallbacks.len());
        let fallback = lacking(standing);
        if let Some(line) = fallback.clone().filter(|_| is_unmet) {
            if is_named {
                return Ok(Verdict::Lacking(line));
            }
            unsuited.add(&device.name, line);
            continue;
        }
        drawn.push(index);
        let plan = planner.plan(graph, set, &facts, &catalog).map_err(|errors| {
            requirements::with_drawn_graph(planner, (graph, index), case, &catalog, errors)
        })?;
        if let Some(line) = device.exceeded(&plan) {
            return Ok(Verdict::Lacking(line));
        }
        let full = planner.with_every_output(&plan, |planner| planner.plan(graph, set, &facts, &catalog))?;
        checked.note_idle(&plan, &device.name);
        let line = match checked.verified(planner, plan, &device.name, warn) {
            Ok(line) => line,
            Err(violations) => return Ok(Verdict::Wrong(violations)),
        };
        let line = fallback.map_or(line.clone(), |fallback| format!("{fallback}; {line}"));
        checked.lines.add(&device.name, line);
        // A device may have room for the picture and for some outputs, but not for all of them together.
        if let Some(full) = full
            && device.exceeded(&full).is_none()
        {
            match checked.verified(planner, full, &device.name, warn) {
                Ok(line) => checked.lines.add(&device.name, format!("with every output: {line}")),
                Err(violations) => return Ok(Verdict::Wrong(violations)),
            }
        }
    }
    let verdict = if drawn.is_empty() { "not for the least capable supported device" } else { "OK" };
    checked.lines.0.append(&mut unsuited.0);
    let mut unchecked = Unchecked::default();
    for undrawn in requirements::undrawn(planner, graph, &cases, &catalog, &drawn)? {
        let who = undrawn.name.as_ref().map_or("the graph".to_owned(), |name| format!("`{name}`"));
        let lanes = undrawn.case.as_ref().map_or(String::new(), |case| case.device.subgroup_size.to_string());
        let Some(plan) = undrawn.plan(planner, graph, set, &catalog)? else {
            unchecked.add(planner, (graph, &undrawn), &cases[0], &catalog);
            let needs = listed(&undrawn.unmet);
            let line = format!("{who} was not checked: no facts were found with which it has {needs}");
            checked.lines.add(&lanes, line);
            continue;
        };
        let full = undrawn.full_plan(planner, &plan, (graph, set), &catalog)?;
        let who = match undrawn.changed.is_empty() {
            true => who,
            false => format!("{who} with {}", undrawn.changed),
        };
        checked.note_idle(&plan, &lanes);
        let found = checked.verified(planner, plan, &lanes, warn).and_then(|line| {
            checked.lines.add(&lanes, format!("{who}: {line}"));
            let Some(full) = full else { return Ok(()) };
            let line = checked.verified(planner, full, &lanes, warn)?;
            checked.lines.add(&lanes, format!("{who}, with every output: {line}"));
            Ok(())
        });
        if let Err(violations) = found {
            return Ok(Verdict::Wrong(violations));
        }
    }
    for (text, lanes) in &checked.idle.0 {
        warn(Warning::Setting(format!("{}{text}", lanes_of(lanes, is_named))));
    }
    let line = |(line, lanes): (String, Vec<String>)| format!("\n  {}{line}", lanes_of(&lanes, is_named));
    let summary = verdict.to_owned() + &checked.lines.0.into_iter().map(line).collect::<String>();
    match unchecked.diagnostics(checked.known.len()) {
        Ok(warnings) => {
            warn(Warning::Unchecked(warnings));
            Ok(Verdict::Right(summary))
        }
        Err(errors) => Ok(Verdict::Unchecked(summary, errors)),
    }
}

/// Formats the subgroup widths of a line: `16, 32 lanes: `. Empty for a named device.
fn lanes_of(lanes: &[String], is_named: bool) -> String {
    let lanes: Vec<&str> = lanes.iter().map(String::as_str).filter(|lanes| !lanes.is_empty()).collect();
    if is_named || lanes.is_empty() { String::new() } else { format!("{} lanes: ", lanes.join(", ")) }
}

/// Lines of text, each with the subgroup widths to which it applies.
#[derive(Default)]
struct Lines(Vec<(String, Vec<String>)>);

impl Lines {
    fn add(&mut self, lanes: &str, line: String) {
        match self.0.iter_mut().find(|(other, _)| *other == line) {
            Some((_, all)) => all.push(lanes.to_owned()),
            None => self.0.push((line, vec![lanes.to_owned()])),
        }
    }
}

/// The results for the plans of a graph.
#[derive(Default)]
struct Checked<'a> {
    graph: &'a str,
    set: &'a [(String, String)],
    /// True if the command line names the device.
    is_named: bool,
    lines: Lines,
    /// Settings without an effect.
    idle: Lines,
    /// Verified plans that differ, each with its summary.
    known: Vec<(Plan, String)>,
    warned: Vec<plan::Warning>,
}

impl Checked<'_> {
    /// Notes the settings without an effect in a plan.
    fn note_idle(&mut self, plan: &Plan, lanes: &str) {
        for (_, text) in without_effect(plan, self.set) {
            self.idle.add(lanes, text);
        }
    }

    /// Verifies the barriers of a plan, unless an equal plan was verified. Returns the summary, or the violations.
    ///
    /// `lanes` is the subgroup size of the plan's device, or the name of a device that the user named. New warnings go
    /// to `warn`.
    fn verified(
        &mut self,
        planner: &mut Planner,
        mut plan: Plan,
        lanes: &str,
        warn: &mut dyn FnMut(Warning),
    ) -> Result<String, String> {
        planner.warn_of_subgroups(&mut plan);
        lsp::warn_of_unused(planner, self.graph, &mut plan);
        let warnings = new_warnings(&plan, &mut self.warned);
        if !warnings.is_empty() {
            let text = planner.warnings(&warnings, colour());
            warn(Warning::Plan { text, plain: planner.plain_warnings(&warnings) });
        }
        // Barriers depend on passes, resources and bindings, not on the code of shaders or on facts.
        if let Some((_, line)) = self.known.iter().find(|(other, _)| is_same(other, &plan)) {
            return Ok(line.clone());
        }
        let verified =
            sync::barriers(&plan).map_err(|e| e.to_string()).and_then(|barriers| verify(&plan, &barriers));
        let line = verified.map_err(|violations| match self.is_named {
            true => violations,
            false => format!("with subgroups of {lanes} lanes:\n{violations}"),
        })?;
        self.known.push((plan, line.clone()));
        Ok(line)
    }
}

fn listed(unmet: &[Unmet]) -> String {
    unmet.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ")
}

/// Describes the requirements that a device does not meet, and the fallbacks; `None` if there are none. Skips graphs
/// that a choice only ranks lower.
fn lacking(Standing { fallbacks, unmet }: Standing) -> Option<String> {
    let mut parts: Vec<String> = Fallback::lacking(&fallbacks).map(ToString::to_string).collect();
    if !unmet.is_empty() {
        let whose = fallbacks.last().map_or("the graph".to_owned(), |last| format!("`{}`", last.taken));
        parts.push(format!("{whose} needs {}, and there is no fallback", listed(&unmet)));
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
    let catalog = facts::with_count(lsp::nominal_catalog(), splats);
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

/// Verifies a plan, and returns a summary.
///
/// Checks its dependencies, replays it with its barriers and, if neither finds a problem, tries every mutation of the
/// barriers.
///
/// # Errors
/// The text lists wrong dependencies and hazards or, if there are none, needless barriers.
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
        let unread = inspect::unread(&dump.left_out);
        if !unread.is_empty() {
            line += &format!("; unread: {unread}");
        }
    }
    Ok(line)
}

#[cfg(test)]
mod tests;
