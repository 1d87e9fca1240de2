//! Finds files by name and keeps their texts, which spans refer to.
//!
//! A name is looked up in three places, in this order: in memory ([`Library::memory`]), on disk, and among the files
//! built into the binary. Paths in memory and in the binary are relative to the repository: graphs are in `pipelines/`,
//! shaders in `shaders/`. On disk, these two folders are searched around the referring file, so that a copied graph
//! finds the shaders that were copied with it. An unsaved text of an editor replaces its file on disk.
//!
//! Graphs are untrusted: the files that they name are read, and diagnostics quote them. These files must therefore,
//! with links followed, be in the graph's own folders ([`Roots`]) or in one of [`Library::include_roots`].

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::{fmt, fs};

use super::content::{self, Content, Found, MAX_FILE, Wanted};
use super::paths::{appended, displayed, joined, normalised, parent, root_and_rest, slashed};
use super::{Diagnostic, nearest};
use crate::ir::{FileId, Origin, Span};

/// The kind of a file, which determines the folder to search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A graph, a preset or a choice, in `pipelines`. The extension `.ron` may be omitted.
    Graph,
    /// A shader or a GLSL include, in `shaders`.
    Shader,
}

impl Kind {
    fn folder(self) -> &'static str {
        match self {
            Kind::Graph => "pipelines",
            Kind::Shader => "shaders",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Kind::Graph => "graph",
            Kind::Shader => "shader",
        })
    }
}

/// Sources of files other than a graph's own folders on disk.
#[derive(Clone, Debug, Default)]
pub struct Library {
    /// Files built into the binary: pairs of a path, such as `shaders/sort/scatter.comp`, and a text.
    pub builtin: &'static [(&'static str, &'static str)],
    /// Texts in memory, by path. They take precedence over the disk.
    pub memory: BTreeMap<String, String>,
    /// Additional folders on disk that graphs may use files from.
    pub include_roots: Vec<PathBuf>,
    /// Unsaved editor texts, by path. They replace files on disk, which may be missing.
    pub unsaved: BTreeMap<PathBuf, String>,
}

/// The number of the next file.
static SERIAL: AtomicU64 = AtomicU64::new(1);

/// Folders that may contain a graph's files; canonical.
type Roots = Arc<Vec<PathBuf>>;

/// The files of a build: finds them by name, as the module's documentation describes, and keeps their texts.
///
/// ```
/// use splatgraph_framework::source::{Kind, Library, SourceMap};
///
/// let memory = [("pipelines/thin.ron".to_string(), "Preset(...)".to_string())].into();
/// let mut files = SourceMap::new(Library { memory, ..Library::default() });
/// let file = files.find(None, "thin", Kind::Graph)?;
/// assert_eq!((files.path(file), files.text(file)), ("pipelines/thin.ron", "Preset(...)"));
/// # Ok::<(), splatgraph_framework::source::NotFound>(())
/// ```
#[derive(Debug, Default)]
pub struct SourceMap {
    library: Library,
    files: Vec<File>,
    known: HashMap<Identity, FileId>,
    /// The results of successful searches, by the referring file and the kind, and by the name. A map reads each file
    /// once, so another search would find the same; on disk, it would take dozens of system calls.
    found: HashMap<(Option<FileId>, Kind), HashMap<String, FileId>>,
    /// Every path on disk that was tried, with its contents when first tried.
    looked: BTreeMap<PathBuf, Content>,
}

#[derive(Debug)]
struct File {
    /// Path for messages. For a file on disk, it can also be opened.
    path: String,
    text: Cow<'static, str>,
    /// Byte offsets of the line starts; the first is 0.
    lines: Vec<usize>,
    disk: Option<OnDisk>,
    /// Number that identifies the text among all files of this process.
    serial: u64,
}

#[derive(Clone, Debug)]
struct OnDisk {
    content: Content,
    /// Folders that may contain the files named by this one. Inherited from the graph.
    roots: Roots,
}

/// The identity of a file, whatever name it was found by.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    /// In memory, by normalised path.
    Memory(String),
    /// On disk, by canonical path.
    Disk(PathBuf),
    /// Built in, by index in [`Library::builtin`].
    BuiltIn(usize),
}

/// The error for a file that does not exist or cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotFound {
    /// The name as the graph or the user wrote it.
    pub name: String,
    /// The kind of file.
    pub kind: Kind,
    /// The paths tried, in order of search, for messages: some end in a remark, such as `(built in)`.
    pub tried: Vec<String>,
    /// The most similar existing name; `None` if no name is similar, or if `why` is given.
    pub nearest: Option<String>,
    /// Why the last path in `tried`, which exists, cannot be used; `None` if no path exists.
    pub why: Option<String>,
    /// The first invalid byte of a file that is not UTF-8 text.
    pub place: Option<Box<Span>>,
}

/// Why an existing file cannot be used, with its first invalid byte if it is not UTF-8 text.
type Refusal = (String, Option<Box<Span>>);

impl NotFound {
    /// Converts the error to a diagnostic at `span`, the name in the referring file, or at the invalid byte.
    pub fn at(&self, span: Span) -> Diagnostic {
        match &self.place {
            Some(place) => {
                let error = Diagnostic::new(self.to_string(), **place, "the first invalid byte");
                return error.with_label(span, "the file is used here");
            }
            None if self.why.is_some() => return Diagnostic::new(self.to_string(), span, ""),
            None => {}
        }
        let label = match &self.nearest {
            Some(near) => format!("did you mean `{near}`?"),
            None => "no such file".to_string(),
        };
        Diagnostic::new(self.sentence(), span, label)
            .with_help(format!("searched in {}", self.tried.join(", ")))
    }

    fn sentence(&self) -> String {
        format!("there is no {} `{}`", self.kind, self.name)
    }
}

impl fmt::Display for NotFound {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if let Some(why) = &self.why {
            let path = self.tried.last().unwrap_or(&self.name);
            return write!(f, "the {} `{}` cannot be used: {path} {why}", self.kind, self.name);
        }
        write!(f, "{}", self.sentence())?;
        if let Some(near) = &self.nearest {
            write!(f, "; did you mean `{near}`?")?;
        }
        if !self.tried.is_empty() {
            write!(f, " (looked for {})", self.tried.join(", "))?;
        }
        Ok(())
    }
}

impl std::error::Error for NotFound {}

impl SourceMap {
    /// Creates a map that searches the library and the disk.
    pub fn new(mut library: Library) -> Self {
        let memory = std::mem::take(&mut library.memory);
        library.memory = memory.into_iter().map(|(path, text)| (normalised(&path), text)).collect();
        let roots = library.include_roots.iter().map(|root| canonical(root));
        library.include_roots = roots.collect();
        let unsaved = std::mem::take(&mut library.unsaved);
        library.unsaved = unsaved.into_iter().map(|(path, text)| (canonical(&path), text)).collect();
        SourceMap { library, ..SourceMap::default() }
    }

    /// Adds a text that has no file. Each call creates a new file, even for the same path, and [`SourceMap::find`]
    /// never returns it. Names in the text are resolved as if it were in memory at `path`.
    pub fn add(&mut self, path: impl Into<String>, text: impl Into<String>) -> FileId {
        self.insert(path.into(), Cow::Owned(text.into()), None)
    }

    /// Finds the file called `name`, and reads it unless it was read before.
    ///
    /// `from` is the file that refers to `name`, or `None` for the command line. The folder of a kind is `pipelines` or
    /// `shaders`. The first existing file is returned, of:
    ///
    /// 1. In memory: beside `from`, beside the part of its path from the innermost `pipelines` or `shaders` on, at
    ///    `name`, and in the folder of `kind`.
    /// 2. On disk, if `from` is on disk: beside `from`. Then in two folders of `kind`: next to the innermost
    ///    `pipelines` or `shaders` folder around `from`, and next to the folder that contains `from`.
    /// 3. On disk, if `from` is `None`: at `name`, and in the folder of `kind`.
    /// 4. Built in: at the paths of 1.
    ///
    /// The extension `.ron` of a graph may be omitted: a name without a dot is first searched everywhere with it.
    ///
    /// # Errors
    /// There is no such file, or the search reaches one that is not a regular file (folders are skipped), cannot be
    /// read, is too large, or is not UTF-8. With a `from`, also a file outside both the graph's folders and
    /// [`Library::include_roots`].
    pub fn find(&mut self, from: Option<FileId>, name: &str, kind: Kind) -> Result<FileId, NotFound> {
        if let Some(file) = self.found.get(&(from, kind)).and_then(|found| found.get(name)) {
            return Ok(*file);
        }
        let mut tried = Vec::new();
        for spelling in spellings(name, kind) {
            match self.find_spelling(from, &spelling, kind, &mut tried) {
                Ok(Some(file)) => {
                    self.found.entry((from, kind)).or_default().insert(name.to_owned(), file);
                    return Ok(file);
                }
                Ok(None) => {}
                Err((why, place)) => {
                    let (name, nearest) = (name.to_string(), None);
                    return Err(NotFound { name, kind, tried, nearest, why: Some(why), place });
                }
            }
        }
        let nearest = self.nearest_name(from, name, kind);
        let tried =
            tried.into_iter().map(|path| format!("{path}{}", content::obstacle(Path::new(&path)))).collect();
        Err(NotFound { name: name.to_string(), kind, tried, nearest, why: None, place: None })
    }

    /// Returns the path of a file, for messages; `<unknown file>` for an invalid id.
    pub fn path(&self, file: FileId) -> &str {
        self.file(file).map_or("<unknown file>", |f| &f.path)
    }

    /// Returns the path of a file for messages, with a remark if it is built in. Then there may be no such file on
    /// disk.
    pub fn shown_path(&self, file: FileId) -> Cow<'_, str> {
        let path = self.path(file);
        if self.is_built_in(file) { Cow::Owned(format!("{path} (built in)")) } else { Cow::Borrowed(path) }
    }

    fn is_built_in(&self, file: FileId) -> bool {
        let mut known = self.known.iter();
        known.any(|(identity, known)| *known == file && matches!(identity, Identity::BuiltIn(_)))
    }

    /// Returns true if a built-in graph is called `name`, but [`SourceMap::find`] returned `file` for this name, which
    /// has another text.
    pub fn hides_built_in(&self, file: FileId, name: &str) -> bool {
        let hides = |path: String| {
            self.library.builtin.iter().any(|(built_in, text)| *built_in == path && *text != self.text(file))
        };
        spellings(name, Kind::Graph).into_iter().any(|name| hides(joined(Kind::Graph.folder(), &name)))
    }

    /// Returns the text of a file; empty for an invalid id. A byte order mark is removed only from files on disk.
    pub fn text(&self, file: FileId) -> &str {
        self.file(file).map_or("", |f| &f.text)
    }

    /// Returns a number that identifies the text among all files of this process; 0 for an invalid id.
    pub(crate) fn serial(&self, file: FileId) -> u64 {
        self.file(file).map_or(0, |file| file.serial)
    }

    /// Returns the line and column of a span's start. Both count from 1, columns in characters. An offset beyond the
    /// text counts as its end, an invalid file as (1, 1).
    pub fn line_column(&self, span: Span) -> (u32, u32) {
        let Some(file) = self.file(span.file) else { return (1, 1) };
        let start = span.start.min(file.text.len());
        let line = file.lines.partition_point(|line_start| *line_start <= start) - 1;
        let from = file.lines[line];
        // `chars().count()` is much faster than a loop, and a line can have megabytes and thousands of errors.
        let column = file.text[from..file.text.ceil_char_boundary(start)].chars().count();
        (line as u32 + 1, column as u32 + 1)
    }

    /// Returns the path, line and column of a span's start.
    pub fn origin(&self, span: Span) -> Origin {
        let (line, column) = self.line_column(span);
        Origin { file: self.path(span.file).to_string(), line, column }
    }

    /// Iterates over the opened files: id, path, and true if the file is on disk, where it can change.
    pub fn opened(&self) -> impl Iterator<Item = (FileId, &str, bool)> {
        self.files.iter().enumerate().map(|(i, f)| (FileId(i as u32), f.path.as_str(), f.disk.is_some()))
    }

    /// Returns every path on disk that [`SourceMap::find`] tried, sorted: files read, unreadable files, and paths
    /// without a file. A map reads each file once, so each build needs a new map.
    pub fn wanted(&self) -> Vec<Wanted> {
        self.looked.iter().map(|(path, content)| Wanted { path: path.clone(), content: *content }).collect()
    }

    /// Runs `read` and forgets the files that it opens, so that the build does not depend on them. The ids of these
    /// files are invalid afterwards.
    pub fn aside<T>(&mut self, read: impl FnOnce(&mut SourceMap) -> T) -> T {
        let count = self.files.len();
        // A search aside may find a file that stays, but the paths that it looked at do not count.
        let (found, looked) = (self.found.clone(), self.looked.clone());
        let result = read(self);
        self.files.truncate(count);
        self.known.retain(|_, file| (file.0 as usize) < count);
        (self.found, self.looked) = (found, looked);
        result
    }

    fn file(&self, file: FileId) -> Option<&File> {
        self.files.get(file.0 as usize)
    }

    fn insert(&mut self, path: String, text: Cow<'static, str>, disk: Option<OnDisk>) -> FileId {
        let lines = std::iter::once(0).chain(text.match_indices('\n').map(|(at, _)| at + 1)).collect();
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        self.files.push(File { path, text, lines, disk, serial });
        FileId(self.files.len() as u32 - 1)
    }

    /// Looks up one spelling of a name; `None` if no file has it. Adds the paths to `tried`, for messages.
    fn find_spelling(
        &mut self,
        from: Option<FileId>,
        name: &str,
        kind: Kind,
        tried: &mut Vec<String>,
    ) -> Result<Option<FileId>, Refusal> {
        let library_paths = self.library_paths(from, name, kind);
        for path in &library_paths {
            if let Some(text) = self.library.memory.get(path) {
                let text = Cow::Owned(text.clone());
                return Ok(Some(self.of_library(Identity::Memory(path.clone()), path, text)));
            }
        }
        for folder in self.disk_folders(from, kind) {
            let path = Path::new(&folder).join(name);
            push_new(tried, displayed(&path));
            if let Some(file) = self.open(from, &path)? {
                return Ok(Some(file));
            }
        }
        for path in &library_paths {
            if let Some(index) = self.library.builtin.iter().position(|(builtin, _)| builtin == path) {
                let text = Cow::Borrowed(self.library.builtin[index].1);
                return Ok(Some(self.of_library(Identity::BuiltIn(index), path, text)));
            }
        }
        for path in library_paths.into_iter().filter(|path| !path.starts_with("..")) {
            push_new(tried, format!("{path} (built in)"));
        }
        Ok(None)
    }

    /// Returns the id of an in-memory or built-in file, adding the file if it is new.
    fn of_library(&mut self, identity: Identity, path: &str, text: Cow<'static, str>) -> FileId {
        if let Some(file) = self.known.get(&identity) {
            return *file;
        }
        let file = self.insert(path.to_string(), text, None);
        self.known.insert(identity, file);
        file
    }

    /// Lists the normalised paths to try in memory and among the built-in files.
    fn library_paths(&self, from: Option<FileId>, name: &str, kind: Kind) -> Vec<String> {
        let mut paths = Vec::new();
        if let Some(from) = from {
            let folder = parent(self.path(from));
            push_new(&mut paths, joined(folder, name));
            // A file in `/home/me/shaders/sort` on disk corresponds to one in the library's `shaders/sort`.
            if let Some((_, rest)) = root_and_rest(folder) {
                push_new(&mut paths, joined(rest, name));
            }
        }
        push_new(&mut paths, normalised(name));
        push_new(&mut paths, joined(kind.folder(), name));
        paths
    }

    /// Lists the folders on disk that [`SourceMap::find`] searches for a name, in order of search.
    pub fn disk_folders(&self, from: Option<FileId>, kind: Kind) -> Vec<String> {
        let Some(from) = from else { return vec![String::new(), kind.folder().to_string()] };
        let Some(file) = self.file(from).filter(|f| f.disk.is_some()) else { return Vec::new() };
        let folder = parent(&file.path);
        let mut folders = vec![folder.to_string()];
        if let Some((root, _)) = root_and_rest(folder) {
            push_new(&mut folders, appended(root, kind.folder()));
        }
        push_new(&mut folders, appended(&appended(folder, ".."), kind.folder()));
        folders
    }

    /// Reads a file from disk unless it was read before; `None` if it does not exist.
    fn open(&mut self, from: Option<FileId>, path: &Path) -> Result<Option<FileId>, Refusal> {
        let (content, found) = self.look(from, path);
        // Keep the contents of the first look: if they differ, the file has changed since.
        self.looked.entry(path.to_path_buf()).or_insert(content);
        found
    }

    fn look(&mut self, from: Option<FileId>, path: &Path) -> (Content, Result<Option<FileId>, Refusal>) {
        let unsaved = self.unsaved(path);
        let opened = match &unsaved {
            Some(_) => Ok(None),
            None => match content::open(path) {
                Ok(Found::Nothing) => return (Content::without_file(path), Ok(None)),
                Ok(Found::File(file)) => Ok(Some(file)),
                Ok(Found::Other(what)) => Err(format!("is {what}, not a file")),
                Err(error) => Err(cannot_be_read(&error)),
            },
        };
        let canonical = canonical(path);
        let roots = match from.and_then(|from| self.file(from)).and_then(|file| file.disk.as_ref()) {
            Some(disk) => disk.roots.clone(),
            None => Arc::new(own_roots(path)),
        };
        if from.is_some() && !self.allows(&roots, &canonical) {
            let folder = roots.first().map_or("it".into(), |root| root.display().to_string());
            let link = match canonical.ends_with(displayed(path)) {
                true => String::new(),
                false => format!("leads to {}, which ", canonical.display()),
            };
            let why = format!(
                "{link}is outside the graph's folder, {folder}, and outside pipelines/ and shaders/ beside it \
                 (`--include-root` allows others)"
            );
            return (Content::at(path), Err((why, None)));
        }
        let file = match opened {
            Ok(file) => file,
            Err(why) => return (Content::Unusable, Err((why, None))),
        };
        let identity = Identity::Disk(canonical);
        if let Some(file) = self.known.get(&identity) {
            let content = self.file(*file).and_then(|f| f.disk.as_ref()).map(|disk| disk.content);
            return (content.unwrap_or(Content::Unusable), Ok(Some(*file)));
        }
        let bytes = match file.map_or_else(|| Ok(unsaved.map(String::into_bytes)), content::read) {
            Ok(Some(bytes)) => bytes,
            Ok(None) => {
                return (Content::Unusable, Err((format!("is larger than {} MiB", MAX_FILE >> 20), None)));
            }
            Err(error) => return (Content::Unusable, Err((cannot_be_read(&error), None))),
        };
        let content = Content::of(&bytes);
        let disk = OnDisk { content, roots };
        let text = match content::as_text(bytes) {
            Ok(text) => text,
            Err((text, at)) => {
                // Errors about one file have one place, so that they are shown once.
                let path = displayed(path);
                let is_same = |file: &File| file.path == path && file.text == text;
                let known = self.files.iter().position(is_same).map(|index| FileId(index as u32));
                let file = known.unwrap_or_else(|| self.insert(path, Cow::Owned(text), Some(disk)));
                return (content, Err(("is not UTF-8 text".into(), Some(Span::new(file, at).into()))));
            }
        };
        let file = self.insert(displayed(path), Cow::Owned(text), Some(disk));
        self.known.insert(identity, file);
        (content, Ok(Some(file)))
    }

    /// Returns the unsaved text of a file, if it has one. The file may be missing from the disk.
    fn unsaved(&self, path: &Path) -> Option<String> {
        // Without unsaved texts, the path is not resolved: that takes several system calls, and most paths do not
        // exist.
        if self.library.unsaved.is_empty() {
            None
        } else {
            self.library.unsaved.get(&canonical(path)).cloned()
        }
    }

    /// Returns true if a graph with these roots may use `path`, which is canonical.
    fn allows(&self, roots: &Roots, path: &Path) -> bool {
        roots.iter().chain(&self.library.include_roots).any(|root| path.starts_with(root))
    }

    /// Finds the existing name most similar to `name`, or `None`.
    fn nearest_name(&self, from: Option<FileId>, name: &str, kind: Kind) -> Option<String> {
        let mut candidates: Vec<String> = Vec::new();
        let mut offer = |path: &str| {
            let short = match kind {
                Kind::Graph if !name.ends_with(".ron") => path.strip_suffix(".ron").unwrap_or(path),
                _ => path,
            };
            candidates.push(short.to_string());
        };
        let built_in = self.library.builtin.iter().map(|(path, _)| *path);
        for path in self.library.memory.keys().map(String::as_str).chain(built_in) {
            let in_folder = path.strip_prefix(kind.folder()).and_then(|rest| rest.strip_prefix('/'));
            // A file outside of all folders can be of either kind; one in the other kind's folder cannot.
            if let Some(short) = in_folder.or((!path.contains('/')).then_some(path)) {
                offer(short);
            }
        }
        for folder in self.disk_folders(from, kind) {
            // Compare a name that has a folder only with names in that folder.
            let within = name.rsplit_once('/').map(|(within, _)| within);
            let listed = within.map_or(PathBuf::from(&folder), |within| Path::new(&folder).join(within));
            let listed = if listed.as_os_str().is_empty() { Path::new(".") } else { &listed };
            let disk = from.and_then(|from| self.file(from)).and_then(|file| file.disk.as_ref());
            if disk.is_some_and(|disk| !self.allows(&disk.roots, &canonical(listed))) {
                continue;
            }
            let Ok(entries) = fs::read_dir(listed) else { continue };
            for entry in entries.flatten().take(MAX_LISTED) {
                let Ok(file) = entry.file_name().into_string() else { continue };
                if (kind == Kind::Graph) == file.ends_with(".ron") {
                    offer(&within.map_or(file.clone(), |within| format!("{within}/{file}")));
                }
            }
        }
        // A folder, or a link to nothing, can have the very name.
        candidates.retain(|candidate| candidate != name);
        candidates.sort();
        // The folder and the extension say nothing about the similarity of names that share them.
        let around = |path: &str| {
            let start = path.rfind('/').map_or(0, |slash| slash + 1);
            let end = path[start..].rfind('.').map_or(path.len(), |dot| start + dot);
            start..end
        };
        let stem = around(name);
        let near = nearest(name, candidates.iter().map(String::as_str)).filter(|near| {
            let other = around(near);
            let same = (&name[..stem.start], &name[stem.end..]) == (&near[..other.start], &near[other.end..]);
            !same || nearest(&name[stem.clone()], [&near[other]]).is_some()
        });
        if let Some(near) = near {
            return Some(near.to_string());
        }
        // Otherwise look for a file with the right name in another folder.
        let last = |path: &str| path.rsplit('/').next().unwrap_or_default().to_string();
        candidates.into_iter().find(|candidate| !name.is_empty() && last(candidate) == last(name))
    }
}

/// Maximum number of folder entries to compare with a misspelt name.
const MAX_LISTED: usize = 1000;

/// Returns the file names that `name` can mean, the most likely first.
fn spellings(name: &str, kind: Kind) -> Vec<String> {
    let last = name.rsplit('/').next().unwrap_or_default();
    if kind == Kind::Shader || last.is_empty() || name.ends_with(".ron") {
        return vec![name.to_string()];
    }
    let full = format!("{name}.ron");
    // `splat` means `splat.ron` first, even if a file called `splat` exists. `splat.old` is a complete name.
    if last.contains('.') { vec![name.to_string(), full] } else { vec![full, name.to_string()] }
}

/// Resolves the links and `..` in a path, or in its folder if there is no such file. Returns other paths unchanged.
///
/// [`SourceMap::new`] resolves the paths of [`Library::unsaved`] in this way.
pub fn canonical(path: &Path) -> PathBuf {
    let missing = || Some(dunce::canonicalize(path.parent()?).ok()?.join(path.file_name()?));
    dunce::canonicalize(path).ok().or_else(missing).unwrap_or_else(|| path.to_path_buf())
}

/// Returns the folders that the graph at `path` may take files from, its own folder first.
fn own_roots(path: &Path) -> Vec<PathBuf> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let text = slashed(&folder);
    let around = root_and_rest(&text).map(|(root, _)| if root.is_empty() { "." } else { root });
    let pairs = [Some(Path::new(&text).join("..")), around.map(PathBuf::from)].into_iter().flatten();
    let pairs = pairs.flat_map(|root| [Kind::Graph, Kind::Shader].map(|kind| root.join(kind.folder())));
    let existing =
        std::iter::once(folder.clone()).chain(pairs).filter_map(|root| dunce::canonicalize(root).ok());
    existing.collect()
}

fn cannot_be_read(error: &std::io::Error) -> String {
    format!("cannot be read ({error})")
}

fn push_new(list: &mut Vec<String>, item: String) {
    if !list.contains(&item) {
        list.push(item);
    }
}
