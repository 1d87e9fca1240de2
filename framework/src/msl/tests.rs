//! Tests translated texts, argument indices, and the errors for shaders that are invalid or that Metal cannot run.

use super::*;
use crate::build;
use crate::ir::{Catalog, DeviceFacts, Request};
use crate::shader::{Glslang, ShaderCompiler, ShaderRequest};
use crate::source::{Library, SourceMap, render};

/// Builds a plan for SIMD-groups of 32: fills of `buffers` buffers of 64 words, and one dispatch that binds them.
fn plan(shader: &str, buffers: usize) -> Plan {
    let names: Vec<String> = (0..buffers).map(|i| format!("b{i}")).collect();
    let resources: String =
        names.iter().map(|name| format!("\"{name}\": Buffer(stride: 4, count: 64), ")).collect();
    let graph = format!(
        "Graph(version: 1, summary: \"one\", output: \"image\",
            resources: {{ {resources} \"image\": Image(format: \"rgba8\", size: (64, 1)) }},
            passes: [
                {fills}
                Dispatch(name: \"paint\", shader: \"paint.comp\", size: Threads(64), push: {{ \"at\": 3 }},
                    bind: {{ {binds} \"image\": \"image\" }}),
            ],
        )",
        fills = names
            .iter()
            .map(|name| format!("Fill(name: \"fill {name}\", buffer: \"{name}\", value: 0),"))
            .collect::<String>(),
        binds =
            names.iter().enumerate().map(|(i, name)| format!("\"B{i}\": \"{name}\", ")).collect::<String>(),
    );
    let memory =
        [("pipelines/one.ron".to_string(), graph), ("shaders/paint.comp".to_string(), shader.to_string())];
    let mut files = SourceMap::new(Library { memory: memory.into(), ..Library::default() });
    let (facts, catalog) = (DeviceFacts::typical(32).into(), Catalog::default());
    let request = Request::new("one", &facts, &catalog);
    build(&request, &mut files, &mut Glslang::default())
        .unwrap_or_else(|errors| panic!("{}", render(&files, &errors, false)))
}

/// Returns a shader that reads `buffers` buffers with descending bindings, and declares one that it does not use. The
/// text `size` follows each read.
fn shader(buffers: usize, size: &str) -> String {
    // 31 is reserved for live parameters.
    let bindings = (0..=60).rev().filter(|binding| *binding != 31).take(buffers);
    let blocks: String = bindings
        .enumerate()
        .map(|(i, binding)| format!("layout(binding = {binding}, std430) buffer B{i} {{ uint b{i}[]; }};\n"))
        .collect();
    let sum: String = (0..buffers).map(|i| format!(" + b{i}[at]{size}")).collect();
    format!(
        "#version 460
        #extension GL_KHR_shader_subgroup_basic : require
        layout(local_size_x = 64) in;
        layout(push_constant) uniform Push {{ uint at; }};
        layout(binding = 61, std430) buffer Unused {{ uint unused[]; }};
        {blocks}
        layout(binding = 1, rgba8) writeonly uniform image2D image;
        void main() {{
            imageStore(image, ivec2(gl_GlobalInvocationID.x, 0), vec4(gl_SubgroupSize{sum}));
        }}"
    )
}

fn msl(plan: &Plan) -> &Msl {
    plan.shaders[0].msl.as_ref().expect("translated")
}

#[test]
fn buffers_are_numbered_by_their_bindings_then_push_constants_then_sizes_and_textures_apart() {
    let mut plan = plan(&shader(2, " + uint(b0.length())"), 2);
    add_msl(&mut plan).expect("translated");
    let msl = msl(&plan);
    let places: Vec<_> = msl.arguments.iter().map(|a| (a.binding, a.texture, a.index)).collect();
    assert_eq!(places, [(1, true, 0), (59, false, 0), (60, false, 1)]);
    assert_eq!((msl.push, msl.sizes, msl.entry.as_str()), (Some(2), Some(3), "main0"));
    for argument in [
        "device B1& ",
        "device B0& ",
        "constant Push& ",
        "constant uint* spvBufferSizeConstants [[buffer(3)]]",
    ] {
        assert!(msl.source.contains(argument), "no `{argument}` in\n{}", msl.source);
    }
    assert!(!msl.source.contains("Unused&"), "{}", msl.source);
}

#[test]
fn the_width_of_simd_groups_is_a_constant_of_the_text() {
    let mut plan = plan(&shader(1, ""), 1);
    add_msl(&mut plan).expect("translated");
    assert!(msl(&plan).source.contains("gl_SubgroupSize = 32;"), "{}", msl(&plan).source);
}

#[test]
fn translations_of_equal_plans_are_equal() {
    let text = |mut plan: Plan| {
        add_msl(&mut plan).expect("translated");
        msl(&plan).clone()
    };
    assert_eq!(text(plan(&shader(5, ""), 5)), text(plan(&shader(5, ""), 5)));
}

#[test]
fn thirty_buffers_and_push_constants_are_translated_and_one_more_is_refused_by_its_name() {
    add_msl(&mut plan(&shader(30, ""), 30)).expect("translated");
    let errors = add_msl(&mut plan(&shader(31, ""), 31)).expect_err("one too many");
    let texts: Vec<String> = errors.iter().map(MslError::to_string).collect();
    assert_eq!(
        texts,
        [
            "the shader `paint.comp` cannot be translated to Metal's language: expected at most 31 buffers, including push \
          constants, found 32"
        ]
    );
}

#[test]
fn sizes_take_the_place_of_a_buffer() {
    let errors = add_msl(&mut plan(&shader(30, " + uint(b0.length())"), 30)).expect_err("one too many");
    assert!(errors[0].problem.ends_with("found 32"), "{errors:?}");
}

/// Translates a compute shader that binds the image `counts` at 0 and the buffer `B0` at 60. Returns the error; empty
/// if there is none.
fn refusal(declarations: &str, body: &str) -> String {
    let mut plan = plan(&shader(1, ""), 1);
    let text = format!(
        "#version 460
        #extension GL_KHR_shader_subgroup_arithmetic : require
        #extension GL_KHR_memory_scope_semantics : require
        layout(local_size_x = 64) in;
        layout(binding = 60, std430) buffer B0 {{ uint b0[]; }};
        layout(binding = 0, r32ui) uniform uimage2D counts;
        {declarations}
        void main() {{ {body} }}"
    );
    replace(&mut plan.shaders[0], ShaderStage::Compute, text);
    match add_msl(&mut plan) {
        Ok(()) => String::new(),
        Err(errors) => errors[0].to_string(),
    }
}

fn replace(shader: &mut Shader, stage: ShaderStage, text: String) {
    let mut files = SourceMap::new(Library::default());
    let file = files.add("test.glsl", text);
    let request = ShaderRequest { file, stage, defines: &[], unfit: &[], live_glsl: None };
    let compiled = Glslang::default().compile(&mut files, &request);
    let compiled = compiled.unwrap_or_else(|errors| panic!("{}", render(&files, &errors, false)));
    (shader.spirv, shader.reflection) = (compiled.spirv, compiled.reflection);
}

#[test]
fn atomics_on_images_are_refused_by_the_images_name_if_the_code_reaches_them() {
    let count = "void count(ivec2 at) { imageAtomicAdd(counts, at, 1u); }";
    let error = refusal(count, "count(ivec2(b0[0]));");
    assert!(error.starts_with("the shader `paint.comp`"), "{error}");
    assert!(error.contains("found atomics on the image `counts`"), "{error}");
    assert_eq!(refusal(count, "b0[0] = atomicAdd(b0[1], imageLoad(counts, ivec2(0)).x);"), "");
}

#[test]
fn a_memory_order_that_metal_lacks_is_refused_and_barriers_of_a_threadgroup_are_not() {
    let atomic = |order: &str| {
        let load = format!("atomicLoad(b0[1], gl_ScopeDevice, {order})");
        refusal("", &format!("b0[0] = {load};"))
    };
    assert_eq!(atomic("0, gl_SemanticsRelaxed"), "");
    assert!(
        atomic("gl_StorageSemanticsBuffer, gl_SemanticsAcquire")
            .contains("found one with acquire or release")
    );
    for (body, is_refused) in [
        ("b0[0] = atomicAdd(b0[1], 1); memoryBarrierShared(); barrier(); b0[2] = b0[1];", false),
        ("b0[0] = 1; memoryBarrierBuffer(); memoryBarrierShared(); barrier(); b0[2] = b0[1];", false),
        ("b0[0] = 1; memoryBarrierBuffer(); b0[2] = atomicAdd(b0[1], 1);", true),
        ("b0[0] = 1; memoryBarrier();", true),
    ] {
        assert_eq!(refusal("", body).contains("found one elsewhere"), is_refused, "{body}");
    }
}

#[test]
fn more_images_that_are_read_and_written_than_a_function_may_have_are_refused() {
    let of = |count: usize, qualifier: &str| {
        let declarations: String = (1..count)
            .map(|at| format!("layout(binding = {at}, r32ui) uniform {qualifier} uimage2D i{at};"))
            .collect();
        let stores =
            (1..count).map(|at| format!("imageStore(i{at}, ivec2(0), uvec4({at}));")).collect::<String>();
        refusal(&declarations, &format!("{stores} imageStore(counts, ivec2(0), uvec4(b0[0]));"))
    };
    assert_eq!((of(8, ""), of(9, "writeonly")), (String::new(), String::new()));
    assert!(
        of(9, "").ends_with("expected at most 8 images that are neither `readonly` nor `writeonly`, found 9")
    );
}

#[test]
fn the_index_of_a_draw_is_refused_and_the_first_instance_is_not() {
    let mut plan = plan(&shader(1, ""), 1);
    let mut translated = |value: &str| {
        let text = format!("#version 460\nvoid main() {{ gl_Position = vec4({value}); }}");
        plan.shaders[0].msl = None;
        replace(&mut plan.shaders[0], ShaderStage::Vertex, text);
        add_msl(&mut plan)
    };
    let errors = translated("gl_DrawID").expect_err("nothing binds its buffer");
    assert!(errors[0].problem.contains("expected no `gl_DrawID`"), "{errors:?}");
    translated("gl_BaseInstance + gl_BaseVertex").expect("translated");
}

#[test]
fn scans_of_sums_are_translated_and_other_scans_are_refused_by_their_name() {
    assert_eq!(refusal("", "b0[0] = subgroupInclusiveAdd(b0[1]) + subgroupMax(b0[2]);"), "");
    let error = refusal("", "b0[0] = subgroupInclusiveMax(b0[1]);");
    assert!(error.contains("Metal doesn't support InclusiveScan for OpGroupNonUniformUMax"), "{error}");
}

/// SPIRV-Cross is C++ and throws; its C interface turns the exception into an error.
#[test]
fn what_is_no_spirv_is_an_error_with_the_shaders_name() {
    let mut plan = plan(&shader(1, ""), 1);
    let whole = plan.shaders[0].spirv.clone();
    for broken in [vec![], vec![0; 8], whole[..whole.len() / 2].to_vec(), whole[5..].to_vec()] {
        plan.shaders[0].spirv = Arc::new(broken);
        let errors = add_msl(&mut plan).expect_err("no module");
        assert_eq!(errors.len(), 1);
        assert_eq!(errors[0].shader, "paint.comp");
    }
    plan.shaders[0].spirv = whole;
    add_msl(&mut plan).expect("the plan itself is right");
}
