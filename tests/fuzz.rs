//! Every shipped graph and shader, broken at random as if it were being edited. No file contents may crash or hang the
//! program. Once the file is mended, the plan must be the original one.
//!
//! The setup is the live program's: files on disk, a [`Rebuilder`] with the real compiler, and [`LastGood`]. Broken
//! shaders that compile are not executed.

use splatgraph::draw::builtin;
use splatgraph::draw::facts;
use splatgraph_framework::build;
use splatgraph_framework::ir::{Catalog, Facts, OUTPUTS, Request, Value};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::reload::{Content, LastGood, Rebuilder};
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::{Diagnostic, SourceMap, render};
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::common::{self, long};
use crate::numbers::Random;

/// Number of broken files: in a long run, and by default.
const CASES: (usize, usize) = (10_000, 600);

const TIME_LIMIT: Duration = Duration::from_secs(120);

impl Random {
    /// Returns a byte, mostly a character that graphs and shaders use.
    fn byte(&mut self) -> u8 {
        const LIKELY: &[u8] = b"(){}[]<>;,.:\"'#/*+-=!&|%~?\\_ \n\t0123456789abxuifeABXU";
        if self.below(4) > 0 { LIKELY[self.below(LIKELY.len())] } else { self.next() as u8 }
    }
}

/// Damages a file as an editor or an accident might. Returns the kind of damage, and the damaged file.
pub fn damaged(text: &[u8], random: &mut Random) -> (&'static str, Vec<u8>) {
    let mut bytes = text.to_vec();
    let mut lines: Vec<&[u8]> = text.split_inclusive(|byte| *byte == b'\n').collect();
    let [one, other] = [random.below(lines.len()), random.below(lines.len())];
    let what = match random.below(11) {
        0 | 1 => {
            bytes.truncate(random.below(text.len()));
            "cut off"
        }
        2 => {
            // Emptied only half of the time: each file has only one emptied version.
            if random.below(2) == 0 {
                bytes.clear();
                "emptied"
            } else {
                bytes.drain(..random.below(text.len()));
                "without its start"
            }
        }
        3 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
            "with flipped bits"
        }
        4 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] = random.byte();
            }
            "with other bytes"
        }
        5 => {
            for _ in 0..=random.below(4) {
                let at = random.below(bytes.len());
                bytes.insert(at, random.byte());
            }
            "with more bytes"
        }
        6 => {
            let start = random.below(bytes.len());
            let end = (start + 1 + random.below(40)).min(bytes.len());
            bytes.drain(start..end);
            "with a gap"
        }
        7 => {
            lines.swap(one, other);
            bytes = lines.concat();
            "with two lines swapped"
        }
        8 => {
            let times = [1, 1, 1, 2, 100][random.below(5)];
            lines.splice(other..other, std::iter::repeat_n(lines[one], times).collect::<Vec<_>>());
            bytes = lines.concat();
            "with a line repeated"
        }
        9 => {
            lines.remove(one);
            bytes = lines.concat();
            "without a line"
        }
        _ => {
            const BAD: [&[u8]; 5] = [b"\xff", b"\xc3\x28", b"\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80"];
            let (at, bad) = (random.below(bytes.len()), BAD[random.below(BAD.len())]);
            bytes.splice(at..at, bad.iter().copied());
            "that is no UTF-8"
        }
    };
    (what, bytes)
}

#[derive(Clone, Debug)]
struct Build {
    graph: String,
    set: Vec<(String, String)>,
    /// An output requested besides the picture, by name.
    output: Option<&'static str>,
    lanes: u32,
}

/// Returns builds that together read every shipped file.
fn builds() -> Vec<Build> {
    let plain = |lanes, graph: &str| Build { graph: graph.into(), set: vec![], output: None, lanes };
    let all = |lanes| common::graphs().into_iter().map(move |graph| plain(lanes, graph));
    let lanes = facts::USUAL_SUBGROUP_SIZE;
    let with = |graph, set: &[_]| Build { set: common::settings(set), ..plain(lanes, graph) };
    let forms = [
        ("sorter", "serial"),
        ("covariance", "factored"),
        ("sh_storage", "q8"),
        ("position_storage", "fixed16"),
        ("key_map", "equalised"),
    ];
    let more = [
        with("splat", &forms),
        with("splat", &[("storage", "b64")]),
        with("tiled", &[("show", "lists")]),
        with("tiled", &[("sorter", "sweep")]),
        with("tiled", &[("sorted", "splats")]),
        with("filters/edges", &[]),
        Build { output: Some("normal"), ..with("tiled", &[]) },
    ];
    all(lanes).chain(all(4)).chain(more).collect()
}

/// The outcome of a build: the plan, or the diagnostics, each with its rendering.
struct Outcome {
    built: Result<Plan, Vec<(Diagnostic, String)>>,
    /// A defect of the diagnostics themselves; `None` if there is none.
    unclear: Option<String>,
    read: Vec<PathBuf>,
}

/// Returns a builder like the live program's, with a persistent compiler.
fn builder(folder: PathBuf) -> impl FnMut(Build) -> Outcome {
    let mut compiler = Glslang::in_worker(common::worker());
    let catalog = common::catalog();
    move |job| {
        let mut facts = common::facts_of(&facts::portable_device(job.lanes));
        facts.host.extend(job.output.map(|name| (format!("{OUTPUTS}{name}"), Value::Bool(true))));
        let mut files = builtin::source_map();
        let built = plan(&folder, &job, &facts, &catalog, &mut files, &mut compiler);
        let unclear = built.as_ref().err().and_then(|found| unclear(&files, found));
        let wanted = files.wanted().into_iter();
        Outcome {
            built: built.map_err(|found| {
                found.into_iter().map(|d| (d.clone(), render(&files, &[d], false))).collect()
            }),
            unclear,
            read: wanted.filter(|w| matches!(w.content, Content::Bytes { .. })).map(|w| w.path).collect(),
        }
    }
}

fn plan(
    folder: &std::path::Path,
    job: &Build,
    facts: &Facts,
    catalog: &Catalog,
    files: &mut SourceMap,
    compiler: &mut Glslang,
) -> Result<Plan, Vec<Diagnostic>> {
    let graph = folder.join(format!("pipelines/{}.ron", job.graph));
    let graph = graph.to_str().expect("temporary folders have plain names");
    build(
        &Request { graph, set: &job.set, capacities: &[], facts, catalog, share_memory: true },
        files,
        compiler,
    )
}

/// Returns why a diagnostic would not help the user: no text, no place, or an internal error. `None` if all would help.
fn unclear(files: &SourceMap, found: &[Diagnostic]) -> Option<String> {
    if found.is_empty() {
        return Some("an error without a diagnostic".into());
    }
    for diagnostic in found {
        let span = diagnostic.primary.span;
        let (path, text) = (files.path(span.file), files.text(span.file));
        let shown = render(files, std::slice::from_ref(diagnostic), false);
        let (line, column) = files.line_column(span);
        let why = if diagnostic.message.trim().is_empty() {
            "says nothing"
        } else if path == "<unknown file>" || span.start > span.end || span.end > text.len() {
            "is about no place"
        } else if !shown.contains(&format!("--> {path}:{line}:{column}")) {
            "is shown without its place"
        } else if diagnostic.message.contains("mistake of the solver") {
            "is our own fault"
        } else {
            continue;
        };
        return Some(format!("a diagnostic {why} ({path}:{line}:{column}): {diagnostic:?}\n{shown}"));
    }
    None
}

/// A copy of all shipped files, and the thread that builds graphs from it.
struct Workshop {
    folder: tempfile::TempDir,
    rebuilder: Rebuilder<Build, Outcome>,
    wakes: Receiver<()>,
}

impl Workshop {
    fn open() -> Workshop {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path().to_path_buf();
        let (sender, wakes) = channel();
        let rebuilder = Rebuilder::new(
            move |_| builder(root.clone()),
            move || {
                let _ = sender.send(());
            },
        );
        let workshop = Workshop { folder, rebuilder: rebuilder.expect("a thread"), wakes };
        for (path, text) in builtin::FILES {
            let path = workshop.folder.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
            fs::write(path, text).expect("written");
        }
        workshop
    }

    fn build(&self, job: &Build) -> Result<Outcome, String> {
        self.rebuilder.submit(job.clone());
        if self.wakes.recv_timeout(TIME_LIMIT).is_err() {
            return Err("the build hangs".into());
        }
        self.rebuilder.poll().ok_or("there is no output")?.map_err(|panicked| panicked.to_string())
    }
}

/// The plan of each build from intact files, and for each file the indices of the builds that read it.
struct Truth {
    plans: Vec<Plan>,
    readers: BTreeMap<&'static str, Vec<usize>>,
}

impl Truth {
    fn of(workshop: &Workshop, builds: &[Build]) -> Truth {
        let mut truth = Truth { plans: Vec::new(), readers: BTreeMap::new() };
        for (index, job) in builds.iter().enumerate() {
            let outcome = workshop.build(job).expect("a build of a sound graph");
            let plan = outcome.built.unwrap_or_else(|found| panic!("{job:?}:\n{}", found[0].1));
            truth.plans.push(plan);
            for (path, _) in builtin::FILES {
                let on_disk = workshop.folder.path().join(path);
                let on_disk = on_disk.canonicalize().expect("a file");
                if outcome.read.iter().any(|read| read.canonicalize().is_ok_and(|read| read == on_disk)) {
                    truth.readers.entry(path).or_default().push(index);
                }
            }
        }
        let missed: Vec<&str> = builtin::FILES
            .iter()
            .map(|(path, _)| *path)
            .filter(|path| !truth.readers.contains_key(path))
            .collect();
        assert!(missed.is_empty(), "no build reads {missed:?}");
        truth
    }
}

#[derive(Default)]
struct Counts {
    errors: AtomicUsize,
    diagnostics: AtomicUsize,
    built: AtomicUsize,
    same: AtomicUsize,
    crashed: AtomicUsize,
    slowest_ms: AtomicUsize,
}

/// Breaks one file, builds, mends the file and builds again; returns an error if a check fails.
fn case(
    number: usize,
    workshop: &Workshop,
    builds: &[Build],
    truth: &Truth,
    counts: &Counts,
) -> Result<(), String> {
    let (file, text) = builtin::FILES[number % builtin::FILES.len()];
    let mut random = Random(number as u64);
    let readers = &truth.readers[file];
    let index = readers[random.below(readers.len())];
    let (job, sound) = (&builds[index], &truth.plans[index]);
    let (what, broken) = damaged(text.as_bytes(), &mut random);
    let path = workshop.folder.path().join(file);
    let failed = |why: String| {
        format!("case {number}, {job:?}, {file} {what}: {why}\n---\n{}", String::from_utf8_lossy(&broken))
    };

    let now = Instant::now();
    let mut shown: LastGood<Plan, String> = LastGood::new();
    let first = shown.asked(now);
    shown.succeeded(first, sound.clone());

    fs::write(&path, &broken).expect("written");
    let attempt = shown.changed(now);
    let outcome = workshop.build(job).map_err(failed)?;
    counts.slowest_ms.fetch_max(now.elapsed().as_millis() as usize, Relaxed);
    if let Some(unclear) = outcome.unclear {
        return Err(failed(unclear));
    }
    match outcome.built {
        Ok(plan) => {
            counts.built.fetch_add(1, Relaxed);
            counts.same.fetch_add((plan == *sound).into(), Relaxed);
            shown.succeeded(attempt, plan);
        }
        Err(found) => {
            counts.errors.fetch_add(1, Relaxed);
            counts.diagnostics.fetch_add(found.len(), Relaxed);
            let text: String = found.iter().map(|(_, text)| text.as_str()).collect();
            counts.crashed.fetch_add(text.contains("crash").into(), Relaxed);
            shown.failed(attempt, text);
            if shown.good() != Some(sound) || shown.error(now + TIME_LIMIT).is_none() {
                return Err(failed("the error is not shown beside the last good plan".into()));
            }
        }
    }

    fs::write(&path, text).expect("written");
    let attempt = shown.changed(now);
    match workshop.build(job).map_err(failed)?.built {
        Ok(plan) => shown.succeeded(attempt, plan),
        Err(found) => return Err(failed(format!("the mended file has errors:\n{}", found[0].1))),
    };
    if shown.good() != Some(sound) {
        return Err(failed("the mended file gives another plan".into()));
    }
    match shown.error(now + TIME_LIMIT) {
        Some(error) => Err(failed(format!("the error is still shown:\n{error}"))),
        None => Ok(()),
    }
}

#[test]
fn whatever_a_file_holds_it_is_an_error_with_a_place_or_a_plan_and_mending_it_brings_the_plan_back() {
    let begun = Instant::now();
    let cases = if long() { CASES.0 } else { CASES.1 };
    let builds = builds();
    let (next, counts, failure) = (AtomicUsize::new(0), Counts::default(), Mutex::new(None::<String>));
    let work = || {
        let workshop = Workshop::open();
        // One per thread: plans contain the paths of the thread's files.
        let truth = Truth::of(&workshop, &builds);
        loop {
            let number = next.fetch_add(1, Relaxed);
            if number >= cases || failure.lock().is_ok_and(|failure| failure.is_some()) {
                return;
            }
            if let Err(text) = case(number, &workshop, &builds, &truth, &counts) {
                if let Ok(mut failure) = failure.lock() {
                    failure.get_or_insert(text);
                }
                return;
            }
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, |count| count.get());
        (0..threads).for_each(|_| drop(scope.spawn(work)));
    });
    if let Ok(Some(text)) = failure.into_inner() {
        panic!("{text}");
    }
    let [errors, diagnostics, built, same, crashed, slowest] = [
        &counts.errors,
        &counts.diagnostics,
        &counts.built,
        &counts.same,
        &counts.crashed,
        &counts.slowest_ms,
    ]
    .map(|count| count.load(Relaxed));
    common::say(&format!(
        "fuzz: {cases} broken files: {errors} errors ({diagnostics} diagnostics, {crashed} of a crash of the compiler), \
         {built} built anyway ({same} to the same plan); the slowest took {slowest} ms, all {:.0} s",
        begun.elapsed().as_secs_f64()
    ));
    assert_eq!(errors + built, cases);
    // If nearly all damage were harmless, or nearly all fatal, the test would prove little.
    assert!(errors > cases / 2 && built > cases / 50, "{errors} errors, {built} built");
}
