//! Lists physical devices with their properties, and opens one.
//!
//! The logical device has a single queue, for compute, graphics and transfer.

use crate::error::api;
use crate::features::OptionalFeatures;
use crate::instance::{API_VERSION, Instance, changing_devices, no_driver};
use crate::robustness::RobustnessFeatures;
use ash::{ext, khr, vk};
use splatgraph_api::{BackendError, DeviceInfo, Heap, Robustness};
use splatgraph_framework::ir::DeviceFacts;
use splatgraph_runtime::{Limits, SubgroupLimits};
use std::ffi::{CStr, c_char};

pub(crate) struct Physical {
    pub handle: vk::PhysicalDevice,
    /// Index of a queue family with compute and graphics. With a window, the family can also present to it. Meaningless
    /// if the device is unfit.
    pub family: u32,
    pub info: DeviceInfo,
    pub limits: Limits,
    /// True if the device has `VK_EXT_memory_budget`.
    pub budget: bool,
}

/// Lists all physical devices. A device is marked unfit if it is older than Vulkan 1.3, if it has no queue family for
/// compute and graphics, or if it cannot present to the instance's window.
pub(crate) fn all(instance: &Instance) -> Result<Vec<Physical>, BackendError> {
    let handles = instance.physical_devices()?;
    Ok(handles.into_iter().enumerate().map(|(index, handle)| describe(instance, handle, index)).collect())
}

pub(crate) fn choose(devices: Vec<Physical>, wanted: Option<&str>) -> Result<Physical, BackendError> {
    if devices.is_empty() {
        return Err(no_driver());
    }
    let infos: Vec<&DeviceInfo> = devices.iter().map(|device| &device.info).collect();
    let found = splatgraph_runtime::choose(&infos, wanted)?;
    Ok(devices.into_iter().nth(found).expect("the index was found in this list"))
}

fn kind_name(kind: vk::PhysicalDeviceType) -> &'static str {
    match kind {
        vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
        vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
        vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
        vk::PhysicalDeviceType::CPU => "cpu",
        _ => "other",
    }
}

fn describe(instance: &Instance, handle: vk::PhysicalDevice, index: usize) -> Physical {
    // The version comes first: an older device must not be queried with the structures of newer versions.
    // SAFETY: `handle` is one of the instance's.
    let basic = unsafe { instance.raw.get_physical_device_properties(handle) };
    let name = basic.device_name_as_c_str().map(CStr::to_string_lossy).unwrap_or_default().into_owned();
    let family = queue_family(instance, handle);
    let mut unfit = None;
    let mut limits = Limits::default();
    let mut driver = String::new();
    let mut robustness = Robustness::default();
    if basic.api_version < API_VERSION {
        unfit = Some(format!(
            "it supports Vulkan {}.{}, but 1.3 is needed",
            vk::api_version_major(basic.api_version),
            vk::api_version_minor(basic.api_version)
        ));
    } else {
        (limits, driver) = query(instance, handle);
        robustness = RobustnessFeatures::of(instance, handle).bounds();
        match &family {
            Ok((_, properties)) => limits.timestamp_bits = properties.timestamp_valid_bits,
            Err(why) => unfit = Some(why.to_string()),
        }
    }
    let facts = limits.facts;
    let budget = instance.has_extension(handle, ext::memory_budget::NAME);
    let heap = if unfit.is_none() { heap(instance, handle, budget) } else { Heap::default() };
    let kind = kind_name(basic.device_type).to_string();
    let info = DeviceInfo { index, name, kind, driver, facts, robustness, heap, unfit };
    Physical { handle, family: family.map_or(0, |f| f.0), info, limits, budget }
}

fn queue_family(
    instance: &Instance,
    handle: vk::PhysicalDevice,
) -> Result<(u32, vk::QueueFamilyProperties), &'static str> {
    // SAFETY: `handle` is one of the instance's.
    let families = unsafe { instance.raw.get_physical_device_queue_family_properties(handle) };
    let flags: Vec<vk::QueueFlags> = families.iter().map(|family| family.queue_flags).collect();
    let index = match instance.surface() {
        None => fit_family(&flags, |_| true)?,
        Some(_) if !instance.has_extension(handle, khr::swapchain::NAME) => return Err(NO_PRESENTING),
        Some(surface) => fit_family(&flags, |family| surface.can_show(handle, family))?,
    };
    Ok((index, families[index as usize]))
}

const NO_PRESENTING: &str = "it cannot show pictures in this window";

/// Finds the first family with compute and graphics that satisfies `presents`; an error says why there is none.
fn fit_family(families: &[vk::QueueFlags], presents: impl Fn(u32) -> bool) -> Result<u32, &'static str> {
    let needed = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let mut able = (0..).zip(families).filter(|(_, flags)| flags.contains(needed)).peekable();
    if able.peek().is_none() {
        return Err("it has no queue that can both compute and draw");
    }
    able.map(|(index, _)| index).find(|&index| presents(index)).ok_or(NO_PRESENTING)
}

/// Describes the largest device-local heap; the result is empty without one. Its available bytes are known only with
/// `VK_EXT_memory_budget` (`budget`).
pub(crate) fn heap(instance: &Instance, handle: vk::PhysicalDevice, budget: bool) -> Heap {
    let mut left = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
    let mut answer = vk::PhysicalDeviceMemoryProperties2::default();
    if budget {
        answer = answer.push_next(&mut left);
    }
    // SAFETY: `handle` is one of the instance's, of version 1.1 or later, and the chain holds what it supports.
    unsafe { instance.raw.get_physical_device_memory_properties2(handle, &mut answer) };
    let memory = answer.memory_properties;
    let Some(index) = largest_heap(&memory) else { return Heap::default() };
    let available = left.heap_budget[index].saturating_sub(left.heap_usage[index]);
    // A budget of 0 means that the driver reports none for this heap.
    let known = budget && left.heap_budget[index] > 0;
    Heap { bytes: memory.memory_heaps[index].size, available: known.then_some(available) }
}

fn largest_heap(memory: &vk::PhysicalDeviceMemoryProperties) -> Option<usize> {
    let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
    let local = (0..heaps.len()).filter(|&i| heaps[i].flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
    local.max_by_key(|&index| heaps[index].size)
}

/// Queries a device of version 1.3 or later for its limits and its driver's name and version. `timestamp_bits` stays 0:
/// it belongs to the queue family.
fn query(instance: &Instance, handle: vk::PhysicalDevice) -> (Limits, String) {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut subgroups = vk::PhysicalDeviceSubgroupProperties::default();
    let mut control = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
    let mut maintenance3 = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut maintenance4 = vk::PhysicalDeviceMaintenance4Properties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut driver)
        .push_next(&mut subgroups)
        .push_next(&mut control)
        .push_next(&mut maintenance3)
        .push_next(&mut maintenance4);
    // SAFETY: the chain holds structures of Vulkan 1.3 only, which the device has.
    unsafe { instance.raw.get_physical_device_properties2(handle, &mut properties) };
    let core = properties.properties.limits;
    // SAFETY: `handle` is one of the instance's.
    let memory = unsafe { instance.raw.get_physical_device_memory_properties(handle) };
    // SAFETY: as above.
    let features = unsafe { instance.raw.get_physical_device_features(handle) };
    // SAFETY: as above.
    let floats = unsafe {
        instance.raw.get_physical_device_format_properties(handle, vk::Format::R32G32B32A32_SFLOAT)
    };
    let blends_floats =
        floats.optimal_tiling_features.contains(vk::FormatFeatureFlags::COLOR_ATTACHMENT_BLEND);

    let buffer = maintenance4.max_buffer_size.min(maintenance3.max_memory_allocation_size);
    let limits = Limits {
        facts: DeviceFacts {
            // The default size may lie outside the range that a request may name.
            subgroup_size: subgroups
                .subgroup_size
                .clamp(control.min_subgroup_size, control.max_subgroup_size),
            max_groups: core.max_compute_work_group_count,
            max_storage_bytes: (core.max_storage_buffer_range as u64).min(buffer),
            max_push_bytes: core.max_push_constants_size,
            max_invocations: core.max_compute_work_group_invocations,
            shared_bytes: core.max_compute_shared_memory_size,
            max_image_size: core
                .max_image_dimension2_d
                .min(core.max_framebuffer_width)
                .min(core.max_framebuffer_height)
                .min(core.max_viewport_dimensions[0])
                .min(core.max_viewport_dimensions[1]),
            max_targets: core.max_color_attachments,
            rounds_half: rounds_once(driver.driver_id) || !blends_floats,
            fused_fma: rounds_once(driver.driver_id),
            features: OptionalFeatures::of(instance, handle).shaders,
        },
        max_uniform_bytes: core.max_uniform_buffer_range as u64,
        max_buffer_bytes: buffer,
        max_local_size: core.max_compute_work_group_size,
        max_storage_buffers: core.max_per_stage_descriptor_storage_buffers,
        max_uniform_buffers: core.max_per_stage_descriptor_uniform_buffers,
        max_storage_images: core.max_per_stage_descriptor_storage_images,
        heap_bytes: largest_heap(&memory).map_or(0, |index| memory.memory_heaps[index].size),
        device_memory_types: memory.memory_types[..memory.memory_type_count as usize]
            .iter()
            .enumerate()
            .filter(|(_, kind)| kind.property_flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL))
            .fold(0, |types, (index, _)| types | 1 << index),
        buffer_image_granularity: core.buffer_image_granularity,
        independent_blend: features.independent_blend == vk::TRUE,
        subgroup: SubgroupLimits {
            min_size: control.min_subgroup_size,
            max_size: control.max_subgroup_size,
            selectable: control.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE),
            max_per_group: control.max_compute_workgroup_subgroups,
        },
        timestamp_bits: 0,
        // On lavapipe, reading timestamps waits for all submitted work.
        live_timestamps: driver.driver_id != vk::DriverId::MESA_LLVMPIPE,
        timestamp_period: core.timestamp_period,
    };
    let text = |s: Result<&CStr, _>| s.map(CStr::to_string_lossy).unwrap_or_default().into_owned();
    let driver = format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()));
    (limits, driver.trim().to_string())
}

/// Returns true if a driver is known to round half-float blending to nearest, and `fma` once.
///
/// Vulkan guarantees neither. Blending truncates on AMD and lavapipe. RADV before RDNA 2, V3DV and lavapipe compute
/// `fma` as a multiplication and an addition. `false` costs only time; a wrong `true` costs accuracy.
fn rounds_once(driver: vk::DriverId) -> bool {
    driver == vk::DriverId::NVIDIA_PROPRIETARY
}

/// Creates the logical device, with `extensions` (such as the swapchain's) in addition to the crate's own.
///
/// Enables the strictest bounds checks of shader accesses that the device supports, unless `unchecked`.
pub(crate) fn create(
    instance: &Instance,
    physical: &Physical,
    extensions: &[&CStr],
    unchecked: bool,
) -> Result<ash::Device, BackendError> {
    let mut features = OptionalFeatures::of(instance, physical.handle);
    let OptionalFeatures {
        core, vulkan11, vulkan12, float, has_atomic_float, flow, has_uniform_flow, ..
    } = &mut features;
    // Features that every 1.3 device has are requested outright. The others are enabled if present: a plan with a
    // shader that needs a missing one is refused.
    vulkan12.host_query_reset = vk::TRUE;
    let mut robust = RobustnessFeatures::default();
    if !unchecked {
        robust = RobustnessFeatures::of(instance, physical.handle);
    }
    core.robust_buffer_access = robust.buffers;
    let mut vulkan13 = vk::PhysicalDeviceVulkan13Features::default()
        .synchronization2(true)
        .dynamic_rendering(true)
        .maintenance4(true)
        // Since SPIR-V 1.6, `discard` compiles to a demotion.
        .shader_demote_to_helper_invocation(true)
        .shader_integer_dot_product(true)
        .subgroup_size_control(true)
        .compute_full_subgroups(true);
    vulkan13.robust_image_access = robust.images;

    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(physical.family)
        .queue_priorities(&priorities)];
    let mut names: Vec<*const c_char> = extensions.iter().map(|name| name.as_ptr()).collect();
    if robust.two.is_some() {
        names.push(ext::robustness2::NAME.as_ptr());
    }
    if physical.budget {
        names.push(ext::memory_budget::NAME.as_ptr());
    }
    // A device that has this extension must be opened with it.
    if instance.has_extension(physical.handle, khr::portability_subset::NAME) {
        names.push(khr::portability_subset::NAME.as_ptr());
    }
    let mut info = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_features(core)
        .push_next(vulkan11)
        .push_next(vulkan12)
        .push_next(&mut vulkan13);
    if let Some(two) = &mut robust.two {
        info = info.push_next(two);
    }
    if *has_atomic_float {
        names.push(ext::shader_atomic_float::NAME.as_ptr());
        info = info.push_next(float);
    }
    if *has_uniform_flow {
        names.push(khr::shader_subgroup_uniform_control_flow::NAME.as_ptr());
        info = info.push_next(flow);
    }
    info = info.enabled_extension_names(&names);
    // SAFETY: `info` and its chain live until the call returns; the features requested are mandatory or were found.
    let device = changing_devices(|| unsafe { instance.raw.create_device(physical.handle, &info, None) });
    device.map_err(api("vkCreateDevice"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instance::no_driver_in;

    #[test]
    fn the_queue_is_of_a_family_that_draws_and_computes_and_shows_pictures_in_the_window() {
        let (draw, compute) = (vk::QueueFlags::GRAPHICS, vk::QueueFlags::COMPUTE);
        let families = [compute, draw | compute, draw | compute];
        assert_eq!(fit_family(&families, |_| true), Ok(1));
        assert_eq!(fit_family(&families, |family| family != 1), Ok(2));
        assert_eq!(fit_family(&families, |family| family == 0), Err(NO_PRESENTING));
        assert!(fit_family(&[compute, draw], |_| true).unwrap_err().contains("both compute and draw"));
    }

    #[test]
    fn a_machine_without_drivers_is_told_what_to_install_or_which_variable_is_wrong() {
        let named = no_driver_in(Some(("VK_DRIVER_FILES", "/none.json".into()))).to_string();
        assert!(named.contains("VK_DRIVER_FILES=/none.json"), "{named}");
        let error = no_driver_in(None).to_string();
        let named = [("macos", "MoltenVK"), ("windows", "graphics card"), ("linux", "mesa-vulkan-drivers")];
        for (_, what) in named.into_iter().filter(|(system, _)| *system == std::env::consts::OS) {
            assert!(error.contains(what), "{error}");
        }
    }

    #[test]
    fn only_drivers_whose_rounding_is_known_are_trusted_to_round_once() {
        use vk::DriverId as Id;
        let unknown = [Id::MESA_LLVMPIPE, Id::MESA_RADV, Id::AMD_PROPRIETARY, Id::MESA_V3DV, Id::MESA_TURNIP];
        assert!(!unknown.into_iter().any(rounds_once));
        assert!(rounds_once(Id::NVIDIA_PROPRIETARY));
    }
}
