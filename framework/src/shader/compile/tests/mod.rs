mod reached;

use super::generate::{IncludeFailure, IncludeProblem};
use super::*;
use crate::ir::ShaderStage;
use crate::source::{Kind, Library, render};
use std::time::Duration;

struct Bench {
    files: SourceMap,
    compiler: Glslang,
}

impl Bench {
    fn new(files: &[(&str, &str)]) -> Bench {
        let memory = files.iter().map(|(path, text)| (path.to_string(), text.to_string())).collect();
        Bench { files: SourceMap::new(Library { memory, ..Library::default() }), compiler: Glslang::new() }
    }

    /// Compiles in a worker: this test program, running only the test that serves.
    fn in_worker(mut self, limits: Limits) -> Bench {
        let program = std::env::current_exe().expect("this program");
        let test = "shader::compile::tests::the_worker_of_the_other_tests_serves_when_it_is_asked";
        let arguments = ["--exact", test, "--nocapture"].map(Into::into).into();
        self.compiler = Glslang::in_worker(Worker { program, arguments, limits });
        self
    }

    fn compile(&mut self, name: &str, defines: &[(&str, &str)]) -> Result<Compiled, String> {
        self.compile_with(name, defines, None)
    }

    fn compile_with(
        &mut self,
        name: &str,
        defines: &[(&str, &str)],
        live: Option<&str>,
    ) -> Result<Compiled, String> {
        self.diagnostics(name, defines, live).map_err(|d| render(&self.files, &d, false))
    }

    fn diagnostics(
        &mut self,
        name: &str,
        defines: &[(&str, &str)],
        live: Option<&str>,
    ) -> Result<Compiled, Vec<Diagnostic>> {
        let defines: Vec<_> = defines.iter().map(|(a, b)| (a.to_string(), b.to_string())).collect();
        let live_glsl = live.map(|text| self.files.add("live.glsl (generated)", text));
        let file = self.files.find(None, name, Kind::Shader).expect("the shader is there");
        let stage = ShaderStage::of_file(name).unwrap_or(ShaderStage::Compute);
        let request = ShaderRequest { file, stage, defines: &defines, unfit: &[], live_glsl };
        self.compiler.compile(&mut self.files, &request)
    }
}

const HEAD: &str = "#version 460
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) buffer Out { uint o[]; };
";

/// Returns the diagnostics of one shader, as `line:column: text | message | label`.
fn errors(body: &str) -> Vec<String> {
    errors_of(&[("shaders/a.comp", &format!("{HEAD}{body}"))], &[])
}

fn errors_of(files: &[(&str, &str)], defines: &[(&str, &str)]) -> Vec<String> {
    let mut bench = Bench::new(files);
    let diagnostics = bench.diagnostics("a.comp", defines, None).expect_err("there are errors");
    let line = |d: &Diagnostic| {
        let span = d.primary.span;
        let origin = bench.files.origin(span);
        let text = &bench.files.text(span.file)[span.start..span.end];
        let file = if origin.file == "shaders/a.comp" { String::new() } else { format!("{} ", origin.file) };
        format!("{file}{}:{}: {text} | {} | {}", origin.line, origin.column, d.message, d.primary.text)
    };
    diagnostics.iter().map(line).collect()
}

/// `framework/tests/golden/in/shaders.ron` has simpler errors.
#[test]
fn errors_are_at_the_token_that_they_are_about() {
    for (body, expected) in [
        (
            "void main() {\n  uint   x =   (3;\n}",
            "6:18: ; | syntax error: unexpected `;` | expected `)` or `,`",
        ),
        (
            "void main() { uint q = 2 /* x */ foo; }",
            "5:34: foo | syntax error: unexpected `foo` | expected `,` or `;`",
        ),
        (
            "void main() {\n\tvec3 a = vec2(1);\n}",
            "6:9: = | `=`: cannot convert from `const vec2` to `vec3` | ",
        ),
        (
            "void main() { o[0] = uvec2(3u); }",
            "5:20: = | `=`: cannot convert from `const uvec2` to `uint` | ",
        ),
        (
            "void main() { const int b = 3; b = 4; }",
            "5:34: = | `=`: l-value required (can't modify a const) | ",
        ),
        (
            "void add(inout uint x) {}\nvoid main() { const uint k = 1u; uint j = 2u; add(k); }",
            "6:51: k | l-value required (can't modify a const) | ",
        ),
        (
            "void main() { const uint k = 1u; uint j = 2u; k += j; }",
            "5:49: += | `+=`: l-value required (can't modify a const) | ",
        ),
        ("// \u{e9}\u{fc}\nvoid main() { /* \u{e9} */ x = 3; }", "6:23: x | `x`: undeclared identifier | "),
        // A swizzle is not proposed; `at0` is, before the shorter `a`.
        ("void main() { uvec4 c = uvec4(1); o[0] = c.a + at; }", "5:48: at | `at`: undeclared identifier | "),
        (
            "void main() { uint a = 1, at0 = 2; o[0] = a + at0 + at; }",
            "5:53: at | `at`: undeclared identifier | did you mean `at0`?",
        ),
        (
            "#define A B\nvoid main() { uint A = 3, q = 2 A; }",
            "6:33: A | syntax error: unexpected `A` | expected `,` or `;`",
        ),
    ] {
        assert_eq!(errors(body), [expected], "{body}");
    }
}

#[test]
fn what_follows_an_error_in_its_line_is_left_out_and_what_follows_ten_errors() {
    let log = "ERROR: 0:6:15: 'x' : undeclared identifier \nERROR: 0:6:7: '=' :  cannot convert from ' temp float' to ' temp int'\n\
               ERROR: 0:8:25: '' : compilation terminated \nERROR: 2 compilation errors.  No code generated.\n\n";
    let mut bench = Bench::new(&[("shaders/a.comp", &format!("{HEAD}\nx = y;\n"))]);
    let file = bench.files.find(None, "a.comp", Kind::Shader).unwrap();
    let request =
        ShaderRequest { file, stage: ShaderStage::Compute, defines: &[], unfit: &[], live_glsl: None };
    let sources = Sources::gather(&mut bench.files, &request, &mut Scans::default()).unwrap();
    let found = log::diagnose(&bench.files, &request, &sources, log);
    assert_eq!(found.iter().map(|d| d.message.as_str()).collect::<Vec<_>>(), ["`x`: undeclared identifier"]);
    // Of many errors, the first ten are shown.
    let many: String = (1..=11).map(|line| format!("ERROR: 0:{line}:1: 'x{line}' : unknown\n")).collect();
    let missing = |i| IncludeFailure { unit: 0, name: format!("{i}.glsl"), why: IncludeProblem::Missing };
    for failure in [Failure::Log(many), Failure::Includes((0..11).map(missing).collect())] {
        let found = failure.diagnose(&bench.files, &request, &sources);
        assert_eq!(found.len(), 10, "{failure:?}");
    }
}

#[test]
fn an_error_in_an_included_file_is_shown_there() {
    let shader = format!("{HEAD}#include \"common/math.glsl\"\nvoid main() {{ o[0] = twice(BITS); }}\n");
    let math = "#define TWO 2u\n\nuint twice(uint x) {\n    return TWO * y;\n}\n";
    let files = [("shaders/a.comp", shader.as_str()), ("shaders/common/math.glsl", math)];
    let found = errors_of(&files, &[("BITS", "3")]);
    assert_eq!(found, ["shaders/common/math.glsl 4:18: y | `y`: undeclared identifier | "]);
    // After the include, line numbers are the shader's again, and the defines do not shift them.
    let shader = shader.replace("twice(BITS)", "BITS + z");
    let math = math.replace('y', "x");
    let files = [("shaders/a.comp", shader.as_str()), ("shaders/common/math.glsl", math.as_str())];
    assert_eq!(errors_of(&files, &[("BITS", "3")]), ["6:29: z | `z`: undeclared identifier | "]);
}

#[test]
fn a_missing_include_that_an_if_hides_is_none() {
    let shader = format!("{HEAD}#if 0\n#include \"missing.glsl\"\n#endif\nvoid main() {{ o[0] = 1; }}\n");
    Bench::new(&[("shaders/a.comp", &shader)]).compile("a.comp", &[]).unwrap();
}

#[test]
fn a_guarded_include_cycle_is_no_error() {
    let shader = format!("{HEAD}#include \"b.glsl\"\nvoid main() {{ o[0] = 1; }}\n");
    let files = [
        ("shaders/a.comp", shader.as_str()),
        ("shaders/b.glsl", "#ifndef B\n#define B\n#include \"c.glsl\"\n#endif\n"),
        ("shaders/c.glsl", "\n  #include <b.glsl>\n"),
    ];
    Bench::new(&files).compile("a.comp", &[]).unwrap();
}

#[test]
fn a_shader_that_includes_itself_is_an_error_at_the_include() {
    let shader = format!("{HEAD}#include \"b.glsl\"\nvoid main() {{ o[0] = 1; }}\n");
    let found = errors_of(&[("shaders/a.comp", &shader), ("shaders/b.glsl", "#include \"a.comp\"\n")], &[]);
    assert_eq!(
        found,
        ["shaders/b.glsl 1:11: a.comp | `shaders/a.comp` includes itself | included again here"]
    );
}

#[test]
fn a_chain_of_else_if_that_is_too_long_is_told_as_nesting() {
    let chain = |count| {
        format!(
            "void main() {{ if (o[0] == 0) o[0] = 1;\n{}}}",
            "else if (o[1] == 2) o[2] = 3;\n".repeat(count)
        )
    };
    let found = errors(&chain(1500));
    let expected = "expected less nesting, found more than the compiler can parse";
    assert!(found.len() == 1 && found[0].contains(expected), "{found:?}");
}

#[test]
fn includes_that_multiply_are_an_error_and_no_hang() {
    let mut files =
        vec![("shaders/a.comp".to_string(), format!("{HEAD}#include \"0\"\nvoid main() {{ }}\n"))];
    for i in 0..30 {
        files.push((format!("shaders/{i}"), format!("#include \"{0}\"\n#include \"{0}\"\n", i + 1)));
    }
    files.push(("shaders/30".into(), "\n".into()));
    let files: Vec<(&str, &str)> = files.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let found = errors_of(&files, &[]);
    assert!(found[0].contains("the included files together are more than 4 MiB"), "{found:?}");
    let deep: Vec<(String, String)> =
        (0..40).map(|i| (format!("shaders/{i}"), format!("#include \"{}\"\n", i + 1))).collect();
    let mut files: Vec<(&str, &str)> = deep.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let shader = format!("{HEAD}#include \"0\"\nvoid main() {{ }}\n");
    files.extend([("shaders/a.comp", shader.as_str()), ("shaders/40", "")]);
    assert_eq!(
        errors_of(&files, &[]),
        ["shaders/31 1:11: 32 | includes are nested deeper than 32 | the limit is exceeded here"]
    );
}

#[test]
fn too_much_text_is_an_error() {
    let shader = format!("{HEAD}void main() {{ o[0] = {}; }}", vec!["1u"; 200_000].join("+"));
    let found = errors_of(&[("shaders/a.comp", &shader)], &[]);
    assert!(found[0].contains("256 KiB"), "{found:?}");
}

#[test]
fn the_longest_sum_compiles() {
    let shader = format!("{HEAD}void main() {{ o[0] = {}; }}", vec!["o[1]"; 50_000].join("+"));
    Bench::new(&[("shaders/a.comp", &shader)]).compile("a.comp", &[]).unwrap();
}

#[test]
fn the_generated_file_comes_before_all_others() {
    let shader = format!("{HEAD}#include \"live.glsl\"\nvoid main() {{ o[0] = uint(cutoff); }}\n");
    let mut bench = Bench::new(&[("shaders/a.comp", &shader), ("shaders/live.glsl", "nonsense")]);
    let live = "layout(set = 0, binding = 31, std140) uniform Live { float cutoff; };\n";
    let compiled = bench.compile_with("a.comp", &[], Some(live)).unwrap();
    assert!(compiled.reflection.bindings.iter().any(|b| b.name == "Live"));
    let wrong = bench.compile_with("a.comp", &[], Some("float cutoff = nothing;\n")).unwrap_err();
    assert!(wrong.contains("live.glsl (generated):1:16"), "{wrong}");
}

#[test]
fn defines_change_only_the_shaders_that_mention_them() {
    let a = format!("{HEAD}#include \"inc.glsl\"\nvoid main() {{ o[0] = A + inc; }} // B\n");
    let b = format!("{HEAD}#ifdef B\nvoid main() {{ o[0] = B; }}\n#endif\n");
    let mut bench = Bench::new(&[
        ("shaders/a.comp", &a),
        ("shaders/b.comp", &b),
        ("shaders/inc.glsl", "const uint inc = C;\n"),
    ]);
    let base = [("A", "1"), ("B", "2"), ("C", "3"), ("D", "4")];
    let first = bench.compile("a.comp", &base).unwrap();
    assert_eq!(first.defines, [("A".to_string(), "1".to_string()), ("C".to_string(), "3".to_string())]);
    bench.compile("b.comp", &base).unwrap();
    assert_eq!(bench.compiler.compiled_count(), 2);
    let other_b = [("A", "1"), ("B", "20"), ("C", "3"), ("D", "40")];
    assert_eq!(bench.compile("a.comp", &other_b).unwrap().spirv, first.spirv);
    assert_eq!(bench.compiler.compiled_count(), 2, "neither B nor D is mentioned in a.comp");
    bench.compile("b.comp", &other_b).unwrap();
    assert_eq!(bench.compiler.compiled_count(), 3);
    let other_c = [("A", "1"), ("B", "2"), ("C", "30"), ("D", "4")];
    assert_ne!(bench.compile("a.comp", &other_c).unwrap().spirv, first.spirv);
    assert_eq!(bench.compiler.compiled_count(), 4, "C is mentioned in what a.comp includes");
    bench.compile("a.comp", &base).unwrap();
    assert_eq!(bench.compiler.compiled_count(), 4, "the first outcome is still known");
}

#[test]
fn an_edited_include_is_compiled_again_by_the_same_compiler() {
    let shader = format!("{HEAD}#include \"inc.glsl\"\nvoid main() {{ o[0] = inc; }}\n");
    let mut bench = Bench::new(&[("shaders/a.comp", &shader), ("shaders/inc.glsl", "const uint inc = 1;\n")]);
    bench.compile("a.comp", &[]).unwrap();
    for (text, count) in [("const uint inc = 2;\n", 2), ("const uint inc = 1;\n", 2)] {
        let edited = Bench::new(&[("shaders/a.comp", &shader), ("shaders/inc.glsl", text)]);
        bench.files = edited.files;
        bench.compile("a.comp", &[]).unwrap();
        assert_eq!(bench.compiler.compiled_count(), count);
    }
}

#[test]
fn a_shader_can_have_a_default_for_a_define() {
    let shader =
        format!("{HEAD}#ifndef N\n#define N 4\n#endif\nshared uint s[N];\nvoid main() {{ s[0] = 1; }}\n");
    let mut bench = Bench::new(&[("shaders/a.comp", &shader)]);
    assert_eq!(bench.compile("a.comp", &[]).unwrap().reflection.shared_bytes, 16);
    assert_eq!(bench.compile("a.comp", &[("N", "8")]).unwrap().reflection.shared_bytes, 32);
    let again = format!("{HEAD}#define N 5\nvoid main() {{ }}\n");
    let found = errors_of(&[("shaders/a.comp", &again)], &[("N", "8")]);
    assert_eq!(found, ["5:9: N | `N` is a constant of the graph | declared again here"]);
}

#[test]
fn the_version_must_be_460() {
    let (empty, other) = ("the file is empty", "the shader is not declared to be GLSL 4.60");
    for (text, expected) in [
        ("", empty),
        ("\n", empty),
        ("void main() {}", other),
        ("#version 330\nvoid main() {}", other),
        ("#version 460 es\n", other),
        ("#version 46", other),
    ] {
        let mut bench = Bench::new(&[("shaders/a.comp", text)]);
        let error = bench.compile("a.comp", &[]).unwrap_err();
        assert!(error.contains(expected), "{text}: {error}");
    }
    for text in ["#version 460\nvoid main() {}", "// so\r\n#version 460 core\r\nvoid main() {}\r\n"] {
        Bench::new(&[("shaders/a.comp", text)]).compile("a.comp", &[]).unwrap();
    }
}

#[test]
fn a_byte_order_mark_and_foreign_comments_are_allowed() {
    let shader = format!("\u{feff}{HEAD}// \u{e9}\0\nvoid main() {{ /* \u{1f600} */ o[0] = 1; }}\n");
    Bench::new(&[("shaders/a.comp", &shader)]).compile("a.comp", &[]).unwrap();
    assert_eq!(
        errors("float \u{e9};"),
        ["5:7: \u{e9} | GLSL has only ASCII characters outside of comments | not allowed"]
    );
    assert_eq!(errors("uint \0;").len(), 1);
}

/// Serves in the worker's process; does nothing in the process that runs all tests.
#[test]
fn the_worker_of_the_other_tests_serves_when_it_is_asked() {
    serve_if_asked();
}

fn next(bench: &mut Bench, body: &str) -> Result<Compiled, String> {
    bench.files = Bench::new(&[("shaders/a.comp", &format!("{HEAD}{body}"))]).files;
    bench.compile("a.comp", &[])
}

const SOUND: &str = "void main() { o[0] = 1; }";
/// Crashes glslang: a shared array has the name of a block.
const CRASH: &str = "shared uint Out[64];\nvoid main() { Out[0] = 1; }";

/// Returns a shader whose macros expand to a sum of 2^`doublings` terms.
fn bomb(doublings: usize) -> String {
    let lines: String = (1..=doublings).map(|i| format!("#define M{i} M{0} + M{0}\n", i - 1)).collect();
    format!("#define M0 o[1]\n{lines}void main() {{ o[0] = M{doublings}; }}")
}

#[test]
fn a_shader_that_crashes_the_compiler_is_an_error() {
    let mut bench = Bench::new(&[]).in_worker(Limits::default());
    for _ in 0..2 {
        let error = next(&mut bench, CRASH).unwrap_err();
        assert!(error.contains("the compiler crashed on this shader"), "{error}");
        next(&mut bench, SOUND).expect("the next one is compiled");
        let error = next(&mut bench, "void main() { x = 1; }").unwrap_err();
        assert!(error.contains("undeclared"), "{error}");
    }
}

#[test]
fn a_shader_that_takes_too_much_memory_or_time_is_an_error() {
    let little = Limits { memory_bytes: 160 << 20, time: Duration::from_secs(60) };
    let mut bench = Bench::new(&[]).in_worker(little);
    // With long names, memory runs out before time.
    let error = next(&mut bench, &bomb(40).replace("o[1]", &"o".repeat(1000))).unwrap_err();
    assert!(error.contains("the compiler took over 160 MiB of memory for this shader"), "{error}");
    next(&mut bench, SOUND).expect("the next one is compiled");
    let short = Limits { memory_bytes: 64 << 30, time: Duration::from_millis(1500) };
    let mut bench = bench.in_worker(short);
    let error = next(&mut bench, &bomb(40)).unwrap_err();
    assert!(error.contains("the compiler ran out of its 1.5 s on this shader"), "{error}");
    let before = bench.compiler.compiled_count();
    assert_eq!(next(&mut bench, &bomb(40)).unwrap_err(), error, "the same error, without compiling again");
    assert_eq!(bench.compiler.compiled_count(), before);
    next(&mut bench, SOUND).expect("the next one is compiled");
}

#[test]
fn a_cancelled_compilation_ends_and_the_next_one_is_compiled() {
    let mut bench =
        Bench::new(&[]).in_worker(Limits { memory_bytes: 64 << 30, time: Duration::from_secs(60) });
    let begun = std::time::Instant::now();
    bench.compiler.set_cancel(Cancel::new(move || begun.elapsed() > Duration::from_millis(50)));
    let error = next(&mut bench, &bomb(40)).unwrap_err();
    assert!(error.contains(CANCELLED), "{error}");
    bench.compiler.set_cancel(Cancel::default());
    next(&mut bench, SOUND).expect("the next one is compiled");
}

#[test]
fn a_worker_that_ended_while_nobody_asked_is_replaced() {
    let mut bench = Bench::new(&[]).in_worker(Limits::default());
    next(&mut bench, SOUND).expect("compiled");
    bench.compiler.worker.as_mut().expect("a worker").kill();
    next(&mut bench, "void main() { o[0] = 2; }").expect("compiled by another");
}

#[cfg(unix)]
#[test]
fn a_worker_in_which_the_compiler_does_not_start_is_replaced() {
    let reply = r#"{"Err":{"Crash":"ERROR: glslang does not start"}}"#;
    let begun = tempfile::NamedTempFile::new().expect("a file");
    let reply = format!(r"\{:03o}\0\0\0{reply}", reply.len());
    let magic = r"\nsplatgraph shader compiler 1\n";
    let script = format!("echo >> {}; printf '{magic}{reply}{reply}'; exec cat", begun.path().display());
    let arguments = ["-c", &script].map(Into::into).into();
    let mut bench = Bench::new(&[]);
    let worker = Worker { arguments, ..Worker::new("/bin/sh") };
    bench.compiler = Glslang::in_worker(worker);
    for attempt in 1..=2 {
        let error = next(&mut bench, SOUND).unwrap_err();
        assert!(error.contains("glslang does not start"), "{error}");
        assert_eq!(std::fs::read(begun.path()).expect("readable").len(), attempt);
    }
}

#[test]
fn a_program_that_does_not_serve_is_an_error() {
    for program in ["/bin/true", "/nowhere/at all"] {
        let mut bench = Bench::new(&[]);
        bench.compiler = Glslang::in_worker(Worker::new(program));
        let error = next(&mut bench, SOUND).unwrap_err();
        assert!(error.contains(&format!("the compiler's process {program} cannot be started")), "{error}");
    }
}

#[test]
fn a_worker_without_threads_is_an_error_that_names_the_limit() {
    let script = format!("exit {}", super::worker::NO_THREAD);
    let mut bench = Bench::new(&[]);
    let worker = Worker { arguments: ["-c", &script].map(Into::into).into(), ..Worker::new("/bin/sh") };
    bench.compiler = Glslang::in_worker(worker);
    let error = next(&mut bench, SOUND).unwrap_err();
    assert!(error.contains("(it could not start a thread; a limit of processes"), "{error}");
}

#[test]
fn a_worker_that_does_not_serve_starts_no_worker_of_its_own() {
    if std::env::var_os(super::worker::VARIABLE).is_some() {
        let error = next(&mut Bench::new(&[]).in_worker(Limits::default()), SOUND).unwrap_err();
        assert!(error.contains("found a worker that compiles"), "{error}");
        return;
    }
    let test = "shader::compile::tests::a_worker_that_does_not_serve_starts_no_worker_of_its_own";
    let mut again = std::process::Command::new(std::env::current_exe().expect("this program"));
    let ended = again.args(["--exact", test]).env(super::worker::VARIABLE, "").status().expect("started");
    assert!(ended.success());
}

#[test]
fn a_constant_beyond_the_int_of_an_if_can_be_used_elsewhere() {
    let text = format!("{HEAD}void main() {{ o[0] = P; }}");
    Bench::new(&[("shaders/a.comp", &text)]).compile("a.comp", &[("P", "3000000000u")]).unwrap();
}

#[test]
fn a_shader_declares_the_name_of_a_constant_where_the_graph_has_none() {
    let shader = format!("{HEAD}const uint BINS = 4u;\nvoid main() {{ o[0] = BINS; }}\n");
    Bench::new(&[("shaders/a.comp", &shader)]).compile("a.comp", &[]).unwrap();
    let default = shader.replace("const uint BINS = 4u;", "#ifndef BINS\nconst uint BINS = 4u;\n#endif");
    for defines in [&[][..], &[("BINS", "256")]] {
        Bench::new(&[("shaders/a.comp", &default)]).compile("a.comp", defines).unwrap();
    }
}
