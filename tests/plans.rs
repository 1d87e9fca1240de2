//! The plan of every built-in graph, with subgroups of 4, 8, 32 and 64 lanes. It is the text of `splatgraph dump`
//! without the reasons for the values of parameters and the files of shaders.
//!
//! The texts are in `tests/plans/*.snap`; widths with equal plans share one. After an intended change of plans:
//!
//! ```sh
//! INSTA_UPDATE=always cargo test -p splatgraph --test end_to_end plans::every_built_in
//! git diff tests/plans
//! ```

use crate::common;
use splatgraph::draw::backend;
use splatgraph::draw::builtin;
use splatgraph::draw::facts;
use splatgraph::draw::planner::Planner;
use splatgraph_framework::ir::{OUTPUTS, Request, Value};
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::render;
use splatgraph_framework::{build, dump};
use std::collections::BTreeSet;

#[test]
fn every_built_in_graph_has_the_plan_of_its_snapshot_at_every_width_of_subgroups() {
    // One planner for all: graphs share most of their shaders.
    let mut planner = Planner::default();
    let catalog = common::catalog();
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("plans");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    for graph in common::graphs() {
        let mut texts: Vec<(String, String)> = Vec::new();
        for lanes in [4, 8, 32, 64] {
            let facts = common::facts_of(&facts::portable_device(lanes));
            let plan = planner.plan(graph, &[], &facts, &catalog);
            let mut dump = backend::dump(&plan.unwrap_or_else(|error| panic!("{graph}: {error}")));
            // Reasons mention the width, which would make equal plans differ.
            dump.parameters.iter_mut().for_each(|parameter| parameter.reason = None);
            // Each pass names its shaders, which all come from one folder.
            dump.passes.iter_mut().flat_map(|pass| &mut pass.shaders).for_each(|shader| shader.path.clear());
            let text = dump::text(&dump);
            match texts.iter_mut().find(|(_, other)| *other == text) {
                Some((widths, _)) => *widths += &format!(", {lanes}"),
                None => texts.push((lanes.to_string(), text)),
            }
        }
        let shown = texts.iter().map(|(widths, text)| format!("==== {widths} lanes ====\n\n{text}"));
        let shown = shown.collect::<Vec<_>>().join("\n");
        settings.bind(|| insta::assert_snapshot!(graph.replace('/', "_"), shown));
    }
}

#[test]
fn every_shipped_file_is_read_by_a_build() {
    const FORMS: &[(&str, &str)] = &[
        ("sorter", "serial"),
        ("covariance", "factored"),
        ("sh_storage", "q8"),
        ("position_storage", "fixed16"),
        ("key_map", "equalised"),
    ];
    let lanes = facts::USUAL_SUBGROUP_SIZE;
    let plain =
        common::graphs().into_iter().flat_map(|graph| [4, lanes].map(|lanes| (graph, lanes, &[][..])));
    let varied: [(&str, &[(&str, &str)]); 6] = [
        ("splat", FORMS),
        ("splat", &[("storage", "b64")]),
        ("tiled", &[("show", "lists")]),
        ("tiled", &[("sorter", "sweep")]),
        ("tiled", &[("sorted", "splats")]),
        ("filters/edges", &[]),
    ];
    let varied = varied.map(|(graph, set)| (graph, lanes, set));
    let builds = plain.chain(varied).map(|(graph, lanes, set)| (graph, lanes, set, false));
    let (catalog, mut compiler) = (common::catalog(), Glslang::new());
    let mut read: BTreeSet<String> = BTreeSet::new();
    for (graph, lanes, set, has_normals) in builds.chain([("tiled", lanes, &[][..], true)]) {
        let mut facts = common::facts_of(&facts::portable_device(lanes));
        facts.host.insert(format!("{OUTPUTS}normal"), Value::Bool(has_normals));
        let (mut files, set) = (builtin::source_map(), common::settings(set));
        let request = Request { set: &set, ..Request::new(graph, &facts, &catalog) };
        if let Err(errors) = build(&request, &mut files, &mut compiler) {
            panic!("{graph}, {set:?}: {}", render(&files, &errors, false));
        }
        read.extend(files.opened().map(|(_, path, _)| path.to_owned()));
    }
    let mut missed = builtin::FILES.iter().map(|(path, _)| *path).filter(|path| !read.contains(*path));
    assert_eq!(missed.next(), None, "no build reads it");
}
