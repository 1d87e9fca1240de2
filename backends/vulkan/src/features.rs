//! Selects the optional device features to enable, and lists the shader features that they provide.

use crate::instance::Instance;
use crate::lower::flags;
use ash::{ext, khr, vk};
use splatgraph_framework::ir::Features;

/// The optional features that the device is opened with, except robustness. All others stay off.
#[derive(Default)]
pub(crate) struct OptionalFeatures {
    pub core: vk::PhysicalDeviceFeatures,
    pub vulkan11: vk::PhysicalDeviceVulkan11Features<'static>,
    pub vulkan12: vk::PhysicalDeviceVulkan12Features<'static>,
    pub float: vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT<'static>,
    /// True if the device has `VK_EXT_shader_atomic_float`, whose features are in `float`.
    pub has_atomic_float: bool,
    pub flow: vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR<'static>,
    /// True if the device has `VK_KHR_shader_subgroup_uniform_control_flow`, whose feature is in `flow`.
    pub has_uniform_flow: bool,
    /// The features that shaders can use.
    pub shaders: Features,
}

/// An accessor of one feature.
type Field = fn(&mut OptionalFeatures) -> &mut vk::Bool32;

/// The features to enable if the device has them, each with the shader feature that it provides, if any.
const SELECTED: [(Features, Field); 39] = [
    (Features::empty(), |f| &mut f.core.independent_blend),
    (Features::empty(), |f| &mut f.core.draw_indirect_first_instance),
    (Features::empty(), |f| &mut f.vulkan12.shader_subgroup_extended_types),
    (Features::empty(), |f| &mut f.vulkan12.vulkan_memory_model),
    (Features::empty(), |f| &mut f.vulkan12.vulkan_memory_model_device_scope),
    (Features::INT16, |f| &mut f.core.shader_int16),
    (Features::INT64, |f| &mut f.core.shader_int64),
    (Features::INT8, |f| &mut f.vulkan12.shader_int8),
    (Features::FLOAT16, |f| &mut f.vulkan12.shader_float16),
    (Features::FLOAT64, |f| &mut f.core.shader_float64),
    (Features::STORAGE_16, |f| &mut f.vulkan11.storage_buffer16_bit_access),
    (Features::UNIFORM_16, |f| &mut f.vulkan11.uniform_and_storage_buffer16_bit_access),
    (Features::STORAGE_8, |f| &mut f.vulkan12.storage_buffer8_bit_access),
    (Features::UNIFORM_8, |f| &mut f.vulkan12.uniform_and_storage_buffer8_bit_access),
    (Features::SCALAR_LAYOUT, |f| &mut f.vulkan12.scalar_block_layout),
    (Features::BUFFER_INT64_ATOMICS, |f| &mut f.vulkan12.shader_buffer_int64_atomics),
    (Features::SHARED_INT64_ATOMICS, |f| &mut f.vulkan12.shader_shared_int64_atomics),
    (Features::BUFFER_FLOAT_ATOMICS, |f| &mut f.float.shader_buffer_float32_atomics),
    (Features::BUFFER_FLOAT_ATOMIC_ADD, |f| &mut f.float.shader_buffer_float32_atomic_add),
    (Features::SHARED_FLOAT_ATOMICS, |f| &mut f.float.shader_shared_float32_atomics),
    (Features::SHARED_FLOAT_ATOMIC_ADD, |f| &mut f.float.shader_shared_float32_atomic_add),
    (Features::IMAGE_FLOAT_ATOMICS, |f| &mut f.float.shader_image_float32_atomics),
    (Features::IMAGE_FLOAT_ATOMIC_ADD, |f| &mut f.float.shader_image_float32_atomic_add),
    (Features::IMAGE_READ_WITHOUT_FORMAT, |f| &mut f.core.shader_storage_image_read_without_format),
    (Features::IMAGE_WRITE_WITHOUT_FORMAT, |f| &mut f.core.shader_storage_image_write_without_format),
    (Features::IMAGE_EXTENDED_FORMATS, |f| &mut f.core.shader_storage_image_extended_formats),
    (Features::STORAGE_BUFFER_INDEXING, |f| &mut f.core.shader_storage_buffer_array_dynamic_indexing),
    (Features::UNIFORM_BUFFER_INDEXING, |f| &mut f.core.shader_uniform_buffer_array_dynamic_indexing),
    (Features::STORAGE_IMAGE_INDEXING, |f| &mut f.core.shader_storage_image_array_dynamic_indexing),
    (Features::STORAGE_BUFFER_NONUNIFORM, |f| {
        &mut f.vulkan12.shader_storage_buffer_array_non_uniform_indexing
    }),
    (Features::UNIFORM_BUFFER_NONUNIFORM, |f| {
        &mut f.vulkan12.shader_uniform_buffer_array_non_uniform_indexing
    }),
    (Features::STORAGE_IMAGE_NONUNIFORM, |f| &mut f.vulkan12.shader_storage_image_array_non_uniform_indexing),
    (Features::VERTEX_STORES, |f| &mut f.core.vertex_pipeline_stores_and_atomics),
    (Features::FRAGMENT_STORES, |f| &mut f.core.fragment_stores_and_atomics),
    (Features::DRAW_PARAMETERS, |f| &mut f.vulkan11.shader_draw_parameters),
    (Features::CLIP_DISTANCE, |f| &mut f.core.shader_clip_distance),
    (Features::CULL_DISTANCE, |f| &mut f.core.shader_cull_distance),
    (Features::SAMPLE_SHADING, |f| &mut f.core.sample_rate_shading),
    (Features::SUBGROUP_UNIFORM_CONTROL_FLOW, |f| &mut f.flow.shader_subgroup_uniform_control_flow),
];

const OPERATIONS: [(vk::SubgroupFeatureFlags, Features); 8] = [
    (vk::SubgroupFeatureFlags::BASIC, Features::SUBGROUP_BASIC),
    (vk::SubgroupFeatureFlags::VOTE, Features::SUBGROUP_VOTE),
    (vk::SubgroupFeatureFlags::ARITHMETIC, Features::SUBGROUP_ARITHMETIC),
    (vk::SubgroupFeatureFlags::BALLOT, Features::SUBGROUP_BALLOT),
    (vk::SubgroupFeatureFlags::SHUFFLE, Features::SUBGROUP_SHUFFLE),
    (vk::SubgroupFeatureFlags::SHUFFLE_RELATIVE, Features::SUBGROUP_SHUFFLE_RELATIVE),
    (vk::SubgroupFeatureFlags::CLUSTERED, Features::SUBGROUP_CLUSTERED),
    (vk::SubgroupFeatureFlags::QUAD, Features::SUBGROUP_QUAD),
];

const STAGES: [(vk::ShaderStageFlags, Features); 2] = [
    (vk::ShaderStageFlags::VERTEX, Features::SUBGROUPS_IN_VERTEX),
    (vk::ShaderStageFlags::FRAGMENT, Features::SUBGROUPS_IN_FRAGMENT),
];

impl OptionalFeatures {
    /// Queries a device of version 1.3 or later, and selects the features to enable.
    pub fn of(instance: &Instance, handle: vk::PhysicalDevice) -> OptionalFeatures {
        let has_atomic_float = instance.has_extension(handle, ext::shader_atomic_float::NAME);
        let has_uniform_flow =
            instance.has_extension(handle, khr::shader_subgroup_uniform_control_flow::NAME);
        let mut has = OptionalFeatures::default();
        let mut query =
            vk::PhysicalDeviceFeatures2::default().push_next(&mut has.vulkan11).push_next(&mut has.vulkan12);
        if has_atomic_float {
            query = query.push_next(&mut has.float);
        }
        if has_uniform_flow {
            query = query.push_next(&mut has.flow);
        }
        // SAFETY: the chain holds structures of Vulkan 1.3, which the device has, and of extensions that it offers.
        unsafe { instance.raw.get_physical_device_features2(handle, &mut query) };
        has.core = query.features;
        let mut subgroups = vk::PhysicalDeviceSubgroupProperties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut subgroups);
        // SAFETY: as above.
        unsafe { instance.raw.get_physical_device_properties2(handle, &mut properties) };

        let shaders = flags(&OPERATIONS, |bit| subgroups.supported_operations.contains(bit))
            | flags(&STAGES, |bit| subgroups.supported_stages.contains(bit));
        let mut enabled =
            OptionalFeatures { has_atomic_float, has_uniform_flow, shaders, ..Default::default() };
        for (feature, field) in SELECTED {
            *field(&mut enabled) = *field(&mut has);
            if *field(&mut has) == vk::TRUE {
                enabled.shaders |= feature;
            }
        }
        enabled
    }
}
