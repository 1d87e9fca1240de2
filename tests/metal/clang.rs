//! Compiles shaders in Metal's language as C++, with clang and the headers in `include/`.

use splatgraph_framework::ir::{Msl, Shader, ShaderStage};
use std::collections::{BTreeSet, HashMap};
use std::ffi::{CStr, CString, c_char, c_uint, c_void};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/metal");

/// Compiler flags. Metal's language is based on C++14; the header needs slightly more.
///
/// Literals are floats, as in Metal, and products and sums are rounded separately, as by lavapipe. Warnings are errors,
/// except about unknown attributes and code that SPIRV-Cross leaves unused.
const FLAGS: [&str; 12] = [
    "-std=c++17",
    "-Xclang",
    "-cl-single-precision-constant",
    "-ffp-contract=off",
    "-fno-strict-aliasing",
    "-fPIC",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wno-unused",
    "-Wno-unknown-attributes",
    "-Wno-unused-parameter",
];

fn clang(folder: &Path, arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("clang++")
        .args(FLAGS)
        .args(["-I", &format!("{FOLDER}/include")])
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .map_err(|error| {
            format!("these tests need clang++ (on Debian and Ubuntu the package clang): {error}")
        })?;
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

/// Beginning and end of SPIRV-Cross's array type, which has members for each address space. C++ cannot distinguish
/// these, so the header has a type with one set of members.
const ARRAY: (&str, &str) = ("template<typename T, size_t Num>\nstruct spvUnsafeArray\n{", "\n};\n");

/// Converts a shader's text to C++, in a separate namespace. A compute shader also gets the C function
/// `kernel_{index}`, which calls it.
///
/// Threadgroup variables get another qualifier than references to them.
fn as_cpp(shader: &Shader, msl: &Msl, index: usize) -> String {
    let mut text = msl.source.clone();
    if let Some(begin) = text.find(ARRAY.0) {
        let end = begin + text[begin..].find(ARRAY.1).expect("the array ends") + ARRAY.1.len();
        let lines = "\n".repeat(text[begin..end].matches('\n').count());
        text.replace_range(begin..end, &lines);
    }
    // clang has no vectors of bool before version 15.
    let text = text.replace("vec<bool, N>", "bool_vector<N>");
    let declared = |line: &str| {
        let rest = line.strip_prefix("    threadgroup ").filter(|rest| !rest.contains('('))?;
        Some(format!("    threadgroup_variable {rest}"))
    };
    let lines: Vec<String> =
        text.lines().map(|line| declared(line).unwrap_or_else(|| line.to_string())).collect();
    let mut cpp =
        format!("namespace k{index} {{\n#line 1 \"{}.metal\"\n{}\n}}\n", shader.name, lines.join("\n"));
    if shader.reflection.stage == ShaderStage::Compute {
        let arguments: Vec<String> = attributes(msl).iter().map(|name| format!("call.{name}")).collect();
        let (entry, arguments) = (&msl.entry, arguments.join(", "));
        cpp += &format!(
            "extern \"C\" void kernel_{index}(const metal::Call& call) {{ k{index}::{entry}({arguments}); }}\n"
        );
    }
    cpp
}

/// Lists the attributes of a function's parameters, in order: `buffer(0)`, `thread_index_in_simdgroup`, ...
fn attributes(msl: &Msl) -> Vec<&str> {
    let name = format!(" {}(", msl.entry);
    let line = msl.source.lines().find(|line| {
        ["kernel ", "vertex ", "fragment "].iter().any(|stage| line.starts_with(stage))
            && line.contains(&name)
    });
    let line = line.expect("the function");
    line.split("[[").skip(1).map(|rest| rest.split("]]").next().expect("it ends")).collect()
}

/// Checks that the indices of the arguments in the text equal the backend's. Returns the number of buffers.
pub fn assert_places(shader: &Shader) -> usize {
    let msl = shader.msl.as_ref().expect("translated");
    let found: BTreeSet<String> =
        attributes(msl).into_iter().filter(|name| name.contains('(')).map(str::to_string).collect();
    let bound = msl.arguments.iter().map(|a| (a.texture, a.index));
    let further = msl.push.into_iter().chain(msl.sizes).map(|index| (false, index));
    let told: Vec<String> = bound
        .chain(further)
        .map(|(texture, index)| format!("{}({index})", if texture { "texture" } else { "buffer" }))
        .collect();
    let all: BTreeSet<String> = told.iter().cloned().collect();
    assert_eq!(all.len(), told.len(), "{}: two arguments have one place: {told:?}", shader.name);
    assert_eq!(found, all, "{}", shader.name);
    all.iter().filter(|place| place.starts_with("buffer")).count()
}

/// Distributes shaders over files that are compiled in parallel, without duplicates. Also returns each text's index.
fn files(shaders: &[&Shader], parts: usize) -> (Vec<String>, HashMap<String, usize>) {
    let mut known = HashMap::new();
    let mut files = vec!["#include <metal_stdlib>\n".to_string(); parts];
    for shader in shaders {
        let msl = shader.msl.as_ref().expect("translated");
        let index = known.len();
        if known.contains_key(&msl.source) {
            continue;
        }
        known.insert(msl.source.clone(), index);
        files[index % parts] += &as_cpp(shader, msl, index);
    }
    (files, known)
}

/// Compiles files in parallel; panics on errors. Returns the folder with the objects, and their names without an
/// extension.
fn compile(files: Vec<String>, arguments: &[&str]) -> (tempfile::TempDir, Vec<String>) {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
    let names: Vec<String> = (0..files.len()).map(|i| format!("part{i}")).collect();
    std::thread::scope(|scope| {
        let compiled: Vec<_> = std::iter::zip(&names, &files)
            .map(|(name, text)| {
                let path = folder.path().join(format!("{name}.cpp"));
                std::fs::write(&path, text).expect("written");
                let folder = folder.path();
                scope.spawn(move || {
                    let (source, object) = (format!("{name}.cpp"), format!("{name}.o"));
                    clang(folder, &[arguments, &["-c", &source, "-o", &object]].concat())
                })
            })
            .collect();
        for part in compiled {
            part.join().expect("clang ran").unwrap_or_else(|errors| panic!("{errors}"));
        }
    });
    (folder, names)
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Fails if the text of a shader is not valid C++ with the header. Returns the number of distinct texts.
pub fn check(shaders: &[&Shader]) -> usize {
    let (files, known) = files(shaders, cores());
    compile(files, &["-fsyntax-only"]);
    known.len()
}

/// Checks that a text is valid C++ with the header. The error has clang's messages.
pub fn check_text(text: &str) -> Result<(), String> {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("text.cpp"), text).expect("written");
    clang(folder.path(), &["-Wunused-parameter", "-fsyntax-only", "text.cpp"])
}

pub struct Call<'a> {
    pub buffers: &'a mut [*mut u8],
    pub images: &'a mut [Image],
    pub groups: [u32; 3],
    pub size: [u32; 3],
    pub lanes: u32,
    /// True to run lanes and SIMD-groups in reverse order.
    pub reversed: bool,
}

/// Mirrors `Image` of the header.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Image {
    pub bytes: *mut u8,
    pub width: u32,
    pub height: u32,
    pub format: u32,
}

type Kernel = *mut c_void;
type Run = unsafe extern "C" fn(
    Kernel,
    *const c_char,
    *mut *mut u8,
    *mut Image,
    *const c_uint,
    *const c_uint,
    c_uint,
    bool,
) -> *const c_char;

pub struct Library {
    handle: *mut c_void,
    known: HashMap<String, usize>,
}

impl Library {
    /// Compiles the compute shaders among `shaders`.
    pub fn new(shaders: &[&Shader]) -> Library {
        let kernels: Vec<&Shader> =
            shaders.iter().copied().filter(|s| s.reflection.stage == ShaderStage::Compute).collect();
        let (files, known) = files(&kernels, cores());
        let (folder, parts) = compile(files, &["-O1"]);
        let machine = format!("{FOLDER}/machine.cpp");
        let objects: Vec<String> = parts.iter().map(|part| format!("{part}.o")).collect();
        let objects: Vec<&str> = objects.iter().map(String::as_str).collect();
        let arguments = [&["-O1", "-shared", "-o", "kernels.so", machine.as_str()], &objects[..]].concat();
        clang(folder.path(), &arguments).unwrap_or_else(|errors| panic!("{errors}"));
        let path: PathBuf = folder.path().join("kernels.so");
        let path = CString::new(path.to_str().expect("a plain path")).expect("a plain path");
        // SAFETY: the library has no constructors. Its file may be removed once it is loaded.
        let handle = unsafe { libc::dlopen(path.as_ptr(), libc::RTLD_NOW | libc::RTLD_LOCAL) };
        assert!(!handle.is_null(), "the compiled kernels do not load");
        Library { handle, known }
    }

    fn symbol(&self, name: &str) -> *mut c_void {
        let symbol = CString::new(name).expect("a name");
        // SAFETY: the handle belongs to a library that is never closed.
        let found = unsafe { libc::dlsym(self.handle, symbol.as_ptr()) };
        assert!(!found.is_null(), "there is no `{name}`");
        found
    }

    /// Runs a kernel. Returns the machine's error, such as threads at different barriers. An access beyond a buffer
    /// ends the process.
    pub fn run(&self, shader: &Shader, call: Call) -> Result<(), String> {
        let msl = shader.msl.as_ref().expect("translated");
        let kernel = self.symbol(&format!("kernel_{}", self.known[&msl.source]));
        let name = CString::new(shader.name.clone()).expect("a name");
        // SAFETY: the symbol is the function of machine.cpp with this type.
        let run = unsafe { std::mem::transmute::<*mut c_void, Run>(self.symbol("machine_run")) };
        // SAFETY: each argument of the kernel has an entry in the tables, which the caller made from the same places;
        // buffers are enclosed by memory that ends the process when it is touched.
        let error = unsafe {
            run(
                kernel,
                name.as_ptr(),
                call.buffers.as_mut_ptr(),
                call.images.as_mut_ptr(),
                call.groups.as_ptr(),
                call.size.as_ptr(),
                call.lanes,
                call.reversed,
            )
        };
        if error.is_null() {
            return Ok(());
        }
        // SAFETY: the machine's errors are C strings that it never frees.
        Err(unsafe { CStr::from_ptr(error) }.to_string_lossy().into_owned())
    }
}
