//! Tests the diagnostics of graphs with mistakes, as users read them: `golden/in/*.ron` to `golden/out/*.snap`.
//!
//! An input contains many small graphs. A line `//// title` starts each. These lines can follow the title:
//!
//! - `// set: name=value` and `// fact: name=value` change a parameter or a fact;
//! - `// show: effects` shows the effects of parameters in a valid graph;
//! - `// output: NAME` requests an output;
//! - `// without: FEATURE` removes a device feature;
//! - `// graph: name` builds a file other than this one.
//!
//! `//// file: path` starts an additional file of the section. The folders `in/pipelines` and `in/shaders` are
//! available to all sections.
//!
//! After a change of messages, regenerate the outputs and review the diff:
//!
//! ```sh
//! INSTA_UPDATE=always cargo test -p splatgraph-framework --test golden
//! git diff framework/tests/golden/out
//! ```

mod worker;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use splatgraph_framework::build;
use splatgraph_framework::ir::{
    Attribute, Catalog, DeviceFacts, Facts, Family, Features, HostBuffer, Param, Request, Value,
};
use splatgraph_framework::shader::{Glslang, Limits};
use splatgraph_framework::source::{Diagnostic, Library, SourceMap, render, render_warnings};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() { found.extend(files_in(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn shared_files() -> BTreeMap<String, String> {
    let root = folder("tests/golden/in");
    let shared = ["pipelines", "shaders"].map(|name| files_in(&root.join(name))).concat();
    let name = |path: &PathBuf| path.strip_prefix(&root).expect("inside").display().to_string();
    shared.iter().map(|path| (name(path), read(path))).collect()
}

fn catalog() -> Catalog {
    let attribute = |stride, planes| Attribute { stride, count: 1000, planes };
    let attributes = [("scene.position", (12, 1)), ("scene.sh", (16, 12)), ("scene.index", (4, 1))];
    let family = Family { any: None, help: "--property NAME loads a property of a PLY file".into() };
    Catalog {
        attributes: attributes
            .map(|(name, (stride, planes))| (name.into(), attribute(stride, planes)))
            .into(),
        uniforms: [("frame.camera".into(), 256)].into(),
        buffers: [("frame.words".into(), HostBuffer { stride: 4, least: 64 })].into(),
        families: [("scene.property.".into(), family)].into(),
    }
}

fn printed(name: &str, section: &str, shared: &BTreeMap<String, String>, compiler: &mut Glslang) -> String {
    let host = [("scene.count", 1000), ("viewport.width", 64), ("viewport.height", 32)]
        .map(|(name, value)| (name.to_string(), Value::Int(value)));
    let device = DeviceFacts {
        max_storage_bytes: u64::MAX,
        shared_bytes: u32::MAX,
        max_invocations: u32::MAX,
        ..DeviceFacts::typical(8)
    };
    let mut facts = Facts { host: host.into(), ..device.into() };
    let (mut graph, mut set, mut effects) = (name.to_string(), Vec::new(), false);
    let mut memory = shared.clone();
    for (number, file) in section.split("//// file: ").enumerate() {
        let (path, text) = if number == 0 { (name, file) } else { file.split_once('\n').expect("a text") };
        let directives = text.lines().take_while(|line| line.starts_with("// "));
        for line in directives.filter(|_| number == 0) {
            let pair = |text: &str| {
                let (name, value) = text.split_once('=').expect("name=value");
                (name.to_string(), value.to_string())
            };
            match line.split_once(": ") {
                Some(("// set", text)) => set.push(pair(text)),
                Some(("// graph", text)) => graph = text.to_string(),
                Some(("// show", "effects")) => effects = true,
                Some(("// output", name)) => {
                    facts.host.insert(format!("outputs.{name}"), Value::Bool(true));
                }
                Some(("// without", text)) => {
                    facts.device.features.remove(Features::from_name(text).expect("a feature"));
                }
                Some(("// fact", text)) => {
                    let (name, value) = pair(text);
                    let value: u32 = value.parse().expect("an integer");
                    match name.as_str() {
                        "device.max_storage_bytes" => facts.device.max_storage_bytes = value.into(),
                        "device.shared_bytes" => facts.device.shared_bytes = value,
                        "device.max_push_bytes" => facts.device.max_push_bytes = value,
                        "device.max_targets" => facts.device.max_targets = value,
                        "device.max_invocations" => facts.device.max_invocations = value,
                        _ => drop(facts.host.insert(name, Value::Int(value.into()))),
                    }
                }
                _ => panic!("{name}: {line}"),
            }
        }
        memory.insert(path.to_string(), text.trim_end().to_string());
    }
    let mut files = SourceMap::new(Library { memory, ..Library::default() });
    let catalog = catalog();
    let request = Request { set: &set, ..Request::new(&graph, &facts, &catalog) };
    match build(&request, &mut files, compiler) {
        Ok(plan) if !plan.warnings.is_empty() => {
            let found: Vec<Diagnostic> =
                plan.warnings.into_iter().map(|warning| warning.diagnostic).collect();
            render_warnings(&files, &found, false)
        }
        Ok(plan) if effects => {
            let text = |param: &Param| plan.effect_text(&param.name).expect("a parameter");
            plan.params.iter().map(|param| text(param) + "\n").collect()
        }
        Ok(_) => panic!("no mistake is found in\n{section}"),
        Err(diagnostics) => render(&files, &diagnostics, false),
    }
}

static OUTPUTS: LazyLock<BTreeMap<String, String>> = LazyLock::new(outputs);

fn outputs() -> BTreeMap<String, String> {
    let shared = shared_files();
    let inputs =
        fs::read_dir(folder("tests/golden/in")).expect("the inputs").map(|e| e.expect("an entry").path());
    let output = |path: PathBuf| {
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        let text = read(&path);
        let sections = text.strip_prefix("//// ").expect("a title").split("\n//// ");
        // A line `//// file:` starts an additional file, not a section.
        let mut joined: Vec<String> = Vec::new();
        for part in sections {
            match joined.last_mut().filter(|_| part.starts_with("file: ")) {
                Some(section) => *section += &format!("\n//// {part}"),
                None => joined.push(part.to_string()),
            }
        }
        let mut compiler = worker::compiler(Limits::default());
        let shown = joined.iter().map(|section| {
            let (title, text) = section.split_once('\n').unwrap_or((section, ""));
            format!("//// {title}\n\n{}", printed(&name, text, &shared, &mut compiler))
        });
        (name.trim_end_matches(".ron").to_string(), shown.collect::<Vec<_>>().join("\n"))
    };
    inputs.filter(|path| path.is_file()).map(output).collect()
}

#[test]
fn every_mistake_is_described_as_its_golden_file_says() {
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("golden/out");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| {
        for (name, text) in &*OUTPUTS {
            insta::assert_snapshot!(name.as_str(), text);
        }
    });
}

/// The folders that report no mistakes in graphs.
const WITHOUT_DIAGNOSTICS: [&str; 4] = ["msl", "dump", "oracle", "reload"];

/// Messages that no golden file shows. Each entry is a source file or folder, or a source file and the start of a
/// message.
const NOT_SHOWN: &[&str] = &[
    // Outputs are requested by facts, not in the file; tested in lower/tests/mod.rs.
    "lower/results.rs: this graph has no output `{name}`",
    "lower/results.rs: outputs only its picture",
    "lower/results.rs: outputs {} besides its picture",
    // No file of the golden tests is built in; tested in tests/mistakes.rs.
    "lower/declared.rs: {path} takes precedence over the built-in `{graph}`",
    // Parts of glslang's log and of generated texts: no messages for users.
    "lower/params.rs: layout(offset = ",
    "lower/params.rs: // ",
    "shader/compile/generate.rs: #define ",
    "shader/compile/generate.rs: ERROR: {",
    "shader/compile/log.rs: INTERNAL ERROR: ",
    "shader/compile/log.rs: UNKNOWN ERROR: ",
    "shader/compile/log.rs: ' : ",
    "shader/compile/log.rs: compilation terminated",
    "shader/compile/log.rs: No code generated.",
    "shader/compile/log.rs: Linking {stage} stage: ",
    "shader/compile/log.rs: Recursion detected",
    "shader/compile/log.rs: preprocessor evaluation",
    "shader/compile/log.rs: memory exhausted",
    "shader/compile/log.rs: , unexpected ",
    "shader/compile/log.rs: , expecting ",
    "shader/compile/log.rs: end of file",
    // The dump shows why a pass is culled, which is no mistake.
    "lower/conditions.rs: its condition",
    "lower/conditions.rs: the count of its repeat",
    // Errors of files on disk; tested in source/tests/files.rs.
    "source/files.rs: the {} `{}` cannot be used",
    "source/files.rs: (looked for {})",
    "source/files.rs: <unknown file>",
    "source/content.rs",
    // Searched for in messages.
    "source/errors.rs: any device",
    "source/files.rs: is {what}, not a file",
    "source/files.rs: leads to {}, which ",
    "source/files.rs: {link}is outside the graph's folder",
    "source/files.rs: is larger than {} MiB",
    "source/files.rs: cannot be read ({error})",
    "source/files.rs: is not UTF-8 text",
    "source/files.rs: the first invalid byte",
    "source/files.rs: the file is used here",
    // RON that the outline rejects before the `ron` crate, and RON types that the schema does not use; tested in
    // source/tests.
    "source/outline.rs: an opening bracket",
    "source/outline.rs: names and values are written in",
    "source/outline.rs: expected {what}, found the end of the file",
    "source/outline.rs: the file ends here",
    "source/ron_error.rs: the file is nested too deeply",
    "source/ron_error.rs: there are no {what} here",
    "source/ron_error.rs: the only one is `{only}`",
    "source/token.rs: the string ends here",
    // Limits that need long texts or a long time to reach; tested in shader/compile/tests.
    "shader/compile/sources.rs: expected at most",
    "shader/compile/sources.rs: the limit is exceeded",
    "shader/compile/log.rs: the included files together",
    "shader/compile/log.rs: expected less nesting",
    "shader/compile/log.rs: each `else if` is nested",
    // Needs a hundred errors; tested in source/tests/diagnostic.rs.
    "source/render.rs: {} more, not shown",
    // No known shader causes these.
    "shader/compile/log.rs: the include of `{}` cannot be parsed",
    "shader/compile/mod.rs: ERROR: cannot start a thread",
    "shader/compile/generate.rs: ERROR: glslang does not start",
    "shader/compile/generate.rs: ERROR: the shader compiles to more than",
    // Texts about plans, not about mistakes.
    "ir/access.rs",
    // Errors of the compiler's process; tested in shader/compile/tests.
    "shader/compile/serve.rs",
    "shader/compile/worker.rs",
    "shader/compiler.rs: the build was cancelled",
    "shader/compile/log.rs: the shader does not compile",
    "shader/compile/log.rs: a type's name",
    "shader/compile/log.rs: a member's name",
    // Units of sizes; golden files show only some.
    "ir/resource.rs: {:.",
    // Names of device features; golden files show only some.
    "ir/features.rs",
    // Errors in SPIR-V that glslang does not generate; tested in shader/reflect/tests.rs.
    "shader/reflect/",
];

/// Collects the messages in a file's string literals: those with a space, outside of attributes, assertions, panics,
/// spans and tests.
fn sentences(tokens: TokenStream, found: &mut Vec<String>) {
    let mut tokens = tokens.into_iter().peekable();
    // True after a name such as `expect` or `assert`: the next group has no message for users.
    let mut silent = false;
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Punct(sign) if sign.as_char() == '#' => {
                tokens.next_if(|token| token.to_string() == "!");
                let attribute = tokens.next().map(|group| group.to_string()).unwrap_or_default();
                if attribute.replace(' ', "") == "[cfg(test)]" {
                    let ends = |token: &TokenTree| match token {
                        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
                        token => token.to_string() == ";",
                    };
                    tokens.by_ref().find(ends);
                }
            }
            TokenTree::Punct(_) => {}
            TokenTree::Ident(name) => {
                silent = ["expect", "panic", "unreachable", "assert", "assert_eq", "info_span"]
                    .iter()
                    .any(|n| name == n);
            }
            TokenTree::Group(group) => {
                if !std::mem::take(&mut silent) {
                    sentences(group.stream(), found);
                }
            }
            TokenTree::Literal(literal) => {
                let text = literal.to_string();
                if let Some(text) = text.strip_prefix('"').and_then(|text| text.strip_suffix('"')) {
                    let text = text.replace("\\\"", "\"").replace("\\\\", "\\");
                    let lines = text.split("\\\n").map(str::trim_start);
                    let text = lines.enumerate().fold(String::new(), |all, (i, line)| match i {
                        0 => line.to_string(),
                        _ => all + line,
                    });
                    if text.trim().contains(' ') {
                        found.push(text);
                    }
                }
            }
        }
    }
}

/// Returns true if a line contains the texts between the placeholders of a format string, in order.
fn is_in(line: &str, sentence: &str) -> bool {
    let escaped = sentence.replace("{{", "\u{1}").replace("}}", "\u{2}");
    let pieces = escaped.split('{').enumerate().map(|(i, piece)| match i {
        0 => piece,
        _ => piece.split_once('}').map_or("", |(_, rest)| rest),
    });
    let mut rest = line;
    pieces.map(|piece| piece.replace('\u{1}', "{").replace('\u{2}', "}")).all(|piece| {
        match rest.find(&piece) {
            Some(at) => {
                rest = &rest[at + piece.len()..];
                true
            }
            None => false,
        }
    })
}

#[test]
fn every_sentence_of_the_modules_that_find_mistakes_is_in_a_golden_file() {
    let lines = || OUTPUTS.values().flat_map(|text| text.lines());
    let (mut seen, mut unseen, mut excused) = (0, Vec::new(), vec![false; NOT_SHOWN.len()]);
    for path in files_in(&folder("src")) {
        let name = path.strip_prefix(folder("src")).expect("inside").display().to_string();
        let module = name.split_once('/').map_or("", |(module, _)| module);
        if module.is_empty() || WITHOUT_DIAGNOSTICS.contains(&module) || name.contains("tests") {
            continue;
        }
        let mut found = Vec::new();
        sentences(read(&path).parse().expect("Rust"), &mut found);
        for sentence in found {
            let place = format!("{name}: {sentence}");
            if lines().any(|line| is_in(line, &sentence)) {
                seen += 1;
            } else if let Some(at) = NOT_SHOWN.iter().position(|start| place.starts_with(start)) {
                excused[at] = true;
            } else {
                unseen.push(place);
            }
        }
    }
    let stale = NOT_SHOWN.iter().zip(excused).filter(|(_, excused)| !excused).map(|(start, _)| *start);
    let stale: Vec<&str> = stale.collect();
    assert!(
        unseen.is_empty() && stale.is_empty(),
        "{seen} sentences are shown, and not these {}:\n{}\nnothing is excused any more by {stale:?}",
        unseen.len(),
        unseen.join("\n"),
    );
}
