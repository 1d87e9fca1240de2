//! Lists the optional device features that a module needs.
//!
//! Most follow from the module's capabilities. Others need the code: for 64-bit atomics, SPIR-V has one capability, but
//! Vulkan has separate features for buffers and shared memory. Stores in vertex and fragment shaders, and non-constant
//! indices into descriptor arrays, are also found in the code.

use std::collections::{HashMap, HashSet};

use rspirv::dr::Instruction;
use rspirv::spirv::{Capability, Op, StorageClass, Word};

use super::access::Accesses;
use super::module::{Module, Type, id};
use crate::ir::{Features, ShaderStage};

/// Returns the features that a module needs. Fails, with a message, if no backend enables one of them.
pub(super) fn features(module: &Module, accesses: &Accesses) -> Result<Features, String> {
    let mut needed = Features::empty();
    let mut int64_atomics = false;
    for capability in &module.capabilities {
        match (of_capability(*capability), capability) {
            (Some(features), _) => needed |= features,
            (None, Capability::Int64Atomics) => int64_atomics = true,
            (None, other) => return Err(format!("shaders with {other:?} are not supported")),
        }
    }
    for extension in &module.extensions {
        needed |=
            of_extension(extension).ok_or_else(|| format!("shaders with {extension} are not supported"))?;
    }
    if module.source_extensions.iter().any(|name| name == "GL_EXT_scalar_block_layout") {
        needed |= Features::SCALAR_LAYOUT;
    }
    let (stores, in_stage) = match module.stage {
        ShaderStage::Vertex => (Features::VERTEX_STORES, Features::SUBGROUPS_IN_VERTEX),
        ShaderStage::Fragment => (Features::FRAGMENT_STORES, Features::SUBGROUPS_IN_FRAGMENT),
        ShaderStage::Compute => (Features::empty(), Features::empty()),
    };
    if needed.intersects(Features::SUBGROUP_OPERATIONS) {
        needed |= in_stage;
    }
    if !accesses.writes.is_empty() {
        needed |= stores;
    }
    Ok(needed | of_code(module, int64_atomics)?)
}

/// Returns the features of a capability; `None` if no backend enables it, and for `Int64Atomics`, which the caller
/// handles. Empty if every device has it or [`of_code`] decides.
///
/// Source: the table of capabilities in the appendix "Vulkan Environment for SPIR-V" of the Vulkan specification.
fn of_capability(capability: Capability) -> Option<Features> {
    Some(match capability {
        Capability::Matrix
        | Capability::Shader
        | Capability::InputAttachment
        | Capability::Sampled1D
        | Capability::Image1D
        | Capability::SampledBuffer
        | Capability::ImageBuffer
        | Capability::ImageQuery
        | Capability::DerivativeControl
        | Capability::DemoteToHelperInvocation
        | Capability::DotProduct
        | Capability::DotProductInputAll
        | Capability::DotProductInput4x8Bit
        | Capability::DotProductInput4x8BitPacked
        | Capability::VulkanMemoryModel
        | Capability::VulkanMemoryModelDeviceScope => Features::empty(),
        Capability::Int16 => Features::INT16,
        Capability::Int64 => Features::INT64,
        Capability::Int8 => Features::INT8,
        Capability::Float16 => Features::FLOAT16,
        Capability::Float64 => Features::FLOAT64,
        Capability::StorageBuffer16BitAccess => Features::STORAGE_16,
        Capability::UniformAndStorageBuffer16BitAccess => Features::UNIFORM_16,
        Capability::StorageBuffer8BitAccess => Features::STORAGE_8,
        Capability::UniformAndStorageBuffer8BitAccess => Features::UNIFORM_8,
        // The feature depends on the storage class, which `of_code` finds.
        Capability::AtomicFloat32AddEXT => Features::empty(),
        Capability::StorageImageReadWithoutFormat => Features::IMAGE_READ_WITHOUT_FORMAT,
        Capability::StorageImageWriteWithoutFormat => Features::IMAGE_WRITE_WITHOUT_FORMAT,
        Capability::StorageImageExtendedFormats => Features::IMAGE_EXTENDED_FORMATS,
        Capability::StorageBufferArrayDynamicIndexing => Features::STORAGE_BUFFER_INDEXING,
        Capability::UniformBufferArrayDynamicIndexing => Features::UNIFORM_BUFFER_INDEXING,
        Capability::StorageImageArrayDynamicIndexing => Features::STORAGE_IMAGE_INDEXING,
        Capability::ShaderNonUniform => Features::empty(),
        Capability::StorageBufferArrayNonUniformIndexing => Features::STORAGE_BUFFER_NONUNIFORM,
        Capability::UniformBufferArrayNonUniformIndexing => Features::UNIFORM_BUFFER_NONUNIFORM,
        Capability::StorageImageArrayNonUniformIndexing => Features::STORAGE_IMAGE_NONUNIFORM,
        Capability::DrawParameters => Features::DRAW_PARAMETERS,
        Capability::ClipDistance => Features::CLIP_DISTANCE,
        Capability::CullDistance => Features::CULL_DISTANCE,
        Capability::SampleRateShading | Capability::InterpolationFunction => Features::SAMPLE_SHADING,
        Capability::GroupNonUniform => Features::SUBGROUP_BASIC,
        Capability::GroupNonUniformVote => Features::SUBGROUP_VOTE,
        Capability::GroupNonUniformArithmetic => Features::SUBGROUP_ARITHMETIC,
        Capability::GroupNonUniformBallot => Features::SUBGROUP_BALLOT,
        Capability::GroupNonUniformShuffle => Features::SUBGROUP_SHUFFLE,
        Capability::GroupNonUniformShuffleRelative => Features::SUBGROUP_SHUFFLE_RELATIVE,
        Capability::GroupNonUniformClustered => Features::SUBGROUP_CLUSTERED,
        Capability::GroupNonUniformQuad => Features::SUBGROUP_QUAD,
        _ => return None,
    })
}

/// Returns the features of a SPIR-V extension beyond those of its capabilities; `None` for an unsupported extension.
fn of_extension(name: &str) -> Option<Features> {
    match name {
        "SPV_KHR_16bit_storage"
        | "SPV_KHR_8bit_storage"
        | "SPV_KHR_storage_buffer_storage_class"
        | "SPV_KHR_shader_draw_parameters"
        | "SPV_KHR_vulkan_memory_model"
        | "SPV_KHR_integer_dot_product"
        | "SPV_KHR_terminate_invocation"
        | "SPV_KHR_non_semantic_info"
        | "SPV_EXT_descriptor_indexing"
        | "SPV_EXT_demote_to_helper_invocation"
        | "SPV_EXT_shader_atomic_float_add"
        | "SPV_GOOGLE_decorate_string"
        | "SPV_GOOGLE_hlsl_functionality1"
        | "SPV_GOOGLE_user_type" => Some(Features::empty()),
        "SPV_KHR_subgroup_uniform_control_flow" => Some(Features::SUBGROUP_UNIFORM_CONTROL_FLOW),
        _ => None,
    }
}

fn of_code(module: &Module, int64_atomics: bool) -> Result<Features, String> {
    let mut needed = Features::empty();
    let variables: HashMap<Word, (StorageClass, Word)> =
        module.variables.iter().map(|v| (v.id, (v.class, v.pointee))).collect();
    let bodies = || module.functions.values().flat_map(|function| &function.body);
    // Types of all values in functions; pointer types show the storage class of an atomic operation.
    let types: HashMap<Word, Word> = bodies().filter_map(|i| Some((i.result_id?, i.result_type?))).collect();
    let mut seen_int64 = false;
    for i in bodies() {
        match i.class.opcode {
            Op::AccessChain | Op::InBoundsAccessChain => {
                if let Some(&(class, pointee)) = variables.get(&id(i, 0)?) {
                    needed |= array_index(module, i, class, pointee)?;
                }
            }
            _ if i.class.opname.starts_with("Atomic") => {
                let value = match i.class.opcode {
                    Op::AtomicStore => {
                        let stored = id(i, 3)?;
                        types.get(&stored).or_else(|| module.constants.get(&stored)).copied()
                    }
                    _ => i.result_type,
                };
                let class = |pointer: &Word| -> Option<StorageClass> {
                    if let Some((class, _)) = variables.get(pointer) {
                        return Some(*class);
                    }
                    match module.types.get(types.get(pointer)?)?.kind {
                        Type::Pointer { class, .. } => Some(class),
                        _ => None,
                    }
                };
                let kind = value.and_then(|value| module.types.get(&value)).map(|info| &info.kind);
                let wide = matches!(kind, Some(Type::Int { bits: 64, .. }));
                seen_int64 |= wide;
                if wide || matches!(kind, Some(Type::Float { .. })) {
                    let adds = i.class.opcode == Op::AtomicFAddEXT;
                    needed |= atomic(wide, adds, class(&id(i, 0)?));
                }
            }
            _ => {}
        }
    }
    if int64_atomics && !seen_int64 {
        needed |= Features::BUFFER_INT64_ATOMICS | Features::SHARED_INT64_ATOMICS;
    }
    Ok(needed)
}

/// Returns the features of an atomic operation on a 64-bit integer (`wide`) or a float. An unknown `class` gives the
/// features of all classes.
fn atomic(wide: bool, adds: bool, class: Option<StorageClass>) -> Features {
    let of = |buffer, shared, image| match class {
        Some(StorageClass::StorageBuffer | StorageClass::Uniform) => buffer,
        Some(StorageClass::Workgroup) => shared,
        Some(StorageClass::Image) => image,
        _ => buffer | shared | image,
    };
    if wide {
        // `of_capability` rejects the capability for images with 64-bit pixels.
        of(Features::BUFFER_INT64_ATOMICS, Features::SHARED_INT64_ATOMICS, Features::empty())
    } else if adds {
        of(
            Features::BUFFER_FLOAT_ATOMIC_ADD,
            Features::SHARED_FLOAT_ATOMIC_ADD,
            Features::IMAGE_FLOAT_ATOMIC_ADD,
        )
    } else {
        of(Features::BUFFER_FLOAT_ATOMICS, Features::SHARED_FLOAT_ATOMICS, Features::IMAGE_FLOAT_ATOMICS)
    }
}

/// Returns the feature for non-constant indices into an array of blocks or images; empty if all are constants.
fn array_index(
    module: &Module,
    chain: &Instruction,
    class: StorageClass,
    pointee: Word,
) -> Result<Features, String> {
    let mut element = pointee;
    let mut varies = false;
    let mut index = 1;
    let mut seen = HashSet::new();
    while let Type::Array { element: inner, .. } = module.type_of(element)?.kind {
        varies |= id(chain, index).is_ok_and(|index| !module.constants.contains_key(&index));
        index += 1;
        element = inner;
        if !seen.insert(element) {
            break;
        }
    }
    if !varies {
        return Ok(Features::empty());
    }
    let old = |block| module.decoration(block, None, rspirv::spirv::Decoration::BufferBlock).is_some();
    Ok(match (class, &module.type_of(element)?.kind) {
        (StorageClass::StorageBuffer, _) => Features::STORAGE_BUFFER_INDEXING,
        (StorageClass::Uniform, _) if old(element) => Features::STORAGE_BUFFER_INDEXING,
        (StorageClass::Uniform, _) => Features::UNIFORM_BUFFER_INDEXING,
        (StorageClass::UniformConstant, Type::Image { .. }) => Features::STORAGE_IMAGE_INDEXING,
        _ => Features::empty(),
    })
}
