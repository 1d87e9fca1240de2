//! Selects the optional device features to enable, and lists the shader features that they provide.

use crate::instance::Instance;
use ash::{ext, khr, vk};
use splatgraph_framework::ir::Features;

/// The optional features that the device is opened with. All others stay off.
pub(crate) struct OptionalFeatures {
    pub core: vk::PhysicalDeviceFeatures,
    pub vulkan11: vk::PhysicalDeviceVulkan11Features<'static>,
    pub vulkan12: vk::PhysicalDeviceVulkan12Features<'static>,
    /// Features of `VK_EXT_shader_atomic_float`; `None` without the extension.
    pub atomic_float: Option<vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT<'static>>,
    /// The feature of `VK_KHR_shader_subgroup_uniform_control_flow`; `None` without the extension.
    pub uniform_flow: Option<vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR<'static>>,
    subgroup_operations: vk::SubgroupFeatureFlags,
    subgroup_stages: vk::ShaderStageFlags,
}

impl OptionalFeatures {
    /// Queries a device of version 1.3 or later, and selects its features that shaders can use.
    pub fn of(instance: &Instance, handle: vk::PhysicalDevice) -> OptionalFeatures {
        let has_atomic_float = instance.has_extension(handle, ext::shader_atomic_float::NAME);
        let has_uniform_flow =
            instance.has_extension(handle, khr::shader_subgroup_uniform_control_flow::NAME);
        let mut flow = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default();
        let mut float = vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default();
        let mut has11 = vk::PhysicalDeviceVulkan11Features::default();
        let mut has12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut has = vk::PhysicalDeviceFeatures2::default().push_next(&mut has11).push_next(&mut has12);
        if has_atomic_float {
            has = has.push_next(&mut float);
        }
        if has_uniform_flow {
            has = has.push_next(&mut flow);
        }
        // SAFETY: the chain holds structures of Vulkan 1.3, which the device has, and of extensions that it offers.
        unsafe { instance.raw.get_physical_device_features2(handle, &mut has) };
        let has10 = has.features;
        let mut subgroups = vk::PhysicalDeviceSubgroupProperties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut subgroups);
        // SAFETY: as above.
        unsafe { instance.raw.get_physical_device_properties2(handle, &mut properties) };

        let core = vk::PhysicalDeviceFeatures {
            independent_blend: has10.independent_blend,
            draw_indirect_first_instance: has10.draw_indirect_first_instance,
            shader_int16: has10.shader_int16,
            shader_int64: has10.shader_int64,
            shader_float64: has10.shader_float64,
            vertex_pipeline_stores_and_atomics: has10.vertex_pipeline_stores_and_atomics,
            fragment_stores_and_atomics: has10.fragment_stores_and_atomics,
            shader_storage_buffer_array_dynamic_indexing: has10.shader_storage_buffer_array_dynamic_indexing,
            shader_uniform_buffer_array_dynamic_indexing: has10.shader_uniform_buffer_array_dynamic_indexing,
            shader_storage_image_array_dynamic_indexing: has10.shader_storage_image_array_dynamic_indexing,
            shader_storage_image_read_without_format: has10.shader_storage_image_read_without_format,
            shader_storage_image_write_without_format: has10.shader_storage_image_write_without_format,
            shader_storage_image_extended_formats: has10.shader_storage_image_extended_formats,
            shader_clip_distance: has10.shader_clip_distance,
            shader_cull_distance: has10.shader_cull_distance,
            sample_rate_shading: has10.sample_rate_shading,
            ..Default::default()
        };
        let vulkan11 = vk::PhysicalDeviceVulkan11Features {
            storage_buffer16_bit_access: has11.storage_buffer16_bit_access,
            uniform_and_storage_buffer16_bit_access: has11.uniform_and_storage_buffer16_bit_access,
            shader_draw_parameters: has11.shader_draw_parameters,
            ..Default::default()
        };
        let vulkan12 = vk::PhysicalDeviceVulkan12Features {
            shader_float16: has12.shader_float16,
            shader_int8: has12.shader_int8,
            storage_buffer8_bit_access: has12.storage_buffer8_bit_access,
            uniform_and_storage_buffer8_bit_access: has12.uniform_and_storage_buffer8_bit_access,
            shader_buffer_int64_atomics: has12.shader_buffer_int64_atomics,
            shader_shared_int64_atomics: has12.shader_shared_int64_atomics,
            shader_subgroup_extended_types: has12.shader_subgroup_extended_types,
            scalar_block_layout: has12.scalar_block_layout,
            vulkan_memory_model: has12.vulkan_memory_model,
            vulkan_memory_model_device_scope: has12.vulkan_memory_model_device_scope,
            shader_storage_buffer_array_non_uniform_indexing: has12
                .shader_storage_buffer_array_non_uniform_indexing,
            shader_uniform_buffer_array_non_uniform_indexing: has12
                .shader_uniform_buffer_array_non_uniform_indexing,
            shader_storage_image_array_non_uniform_indexing: has12
                .shader_storage_image_array_non_uniform_indexing,
            ..Default::default()
        };
        let atomic_float = has_atomic_float.then(|| vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT {
            shader_buffer_float32_atomics: float.shader_buffer_float32_atomics,
            shader_buffer_float32_atomic_add: float.shader_buffer_float32_atomic_add,
            shader_shared_float32_atomics: float.shader_shared_float32_atomics,
            shader_shared_float32_atomic_add: float.shader_shared_float32_atomic_add,
            shader_image_float32_atomics: float.shader_image_float32_atomics,
            shader_image_float32_atomic_add: float.shader_image_float32_atomic_add,
            ..Default::default()
        });
        let uniform_flow = has_uniform_flow.then(|| {
            vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
                .shader_subgroup_uniform_control_flow(flow.shader_subgroup_uniform_control_flow == vk::TRUE)
        });
        OptionalFeatures {
            core,
            vulkan11,
            vulkan12,
            atomic_float,
            uniform_flow,
            subgroup_operations: subgroups.supported_operations,
            subgroup_stages: subgroups.supported_stages,
        }
    }

    pub fn shaders(&self) -> Features {
        let OptionalFeatures { core, vulkan11, vulkan12, .. } = self;
        let float = self.atomic_float.unwrap_or_default();
        let flow = self.uniform_flow.unwrap_or_default();
        let operations = |flag| vk::Bool32::from(self.subgroup_operations.contains(flag));
        let stages = |flag| vk::Bool32::from(self.subgroup_stages.contains(flag));
        let enabled = [
            (Features::INT16, core.shader_int16),
            (Features::INT64, core.shader_int64),
            (Features::INT8, vulkan12.shader_int8),
            (Features::FLOAT16, vulkan12.shader_float16),
            (Features::FLOAT64, core.shader_float64),
            (Features::STORAGE_16, vulkan11.storage_buffer16_bit_access),
            (Features::UNIFORM_16, vulkan11.uniform_and_storage_buffer16_bit_access),
            (Features::STORAGE_8, vulkan12.storage_buffer8_bit_access),
            (Features::UNIFORM_8, vulkan12.uniform_and_storage_buffer8_bit_access),
            (Features::SCALAR_LAYOUT, vulkan12.scalar_block_layout),
            (Features::BUFFER_INT64_ATOMICS, vulkan12.shader_buffer_int64_atomics),
            (Features::SHARED_INT64_ATOMICS, vulkan12.shader_shared_int64_atomics),
            (Features::BUFFER_FLOAT_ATOMICS, float.shader_buffer_float32_atomics),
            (Features::BUFFER_FLOAT_ATOMIC_ADD, float.shader_buffer_float32_atomic_add),
            (Features::SHARED_FLOAT_ATOMICS, float.shader_shared_float32_atomics),
            (Features::SHARED_FLOAT_ATOMIC_ADD, float.shader_shared_float32_atomic_add),
            (Features::IMAGE_FLOAT_ATOMICS, float.shader_image_float32_atomics),
            (Features::IMAGE_FLOAT_ATOMIC_ADD, float.shader_image_float32_atomic_add),
            (Features::IMAGE_READ_WITHOUT_FORMAT, core.shader_storage_image_read_without_format),
            (Features::IMAGE_WRITE_WITHOUT_FORMAT, core.shader_storage_image_write_without_format),
            (Features::IMAGE_EXTENDED_FORMATS, core.shader_storage_image_extended_formats),
            (Features::STORAGE_BUFFER_INDEXING, core.shader_storage_buffer_array_dynamic_indexing),
            (Features::UNIFORM_BUFFER_INDEXING, core.shader_uniform_buffer_array_dynamic_indexing),
            (Features::STORAGE_IMAGE_INDEXING, core.shader_storage_image_array_dynamic_indexing),
            (Features::STORAGE_BUFFER_NONUNIFORM, vulkan12.shader_storage_buffer_array_non_uniform_indexing),
            (Features::UNIFORM_BUFFER_NONUNIFORM, vulkan12.shader_uniform_buffer_array_non_uniform_indexing),
            (Features::STORAGE_IMAGE_NONUNIFORM, vulkan12.shader_storage_image_array_non_uniform_indexing),
            (Features::VERTEX_STORES, core.vertex_pipeline_stores_and_atomics),
            (Features::FRAGMENT_STORES, core.fragment_stores_and_atomics),
            (Features::DRAW_PARAMETERS, vulkan11.shader_draw_parameters),
            (Features::CLIP_DISTANCE, core.shader_clip_distance),
            (Features::CULL_DISTANCE, core.shader_cull_distance),
            (Features::SAMPLE_SHADING, core.sample_rate_shading),
            (Features::SUBGROUP_BASIC, operations(vk::SubgroupFeatureFlags::BASIC)),
            (Features::SUBGROUP_VOTE, operations(vk::SubgroupFeatureFlags::VOTE)),
            (Features::SUBGROUP_ARITHMETIC, operations(vk::SubgroupFeatureFlags::ARITHMETIC)),
            (Features::SUBGROUP_BALLOT, operations(vk::SubgroupFeatureFlags::BALLOT)),
            (Features::SUBGROUP_SHUFFLE, operations(vk::SubgroupFeatureFlags::SHUFFLE)),
            (Features::SUBGROUP_SHUFFLE_RELATIVE, operations(vk::SubgroupFeatureFlags::SHUFFLE_RELATIVE)),
            (Features::SUBGROUP_CLUSTERED, operations(vk::SubgroupFeatureFlags::CLUSTERED)),
            (Features::SUBGROUP_QUAD, operations(vk::SubgroupFeatureFlags::QUAD)),
            (Features::SUBGROUPS_IN_VERTEX, stages(vk::ShaderStageFlags::VERTEX)),
            (Features::SUBGROUPS_IN_FRAGMENT, stages(vk::ShaderStageFlags::FRAGMENT)),
            (Features::SUBGROUP_UNIFORM_CONTROL_FLOW, flow.shader_subgroup_uniform_control_flow),
        ];
        enabled.into_iter().filter(|(_, on)| *on == vk::TRUE).map(|(feature, _)| feature).collect()
    }
}
