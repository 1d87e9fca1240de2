use std::fs;
use std::path::PathBuf;

use super::*;
use crate::ir::{FileId, Span};

const BUILTIN: &[(&str, &str)] = &[
    ("pipelines/splat.ron", "built-in splat"),
    ("pipelines/sort/radix.ron", "built-in radix"),
    ("shaders/covariance.comp", "built-in covariance"),
    ("shaders/camera.glsl", "built-in camera"),
    ("shaders/sort/scatter.comp", "built-in scatter"),
    ("shaders/sort/common.glsl", "built-in common"),
];

fn library(memory: &[(&str, &str)]) -> SourceMap {
    let memory = memory.iter().map(|(path, text)| (path.to_string(), text.to_string())).collect();
    SourceMap::new(Library { builtin: BUILTIN, memory, ..Library::default() })
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new(files: &[(&str, &str)]) -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        for (path, text) in files {
            let path = folder.0.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        folder
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_string()
    }
}

#[track_caller]
fn finds(files: &mut SourceMap, from: Option<FileId>, name: &str, kind: Kind, text: &str) -> FileId {
    let file = files.find(from, name, kind).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(files.text(file), text);
    file
}

#[test]
fn a_built_in_graph_is_found_by_its_short_name() {
    let mut files = library(&[]);
    let file = finds(&mut files, None, "splat", Kind::Graph, "built-in splat");
    assert_eq!(files.path(file), "pipelines/splat.ron");
    for name in ["splat.ron", "pipelines/splat.ron", "pipelines/splat", "./splat", "sort/../splat.ron"] {
        assert_eq!(files.find(None, name, Kind::Graph), Ok(file), "{name}");
    }
}

#[test]
fn a_built_in_file_finds_others_beside_it_and_in_the_folder_of_their_kind() {
    let mut files = library(&[]);
    let graph = files.find(None, "splat", Kind::Graph).unwrap();
    let sort = finds(&mut files, Some(graph), "sort/radix.ron", Kind::Graph, "built-in radix");
    finds(&mut files, Some(sort), "covariance.comp", Kind::Shader, "built-in covariance");
    let scatter = finds(&mut files, Some(sort), "sort/scatter.comp", Kind::Shader, "built-in scatter");
    finds(&mut files, Some(scatter), "common.glsl", Kind::Shader, "built-in common");
    let camera = finds(&mut files, Some(scatter), "camera.glsl", Kind::Shader, "built-in camera");
    assert_eq!(files.find(Some(scatter), "../camera.glsl", Kind::Shader), Ok(camera));
    assert_eq!(files.find(Some(graph), "../shaders/camera.glsl", Kind::Shader), Ok(camera));
}

#[test]
fn memory_comes_before_disk_and_disk_before_what_is_built_in() {
    let folder = Folder::new(&[
        ("pipelines/a.ron", "graph"),
        ("pipelines/splat.ron", "disk"),
        ("pipelines/b.ron", "b"),
    ]);
    let mut files = library(&[("pipelines/b.ron", "memory"), ("sort/radix.ron", "memory radix")]);
    let graph = finds(&mut files, None, &folder.path("pipelines/a.ron"), Kind::Graph, "graph");
    finds(&mut files, Some(graph), "splat", Kind::Graph, "disk");
    finds(&mut files, Some(graph), "b", Kind::Graph, "memory");
    finds(&mut files, Some(graph), "sort/radix", Kind::Graph, "memory radix");
    let on_disk: Vec<bool> = files.opened().map(|(_, _, on_disk)| on_disk).collect();
    assert_eq!(on_disk, [true, true, false, false]);
}

#[test]
fn an_overlay_in_memory_is_found_at_a_path_on_disk() {
    let folder = Folder::new(&[("a.ron", "old")]);
    let path = folder.path("a.ron");
    let mut files = library(&[(&path, "unsaved")]);
    finds(&mut files, None, &path, Kind::Graph, "unsaved");
}

#[test]
fn a_graph_on_disk_finds_its_shaders_in_the_folder_beside_its_own() {
    let folder = Folder::new(&[
        ("pipelines/deep/splat.ron", ""),
        ("shaders/sort/scatter.comp", "scatter"),
        ("shaders/camera.glsl", "camera"),
        ("pipelines/deep/own.comp", "own"),
    ]);
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("pipelines/deep/splat.ron"), Kind::Graph).unwrap();
    let scatter = finds(&mut files, Some(graph), "sort/scatter.comp", Kind::Shader, "scatter");
    finds(&mut files, Some(graph), "own.comp", Kind::Shader, "own");
    finds(&mut files, Some(scatter), "camera.glsl", Kind::Shader, "camera");
    // Files that are not on disk are built-in ones, even next to a shader that replaces a built-in one.
    finds(&mut files, Some(scatter), "common.glsl", Kind::Shader, "built-in common");
    finds(&mut files, Some(graph), "covariance.comp", Kind::Shader, "built-in covariance");
}

#[test]
fn shaders_are_found_beside_a_folder_of_any_name() {
    let folder = Folder::new(&[("mine/a.ron", ""), ("shaders/a.comp", "a"), ("pipelines/b.ron", "b")]);
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("mine/a"), Kind::Graph).unwrap();
    finds(&mut files, Some(graph), "a.comp", Kind::Shader, "a");
    finds(&mut files, Some(graph), "b", Kind::Graph, "b");
}

#[test]
fn one_file_is_one_id_whatever_it_is_called() {
    let folder = Folder::new(&[("x/a.ron", "a"), ("y/b.ron", "b")]);
    let include_roots = vec![folder.0.path().to_owned()];
    let mut files = SourceMap::new(Library { include_roots, ..Library::default() });
    let a = files.find(None, &folder.path("x/a.ron"), Kind::Graph).unwrap();
    let b = files.find(Some(a), "../y/b.ron", Kind::Graph).unwrap();
    assert_eq!(files.find(None, &folder.path("x/../y/./b"), Kind::Graph), Ok(b));
    assert_eq!(files.find(Some(b), "../x/../y//../x/a.ron", Kind::Graph), Ok(a));
    assert_eq!(files.path(b), folder.path("y/b.ron"));
    assert_eq!(files.opened().count(), 2);
}

#[cfg(unix)]
#[test]
fn links_are_followed_to_the_one_file() {
    let folder = Folder::new(&[("a/real.ron", "real"), ("b/other.ron", "other")]);
    std::os::unix::fs::symlink(folder.path("a"), folder.path("b/link")).unwrap();
    let mut files = library(&[]);
    let real = files.find(None, &folder.path("a/real.ron"), Kind::Graph).unwrap();
    assert_eq!(files.find(None, &folder.path("b/link/real.ron"), Kind::Graph), Ok(real));
    // Behind the link, `..` is the folder that contains `a`, not `b`.
    finds(&mut files, None, &folder.path("b/link/../b/other.ron"), Kind::Graph, "other");
}

#[test]
fn a_file_is_read_once() {
    let folder = Folder::new(&[("a.ron", "before")]);
    let mut files = library(&[]);
    let file = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap();
    fs::write(folder.path("a.ron"), "after").unwrap();
    assert_eq!(finds(&mut files, None, &folder.path("a.ron"), Kind::Graph, "before"), file);
}

#[test]
fn a_short_name_prefers_the_graph_to_a_stray_file_or_folder() {
    let folder =
        Folder::new(&[("splat", "\u{7f}ELF"), ("splat.ron", "graph"), ("out/x", ""), ("plain", "plain")]);
    let mut files = library(&[]);
    finds(&mut files, None, &folder.path("splat"), Kind::Graph, "graph");
    finds(&mut files, None, &folder.path("plain"), Kind::Graph, "plain");
    assert!(files.find(None, &folder.path("out"), Kind::Graph).unwrap_err().why.is_none());
}

#[test]
fn a_text_that_was_added_is_not_found_but_finds_others() {
    let mut files = library(&[("shaders/x.comp", "x"), ("pipelines/part.ron", "part")]);
    let first = files.add("pipelines/test.ron", "first");
    let second = files.add("pipelines/test.ron", "second");
    assert_ne!(first, second);
    assert!(files.find(None, "pipelines/test.ron", Kind::Graph).is_err());
    finds(&mut files, Some(first), "part", Kind::Graph, "part");
    finds(&mut files, Some(first), "x.comp", Kind::Shader, "x");
    finds(&mut files, Some(first), "camera.glsl", Kind::Shader, "built-in camera");
}

#[test]
fn a_missing_file_is_met_with_where_it_was_looked_for_and_the_nearest_name() {
    let folder = Folder::new(&[
        ("pipelines/mine.ron", ""),
        ("shaders/tonemap.comp", ""),
        ("shaders/sort/own.comp", ""),
    ]);
    let mut files = library(&[("pipelines/held.ron", "")]);
    let graph = files.find(None, &folder.path("pipelines/mine"), Kind::Graph).unwrap();
    let mut nearest = |name, kind| files.find(Some(graph), name, kind).unwrap_err().nearest;
    assert_eq!(nearest("splt", Kind::Graph).as_deref(), Some("splat"));
    assert_eq!(nearest("splt.ron", Kind::Graph).as_deref(), Some("splat.ron"));
    assert_eq!(nearest("hled", Kind::Graph).as_deref(), Some("held"));
    assert_eq!(nearest("mnie", Kind::Graph).as_deref(), Some("mine"));
    assert_eq!(nearest("tonmap.comp", Kind::Shader).as_deref(), Some("tonemap.comp"));
    assert_eq!(nearest("sort/onw.comp", Kind::Shader).as_deref(), Some("sort/own.comp"));
    assert_eq!(nearest("scatter.comp", Kind::Shader).as_deref(), Some("sort/scatter.comp"));
    assert_eq!(nearest("nothing_like_it.comp", Kind::Shader), None);
    assert_eq!(nearest("sort/pull.comp", Kind::Shader), None, "as long as `own`, but not like it");

    let mut files = library(&[]);
    let graph = files.find(None, "splat", Kind::Graph).unwrap();
    let error = files.find(Some(graph), "covarance.comp", Kind::Shader).unwrap_err();
    assert_eq!(
        error.to_string(),
        "there is no shader `covarance.comp`; did you mean `covariance.comp`? (looked for \
         pipelines/covarance.comp (built in), covarance.comp (built in), shaders/covarance.comp (built in))"
    );
}

#[cfg(unix)]
#[test]
fn a_folder_or_a_link_to_nothing_in_the_place_of_a_file_is_named() {
    let folder = Folder::new(&[("a.ron", ""), ("folder.comp/b.comp", "")]);
    std::os::unix::fs::symlink("gone.comp", folder.path("link.comp")).unwrap();
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap();
    for (name, what) in
        [("folder.comp", "a folder"), ("link.comp", "a link to gone.comp, which does not exist")]
    {
        let error = files.find(Some(graph), name, Kind::Shader).unwrap_err();
        assert_eq!(error.tried[0], format!("{} ({what})", folder.path(name)));
        assert_eq!(error.nearest, None, "{name}");
    }
}

#[test]
fn a_file_that_is_no_text_is_not_called_missing() {
    let folder = Folder::new(&[("a.ron", "")]);
    fs::write(folder.path("a.ron"), b"\xef\xbb\xbf\n\xc3\xa9Graph(\xff)").unwrap();
    let mut files = library(&[]);
    let from = files.add("b.ron", "a.ron");
    let error = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap_err();
    let again = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap_err();
    assert_eq!(error, again, "one place, so that the error is shown once");
    let found = error.at(Span::new(from, 0..5));
    let path = folder.path("a.ron");
    assert_eq!(found.message, format!("the graph `{path}` cannot be used: {path} is not UTF-8 text"));
    let origin = files.origin(found.primary.span);
    assert_eq!((origin.file, origin.line, origin.column), (path, 2, 8));
    assert_eq!(found.secondary[0].span, Span::new(from, 0..5));
}

#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_read_is_not_called_missing() {
    let folder = Folder::new(&[("b.ron", "")]);
    std::os::unix::fs::symlink(folder.path("loop.ron"), folder.path("loop.ron")).unwrap();
    let error = library(&[]).find(None, &folder.path("loop.ron"), Kind::Graph).unwrap_err();
    assert!(error.why.unwrap().starts_with("cannot be read"));
}

#[test]
fn a_file_too_large_for_a_graph_is_not_read() {
    let folder = Folder::new(&[("a.ron", "")]);
    fs::File::create(folder.path("a.ron")).unwrap().set_len(1 << 30).unwrap();
    let error = library(&[]).find(None, &folder.path("a.ron"), Kind::Graph).unwrap_err();
    assert_eq!(error.why.as_deref(), Some("is larger than 16 MiB"));
}

#[test]
fn strange_names_are_only_missing() {
    let mut files = library(&[]);
    let graph = files.find(None, "splat", Kind::Graph).unwrap();
    for name in ["", ".", "..", "/", "a\0b", "../../../..", "\n", &"x".repeat(10_000), "é/🦀", "a//b/", "*"]
    {
        for from in [None, Some(graph), Some(FileId(99))] {
            for kind in [Kind::Graph, Kind::Shader] {
                let error = files.find(from, name, kind).unwrap_err();
                assert_eq!(error.why, None, "{name:?}");
            }
        }
    }
}

#[test]
fn a_byte_order_mark_is_not_part_of_the_text() {
    let folder = Folder::new(&[("a.ron", "\u{feff}Graph()")]);
    finds(&mut library(&[]), None, &folder.path("a.ron"), Kind::Graph, "Graph()");
}

#[test]
fn lines_and_columns_count_characters_from_1() {
    let (files, file) = one_file("a.ron", "ab\nçdé f\r\n\nlast");
    let at = |start| files.line_column(Span { file, start, end: start });
    assert_eq!(at(0), (1, 1));
    assert_eq!(at(2), (1, 3));
    assert_eq!(at(3), (2, 1));
    assert_eq!(at(5), (2, 2));
    assert_eq!(at(8), (2, 4));
    assert_eq!(at(12), (3, 1));
    assert_eq!(at(13), (4, 1));
    assert_eq!(at(17), (4, 5));
    assert_eq!(at(9999), (4, 5));
    let origin = files.origin(Span { file, start: 8, end: 9 });
    assert_eq!((origin.file.as_str(), origin.line, origin.column), ("a.ron", 2, 4));
}

#[test]
fn an_unknown_file_has_a_name_and_no_text() {
    let files = SourceMap::default();
    assert_eq!((files.path(FileId(3)), files.text(FileId(3))), ("<unknown file>", ""));
    assert_eq!(files.line_column(Span { file: FileId(3), start: 5, end: 7 }), (1, 1));
}

/// Lists the files that a map has tried, by path under the folder, with their contents.
fn looked(files: &SourceMap, folder: &Folder) -> Vec<(String, Content)> {
    let mut below = Vec::new();
    for wanted in files.wanted() {
        let path = fs::canonicalize(wanted.path.parent().unwrap())
            .unwrap_or_else(|_| wanted.path.parent().unwrap().to_path_buf())
            .join(wanted.path.file_name().unwrap());
        let root = fs::canonicalize(&folder.0).unwrap();
        below.push((path.strip_prefix(root).unwrap().to_str().unwrap().to_string(), wanted.content));
    }
    below
}

#[test]
fn files_that_are_read_aside_are_forgotten() {
    let folder = Folder::new(&[("pipelines/a.ron", "graph"), ("shaders/b.comp", "one")]);
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("pipelines/a"), Kind::Graph).unwrap();
    let (wanted, opened) = (files.wanted(), files.opened().count());
    let read = files.aside(|files| {
        let found = ["a", "b.comp", "c.comp", "covariance.comp"]
            .map(|name| files.find(Some(graph), name, Kind::Shader).ok());
        found.map(|file| file.map(|file| files.text(file).to_string()))
    });
    assert_eq!(read, [None, Some("one".into()), None, Some("built-in covariance".into())]);
    assert_eq!((files.wanted(), files.opened().count()), (wanted, opened));
    // Reading a file again gives its new contents.
    fs::write(folder.path("shaders/b.comp"), "two").unwrap();
    finds(&mut files, Some(graph), "b.comp", Kind::Shader, "two");
    finds(&mut files, Some(graph), "covariance.comp", Kind::Shader, "built-in covariance");
}

#[test]
fn a_name_is_searched_once_so_a_build_sees_one_state_of_the_disk() {
    let folder = Folder::new(&[("pipelines/a.ron", "graph"), ("shaders/b.comp", "one")]);
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("pipelines/a"), Kind::Graph).unwrap();
    let first = files.find(Some(graph), "b.comp", Kind::Shader).unwrap();
    // Beside the graph, it would come first.
    fs::write(folder.path("pipelines/b.comp"), "two").unwrap();
    assert_eq!(files.find(Some(graph), "b.comp", Kind::Shader), Ok(first));
    fs::remove_file(folder.path("shaders/b.comp")).unwrap();
    assert_eq!(files.find(Some(graph), "b.comp", Kind::Shader), Ok(first));
}

#[test]
fn a_map_knows_what_it_read_and_where_it_looked_in_vain() {
    let folder = Folder::new(&[
        ("pipelines/a.ron", "\u{feff}graph"),
        ("shaders/camera.glsl", "camera"),
        ("shaders/broken.comp", ""),
    ]);
    fs::write(folder.path("shaders/broken.comp"), b"\xff").unwrap();
    let mut files = library(&[("pipelines/held.ron", "in memory")]);
    let graph = files.find(None, &folder.path("pipelines/a"), Kind::Graph).unwrap();
    files.find(Some(graph), "camera.glsl", Kind::Shader).unwrap();
    finds(&mut files, Some(graph), "covariance.comp", Kind::Shader, "built-in covariance");
    finds(&mut files, Some(graph), "held", Kind::Graph, "in memory");
    files.find(Some(graph), "broken.comp", Kind::Shader).unwrap_err();
    let read = |text: &[u8]| Content::of(text);
    let expected = [
        ("pipelines/a.ron", read("\u{feff}graph".as_bytes())),
        ("pipelines/broken.comp", Content::Missing),
        ("pipelines/camera.glsl", Content::Missing),
        ("pipelines/covariance.comp", Content::Missing),
        ("shaders/broken.comp", read(b"\xff")),
        ("shaders/camera.glsl", read(b"camera")),
        ("shaders/covariance.comp", Content::Missing),
    ];
    let mut looked = looked(&files, &folder);
    // The search tries the shaders' folder by two paths, which are one path once canonical.
    looked.dedup();
    looked.sort_by(|a, b| a.0.cmp(&b.0));
    looked.dedup();
    assert_eq!(looked, expected.map(|(path, content)| (path.to_string(), content)));
    for wanted in files.wanted() {
        assert_eq!(Content::at(&wanted.path), wanted.content, "{wanted:?}");
    }
}

#[test]
fn what_appears_while_a_map_is_used_counts_as_missing() {
    let folder = Folder::new(&[("a.ron", "")]);
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap();
    files.find(Some(graph), "late.comp", Kind::Shader).unwrap_err();
    fs::write(folder.path("late.comp"), "late").unwrap();
    finds(&mut files, Some(graph), "late.comp", Kind::Shader, "late");
    let wanted = files.wanted().into_iter().find(|w| w.path.ends_with("late.comp")).unwrap();
    assert_eq!(wanted.content, Content::Missing, "a build that saw both must be done again");
}

#[cfg(unix)]
fn make_pipe(path: &str) {
    let path = std::ffi::CString::new(path).unwrap();
    // SAFETY: the path is NUL-terminated.
    assert_eq!(unsafe { libc::mkfifo(path.as_ptr(), 0o600) }, 0);
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_at_once_and_never_opened() {
    let folder = Folder::new(&[("a.ron", "a")]);
    make_pipe(&folder.path("pipe.comp"));
    make_pipe(&folder.path("pipe.ron"));
    let _socket = std::os::unix::net::UnixListener::bind(folder.path("socket.ron")).unwrap();
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("a.ron"), Kind::Graph).unwrap();
    for (name, what) in [("pipe.ron", "a pipe"), ("socket.ron", "a socket")] {
        for (from, name) in [(None, folder.path(name)), (Some(graph), name.to_string())] {
            let error = files.find(from, &name, Kind::Graph).unwrap_err();
            assert_eq!(error.why, Some(format!("is {what}, not a file")), "{name}");
        }
    }
    let error = files.find(Some(graph), "pipe.comp", Kind::Shader).unwrap_err();
    assert_eq!(error.why.as_deref(), Some("is a pipe, not a file"));
    let error = files.find(None, "/dev/zero", Kind::Shader).unwrap_err();
    assert_eq!(error.why.as_deref(), Some("is a device, not a file"));
    assert_eq!(Content::at(std::path::Path::new(&folder.path("pipe.ron"))), Content::Unusable);
}

#[cfg(unix)]
#[test]
fn a_graph_names_no_files_outside_of_its_folders() {
    let folder = Folder::new(&[
        ("in/pipelines/sub/a.ron", "a"),
        ("in/pipelines/b.ron", "b"),
        ("in/shaders/a.comp", "a"),
        ("out/secret.ron", "secret"),
        ("out/secret.comp", "secret"),
    ]);
    std::os::unix::fs::symlink(folder.path("out"), folder.path("in/pipelines/link")).unwrap();
    std::os::unix::fs::symlink(folder.path("out/secret.comp"), folder.path("in/shaders/link.comp")).unwrap();
    let absolute = folder.path("out/secret.comp");
    let outside = [
        ("/etc/passwd", Kind::Graph),
        ("../../../../../../../../../../../../etc/passwd", Kind::Shader),
        ("../../../out/secret.ron", Kind::Graph),
        ("../link/secret", Kind::Graph),
        ("link.comp", Kind::Shader),
        (absolute.as_str(), Kind::Shader),
    ];
    let mut files = library(&[]);
    let graph = files.find(None, &folder.path("in/pipelines/sub/a.ron"), Kind::Graph).unwrap();
    let inner = finds(&mut files, Some(graph), "../b.ron", Kind::Graph, "b");
    let shader = finds(&mut files, Some(graph), "a.comp", Kind::Shader, "a");
    for from in [graph, inner, shader] {
        for (name, kind) in outside {
            let Err(error) = files.find(Some(from), name, kind) else { panic!("{name} is found") };
            let sentence = error.to_string();
            assert!(!sentence.contains("root:") && error.nearest.is_none(), "{sentence}");
            // From another folder, some of the names lead nowhere.
            let refused = error.why.is_some_and(|why| {
                let target = if name.contains("link") { "/out/secret." } else { "" };
                why.contains("is outside the graph's folder, ") && why.contains(target)
            });
            assert!(refused || from != graph && name.starts_with(".."), "{sentence}");
        }
    }
    // A misspelt name outside is not completed from the folder there.
    let error = files.find(Some(graph), "../../../out/secrit.ron", Kind::Graph).unwrap_err();
    assert_eq!(error.nearest, None);
    // The graph may not use the file even after the map has opened it for another reason.
    files.find(None, &absolute, Kind::Shader).unwrap();
    files.find(Some(graph), &absolute, Kind::Shader).unwrap_err();
    let include_roots = vec![PathBuf::from(folder.path("out"))];
    let mut files = SourceMap::new(Library { include_roots, ..Library::default() });
    let graph = files.find(None, &folder.path("in/pipelines/sub/a.ron"), Kind::Graph).unwrap();
    finds(&mut files, Some(graph), "../../../out/secret.ron", Kind::Graph, "secret");
    finds(&mut files, Some(graph), "link.comp", Kind::Shader, "secret");
    files.find(Some(graph), "/etc/passwd", Kind::Graph).unwrap_err();
}

#[cfg(unix)]
#[test]
fn a_device_or_a_folder_is_not_read_to_tell_what_it_holds() {
    assert_eq!(Content::at(std::path::Path::new("/dev/zero")), Content::Unusable);
    assert!(matches!(Content::at(std::path::Path::new("/")), Content::Obstacle { .. }));
}

#[test]
fn an_editors_text_is_read_in_place_of_the_file_on_disk_and_not_without_one() {
    let folder = Folder::new(&[("my.ron", "saved"), ("step.comp", "saved step")]);
    let texts = [("my.ron", "typed"), ("new.ron", "never saved"), ("new.comp", "new step")];
    let unsaved = texts.map(|(name, text)| (folder.0.path().join(name), text.to_string())).into();
    let mut files = SourceMap::new(Library { unsaved, ..Library::default() });
    let graph = finds(&mut files, None, &folder.path("my.ron"), Kind::Graph, "typed");
    finds(&mut files, Some(graph), "step.comp", Kind::Shader, "saved step");
    // A new file has a name in the editor before it is saved.
    finds(&mut files, Some(graph), "new.comp", Kind::Shader, "new step");
    let graph = finds(&mut files, None, &folder.path("new.ron"), Kind::Graph, "never saved");
    finds(&mut files, Some(graph), "step.comp", Kind::Shader, "saved step");
}
