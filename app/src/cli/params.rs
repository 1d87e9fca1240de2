//! Runs `splatgraph params`: lists the parameters of a graph.

use super::loading;
use super::options;
use super::outcome::Outcome;
use crate::draw::facts;
use crate::draw::fit::Target;
use crate::draw::planner::Planner;
use crate::io::load::LoadOptions;
use crate::io::output::say;
use anyhow::Result;
use serde_json::{Value, json};
use splatgraph_assets::grouped;
use splatgraph_framework::ir::ParamBinding;
use splatgraph_framework::lower::{self, Control};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph params                              # of the default graph, `auto`, as this device draws it
  splatgraph params splat
  splatgraph params my/graph.ron --scene scene.ply
  splatgraph params tiled --set sorted=splats    # defaults may depend on other parameters
  splatgraph params --json | jq -r '.parameters[].name'

Set one with --set NAME=VALUE of `render` and the other commands, or by its slider in `view`.";

/// List the parameters of a graph
///
/// Each parameter is listed with its name, its allowed values, its value in brackets (the default, unless --set sets
/// it), and its meaning. If the exact value, which costs no accuracy, differs, it is also shown. Changing a `const`
/// builds a new plan. Changing a `live` parameter does not. Defaults depend on the device and on the scene. Without
/// --scene, a million splats with spherical harmonics of degree 3 are assumed.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graph: the name of a built-in one (see `splatgraph source`), or a path
    #[arg(value_name = "NAME", default_value = options::DEFAULT_PIPELINE)]
    graph: String,
    /// Set a parameter, on which defaults of others may depend; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// The scene that defaults depend on
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// The device that defaults depend on: a part of its name, its index in `splatgraph devices`, a name listed by
    /// `splatgraph check --help`, or a file from `splatgraph devices --json` [default: this machine's, or the least
    /// capable supported one]
    #[arg(long, value_name = "NAME|INDEX|FILE")]
    device: Option<String>,
    /// Print JSON, or write it to a file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    #[command(flatten)]
    load: LoadOptions,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let files = [Some(Path::new(&args.graph)), args.scene.as_deref(), args.device.as_deref().map(Path::new)];
    options::claim_json(args.json.as_deref(), files.into_iter().flatten().map(|file| ("an input", file)))?;
    let Target { name: device_name, facts: device, .. } = device(args.device.as_deref())?;
    let (scene, catalog) = loading::scene_facts(args.scene.as_deref(), &args.load)?;
    let facts = facts::facts(&scene, &device, facts::DEFAULT_SIZE);
    let mut planner = Planner::default();
    let standing = planner.ask((&args.graph, &[]), &facts, &catalog, lower::standing)?;
    let controls = planner.controls(&args.graph, &args.set, &facts, &catalog)?;
    let drawn = standing.fallbacks.last().map_or(args.graph.as_str(), |last| last.taken.as_str());
    if let Some(path) = &args.json {
        let all: Vec<Value> = controls.iter().map(as_json).collect();
        let all = json!({
            "graph": args.graph, "drawn": drawn, "device": device_name, "splats": scene.count, "parameters": all,
        });
        options::write_json(path, &all)?;
        return Ok(Outcome::Done);
    }
    let stands = if drawn == args.graph { String::new() } else { format!(", drawn as {drawn}") };
    let head = format!("{}{stands} on {device_name}, for {} splats", args.graph, grouped(scene.count));
    options::print(&format!("{head}:{}", listed(&controls)))?;
    Ok(Outcome::Done)
}

/// Returns the device `wanted`. `None` is the default device; if there is none, prints so and returns the least capable
/// supported device.
fn device(wanted: Option<&str>) -> Result<Target> {
    match options::target(wanted) {
        Err(_) if wanted.is_none() => {
            say("no device was found: the defaults are those of the least capable supported one");
            Ok(Target::nominal())
        }
        found => found,
    }
}

fn listed(controls: &[Control]) -> String {
    if controls.is_empty() {
        return "\n  it has no parameters".to_owned();
    }
    let mut text = String::new();
    for group in controls.chunk_by(|a, b| a.part == b.part) {
        let title = group[0].part.as_ref().map(|part| format!("\n {part}:")).unwrap_or_default();
        let rows = super::help::two_columns(group.iter().map(row).collect());
        text += &format!("{title}\n{rows}");
    }
    text
}

fn row(control: &Control) -> (String, String) {
    let Control { param, label, help, .. } = control;
    let exact = match &param.exact {
        Some(exact) if *exact != param.value => format!(", exact: {exact}"),
        _ => String::new(),
    };
    let about = if help.is_empty() { label } else { help };
    let domain = super::help::domain(&param.domain);
    (param.name.clone(), format!("{} {domain} [{}{exact}]  {about}", kind(control), param.value))
}

fn kind(control: &Control) -> &'static str {
    match control.param.binding {
        ParamBinding::Const => "const",
        ParamBinding::Live { .. } => "live",
    }
}

fn as_json(control: &Control) -> Value {
    let Control { param, label, help, part, .. } = control;
    json!({
        "name": param.name, "part": part, "kind": kind(control), "domain": super::help::domain(&param.domain),
        "value": param.value, "default": param.default, "exact": param.exact, "grows_with": param.grows,
        "reason": param.reason, "label": label, "help": help,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lsp;

    fn controls(graph: &str) -> Vec<Control> {
        let facts = facts::nominal(facts::USUAL_SUBGROUP_SIZE);
        Planner::default().controls(graph, &[], &facts, &lsp::nominal_catalog()).expect("a graph")
    }

    #[test]
    fn a_row_has_kind_domain_default_exact_value_and_a_sentence() {
        let controls = controls("splat");
        let of = |name: &str| row(controls.iter().find(|c| c.param.name == name).expect(name)).1;
        assert!(of("cutoff").starts_with("live 1.0..4.0 [3.33]  An opaque splat"), "{}", of("cutoff"));
        let target = of("target");
        assert!(target.starts_with("const rgba8|rgba16f|rgba32f [rgba32f]  Half floats"), "{target}");
        let covariance = of("covariance");
        assert!(covariance.starts_with("const half|six|factored [six, exact: factored]  "), "{covariance}");
    }

    #[test]
    fn parameters_stand_under_the_title_of_their_part_and_in_json_with_it() {
        let controls = controls("splat");
        let text = listed(&controls);
        let at = |needle: &str| text.find(needle).unwrap_or_else(|| panic!("no {needle} in\n{text}"));
        assert!(at("\n  cutoff") < at("\n scene:") && at("\n scene:") < at("\n  sh_degree"));
        let json: Vec<Value> = controls.iter().map(as_json).collect();
        let degree = json.iter().find(|p| p["name"] == "sh_degree").expect("a parameter");
        assert_eq!(
            (&degree["part"], &degree["kind"], &degree["exact"]),
            (&json!("scene"), &json!("const"), &json!(3))
        );
        assert_eq!(degree["reason"]["expression"], "scene.sh_degree");
    }
}
