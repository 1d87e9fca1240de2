//! Runs `splatgraph dump`: writes the plan of a graph.

use super::loading;
use super::options;
use super::outcome::{Outcome, Usage, claim_graph_files};
use crate::draw::backend;
use crate::draw::facts;
use crate::draw::fit::Target;
use crate::draw::planner::Planner;
use crate::io::load::LoadOptions;
use crate::io::output::{OutputGuard, say};
use anyhow::{Context, Result};
use clap::ValueEnum;
use splatgraph_framework::dump::{self, DUMP_VERSION, Dump};
use std::path::{Path, PathBuf};

mod times;

const EXAMPLES: &str = "Examples:
  splatgraph dump splat                                    # passes, barriers and resources
  splatgraph dump splat --format html -o splat.html        # a page to click through, in any browser
  splatgraph dump digit4 --scene scene.ply --size 1920x1080
  splatgraph dump splat --set digit_bits=11 --format json
  splatgraph dump splat --request depth                    # the plan that draws this output, too
  splatgraph dump my/graph.ron --format dot | dot -Tsvg > graph.svg

A run's GPU times, on the page:
  splatgraph render scene.ply -o out.png --json=stats.json
  splatgraph dump splat --scene scene.ply --device 0 --times stats.json --format html -o splat.html

Two plans side by side:
  splatgraph dump splat --diff digit4                      # two graphs
  splatgraph dump splat --diff splat --set-b digit_bits=4  # one graph with two values of a parameter
  splatgraph dump splat --diff key16 --set cutoff=3 --format json
  splatgraph dump mine.ron -o before.json; splatgraph dump mine.ron --diff before.json   # before and after an edit

On Apple's GPUs:
  splatgraph dump digit4 --backend metal                   # encoders, fences and barriers, beside Vulkan's";

/// Show the plan of a graph: passes in order, barriers, resources
///
/// No GPU is needed. Without --device, the plan is for the least capable supported device, with subgroups of 32 lanes.
/// Without --scene, it is for a million splats with spherical harmonics of degree 3. With --diff, the differences
/// between two plans are shown. The JSON's fields are documented in docs/dump.md.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graph: the name of a built-in one (see --help), or a path
    #[arg(value_name = "NAME")]
    graph: String,
    /// Set a parameter of the graph (of both graphs, with --diff); may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Request an output of the graph besides its picture, such as `depth`; may be repeated
    #[arg(long, value_name = "NAME")]
    request: Vec<String>,
    /// Compare with the plan of this graph, or with a saved dump (b), and show what is added, removed and changed
    #[arg(long, value_name = "NAME|FILE.json", conflicts_with = "times")]
    diff: Option<String>,
    /// Set a parameter of the graph of --diff, after --set; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = options::setting, requires = "diff")]
    set_b: Vec<(String, String)>,
    /// Add GPU times: medians from a file of `splatgraph render --json`
    #[arg(long, value_name = "STATS.JSON")]
    times: Option<PathBuf>,
    /// Build the plan for this scene's facts (number of splats, degree of the harmonics)
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Build the plan for this device's limits: a part of its name, its index in `splatgraph devices`, a name listed by
    /// `splatgraph check --help`, or a file from `splatgraph devices --json`
    #[arg(long, value_name = "NAME|INDEX|FILE")]
    device: Option<String>,
    /// Size of the pictures [default: that of --times, or 960x540]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// Format [default: by the ending of --output (.json, .dot, .html, .txt), or text]
    #[arg(long, value_enum)]
    format: Option<Form>,
    /// Show how this API runs the plan
    #[arg(long, value_enum, default_value_t = Api::Vulkan, conflicts_with = "diff")]
    backend: Api,
    /// Output file [default: standard output, as for `-`]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    load: LoadOptions,
}

/// Output format of a dump.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Form {
    /// Text to read
    Text,
    /// JSON for programs, with all data of the other formats
    Json,
    /// A picture of passes and dependencies, for Graphviz
    Dot,
    /// A page with a timeline, in one file for any browser
    Html,
}

/// The API whose synchronization is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Api {
    /// Vulkan's barriers
    Vulkan,
    /// Metal's encoders, fences and barriers, beside Vulkan's barriers
    Metal,
}

pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = OutputGuard::default();
    let graphs = [Some(&args.graph), args.diff.as_ref()].into_iter().flatten();
    for graph in graphs {
        guard.input("the graph", Path::new(graph))?;
    }
    if let Some(path) = &args.scene {
        guard.scene("the scene", path)?;
    }
    if let Some(path) = &args.times {
        guard.input("the file of --times", path)?;
    }
    if let Some(path) = &args.output {
        guard.output("--output", path)?;
    }
    Ok(guard)
}

impl Args {
    fn format(&self) -> Result<Form, Usage> {
        let file = self.output.as_deref().unwrap_or(Path::new(""));
        let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
        Ok(match (self.format, extension.to_str()) {
            (Some(format), _) => format,
            (None, Some("json")) => Form::Json,
            (None, Some("dot")) => Form::Dot,
            (None, Some("html")) => Form::Html,
            (None, Some("" | "txt")) => Form::Text,
            _ => {
                return Err(Usage(format!(
                    "expected --output with the ending .json, .dot, .html or .txt, or --format, found {}; \
                     for a picture: `--format dot | dot -Tsvg`",
                    file.display()
                )));
            }
        })
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    let mut guard = guard(args)?;
    let format = args.format()?;
    if args.diff.is_some() && matches!(format, Form::Dot | Form::Html) {
        return Err(Usage("expected --format text or json with --diff; leave out one of them".into()).into());
    }
    let saved = args.diff.as_deref().filter(|name| name.ends_with(".json"));
    if saved.is_some() && !args.set_b.is_empty() {
        return Err(Usage("expected a graph for --diff with --set-b, found a saved dump".into()).into());
    }
    let saved = saved.map(saved_dump).transpose()?;
    if args.backend == Api::Metal && matches!(format, Form::Dot | Form::Html) {
        return Err(Usage(
            "expected --format text or json with --backend metal; leave out one of them".into(),
        )
        .into());
    }
    // Read the times first, because building the plan takes longer.
    let times = args.times.as_deref().map(times::load).transpose()?;
    let (scene, catalog) = loading::scene_facts(args.scene.as_deref(), &args.load)?;
    let (device, note) = match &args.device {
        Some(wanted) => (options::target(Some(wanted))?, ""),
        None => (Target::nominal(), "; --device names another"),
    };
    let note = format!("the plan is for {}{note}", device.name);
    let timed_size = times.as_ref().and_then(|times| times.size);
    let size = args.size.or(timed_size).unwrap_or(facts::DEFAULT_SIZE);
    let facts = facts::facts(&scene, &device.facts, size);
    let mut planner = Planner::default();
    planner.outputs.clone_from(&args.request);
    if let Some(other) = args.diff.as_ref().filter(|_| args.set_b.is_empty() && saved.is_none()) {
        planner.compared(&[&args.graph, other]).iter().for_each(say);
    }
    let mut dump_of = |graph: &str, set: &[(String, String)]| -> Result<Dump> {
        let plan = planner.plan(graph, set, &facts, &catalog);
        let plan = plan.map_err(|errors| errors.with_device(&note))?;
        if let Some(why) = device.exceeded(&plan) {
            say(format!("warning: {graph} does not run on {}: {why}", device.name));
        }
        let dump = backend::dump(&plan);
        Ok(if args.backend == Api::Metal { backend::add_metal_encoders(dump, &plan) } else { dump })
    };
    let mut a = dump_of(&args.graph, &args.set)?;
    let text = if let Some(other) = &args.diff {
        let b = match saved {
            Some(saved) => saved,
            None => dump_of(other, &[args.set.as_slice(), args.set_b.as_slice()].concat())?,
        };
        let diff = dump::diff(&a, &b);
        match format {
            Form::Json => format!("{:#}\n", serde_json::to_value(&diff)?),
            _ => dump::diff_text(&diff),
        }
    } else {
        if let Some(times) = times {
            let device = args.device.as_ref().map(|_| device.name.as_str());
            a = with_times(a, &times, (size, device))?;
        }
        match format {
            Form::Text => dump::encoders_text(&a).unwrap_or_else(|| dump::text(&a)),
            Form::Json => format!("{:#}\n", dump::json(&a)),
            Form::Dot => dump::dot(&a),
            Form::Html => dump::html(&a),
        }
    };
    claim_graph_files(&mut guard, &planner.wanted())?;
    options::write_text(args.output.as_deref(), &text)?;
    Ok(Outcome::Done)
}

/// Reads a dump that `dump --format json` wrote.
fn saved_dump(file: &str) -> Result<Dump> {
    let text = times::read(Path::new(file))?;
    let dump: Dump = serde_json::from_slice(&text)
        .with_context(|| format!("{file}: expected a dump in JSON (`splatgraph dump -o {file}`)"))?;
    if dump.version != DUMP_VERSION {
        anyhow::bail!(
            "{file}: expected a dump of version {DUMP_VERSION}, found one of version {}",
            dump.version
        );
    }
    Ok(dump)
}

/// Adds GPU times to a dump. Fails if no time belongs to a pass of the plan.
///
/// Warns if the times are from another graph, `size`, device or parameter value than the plan, if some times or passes
/// are unmatched, and if more than a quarter of the frame's time belongs to no pass. A device of `None`, which stands
/// for the nominal one, is not compared.
fn with_times(dump: Dump, times: &times::Times, (size, device): ((u32, u32), Option<&str>)) -> Result<Dump> {
    let (mut timed, found) = dump.with_times(&times.passes);
    timed.frame_ms = times.frame_ms;
    let missing = timed.passes.iter().filter(|p| p.gpu_ms.is_none() && !p.needs_no_time()).count();
    if found == 0 {
        anyhow::bail!("the times belong to other passes: none of them is in {}", timed.graph);
    }
    if times.pipeline != timed.graph {
        say(format!("the times are for {}, the plan is for {}", times.pipeline, timed.graph));
    }
    if missing > 0 || found < times.passes.len() {
        say(format!(
            "{missing} passes have no time, and {} times have no pass: the file may be from another device or for other parameters",
            times.passes.len() - found
        ));
    }
    let others = times.others(&timed, size, device);
    if !others.is_empty() {
        say(format!("the times are from another run than the plan: {}", others.join(", ")));
    }
    if let (Some(frame), Some(rest)) = (timed.frame_ms, timed.unattributed_ms())
        && rest > 0.25 * frame
    {
        say(format!(
            "{rest:.3} ms of the frame's {frame:.3} ms belong to no pass: a CPU's driver may write a pass's timestamp before \
             the pass ends, and only the time of the frame is then reliable"
        ));
    }
    Ok(timed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use serde_json::{Value, json};
    use splatgraph_framework::ir::Value::Int;

    fn dumped(folder: &Path, words: &str) -> Result<String> {
        dumped_as(folder, "out", words)
    }

    fn dumped_as(folder: &Path, name: &str, words: &str) -> Result<String> {
        let output = folder.join(name);
        let words = ["dump"].into_iter().chain(words.split(' '));
        let args: Args = parsed(words)?;
        run(&Args { output: Some(output.clone()), ..args })?;
        Ok(std::fs::read_to_string(output)?)
    }

    #[test]
    fn two_graphs_and_two_values_of_a_parameter_compare_alike() {
        let folder = tempfile::tempdir().expect("a folder");
        let compared = |words: &str| -> Value {
            let text = dumped(folder.path(), words).expect("both have plans");
            serde_json::from_str(&text).expect("JSON")
        };
        let by_name = compared("splat --diff digit4 --format json");
        let by_set = compared("splat --diff splat --set-b digit_bits=4 --format json");
        assert_eq!(by_name["passes"], by_set["passes"]);
        assert_eq!(by_name["totals"], by_set["totals"]);
        // 4 digits of 8 bits instead of 8 digits of 4 bits, with three dispatches per digit.
        assert_eq!(by_name["passes"]["only_b"].as_array().map(Vec::len), Some(12));
        let same = compared("splat --set digit_bits=4 --diff digit4 --format json");
        assert_eq!((&same["passes"]["changed"], &same["parameters"]), (&json!([]), &json!([])));
        let text = dumped(folder.path(), "splat --diff digit4").expect("both have plans");
        assert!(text.contains("only in b (12): order.sort.histogram[4..7]"), "{text}");
    }

    #[test]
    fn a_saved_dump_compares_like_its_graph() {
        let folder = tempfile::tempdir().expect("a folder");
        let saved = folder.path().join("before.json");
        let saved = saved.to_str().expect("a name");
        dumped_as(folder.path(), "before.json", "digit4").expect("it has a plan");
        let compared = |words: &str| dumped(folder.path(), words).map_err(|error| error.to_string());
        assert_eq!(compared(&format!("splat --diff {saved}")), compared("splat --diff digit4"));
        let error = compared(&format!("splat --diff {saved} --set-b digit_bits=4")).unwrap_err();
        assert!(error.contains("expected a graph for --diff with --set-b"), "{error}");
        let former =
            std::fs::read_to_string(saved).expect("JSON").replace("\"version\": 4", "\"version\": 3");
        std::fs::write(saved, former).expect("written");
        let error = compared(&format!("splat --diff {saved}")).unwrap_err();
        assert!(error.contains("expected a dump of version 4, found one of version 3"), "{error}");
        std::fs::write(saved, "{}").expect("written");
        assert!(compared(&format!("splat --diff {saved}")).unwrap_err().contains("expected a dump in JSON"));
    }

    #[test]
    fn the_ending_of_the_file_chooses_the_format_unless_it_is_given() {
        let folder = tempfile::tempdir().expect("a folder");
        let begins = |name: &str, words: &str| {
            dumped_as(folder.path(), name, words).expect("it has a plan").chars().take(9).collect::<String>()
        };
        assert_eq!(begins("a.HTML", "unsorted").to_lowercase(), "<!doctype");
        assert_eq!(begins("a.html", "unsorted --format json"), begins("a.json", "unsorted"));
        assert!(begins("a.dot", "unsorted").starts_with("digraph"));
        assert_eq!(begins("a.txt", "unsorted"), begins("a", "unsorted"));
        assert_eq!(begins("a.svg", "unsorted --format text"), begins("a", "unsorted"));
        let error = dumped_as(folder.path(), "b.svg", "unsorted").unwrap_err().to_string();
        assert!(error.contains(".html or .txt") && error.contains("dot -Tsvg"), "{error}");
        let error = dumped_as(folder.path(), "b.html", "splat --diff digit4").unwrap_err().to_string();
        assert!(error.contains("expected --format text or json with --diff"), "{error}");
    }

    #[test]
    fn times_of_a_run_are_added_to_the_plan() {
        let folder = tempfile::tempdir().expect("a folder");
        let stats = folder.path().join("stats.json");
        let camera = |ms: f64| json!({"pipeline": "splat", "passes": [{"name": "compose", "gpu_ms": ms}]});
        std::fs::write(&stats, json!([camera(1.0), camera(4.0)]).to_string()).expect("written");
        let words = format!("splat --format json --times {}", stats.display());
        let dump: Value =
            serde_json::from_str(&dumped(folder.path(), &words).expect("it has a plan")).expect("JSON");
        let pass = dump["passes"].as_array().and_then(|p| p.iter().find(|p| p["name"] == "compose"));
        assert_eq!(pass.map(|p| &p["gpu_ms"]), Some(&json!(2.5)));
        assert_eq!(dump["gpu_ms"], Value::Null, "other passes of the frame have no time");

        assert_eq!(dump["facts"]["viewport.width"], json!(960));
        let camera = json!({
            "pipeline": "splat", "width": 64, "height": 48, "device": "d", "gpu_ms": 9.0,
            "parameters": { "cutoff": 1.0, "digit_bits": 8 },
            "passes": [{"name": "compose", "gpu_ms": 1.0}],
        });
        std::fs::write(&stats, json!([camera]).to_string()).expect("written");
        let text = dumped(folder.path(), &words).expect("it has a plan");
        let dump: splatgraph_framework::dump::Dump = serde_json::from_str(&text).expect("JSON");
        assert_eq!((dump.frame_ms, &dump.facts["viewport.width"]), (Some(9.0), &Int(64)));
        let found = times::load(&stats).expect("times").others(&dump, (32, 24), Some("llvmpipe"));
        assert_eq!(found[..2], ["pictures of 64x48 instead of 32x24", "device d instead of llvmpipe"]);
        assert!(found[2..].iter().any(|other| other == "cutoff=1.0 instead of 3.33"), "{found:?}");
        assert!(times::load(&stats).expect("times").others(&dump, (64, 48), None).len() < found.len());

        let others = json!([{"pipeline": "x", "passes": [{"name": "y", "gpu_ms": 1.0}]}]);
        std::fs::write(&stats, others.to_string()).expect("written");
        let error = dumped(folder.path(), &words).unwrap_err().to_string();
        assert!(error.contains("other passes"), "{error}");
    }

    #[test]
    fn metals_encoders_stand_beside_the_barriers_of_the_same_plan() {
        let folder = tempfile::tempdir().expect("a folder");
        let text = dumped(folder.path(), "digit4 --backend metal").expect("it has a plan");
        assert!(text.contains("encoder 1 (compute)") && text.contains("barrier 2 on all memory"), "{text}");
        let json = |words: &str| -> Value {
            serde_json::from_str(&dumped(folder.path(), words).expect("it has a plan")).expect("JSON")
        };
        let (metal, mut vulkan) =
            (json("digit4 --backend metal --format json"), json("digit4 --format json"));
        assert_eq!(vulkan["encoders"], Value::Null);
        // Encoders hold all passes of a frame except the host's.
        let encoders = metal["encoders"]["frame"].as_array().into_iter().flatten();
        let encoded: usize = encoders.filter_map(|encoder| encoder["passes"].as_array()).map(Vec::len).sum();
        assert_eq!(metal["totals"]["frame_passes"], json!(encoded + 1));
        vulkan["encoders"] = metal["encoders"].clone();
        assert_eq!(metal, vulkan, "the plan is the same");
    }

    #[test]
    fn an_error_about_a_limit_names_the_device_that_has_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let graph = folder.path().join("large.ron");
        let text = r#"Graph(version: 1, summary: "", output: "image",
            resources: { "image": Image(format: "rgba8", size: (8, 8)), "big": Buffer(stride: 4, count: 50000000) },
            passes: [Dispatch(name: "paint", shader: "paint.comp", size: Groups(1), bind: { "image": "image", "Big": "big" })])"#;
        let shader = "#version 460\nlayout(local_size_x = 1) in;\n\
            layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
            layout(set = 0, binding = 1, std430) writeonly buffer Big { uint big[]; };\n\
            void main() { big[0] = 1; imageStore(image, ivec2(0), vec4(1)); }\n";
        std::fs::write(&graph, text).expect("written");
        std::fs::write(folder.path().join("paint.comp"), shader).expect("written");
        let refused = |words: &str| dumped(folder.path(), words).unwrap_err().to_string();
        let graph = graph.display();
        let nominal = "the plan is for the least capable supported device; --device names another";
        for (words, device) in
            [(format!("{graph}"), nominal), (format!("{graph} --device webgpu"), "the plan is for webgpu")]
        {
            let error = refused(&words);
            assert!(error.contains("binds at most 128") && error.ends_with(device), "{error}");
        }
        let error = refused("splat --set digit_bitz=4");
        assert!(!error.contains("the plan is for"), "{error}");
    }

    #[test]
    fn what_cannot_be_is_refused_with_a_reason() {
        let folder = tempfile::tempdir().expect("a folder");
        for (words, reason) in [
            ("splat --diff digit4 --format html", "text or json"),
            ("splat --set-b digit_bits=4", "--diff"),
            ("splat --diff digit4 --times stats.json", "--times"),
            ("splat --times no-such-file.json", "no-such-file.json"),
            ("splat --backend metal --format html", "text or json"),
            ("splat --backend metal --diff digit4", "--diff"),
            ("splat --backend null", "vulkan, metal"),
        ] {
            let error = format!("{:#}", dumped(folder.path(), words).unwrap_err());
            assert!(error.contains(reason), "{words}: {error}");
        }
    }
}
