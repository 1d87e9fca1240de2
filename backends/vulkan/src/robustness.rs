//! Queries robustness features, which limit what out-of-range shader accesses can reach.

use crate::instance::Instance;
use ash::{ext, vk};
use splatgraph_api::{Bounds, Robustness};

/// The robustness features of a device of version 1.3 or later. By default, all are off.
#[derive(Clone, Copy, Default)]
pub(crate) struct RobustnessFeatures {
    /// `robustBufferAccess`.
    pub buffers: vk::Bool32,
    /// `robustImageAccess`.
    pub images: vk::Bool32,
    /// Features of `VK_EXT_robustness2`; `None` without the extension.
    pub two: Option<vk::PhysicalDeviceRobustness2FeaturesEXT<'static>>,
}

impl RobustnessFeatures {
    pub fn of(instance: &Instance, handle: vk::PhysicalDevice) -> RobustnessFeatures {
        let has_two = instance.has_extension(handle, ext::robustness2::NAME);
        let mut vulkan13 = vk::PhysicalDeviceVulkan13Features::default();
        let mut two = vk::PhysicalDeviceRobustness2FeaturesEXT::default();
        let mut all = vk::PhysicalDeviceFeatures2::default().push_next(&mut vulkan13);
        if has_two {
            all = all.push_next(&mut two);
        }
        // SAFETY: the chain holds structures of Vulkan 1.3, which the device has, and of an extension that it offers.
        unsafe { instance.raw.get_physical_device_features2(handle, &mut all) };
        let buffers = all.features.robust_buffer_access;
        let images = vulkan13.robust_image_access;
        // Its chain is rebuilt when the features are requested.
        let two = vk::PhysicalDeviceRobustness2FeaturesEXT { p_next: std::ptr::null_mut(), ..two };
        RobustnessFeatures { buffers, images, two: has_two.then_some(two) }
    }

    pub fn bounds(&self) -> Robustness {
        let bounds = |exact, memory| match (exact == vk::TRUE, memory == vk::TRUE) {
            (true, _) => Bounds::Exact,
            (false, true) => Bounds::Memory,
            (false, false) => Bounds::None,
        };
        let two = self.two.unwrap_or_default();
        Robustness {
            buffers: bounds(two.robust_buffer_access2, self.buffers),
            images: bounds(two.robust_image_access2, self.images),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_are_the_strictest_that_the_features_give() {
        assert_eq!(RobustnessFeatures::default().bounds(), Robustness::default());
        let mut features = RobustnessFeatures { buffers: vk::TRUE, images: vk::TRUE, two: None };
        let memory = Robustness { buffers: Bounds::Memory, images: Bounds::Memory };
        assert_eq!(features.bounds(), memory);
        let two = vk::PhysicalDeviceRobustness2FeaturesEXT::default().robust_buffer_access2(true);
        features.two = Some(two);
        assert_eq!(features.bounds(), Robustness { buffers: Bounds::Exact, ..memory });
    }
}
