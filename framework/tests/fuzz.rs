//! Damages the shipped graphs and shaders at random. Each must build, or fail with an error whose place can be shown.
//! After each case, the same compiler builds the undamaged file, and must give the result of a compiler that has seen
//! no damage. (It compiles an undamaged shader once, and then uses its cache.)
//!
//! Damage is accidental (bytes, lines, gaps) or malicious (numbers beyond 32 bits, brackets, macros that grow). The
//! number of a case is the seed of its damage, so a failure message is enough to reproduce it. Shaders are compiled in
//! a worker, which is this program.
//!
//! `SPLATGRAPH_LONG=1` (`./x test --long`) runs 100,000 cases of each.

mod nominal;
#[path = "../../tests/numbers.rs"]
mod numbers;
mod worker;

use numbers::Random;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use splatgraph_framework::build;
use splatgraph_framework::ir::{Request, ShaderStage};
use splatgraph_framework::shader::{Compiled, Glslang, Limits, ShaderCompiler, ShaderRequest};
use splatgraph_framework::source::{Diagnostic, Kind, Library, SourceMap, render};

/// Number of damaged files of each kind: with `SPLATGRAPH_LONG`, and without.
const CASES: (u64, u64) = (100_000, 1_500);

/// Number of cases between two progress lines.
const TOLD: u64 = 1_000;

/// Time after which a case counts as hung.
const TIME_LIMIT: Duration = Duration::from_secs(120);

/// Fragments of graphs to insert anywhere.
const RON: &[&str] = &[
    "4294967296",
    "-1",
    "1e300",
    "NaN",
    "inf",
    "\"\"",
    "\"1 << 62\"",
    "\"1 / 0\"",
    "()",
    "[",
    "]",
    "{",
    "}",
    "(",
    ")",
    ",",
    ":",
    "Repeat(var: \"r\", count: 20000, body: []),",
    "Swap(\"keys\"),",
    "\"last(keys)\"",
    "\"back(keys)\"",
    "run: Once,",
    "None",
    "when: \"false\",",
    "/*",
    "\"\\u{1b}[2J\"",
    "\u{202e}",
    "\0",
    "9223372036854775807",
    "history: true,",
];

/// Fragments of shaders to insert anywhere.
const GLSL: &[&str] = &[
    "4294967295u",
    "-1",
    "1e300",
    "double",
    "uint64_t(1)",
    "#if",
    "#endif\n",
    "#define X X X\n",
    "X",
    "/*",
    "*/",
    "{",
    "}",
    "(",
    ")",
    ";",
    "[",
    "]",
    "shared uint Out[64];\n",
    "discard;",
    "barrier();",
    "for (;;) {",
    "while (true) {}",
    "\\\n",
    "\u{e9}",
    "\0",
    "#include \"live.glsl\"\n",
    "#line 7\n",
    "#extension all : enable\n",
    "layout(constant_id = 0) const int N = 3;\n",
    "[0x7fffffff]",
    "#define A B B B B\n#define B C C C C\n#define C A\n",
    "void main() {}\n",
    "subgroupAdd(1)",
    "struct S { S s; };\n",
];

/// Damages a text at random places: bytes, lines or numbers, or an inserted entry of `pieces`.
fn damaged(text: &str, pieces: &[&str], random: &mut Random) -> String {
    let mut bytes = text.as_bytes().to_vec();
    // Mostly once, because a text that is damaged twice is rarely accepted.
    for _ in 0..1 + random.below(5) / 3 {
        let at = random.below(bytes.len() + 1);
        match random.below(10) {
            0 => bytes.truncate(at),
            1 => {
                let end = (at + 1 + random.below(40)).min(bytes.len());
                bytes.drain(at.min(end)..end);
            }
            2 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            3 if at < bytes.len() => bytes[at] = random.next() as u8,
            4 | 5 => {
                let mut lines: Vec<Vec<u8>> =
                    bytes.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
                let [one, other] = [random.below(lines.len()), random.below(lines.len())];
                if let Some(line) = lines.get(one).cloned() {
                    let times = [0, 1, 1, 2, 50][random.below(5)];
                    lines
                        .splice(other..(other + usize::from(times == 0)).min(lines.len()), vec![line; times]);
                }
                bytes = lines.concat();
            }
            6 => {
                let digits =
                    |from: usize| bytes[from..].iter().position(u8::is_ascii_digit).map(|i| from + i);
                if let Some(start) = digits(at.min(bytes.len())) {
                    let end = bytes[start..].iter().position(|b| !b.is_ascii_digit());
                    let end = end.map_or(bytes.len(), |length| start + length);
                    let number =
                        ["0", "1", "4294967296", "9223372036854775807", "65536", "31"][random.below(6)];
                    bytes.splice(start..end, number.bytes());
                }
            }
            _ => {
                let piece = pieces[random.below(pieces.len())];
                bytes.splice(at..at, piece.bytes());
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn texts(folder: &str) -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = BTreeMap::new();
    let mut folders = vec![root.join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(&root).expect("inside").display().to_string();
                found.insert(name, fs::read_to_string(&path).expect("a text"));
            }
        }
    }
    found
}

const COUNT: u32 = 1000;
const SIZE: (u32, u32) = (64, 32);

/// Returns a compiler in a separate process.
fn compiler() -> Glslang {
    // Not a lower memory limit: a worker that uses over a quarter of its limit ends after each shader.
    worker::compiler(Limits { time: Duration::from_secs(1), ..Limits::default() })
}

#[derive(Clone, Copy, Default)]
struct Counts {
    built: u64,
    errors: u64,
    crashed: u64,
    ran_out: u64,
    slowest: Duration,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Counts) {
        self.built += other.built;
        self.errors += other.errors;
        self.crashed += other.crashed;
        self.ran_out += other.ran_out;
        self.slowest = self.slowest.max(other.slowest);
    }
}

/// A case: the name and text of the damaged file, the files around it, and the result of building or compiling them.
struct Outcome<'a, T> {
    name: &'a str,
    text: &'a str,
    map: &'a SourceMap,
    result: Result<T, Vec<Diagnostic>>,
    took: Duration,
}

/// Counts a case, after checking that it was accepted, or has errors with a place that can be shown.
fn counted<T>(what: &str, case: u64, outcome: &Outcome<T>) -> Counts {
    let Outcome { name, text, map, result, took } = outcome;
    assert!(*took < TIME_LIMIT, "{what} case {case}: {name} took {took:?}\n{text}");
    let Err(found) = result else { return Counts { built: 1, slowest: *took, ..Counts::default() } };
    assert!(!found.is_empty(), "{what} case {case}: {name}: an error without a diagnostic\n{text}");
    let shown = render(map, found, false);
    for diagnostic in found {
        let (path, place) =
            (map.path(diagnostic.primary.span.file), map.line_column(diagnostic.primary.span));
        let right = !diagnostic.message.trim().is_empty()
            && path != "<unknown file>"
            && !diagnostic.message.contains("mistake of the solver");
        assert!(right, "{what} case {case}: {name}: {path}:{place:?}: {diagnostic:?}\n{text}");
    }
    let first = found[0].primary.span;
    let (path, (line, column)) = (map.path(first.file), map.line_column(first));
    let place = format!("--> {path}:{line}:{column}");
    assert!(shown.contains(&place), "{what} case {case}: {name}: it is shown without its place\n{shown}");
    assert!(
        !shown.contains(|c: char| c.is_control() && c != '\n'),
        "{what} case {case}: {name}: a control character\n{shown:?}"
    );
    Counts {
        built: 0,
        errors: 1,
        crashed: u64::from(shown.contains("the compiler crashed")),
        ran_out: u64::from(shown.contains("the compiler ran out")),
        slowest: *took,
    }
}

/// Runs the cases of one kind of file on all processors, each with its own compilers. `attempt` returns the file to
/// damage, the function that builds it, and a number that identifies this function.
fn fuzz<'a, T: Clone + PartialEq, Attempt>(
    what: &str,
    files: &BTreeMap<String, String>,
    pieces: &[&str],
    attempt: impl Fn(&mut Random) -> (&'a str, (usize, Attempt)) + Sync,
) where
    Attempt: Fn(&mut SourceMap, &mut Glslang) -> Result<T, Vec<Diagnostic>>,
{
    let long = std::env::var_os("SPLATGRAPH_LONG").is_some();
    let cases = if long { CASES.0 } else { CASES.1 };
    let next = AtomicU64::new(0);
    let work = || {
        // The second compiler gets only intact files.
        let (mut compiler, mut intact, mut counts) = (compiler(), compiler(), Counts::default());
        let mut originals: BTreeMap<usize, Result<T, Vec<Diagnostic>>> = BTreeMap::new();
        loop {
            let case = next.fetch_add(1, Relaxed);
            if case >= cases {
                return counts;
            }
            if case > 0 && case.is_multiple_of(TOLD) {
                let _ = writeln!(std::io::stderr(), "fuzz: {case} of {cases} {what}");
            }
            let mut random = Random(case);
            let (name, (number, build)) = attempt(&mut random);
            let mend = |compiler: &mut Glslang| {
                build(&mut SourceMap::new(Library { memory: files.clone(), ..Library::default() }), compiler)
            };
            let original = originals.entry(number).or_insert_with(|| {
                let original = mend(&mut intact);
                // The viewer's window needs another catalogue.
                let may_fail = name.starts_with("pipelines/view/");
                assert!(
                    original.is_ok() || may_fail,
                    "{what} case {case}: {name} has errors when it is intact"
                );
                original
            });
            let text = damaged(&files[name], pieces, &mut random);
            let mut memory = files.clone();
            memory.insert(name.into(), text.clone());
            let mut map = SourceMap::new(Library { memory, ..Library::default() });
            let begun = Instant::now();
            let result = build(&mut map, &mut compiler);
            let outcome = Outcome { name, text: &text, map: &map, result, took: begun.elapsed() };
            counts += counted(what, case, &outcome);
            assert!(
                mend(&mut compiler) == *original,
                "{what} case {case}: {name} is another once mended\n{text}"
            );
        }
    };
    let mut sum = Counts::default();
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, |count| count.get());
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        for thread in threads {
            sum += thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    let Counts { built, errors, crashed, ran_out, slowest } = sum;
    // Not `eprintln!`, whose output is hidden in tests that pass.
    let _ = writeln!(
        std::io::stderr(),
        "fuzz: {cases} {what}: {built} are accepted, {errors} are errors ({crashed} crash the compiler, {ran_out} take too much); \
         the slowest took {slowest:?}"
    );
    // Damage that breaks nothing, or everything, would test nothing.
    assert!(built > cases / 20 && errors > cases / 3, "{built} accepted, {errors} errors");
}

/// Returns true for presets, choices, and graphs with an output; false for graphs that are only included.
fn draws(text: &str) -> bool {
    let is_choice = || text.lines().any(|line| line.starts_with("Choice("));
    text.contains("output:") || text.contains("Preset(") || is_choice()
}

#[test]
fn all_shipped_graphs_that_draw_are_built_themselves() {
    let files = texts("pipelines");
    for (name, text) in files.iter().filter(|(name, _)| name.ends_with(".ron")) {
        // A choice that presets share.
        let is_shared = name == "pipelines/parts/tiles.ron";
        assert_eq!(draws(text), is_shared || !name.starts_with("pipelines/parts/"), "{name}");
    }
}

#[test]
fn damaged_graphs_are_plans_or_errors_with_a_place() {
    let mut files = texts("pipelines");
    files.extend(texts("shaders"));
    let (facts, catalog) = (&nominal::facts(COUNT, SIZE), &nominal::catalog(COUNT));
    let names: Vec<&str> = files.keys().map(String::as_str).filter(|name| name.ends_with(".ron")).collect();
    fuzz("graphs", &files, RON, |random| {
        let number = random.below(names.len());
        let name = names[number];
        let build = move |map: &mut SourceMap, compiler: &mut Glslang| {
            // For a part, `splat` is built, which may include the damaged file.
            let own = map.find(None, name, Kind::Graph).map(|file| map.text(file).to_string());
            let graph = if own.is_ok_and(|text| draws(&text)) { name } else { "pipelines/splat.ron" };
            let request = Request::new(graph, facts, catalog);
            build(&request, map, compiler)
        };
        (name, (number, build))
    });
}

#[derive(Clone, PartialEq)]
struct Compilation {
    file: String,
    stage: ShaderStage,
    defines: Vec<(String, String)>,
    live_glsl: Option<String>,
}

struct Recorder {
    compiler: Glslang,
    seen: Vec<Compilation>,
}

impl ShaderCompiler for Recorder {
    fn compile(
        &mut self,
        files: &mut SourceMap,
        request: &ShaderRequest,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let compilation = Compilation {
            file: files.path(request.file).to_string(),
            stage: request.stage,
            defines: request.defines.to_vec(),
            live_glsl: request.live_glsl.map(|file| files.text(file).into()),
        };
        if !self.seen.contains(&compilation) {
            self.seen.push(compilation);
        }
        self.compiler.compile(files, request)
    }
}

fn compilations() -> Vec<Compilation> {
    let (facts, catalog) = (nominal::facts(COUNT, SIZE), nominal::catalog(COUNT));
    let mut memory = texts("pipelines");
    memory.extend(texts("shaders"));
    let mut recorder = Recorder { compiler: compiler(), seen: Vec::new() };
    let mut map = SourceMap::new(Library { memory: memory.clone(), ..Library::default() });
    for graph in
        memory.iter().filter(|(name, text)| name.ends_with(".ron") && draws(text)).map(|(name, _)| name)
    {
        // The viewer's window needs its own catalogue.
        if graph.starts_with("pipelines/view/") {
            continue;
        }
        let request = Request::new(graph, &facts, &catalog);
        let built = build(&request, &mut map, &mut recorder);
        built.unwrap_or_else(|errors| panic!("{graph}: {}", render(&map, &errors, false)));
    }
    recorder.seen
}

#[test]
fn damaged_shaders_are_compiled_or_errors_with_a_place() {
    let files = texts("shaders");
    let compilations = compilations();
    // The files that a shader includes directly.
    let includes = |file: &str| -> Vec<&str> {
        let text = &files[file];
        let names = files.keys().filter(|name| name.ends_with(".glsl"));
        let named = |name: &&String| text.contains(&format!("{}\"", name.rsplit('/').next().unwrap_or(name)));
        names.filter(named).map(String::as_str).collect()
    };
    fuzz("shaders", &files, GLSL, |random| {
        let number = random.below(compilations.len());
        let Compilation { file, stage, defines, live_glsl } = &compilations[number];
        let included = if random.below(4) == 0 { includes(file) } else { Vec::new() };
        let name = if included.is_empty() { file.as_str() } else { included[random.below(included.len())] };
        let build = move |map: &mut SourceMap, compiler: &mut Glslang| {
            let file = map.find(None, file, Kind::Shader).map_err(|_| Vec::new())?;
            let live_glsl = live_glsl.as_ref().map(|text| map.add("live.glsl", text));
            let request = ShaderRequest { file, stage: *stage, defines, unfit: &[], live_glsl };
            compiler.compile(map, &request).map(|compiled| compiled.spirv)
        };
        (name, (number, build))
    });
}
