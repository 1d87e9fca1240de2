use super::super::compile::Glslang;
use super::super::{ShaderCompiler, ShaderRequest};
use super::*;
use crate::ir::{Features, ShaderStage};
use crate::numbers::Random;
use crate::source::{Library, SourceMap, render};

fn compile(stage: ShaderStage, body: &str) -> Result<(Vec<u32>, Reflection), String> {
    let mut files = SourceMap::new(Library::default());
    let file = files.add("test.glsl", format!("#version 460\n{body}"));
    let request = ShaderRequest { file, stage, defines: &[], unfit: &[], live_glsl: None };
    match Glslang::new().compile(&mut files, &request) {
        Ok(compiled) => Ok((compiled.spirv.to_vec(), compiled.reflection)),
        Err(diagnostics) => Err(render(&files, &diagnostics, false)),
    }
}

fn reflected(stage: ShaderStage, body: &str) -> Reflection {
    compile(stage, body).unwrap_or_else(|error| panic!("{error}")).1
}

fn compute(body: &str) -> Reflection {
    reflected(ShaderStage::Compute, &format!("layout(local_size_x = 64) in;\n{body}"))
}

fn refused(body: &str) -> String {
    compile(ShaderStage::Compute, body).expect_err("should be refused")
}

fn find<'r>(reflection: &'r Reflection, name: &str) -> &'r ReflectedBinding {
    let binding = reflection.bindings.iter().find(|b| b.name == name);
    binding.unwrap_or_else(|| panic!("no {name} in {reflection:#?}"))
}

fn reads_writes(reflection: &Reflection, name: &str) -> (bool, bool) {
    let binding = find(reflection, name);
    (binding.reads, binding.writes)
}

const IN_OUT: &str = "layout(set = 0, binding = 0, std430) buffer In { uint a[]; };
layout(set = 0, binding = 1, std430) buffer Out { uint b[]; };\n";

#[test]
fn a_buffer_without_qualifier_that_is_only_read_is_only_read() {
    let r = compute(&format!("{IN_OUT}void main() {{ b[1] = a[0]; }}"));
    assert_eq!(reads_writes(&r, "In"), (true, false));
    assert_eq!(reads_writes(&r, "Out"), (false, true));
}

#[test]
fn accesses_by_atomics_alone_are_told_from_others() {
    let bindings = |body: &str| {
        let image = "layout(set = 0, binding = 2, r32ui) uniform uimage2D image;";
        let r = compute(&format!("{IN_OUT}{image}\nvoid main() {{ {body} }}"));
        r.bindings
    };
    let atomics_only = |body: &str| bindings(body).iter().map(|b| b.atomics_only).collect::<Vec<_>>();
    let atomics = |body: &str| bindings(body).iter().map(|b| b.atomics).collect::<Vec<_>>();
    assert_eq!(atomics_only("atomicAdd(b[0], 1); atomicMax(b[1], b.length());"), [true]);
    assert_eq!(atomics_only("atomicAdd(b[0], 1); b[1] = 2;"), [false]);
    assert_eq!(atomics_only("if (b[1] == 2) atomicAdd(b[0], 1);"), [false]);
    assert_eq!(atomics_only("imageAtomicAdd(image, ivec2(0), atomicAdd(b[0], a[0]));"), [false, true, true]);
    assert_eq!(atomics_only("b[0] = imageLoad(image, ivec2(0)).x;"), [false, false]);
    assert_eq!(atomics_only("if (b.length() > 3) imageAtomicAdd(image, ivec2(0), 1);"), [false, true]);
    assert_eq!(
        atomics("b[0] = imageAtomicAdd(image, ivec2(0), 1) + imageLoad(image, ivec2(0)).x;"),
        [false, true]
    );
    assert_eq!(atomics("b[0] = imageLoad(image, ivec2(0)).x;"), [false, false]);
}

#[test]
fn a_block_that_is_stored_to_before_anything_else_is_told_from_others() {
    let writes_first = |code: &str| {
        let r = compute(&format!("{IN_OUT}{code}"));
        r.bindings.iter().find(|binding| binding.name == "Out").expect("the block").writes_first
    };
    assert!(writes_first("void main() { b[0] = 0; b[1] += 2; }"));
    assert!(!writes_first("void main() { b[1] += 2; b[0] = 0; }"));
    assert!(!writes_first("void main() { atomicAdd(b[0], 1); b[0] = 0; }"));
    assert!(writes_first("void count() { b[1] += 2; }\nvoid main() { b[0] = 0; count(); }"));
}

#[test]
fn what_unreachable_functions_touch_is_left_out() {
    let r = compute(&format!("{IN_OUT}void never() {{ b[0] = a[0]; }}\nvoid main() {{ b[1] = 3; }}"));
    assert_eq!(r.bindings.len(), 1);
    assert_eq!(reads_writes(&r, "Out"), (false, true));
}

#[test]
fn a_declared_block_that_no_code_mentions_is_left_out() {
    // A graph cannot bind the sampler.
    let sampler = "layout(set = 0, binding = 2) uniform sampler2D tex;";
    assert_eq!(compute(&format!("{IN_OUT}{sampler}void main() {{}}")).bindings, []);
}

#[test]
fn accesses_in_called_functions_count() {
    let r = compute(&format!(
        "{IN_OUT}uint get(uint i) {{ return a[i]; }}\nvoid put(uint i) {{ b[i] = get(i); }}\nvoid main() {{ put(7); }}"
    ));
    assert_eq!(reads_writes(&r, "In"), (true, false));
    assert_eq!(reads_writes(&r, "Out"), (false, true));
}

#[test]
fn an_array_element_as_inout_argument_is_read_and_written() {
    let r = compute(&format!("{IN_OUT}void add(inout uint x) {{ x += 1; }}\nvoid main() {{ add(b[0]); }}"));
    assert_eq!(reads_writes(&r, "Out"), (true, true));
}

#[test]
fn an_image_as_function_argument_has_the_accesses_of_the_function() {
    let r = compute(
        "#extension GL_EXT_shader_image_load_formatted : require
         layout(set = 0, binding = 0) uniform image2D from;
         layout(set = 0, binding = 1) uniform image2D to;
         layout(set = 0, binding = 2) uniform image2D sized;
         float get(image2D i, ivec2 p) { return imageLoad(i, p).x; }
         void put(image2D i, ivec2 p, float v) { imageStore(i, p, vec4(v)); }
         void main() { put(to, imageSize(sized), get(from, ivec2(0))); }",
    );
    assert_eq!(reads_writes(&r, "from"), (true, false));
    assert_eq!(reads_writes(&r, "to"), (false, true));
    assert_eq!(reads_writes(&r, "sized"), (false, false));
    assert_eq!(find(&r, "to").kind, ReflectedKind::StorageImage { format: None });
}

#[test]
fn a_storage_image_has_its_format() {
    let r = compute(
        "layout(set = 0, binding = 3, rgba16f) uniform image2D color;
         void main() { imageStore(color, ivec2(0), imageLoad(color, ivec2(1))); }",
    );
    assert_eq!(find(&r, "color").kind, ReflectedKind::StorageImage { format: Some(Format::Rgba16Float) });
    assert_eq!(reads_writes(&r, "color"), (true, true));
}

#[test]
fn the_length_of_an_array_is_neither_read_nor_written() {
    let r = compute(&format!("{IN_OUT}void main() {{ b[0] = a.length(); }}"));
    assert_eq!(reads_writes(&r, "In"), (false, false));
}

#[test]
fn atomics_read_and_write_but_atomic_load_only_reads_and_atomic_store_only_writes() {
    let r = compute(
        "#extension GL_KHR_memory_scope_semantics : require
         layout(set = 0, binding = 0) buffer A { uint a; };
         layout(set = 0, binding = 1) buffer B { uint b; };
         layout(set = 0, binding = 2) buffer C { uint c; };
         layout(set = 0, binding = 3, r32ui) uniform uimage2D counts;
         void main() {
             atomicAdd(a, 1);
             atomicStore(c, atomicLoad(b, gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsAcquire),
                         gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelease);
             imageAtomicMax(counts, ivec2(0), 1u);
         }",
    );
    assert_eq!(reads_writes(&r, "A"), (true, true));
    assert_eq!(reads_writes(&r, "B"), (true, false));
    assert_eq!(reads_writes(&r, "C"), (false, true));
    assert_eq!(reads_writes(&r, "counts"), (true, true));
}

#[test]
fn a_component_of_a_vector_can_be_written_alone() {
    let r = compute(
        "layout(set = 0, binding = 0) buffer V { vec4 v[]; };
         void main() { v[3].y = 1.0; }",
    );
    assert_eq!(reads_writes(&r, "V"), (false, true));
}

#[test]
fn an_array_of_blocks_is_one_binding_with_a_count() {
    let r = compute(
        "layout(set = 0, binding = 4, std430) readonly buffer Sh { vec4 v[]; } sh[3 * 4];
         layout(set = 0, binding = 5, std430) buffer Out { vec4 o[]; };
         void main() { o[0] = sh[1].v[gl_GlobalInvocationID.x]; }",
    );
    let sh = find(&r, "Sh");
    assert_eq!((sh.set, sh.binding, sh.count), (0, 4, 12));
    assert_eq!(sh.kind, ReflectedKind::StorageBuffer { stride: Some(16), fixed_bytes: 0 });
    assert_eq!((sh.reads, sh.writes), (true, false));
}

#[test]
fn strides_of_nested_structs_and_the_bytes_before_the_array() {
    let r = compute(
        "struct Inner { vec3 p; float w; mat3 m; };
         struct Outer { Inner i[2]; uint last; };
         layout(set = 0, binding = 0, std430) buffer Splats { uvec4 head; uint n; Outer o[]; };
         layout(set = 0, binding = 1, std430) buffer Floats { float f[]; };
         layout(set = 0, binding = 2, std430) buffer Fixed { uint x; uint y[7]; };
         layout(set = 0, binding = 3, std430) buffer Tight { uint x; float f[]; } tight;
         void main() { f[0] = o[n].i[1].p.x; y[0] = x; tight.x = 1; }",
    );
    // Inner: 12 + 4 + 3 x 16 = 64. Outer: 2 x 64 + 4, rounded up to a multiple of 16.
    let stride = |s, fixed_bytes| ReflectedKind::StorageBuffer { stride: s, fixed_bytes };
    assert_eq!(find(&r, "Splats").kind, stride(Some(144), 32));
    assert_eq!(find(&r, "Floats").kind, stride(Some(4), 0));
    assert_eq!(find(&r, "Fixed").kind, stride(None, 32));
    assert_eq!(find(&r, "Tight").kind, stride(Some(4), 4));
}

#[test]
fn blocks_of_one_scalar_type_are_told_from_others_at_any_depth() {
    use MemberKind::{Float, Int, Other, Uint};
    for (block, used, scalar) in [
        ("buffer Data { float f[]; }", "f[0]", Float),
        ("buffer Data { vec4 v; mat3 m; S s[]; }", "s[0].b[1]", Float),
        ("uniform Data { vec2 v[3]; }", "v[0].x", Float),
        ("buffer Data { float f; uint n; }", "f", Other),
        ("buffer Data { uvec2 u[]; }", "u[0].x", Uint),
        ("buffer Data { int i; ivec2 v[]; }", "i", Int),
        ("buffer Data { double d; }", "d", Other),
        ("buffer Data { T t[]; }", "t[0].s.a.x", Other),
    ] {
        let r = compute(&format!(
            "struct S {{ vec3 a; float b[2]; }};
             struct T {{ S s; int n; }};
             layout(set = 0, binding = 0) buffer Out {{ uint o; }};
             layout(set = 0, binding = 1) {block} data[2];
             void main() {{ o = uint(data[1].{used}); }}",
        ));
        assert_eq!(find(&r, "Data").scalar, scalar, "{block}");
    }
}

#[test]
fn words_of_a_storage_block_have_the_names_and_types_of_its_members() {
    let words = |block: &str, used: &str| {
        let r = compute(&format!(
            "#extension GL_EXT_shader_explicit_arithmetic_types : require
             struct S {{ vec3 a; int n; }};
             struct T {{ S s; uint64_t wide; vec3 b[2]; }};
             layout(set = 0, binding = 0) buffer Out {{ uint o; }};
             layout(set = 0, binding = 1) {block} data;
             void main() {{ o = uint(data.{used}); }}",
        ));
        let words = find(&r, "Data").words.clone();
        let text = words.iter().map(|word| format!("{}@{}{:?}", word.name, word.offset, word.kind));
        text.collect::<Vec<_>>().join(" ").replace("Float", "f").replace("Uint", "u").replace("Int", "i")
    };
    assert_eq!(words("buffer Data { float f[]; }", "f[0]"), "@0f");
    assert_eq!(words("buffer Data { uvec2 u[]; }", "u[0].x"), "x@0u y@4u");
    assert_eq!(words("buffer Data { S s[]; }", "s[0].n"), "a.x@0f a.y@4f a.z@8f n@12i");
    assert_eq!(
        words("buffer Data { T t[]; }", "t[0].s.n"),
        "s.a.x@0f s.a.y@4f s.a.z@8f s.n@12i wide@16Other wide@20Other \
         b[0].x@32f b[0].y@36f b[0].z@40f b[1].x@48f b[1].y@52f b[1].z@56f"
    );
    let header = "count@0u scale@4f x@16f y@20f z@24f w@28f";
    assert_eq!(words("buffer Data { uint count; float scale; vec4 v[]; }", "count"), header);
    assert_eq!(
        words("buffer Data { mat3x2 m; layout(row_major) mat3x2 r; }", "m[0].x"),
        "m[0].x@0f m[0].y@4f m[1].x@8f m[1].y@12f m[2].x@16f m[2].y@20f \
         r[0].x@32f r[1].x@36f r[2].x@40f r[0].y@48f r[1].y@52f r[2].y@56f"
    );
    assert_eq!(
        words("buffer Data { layout(row_major) dmat2 m; }", "m[0].x").replace("Other", ""),
        "m[0].x@0 m[0].x@4 m[1].x@8 m[1].x@12 m[0].y@16 m[0].y@20 m[1].y@24 m[1].y@28"
    );
    assert_eq!(
        words("buffer Data { layout(row_major) f16mat3x2 m; }", "m[0].x").replace("Other", ""),
        "m[0].x@0 m[2].x@4 m[0].y@8 m[2].y@12",
        "two small scalars share a word"
    );
    assert_eq!(words("buffer Data { float table[64]; }", "table[0]").matches('@').count(), 64);
    assert_eq!(words("buffer Data { float table[65]; }", "table[0]"), "", "too many to list");
    assert_eq!(words("uniform Data { float f; }", "f"), "", "members of uniform blocks are listed elsewhere");
}

#[test]
fn uniform_members_have_offsets_and_kinds() {
    let r = compute(
        "layout(set = 0, binding = 31, std140) uniform Live { float cutoff; int k; uint n; vec3 v; mat4 m; float a[2]; };
         layout(set = 0, binding = 0) buffer Out { float o; };
         void main() { o = cutoff; }",
    );
    let live = find(&r, "Live");
    assert_eq!((live.binding, live.reads, live.writes), (31, true, false));
    let ReflectedKind::UniformBuffer { bytes, members } = &live.kind else { panic!("{live:?}") };
    assert_eq!(*bytes, 128);
    let members: Vec<_> = members.iter().map(|m| (m.name.as_str(), m.offset, m.kind)).collect();
    assert_eq!(
        members,
        [
            ("cutoff", 0, MemberKind::Float),
            ("k", 4, MemberKind::Int),
            ("n", 8, MemberKind::Uint),
            ("v", 16, MemberKind::Other),
            ("m", 32, MemberKind::Other),
            ("a", 96, MemberKind::Other),
        ]
    );
}

#[test]
fn members_that_the_code_does_not_read_are_known() {
    let block = "uniform Live { float a; uint b; vec4 c; float d[2]; mat4 e; }";
    let used = |block: &str, code: &str| -> String {
        let r = compute(&format!(
            "layout(set = 0, binding = 31, std140) {block};
             layout(set = 0, binding = 0) buffer Out {{ float o; uint i; }};
             float unused() {{ return a; }}
             {code}"
        ));
        let ReflectedKind::UniformBuffer { members, .. } = &find(&r, "Live").kind else { panic!("{r:?}") };
        members.iter().filter(|m| m.used).map(|m| m.name.as_str()).collect()
    };
    assert_eq!(used(block, "void main() { o = float(b); }"), "b");
    assert_eq!(used(block, "float f() { return d[i]; } void main() { o = c.y * f(); }"), "cd");
    assert_eq!(used(block, "void main() { if (false) o = e[1][2]; }"), "e", "code that never runs counts");
    let named = format!("{block} all; float a");
    assert_eq!(used(&named, "void main() { o = all.a + all.c.x; }"), "ac");
    let several = format!("{block} all[2]; float a");
    assert_eq!(
        used(&several, "void main() { o = all[1].a; }"),
        "abcde",
        "arrays of blocks are not told apart"
    );
    let r = compute(
        "layout(push_constant) uniform Push { uint a; uint b; } push;
         layout(set = 0, binding = 0) buffer Out { uint o; };
         void main() { o = push.b; }",
    );
    let members: Vec<bool> = r.push.expect("push constants").members.iter().map(|m| m.used).collect();
    assert_eq!(members, [false, true]);
}

#[test]
fn push_constants_are_listed_by_name() {
    let r = compute(
        "layout(push_constant) uniform Push { uint shift; float scale; int bias; } push;
         layout(set = 0, binding = 0) buffer Out { uint o; };
         void main() { o = push.shift; }",
    );
    let push = r.push.expect("push constants");
    assert_eq!(push.bytes, 12);
    let members: Vec<_> = push.members.iter().map(|m| (m.name.as_str(), m.offset, m.kind)).collect();
    assert_eq!(
        members,
        [("shift", 0, MemberKind::Uint), ("scale", 4, MemberKind::Float), ("bias", 8, MemberKind::Int),]
    );
    assert_eq!(r.bindings.len(), 1);
}

#[test]
fn local_size_is_read_however_it_is_given() {
    let local_size =
        |layout: &str| reflected(ShaderStage::Compute, &format!("{layout}\nvoid main() {{}}")).local_size;
    assert_eq!(local_size("layout(local_size_x = 8, local_size_y = 4) in;"), [8, 4, 1]);
    assert_eq!(local_size("layout(local_size_x_id = 1) in; layout(local_size_x = 128) in;"), [128, 1, 1]);
    assert_eq!(local_size("layout(local_size_x = 2, local_size_y_id = 7, local_size_z = 3) in;"), [2, 1, 3]);
    assert_eq!(local_size(""), [1, 1, 1]);
}

#[test]
fn shared_memory_is_summed_with_specialization_defaults() {
    let r = compute(
        "layout(constant_id = 0) const uint N = 256;
         struct S { vec3 a; float b; };
         shared uint table[N * 2];
         shared S s[3];
         shared vec3 lone[2];
         void main() { table[0] = 1; s[0].b = 2.0; lone[1] = vec3(0); }",
    );
    assert_eq!(r.shared_bytes, 2048 + 48 + 32);
    assert_eq!(compute("void main() {}").shared_bytes, 0);
}

#[test]
fn the_binding_of_live_parameters_is_reserved() {
    let block = |name: &str| {
        format!(
            "layout(set = 0, binding = 31) uniform {name} {{ uint share; }};\n{IN_OUT}void main() {{ b[0] = share; }}"
        )
    };
    compute(&block("Live"));
    let error = refused(&block("Mine"));
    assert!(error.contains("`Mine` is binding 31, which is reserved for live parameters"), "{error}");
}

#[test]
fn large_local_and_global_variables_are_refused_and_constant_tables_are_not() {
    let refused = |code: &str| refused(&format!("{IN_OUT}{code}"));
    for declared in ["void main() { uint table[20000];", "uint table[20000]; void main() {"] {
        let error = refused(&format!("{declared} table[a[0]] = 1; b[0] = table[a[1]]; }}"));
        let expected = "expected at most 64 KiB of local variables (on any device), found 80";
        assert!(error.contains(expected) && error.contains("the most in `table`"), "{error}");
        assert!(error.contains("^^^^^"), "{error}");
    }
    let together = refused(
        "void f(uint i) { uint t[9000]; t[i] = 1; b[i] = t[a[i]]; }
        void main() { uint u[9000]; u[a[0]] = 1; b[1] = u[a[1]]; f(3); }",
    );
    assert!(together.contains("local variables"), "{together}");
    compute(&format!(
        "{IN_OUT}void f(uint i) {{ uint t[90000]; t[i] = 1; b[i] = t[a[i]]; }}
        void main() {{ uint u[16000]; u[a[0]] = 1; b[0] = u[a[1]]; }}"
    ));
    let table = format!("const uint TABLE[9000] = uint[9000]({}0);", "7, ".repeat(8999));
    compute(&format!("{IN_OUT}{table}\nvoid main() {{ b[0] = TABLE[a[0]]; b[1] = TABLE[a[1]]; }}"));
}

#[test]
fn optional_features_are_those_that_the_code_needs() {
    let features = |stage, extension: &str, body: &str| {
        let text = format!("#extension {extension} : require\n{IN_OUT}{body}");
        reflected(stage, &text).features
    };
    let compute = |extension: &str, body: &str| features(ShaderStage::Compute, extension, body);
    let int64 = "GL_EXT_shader_explicit_arithmetic_types_int64";
    let atomic64 = "GL_EXT_shader_atomic_int64";
    let float = "GL_EXT_shader_atomic_float";
    let longs = "layout(set = 0, binding = 2) buffer Longs { uint64_t longs[]; };\nshared uint64_t total;\n";
    let floats = "layout(set = 0, binding = 2) buffer Floats { float floats[]; };\nshared float total;\n";
    let with = |declarations: &str, main: &str| format!("{declarations}void main() {{ {main} }}");
    assert_eq!(compute(int64, &with("", "b[0] = a[0];")), Features::empty());
    assert_eq!(compute(int64, &with("", "b[0] = uint(uint64_t(a[0]) >> 3);")), Features::INT64);
    assert_eq!(compute(int64, &with("", "b[0] = uint(double(a[0]));")), Features::FLOAT64);
    let needs64 = format!("{atomic64} : require\n#extension {int64}");
    assert_eq!(
        compute(&needs64, &with(longs, "atomicAdd(longs[0], uint64_t(a[0]));")),
        Features::INT64 | Features::BUFFER_INT64_ATOMICS
    );
    assert_eq!(
        compute(&needs64, &with(longs, "atomicMax(total, uint64_t(a[0]));")),
        Features::INT64 | Features::SHARED_INT64_ATOMICS
    );
    assert_eq!(
        compute(float, &with(floats, "atomicAdd(floats[0], 1.0);")),
        Features::BUFFER_FLOAT_ATOMIC_ADD
    );
    assert_eq!(
        compute(float, &with(floats, "floats[0] = atomicExchange(total, 1.0);")),
        Features::SHARED_FLOAT_ATOMICS
    );
    assert_eq!(compute("GL_EXT_scalar_block_layout", &with("", "b[0] = a[0];")), Features::SCALAR_LAYOUT);
    let planes = "layout(set = 0, binding = 2) buffer Planes { uint p[]; } planes[3];\n";
    assert_eq!(compute(int64, &with(planes, "b[0] = planes[2].p[a[0]];")), Features::empty());
    assert_eq!(compute(int64, &with(planes, "b[0] = planes[a[0]].p[0];")), Features::STORAGE_BUFFER_INDEXING);
    let vote = "GL_KHR_shader_subgroup_vote";
    let body = with("", "b[0] = subgroupAll(a[0] > 1) ? 1 : 0;");
    let group = Features::SUBGROUP_BASIC | Features::SUBGROUP_VOTE;
    assert_eq!(compute(vote, &body), group);
    assert_eq!(
        features(ShaderStage::Fragment, vote, &body),
        group | Features::SUBGROUPS_IN_FRAGMENT | Features::FRAGMENT_STORES
    );
    assert_eq!(features(ShaderStage::Vertex, vote, &with("", "b[0] = a[0];")), Features::VERTEX_STORES);
    assert_eq!(
        compute(
            "GL_EXT_subgroup_uniform_control_flow",
            "void main() [[subgroup_uniform_control_flow]] { b[0] = a[0]; }"
        ),
        Features::SUBGROUP_UNIFORM_CONTROL_FLOW
    );
}

#[test]
fn capabilities_that_no_backend_enables_are_refused() {
    let error = refused(&format!(
        "#extension GL_ARB_shader_clock : require\n{IN_OUT}void main() {{ b[0] = clock2x32ARB().x; }}"
    ));
    assert!(error.contains("ShaderClockKHR are not supported"), "{error}");
    let error = refused(&format!(
        "#extension GL_EXT_shader_atomic_float2 : require\nshared float m;\n{IN_OUT}void main() {{ atomicMax(m, 1.0); }}"
    ));
    assert!(error.contains("AtomicFloat32MinMaxEXT are not supported"), "{error}");
    let error = refused(&format!(
        "#extension GL_EXT_maximal_reconvergence : require\nlayout(local_size_x = 64) in;\n{IN_OUT}void main() [[maximally_reconverges]] {{ b[0] = a[0]; }}"
    ));
    assert!(error.contains("SPV_KHR_maximal_reconvergence are not supported"), "{error}");
}

#[test]
fn stage_inputs_and_outputs_are_listed_by_location() {
    let r = reflected(
        ShaderStage::Vertex,
        "layout(location = 2) flat out uint id;
         layout(location = 0) out vec2 uv;
         layout(location = 1) out vec4 color;
         layout(location = 3) out Block { mat3x2 m; layout(location = 8) flat ivec3 i; float f[2]; } block;
         layout(location = 0) in float weight[2];
         void main() { id = gl_InstanceIndex; uv = vec2(weight[0]); color = vec4(0); block.m = mat3x2(1); block.i = ivec3(1);
                       block.f[0] = 1.0; gl_Position = vec4(0); }",
    );
    let list = |varyings: &[Varying]| -> Vec<String> {
        varyings.iter().map(|v| format!("{} {} {}", v.location, v.glsl_type, v.name)).collect()
    };
    assert_eq!(r.stage, ShaderStage::Vertex);
    assert_eq!(list(&r.inputs), ["0 float[2] weight"]);
    assert_eq!(
        list(&r.outputs),
        ["0 vec2 uv", "1 vec4 color", "2 uint id", "3 mat3x2 m", "8 ivec3 i", "9 float[2] f"]
    );
    let r = reflected(
        ShaderStage::Fragment,
        "layout(location = 2) flat in uint id; layout(location = 0) out vec4 color;
         void main() { color = vec4(id); }",
    );
    assert_eq!((list(&r.inputs), list(&r.outputs)), (vec!["2 uint id".into()], vec!["0 vec4 color".into()]));
}

#[test]
fn members_without_locations_of_their_own_take_those_after_the_members_before_them() {
    let r = reflected(
        ShaderStage::Vertex,
        "struct Pair { float x; vec2 y; };
         layout(location = 1) out Block { mat2 m[2]; Pair pair; vec4 v[2]; float last; } block;
         void main() { block.m[0] = mat2(1); block.pair.x = 1.0; block.v[1] = vec4(0); block.last = 2.0; gl_Position = vec4(0); }",
    );
    let locations: Vec<_> = r.outputs.iter().map(|v| (v.name.as_str(), v.location)).collect();
    assert_eq!(locations, [("m", 1), ("pair", 5), ("v", 7), ("last", 9)]);
}

#[test]
fn what_is_no_module_is_an_error() {
    assert!(reflect(&[]).is_err());
    assert!(reflect(&[0; 100]).is_err());
    let (spirv, _) = compile(ShaderStage::Compute, "void main() {}").unwrap();
    assert!(reflect(&spirv).is_ok());
    assert!(reflect(&spirv[..5]).is_err(), "a module without an entry point");
}

#[test]
fn a_type_that_is_defined_twice_is_an_error() {
    const OP_TYPE_VOID: u32 = 19;
    let (mut spirv, _) = compile(ShaderStage::Compute, "void main() {}").unwrap();
    let at = spirv.iter().position(|word| *word == 2 << 16 | OP_TYPE_VOID).expect("there is a void");
    let again = [spirv[at], spirv[at + 1]];
    spirv.splice(at..at, again);
    assert!(reflect(&spirv).unwrap_err().contains("defined twice"));
}

#[test]
fn damaged_modules_never_panic() {
    let body = format!(
        "{IN_OUT}layout(set = 0, binding = 2, std140) uniform U {{ mat4 m; vec3 v[2]; }};
         layout(set = 0, binding = 3, rgba16f) uniform image2D image;
         layout(constant_id = 0) const uint N = 4;
         shared mat3 s[N * 2];
         void f(inout uint x) {{ x += 1; s[x % N] = mat3(m); }}
         void main() {{ f(b[a[0]]); atomicAdd(b[1], 1); imageStore(image, ivec2(0), vec4(v[0], 1)); }}"
    );
    let (spirv, _) = compile(ShaderStage::Compute, &body).unwrap();
    for length in 0..spirv.len() {
        let _ = reflect(&spirv[..length]);
    }
    let mut random = Random(1);
    let mut next = |below: usize| random.below(below);
    for _ in 0..3000 {
        let mut damaged = spirv.clone();
        for _ in 0..1 + next(3) {
            let at = next(damaged.len());
            damaged[at] = match next(4) {
                0 => damaged[next(spirv.len())],
                1 => damaged[at] ^ (1 << next(32)),
                2 => next(spirv[3] as usize) as u32,
                _ => u32::MAX,
            };
        }
        let _ = reflect(&damaged);
    }
}

#[test]
fn a_position_is_used_if_code_that_runs_mentions_it() {
    let uses = |body: &str| reflected(ShaderStage::Vertex, body).uses_position;
    assert!(uses("void main() { gl_Position = vec4(1.0); }"));
    assert!(uses("void put(float x) { gl_Position.x = x; }\nvoid main() { put(1.0); }"));
    assert!(uses(
        "out gl_PerVertex { vec4 gl_Position; float gl_PointSize; };\nvoid main() { gl_Position = vec4(1.0); }"
    ));
    assert!(!uses("void main() {}"));
    assert!(!uses("void main() { gl_PointSize = 1.0; }"));
    assert!(!uses("void put() { gl_Position = vec4(1.0); }\nvoid main() {}"));
}

#[test]
fn rows_of_workgroups_are_ignored_by_code_that_numbers_one_row() {
    let ignores = |index: &str| {
        let block = "layout(set = 0, binding = 0) buffer Out { uint o[]; };\n";
        compute(&format!("{block}void main() {{ o[{index}] = 1; }}")).ignores_rows
    };
    for index in ["gl_GlobalInvocationID.x", "gl_WorkGroupID.x * 64 + gl_LocalInvocationIndex"] {
        assert!(ignores(index), "{index}");
    }
    for index in ["gl_LocalInvocationIndex", "gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x"] {
        assert!(!ignores(index), "{index}");
    }
}
