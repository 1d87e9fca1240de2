//! Translates SPIR-V to the Metal Shading Language with SPIRV-Cross.
//!
//! Each shader's SPIR-V becomes the text of a library with one function. Vulkan numbers a shader's bindings freely;
//! Metal has one argument table for buffers and one for textures. `places` assigns the indices, and SPIRV-Cross
//! generates the function with them.
//!
//! To run the function, a backend needs:
//!
//! - `MTLCompileOptions` of [`VERSION`] without fast math, so that NaN and the order of operations stay. It does not
//!   prevent contraction, which only `precise` does;
//! - for a shader with subgroup operations, a pipeline whose `threadExecutionWidth` is the plan's subgroup size: the
//!   text contains it as a constant;
//! - buffers with the push constants and sizes at the indices [`Msl::push`] and [`Msl::sizes`];
//! - no flip of the y axis: the vertex function returns positions with y upwards, as in Metal's clip space.

mod refusals;
#[cfg(all(test, feature = "glslang"))]
mod tests;

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::sync::Arc;

use spirv_cross2::SpirvCrossError;
use spirv_cross2::compile::CompilableTarget;
use spirv_cross2::compile::msl::{BindTarget, CompilerOptions, MetalPlatform, MslVersion, ResourceBinding};
use spirv_cross2::spirv::{BuiltIn, ExecutionModel, StorageClass};
use spirv_cross2::targets;
use spirv_cross2::{Compiler, Module};

use crate::ir::{Msl, MslArgument, ReflectedKind, Reflection, Shader, ShaderStage, Value};
use crate::plan::Plan;

/// Version of the Metal Shading Language that translated shaders need, major and minor.
pub const VERSION: (u32, u32) = (2, 4);

/// A shader that cannot be translated to Metal's language.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the shader `{shader}` cannot be translated to Metal's language: {problem}")]
pub struct MslError {
    /// Path of the shader, as in the graph.
    pub shader: String,
    /// Reason why the shader cannot be translated.
    pub problem: String,
}

/// Translates all shaders of a plan that have no translation yet.
///
/// # Errors
/// One error per shader that failed; the others are translated.
pub fn add_msl(plan: &mut Plan) -> Result<(), Vec<MslError>> {
    let lanes = match plan.facts.get("device.subgroup_size") {
        Some(Value::Int(lanes)) => u32::try_from(*lanes).unwrap_or(0),
        _ => 0,
    };
    let mut errors = Vec::new();
    for shader in plan.shaders.iter_mut().filter(|shader| shader.msl.is_none()) {
        match translate(shader, lanes) {
            Ok(msl) => shader.msl = Some(Arc::new(msl)),
            Err(problem) => errors.push(MslError { shader: shader.name.clone(), problem }),
        }
    }
    if errors.is_empty() { Ok(()) } else { Err(errors) }
}

struct Places {
    arguments: Vec<MslArgument>,
    push: Option<u32>,
    free: u32,
}

/// Assigns indices: buffers in binding order, then push constants; textures separately.
fn places(reflection: &Reflection) -> Places {
    let (mut buffers, mut textures) = (0, 0);
    let mut arguments = Vec::new();
    for bound in &reflection.bindings {
        let texture = matches!(bound.kind, ReflectedKind::StorageImage { .. });
        let next = if texture { &mut textures } else { &mut buffers };
        arguments.extend((0..bound.count).map(|element| MslArgument {
            binding: bound.binding,
            element,
            texture,
            index: *next + element,
        }));
        *next += bound.count;
    }
    let push = reflection.push.as_ref().map(|_| buffers);
    Places { arguments, push, free: buffers + u32::from(push.is_some()) }
}

fn check(places: &Places, sizes: bool, reflection: &Reflection) -> Result<(), String> {
    let buffers = places.free + u32::from(sizes);
    let most = Msl::MAX_BUFFERS;
    if buffers > most {
        return Err(format!("expected at most {most} buffers, including push constants, found {buffers}"));
    }
    let textures = places.arguments.iter().filter(|argument| argument.texture).count();
    let most = Msl::MAX_TEXTURES;
    if textures > most as usize {
        return Err(format!("expected at most {most} images, found {textures}"));
    }
    let most = Msl::MAX_PUSH_BYTES;
    match &reflection.push {
        Some(push) if push.bytes > most => {
            Err(format!("expected at most {most} bytes of push constants, found {}", push.bytes))
        }
        _ => Ok(()),
    }
}

/// Refuses atomics on images. Below Metal 3.1, SPIRV-Cross emulates them with a buffer that shares the image's memory,
/// which nothing binds.
fn check_images(reflection: &Reflection) -> Result<(), String> {
    let is_image = |kind: &ReflectedKind| matches!(kind, ReflectedKind::StorageImage { .. });
    match reflection.bindings.iter().find(|binding| binding.atomics && is_image(&binding.kind)) {
        Some(image) => Err(format!(
            "expected atomics on buffers or shared memory only, found atomics on the image `{}`: use a buffer instead",
            image.name
        )),
        None => Ok(()),
    }
}

fn translate(shader: &Shader, lanes: u32) -> Result<Msl, String> {
    let reflection = &shader.reflection;
    let places = places(reflection);
    check(&places, false, reflection)?;
    check_images(reflection)?;
    refusals::check(&shader.spirv, reflection.stage, &places.arguments)?;
    let stage = match reflection.stage {
        ShaderStage::Vertex => ExecutionModel::Vertex,
        ShaderStage::Fragment => ExecutionModel::Fragment,
        ShaderStage::Compute => ExecutionModel::GLCompute,
    };
    let Translation { source, entry, sizes, draw_index } =
        call(&shader.spirv, stage, &places, lanes).map_err(|error| error.to_string())?;
    // SPIRV-Cross emulates `gl_DrawID` with a buffer that nothing binds.
    if draw_index {
        return Err("expected no `gl_DrawID`, which Metal lacks: use 0, its value in every draw of a graph"
            .to_string());
    }
    check(&places, sizes, reflection)?;
    Ok(Msl {
        source,
        entry,
        push: places.push,
        sizes: sizes.then_some(places.free),
        arguments: places.arguments,
    })
}

struct Translation {
    source: String,
    /// Name of the function in the source.
    entry: String,
    /// True if the function needs the sizes of buffers.
    sizes: bool,
    /// True if the code uses `gl_DrawID`.
    draw_index: bool,
}

fn call(
    spirv: &[u32],
    stage: ExecutionModel,
    places: &Places,
    lanes: u32,
) -> Result<Translation, SpirvCrossError> {
    let mut compiler = Compiler::<targets::Msl>::new(Module::from_words(spirv))?;
    // Otherwise, SPIRV-Cross gives unused arguments the indices of other arguments.
    let used = compiler.active_interface_variables()?;
    compiler.set_enabled_interface_variables(used)?;
    let active = compiler.update_active_builtins();
    let draw_index = compiler.has_active_builtin(BuiltIn::DrawIndex, StorageClass::Input, active)?;
    // An array of descriptors is one binding with a count, at the index of its first element.
    let mut bindings: BTreeMap<u32, (MslArgument, u32)> = BTreeMap::new();
    for argument in &places.arguments {
        bindings.entry(argument.binding).or_insert((*argument, 0)).1 += 1;
    }
    for (binding, (first, count)) in bindings {
        let at = |texture| if first.texture == texture { first.index } else { 0 };
        let target =
            BindTarget { buffer: at(false), texture: at(true), sampler: 0, count: NonZeroU32::new(count) };
        compiler.add_resource_binding(stage, ResourceBinding::Qualified { set: 0, binding }, &target)?;
    }
    if let Some(buffer) = places.push {
        let target = BindTarget { buffer, texture: 0, sampler: 0, count: NonZeroU32::new(1) };
        compiler.add_resource_binding(stage, ResourceBinding::PushConstantBuffer, &target)?;
    }
    let done = compiler.compile(&options(places.free, lanes))?;
    // Metal functions cannot be named `main`.
    let entry = done.cleansed_entry_point_name("main", stage)?;
    let entry = entry
        .ok_or_else(|| SpirvCrossError::InvalidSpirv("expected an entry point `main`".to_string()))?
        .to_string();
    let sizes = done.buffer_requirements().needs_buffer_size_buffer;
    Ok(Translation { source: done.to_string(), entry, sizes, draw_index })
}

fn options(sizes: u32, lanes: u32) -> CompilerOptions {
    let mut options = targets::Msl::options();
    options.version = MslVersion::from(VERSION);
    options.platform = MetalPlatform::MacOS;
    // The shaders contain the plan's subgroup size as a constant.
    options.fixed_subgroup_size = lanes;
    options.buffer_size_buffer_index = sizes;
    // Vulkan's clip space has y downwards, Metal's upwards. Depth has the same range in both.
    options.common.flip_vertex_y = true;
    options.common.fixup_clipspace = false;
    // Comparisons and minima with NaN must behave as in the SPIR-V: they cull degenerate splats.
    options.common.relax_nan_checks = false;
    // Products and sums may be contracted unless the SPIR-V forbids it (`precise`), as in Vulkan.
    options.invariant_fp_math = false;
    // A fragment function must return as many components as its target has.
    options.pad_fragment_output_components = true;
    // Graphs have no point topology.
    options.enable_point_size_builtin = false;
    // Stores after a `discard` must not take effect.
    options.check_discarded_frag_stores = true;
    options
}
