//! Tests with real files. Nothing is timed: a wait ends with the change, or fails after a minute. To check that no
//! change is reported, a test saves another file afterwards; only that one may be reported.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::source::{Kind, Library, SourceMap};

const LONG: Duration = Duration::from_secs(60);

/// The real delays, except that a missing file is reported only after a minute: a slow machine may take long to replace
/// a file.
const REAL: Patience = Patience { gone: LONG, ..PATIENCE };

struct Desk {
    root: tempfile::TempDir,
    watcher: Watcher,
    wakes: Receiver<()>,
    wanted: Vec<PathBuf>,
    content: fn(&Path) -> Content,
}

impl Desk {
    fn new(files: &[(&str, &str)]) -> Desk {
        Desk::with(REAL, files)
    }

    fn with(patience: Patience, files: &[(&str, &str)]) -> Desk {
        let (sender, wakes) = channel();
        let watcher = Watcher::start(patience, move || _ = sender.send(())).expect("a watcher");
        let root = tempfile::tempdir().expect("a folder");
        let mut desk = Desk { root, watcher, wakes, wanted: Vec::new(), content: patience.content };
        for (name, text) in files {
            desk.save(name, text);
        }
        desk.want(&files.iter().map(|(name, _)| *name).collect::<Vec<_>>());
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    fn save(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
        fs::write(path, text).expect("saved");
    }

    fn want(&mut self, names: &[&str]) {
        self.wanted = names.iter().map(|name| self.path(name)).collect();
        self.built();
    }

    /// Records everything as just built.
    fn built(&mut self) -> Vec<Wanted> {
        let read = |path: &PathBuf| Wanted { path: path.clone(), content: (self.content)(path) };
        let wanted: Vec<Wanted> = self.wanted.iter().map(read).collect();
        self.watcher.watch(&wanted);
        // Wait until this look is over, so that the next change is one.
        let (sender, answer) = channel();
        self.watcher.inbox.send(Message::Answer(sender)).expect("the thread runs");
        answer.recv().expect("the thread answers");
        wanted
    }

    #[track_caller]
    fn change(&mut self) -> Vec<String> {
        let change = self.whole_change();
        let name =
            |path: &PathBuf| path.strip_prefix(self.root.path()).expect("below").to_string_lossy().into();
        change.files.iter().map(name).collect()
    }

    #[track_caller]
    fn whole_change(&mut self) -> FileChange {
        let begun = Instant::now();
        loop {
            if let Some(change) = self.watcher.take() {
                return change;
            }
            let left = LONG.saturating_sub(begun.elapsed());
            assert!(self.wakes.recv_timeout(left).is_ok(), "no change came");
        }
    }

    /// Fails if there is an unreported change: saves another file, and expects a change of that file only.
    #[track_caller]
    fn nothing_changed(&mut self) {
        let text = format!("{:?}", Instant::now());
        self.save("sentinel", &text);
        assert_eq!(self.change(), ["sentinel"]);
        self.built();
    }
}

#[test]
fn a_saved_file_is_a_change() {
    let mut desk = Desk::new(&[("a", "one"), ("b", "one")]);
    for text in ["two", "three", "four"] {
        let before = Instant::now();
        desk.save("a", text);
        let change = desk.whole_change();
        assert_eq!(change.files, [desk.path("a")]);
        assert!(change.first_seen >= before && change.first_seen <= Instant::now());
        desk.built();
    }
}

#[test]
fn an_event_makes_a_look_earlier() {
    let patience = Patience { interval: 10 * LONG, ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one"), ("b/c", "one")]);
    desk.save("a", "two");
    assert_eq!(desk.change(), ["a"]);
    desk.built();
    desk.save(".c.swp", "two");
    fs::rename(desk.path(".c.swp"), desk.path("b/c")).expect("renamed");
    assert_eq!(desk.change(), ["b/c"]);
    // Another folder of this name.
    fs::rename(desk.path("b"), desk.path("old")).expect("renamed");
    desk.save("b/c", "two");
    desk.built();
    desk.save("b/c", "three");
    assert_eq!(desk.change(), ["b/c"]);
}

#[test]
fn a_file_that_changed_since_it_was_built_is_a_change_at_once() {
    let mut desk = Desk::new(&[("a", "one")]);
    let old = Wanted { path: desk.path("a"), content: Content::of(b"zero") };
    desk.watcher.watch(&[old]);
    assert_eq!(desk.change(), ["a"]);
}

#[test]
fn a_file_that_is_replaced_by_a_rename_is_a_change() {
    let mut desk = Desk::new(&[("a", "one")]);
    for text in ["two", "three"] {
        desk.save(".a.swp", text);
        fs::rename(desk.path(".a.swp"), desk.path("a")).expect("renamed");
        assert_eq!(desk.change(), ["a"]);
        desk.built();
    }
}

#[test]
fn a_file_that_is_renamed_away_and_written_anew_is_one_change() {
    let mut desk = Desk::new(&[("a", "one"), ("sentinel", "")]);
    for text in ["two", "three"] {
        fs::rename(desk.path("a"), desk.path("a~")).expect("renamed");
        desk.save("a", text);
        assert_eq!(desk.change(), ["a"]);
        desk.built();
        fs::remove_file(desk.path("a~")).expect("removed");
        desk.nothing_changed();
    }
}

#[test]
fn a_touch_is_no_change_and_neither_is_a_save_of_the_same_text() {
    let mut desk = Desk::new(&[("a", "one"), ("b", "one"), ("c", "one"), ("sentinel", "")]);
    let a = fs::File::options().write(true).open(desk.path("a")).expect("opened");
    a.set_modified(std::time::SystemTime::now() + LONG).expect("touched");
    desk.save("b", "one");
    desk.save("new", "one");
    fs::rename(desk.path("new"), desk.path("c")).expect("renamed");
    desk.save("not wanted", "one");
    desk.nothing_changed();
}

#[test]
fn a_change_that_is_taken_back_before_the_file_is_still_is_none() {
    let patience = Patience { quiet: Duration::from_secs(2), ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one"), ("sentinel", "")]);
    desk.save("a", "two");
    desk.save("a", "one");
    desk.nothing_changed();
}

#[test]
fn an_editor_that_empties_a_file_and_writes_it_later_makes_one_change() {
    let mut desk = Desk::new(&[("a", "one"), ("sentinel", "")]);
    desk.save("a", "");
    desk.nothing_changed();
    desk.save("a", "two");
    assert_eq!(desk.change(), ["a"]);
}

#[test]
fn a_file_that_stays_empty_or_away_is_a_change_after_the_grace() {
    let patience = Patience { gone: Duration::from_millis(300), ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one"), ("b", "one")]);
    desk.save("a", "");
    assert_eq!(desk.change(), ["a"]);
    desk.built();
    fs::remove_file(desk.path("b")).expect("removed");
    assert_eq!(desk.change(), ["b"]);
    desk.built();
    // A folder or a link in the place of a missing file is another error.
    fs::create_dir(desk.path("b")).expect("a folder");
    assert_eq!(desk.change(), ["b"]);
    desk.built();
    fs::remove_dir(desk.path("b")).expect("removed");
    assert_eq!(desk.change(), ["b"]);
    desk.built();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nothing", desk.path("b")).expect("a link");
        assert_eq!(desk.change(), ["b"]);
        desk.built();
        fs::remove_file(desk.path("b")).expect("removed");
        assert_eq!(desk.change(), ["b"]);
        desk.built();
    }
    desk.save("b", "one");
    assert_eq!(desk.change(), ["b"]);
}

#[test]
fn a_file_that_never_stands_still_is_a_change_nevertheless() {
    let patience = Patience { quiet: LONG, moving: Duration::from_millis(200), ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one")]);
    desk.save("a", "two");
    assert_eq!(desk.change(), ["a"]);
}

#[test]
fn a_file_that_is_emptied_by_every_save_is_a_change_nevertheless() {
    let desk = Desk::new(&[("a", "one")]);
    let mut subject = Subject::new(&desk.path("a"));
    subject.look(Content::at);
    subject.built(&[Content::of(b"one")]);
    let begun = Instant::now();
    let mut is_due = |frame: u32| {
        let now = begun + frame * Duration::from_millis(16);
        desk.save("a", if frame.is_multiple_of(2) { "" } else { "two" });
        subject.look(Content::at);
        subject.weigh(now);
        subject.difference(&REAL).expect("the file differs").due <= now
    };
    let due = (0..100).find(|frame| is_due(*frame)).expect("a change");
    assert_eq!(due, 63, "with contents, after a second");
}

#[test]
fn a_change_does_not_wait_long_for_a_file_that_is_still_moving() {
    // `b` changes all the time and would delay the report; `a` is saved once.
    let patience = Patience { moving: LONG, ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one"), ("b", "one")]);
    let b = desk.path("b");
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for count in 0.. {
                if stop.load(Ordering::SeqCst) {
                    break;
                }
                fs::write(&b, format!("{count}")).expect("saved");
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        desk.save("a", "two");
        while !desk.change().contains(&"a".to_string()) {}
        stop.store(true, Ordering::SeqCst);
    });
}

#[test]
fn files_that_are_saved_together_are_one_change() {
    let patience = Patience { quiet: Duration::from_secs(1), gather: LONG, ..REAL };
    let mut desk = Desk::with(patience, &[("a/one", "1"), ("b/two", "1"), ("c", "1")]);
    desk.save("b/two", "2");
    desk.save("a/one", "2");
    assert_eq!(desk.change(), ["a/one", "b/two"]);
}

#[test]
fn a_burst_of_saves_is_few_changes_and_the_last_one_wins() {
    let patience = Patience { quiet: Duration::from_millis(500), moving: LONG, ..REAL };
    let mut desk = Desk::with(patience, &[("a", "")]);
    let last = Content::of(b"99");
    for text in 0..100 {
        desk.save("a", &text.to_string());
    }
    let mut changes = 0;
    loop {
        assert_eq!(desk.change(), ["a"]);
        changes += 1;
        if desk.built()[0].content == last {
            break;
        }
    }
    assert!(changes < 10, "{changes} changes for one burst");
}

#[test]
fn a_file_in_folders_that_do_not_exist_yet_is_a_change_when_it_comes() {
    let mut desk = Desk::new(&[("here", "one")]);
    desk.want(&["here", "one/two/three/file"]);
    fs::create_dir(desk.path("one")).expect("a folder");
    fs::create_dir(desk.path("one/two")).expect("a folder");
    desk.save("one/two/three/file", "new");
    assert_eq!(desk.change(), ["one/two/three/file"]);
    // All levels at once.
    desk.want(&["here", "four/five/file"]);
    desk.save("made/five/file", "new");
    fs::rename(desk.path("made"), desk.path("four")).expect("renamed");
    assert_eq!(desk.change(), ["four/five/file"]);
}

#[test]
fn a_folder_that_is_removed_and_restored_is_watched_on() {
    let mut desk = Desk::new(&[("p/shaders/a", "one"), ("p/shaders/b", "one"), ("sentinel", "")]);
    for (round, folder) in ["p/shaders", "p", "p/shaders"].into_iter().enumerate() {
        fs::remove_dir_all(desk.path(folder)).expect("removed");
        desk.save("p/shaders/a", "one");
        desk.save("p/shaders/b", &format!("restored {round}"));
        // `a` is unchanged: its brief absence does not count.
        assert_eq!(desk.change(), ["p/shaders/b"]);
        desk.built();
        desk.save("p/shaders/a", &format!("saved {round}"));
        assert_eq!(desk.change(), ["p/shaders/a"]);
        desk.save("p/shaders/a", "one");
        assert_eq!(desk.change(), ["p/shaders/a"]);
        desk.built();
    }
}

#[test]
fn a_folder_that_is_exchanged_far_above_is_noticed() {
    let mut desk = Desk::new(&[("p/q/r/a", "one")]);
    desk.save("new/q/r/a", "two");
    fs::rename(desk.path("p"), desk.path("old")).expect("renamed");
    fs::rename(desk.path("new"), desk.path("p")).expect("renamed");
    assert_eq!(desk.change(), ["p/q/r/a"]);
    desk.built();
    desk.save("p/q/r/a", "three");
    assert_eq!(desk.change(), ["p/q/r/a"]);
    desk.built();
    // The old target is no longer watched.
    desk.want(&["p/q/r/a", "sentinel"]);
    desk.save("old/q/r/a", "four");
    desk.nothing_changed();
}

#[cfg(unix)]
#[test]
fn a_link_that_is_turned_to_another_place_is_a_change() {
    use std::os::unix::fs::symlink;
    let mut desk = Desk::new(&[("..v1/a", "one"), ("..v2/a", "two"), ("..v3/a", "three")]);
    symlink("..v1", desk.path("..data")).expect("a link");
    symlink("..data/a", desk.path("a")).expect("a link");
    desk.want(&["a"]);
    for version in ["..v2", "..v3"] {
        symlink(version, desk.path("..tmp")).expect("a link");
        fs::rename(desk.path("..tmp"), desk.path("..data")).expect("renamed");
        assert_eq!(desk.change(), ["a"]);
        desk.built();
        // The new target is watched.
        desk.save(&format!("{version}/a"), "edited in place");
        assert_eq!(desk.change(), ["a"]);
        desk.built();
    }
}

#[cfg(unix)]
#[test]
fn a_file_behind_a_link_to_its_folder_is_watched_where_it_is() {
    let mut desk = Desk::new(&[("real/shaders/a", "one")]);
    std::os::unix::fs::symlink(desk.path("real"), desk.path("link")).expect("a link");
    desk.want(&["link/shaders/a"]);
    desk.save("real/shaders/a", "two");
    assert_eq!(desk.change(), ["link/shaders/a"]);
}

#[test]
fn a_change_that_the_build_has_read_already_need_not_be_taken() {
    let mut desk = Desk::new(&[("a", "one"), ("sentinel", "")]);
    desk.save("a", "two");
    // Announced, but not taken.
    desk.wakes.recv_timeout(LONG).expect("woken");
    desk.built();
    assert_eq!(desk.watcher.take(), None);
    desk.nothing_changed();
}

#[test]
fn a_change_that_was_taken_is_not_told_again_when_an_older_build_is_done() {
    let mut desk = Desk::new(&[("a", "one"), ("sentinel", "")]);
    let old = desk.built();
    desk.save("a", "two");
    assert_eq!(desk.change(), ["a"]);
    // A build that began before the change.
    desk.watcher.watch(&old);
    desk.save("sentinel", "saved");
    assert_eq!(desk.change(), ["sentinel"]);
    // But a file that returns to that build's contents is a change: the newer build does not have them.
    desk.save("a", "one");
    assert_eq!(desk.change(), ["a"]);
}

#[test]
fn of_two_builds_that_read_different_texts_one_is_out_of_date() {
    let mut desk = Desk::new(&[("a", "two")]);
    let read = |text: &str| Wanted { path: desk.path("a"), content: Content::of(text.as_bytes()) };
    let both = [read("two"), read("one")];
    desk.watcher.watch(&both);
    assert_eq!(desk.change(), ["a"]);
}

const BUILTIN: &[(&str, &str)] = &[("shaders/splat.frag", "built in")];

/// Simulates a build of `pipelines/a.ron`: watches the files that it looks up. Returns them, and the text of the shader
/// that it finds.
fn build(desk: &mut Desk) -> (Vec<Wanted>, String) {
    let mut files = SourceMap::new(Library { builtin: BUILTIN, ..Library::default() });
    let graph = desk.path("pipelines/a.ron");
    let graph = files.find(None, graph.to_str().expect("text"), Kind::Graph).expect("the graph");
    let shader = files.find(Some(graph), "splat.frag", Kind::Shader).expect("the shader");
    let text = files.text(shader).to_string();
    let wanted = files.wanted();
    desk.watcher.watch(&wanted);
    (wanted, text)
}

#[test]
fn a_file_that_appears_earlier_in_the_search_is_a_change() {
    let patience = Patience { gone: Duration::from_millis(300), ..REAL };
    let mut desk = Desk::with(patience, &[("pipelines/a.ron", "")]);
    assert_eq!(build(&mut desk).1, "built in");
    // Replaces a built-in file, in a folder that does not exist yet.
    desk.save("shaders/splat.frag", "beside the graphs");
    assert!(desk.change().contains(&"shaders/splat.frag".to_string()));
    assert_eq!(build(&mut desk).1, "beside the graphs");
    // A file nearer to the graph.
    desk.save("pipelines/splat.frag", "beside the graph");
    assert_eq!(desk.change(), ["pipelines/splat.frag"]);
    let (wanted, text) = build(&mut desk);
    assert_eq!(text, "beside the graph");
    // Later places in the search do not matter now.
    assert!(wanted.iter().all(|wanted| !wanted.path.ends_with("shaders/splat.frag")), "{wanted:?}");
    // Back to the built-in file.
    fs::remove_dir_all(desk.path("shaders")).expect("removed");
    fs::remove_file(desk.path("pipelines/splat.frag")).expect("removed");
    assert_eq!(desk.change(), ["pipelines/splat.frag"]);
    assert_eq!(build(&mut desk).1, "built in");
}

#[test]
fn a_large_file_is_known_by_its_metadata_and_every_write_is_a_change_but_no_read() {
    let patience = Patience { content: Content::stamp, ..REAL };
    let mut desk = Desk::with(patience, &[("a", "one"), ("sentinel", "")]);
    desk.save("a", "");
    fs::read(desk.path("a")).expect("read");
    desk.nothing_changed();
    // Larger than a file that is read.
    let file = fs::File::options().write(true).open(desk.path("a")).expect("opened");
    for length in [1 << 25, (1 << 25) + 1] {
        file.set_len(length).expect("written");
        assert_eq!(desk.change(), ["a"]);
        desk.built();
    }
    for text in ["two", "two"] {
        desk.save("new", text);
        fs::rename(desk.path("new"), desk.path("a")).expect("renamed");
        assert_eq!(desk.change(), ["a"]);
        desk.built();
    }
    fs::read(desk.path("a")).expect("read");
    desk.nothing_changed();
}

#[test]
fn paths_that_lead_nowhere_are_harmless() {
    let mut desk = Desk::new(&[("a", "one")]);
    let strange = ["", ".", "..", "/", "a\0b", "../../../..", "\n", "a/b/c", "é/🦀", "*"];
    let long = "x".repeat(10_000);
    let mut wanted: Vec<Wanted> = strange
        .into_iter()
        .chain([long.as_str()])
        .map(|path| Wanted { path: path.into(), content: Content::Missing })
        .collect();
    wanted.push(Wanted { path: desk.path("a"), content: Content::of(b"one") });
    desk.watcher.watch(&wanted);
    desk.save("a", "two");
    assert_eq!(desk.change(), ["a"]);
}
