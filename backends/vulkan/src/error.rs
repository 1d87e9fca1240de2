//! Converts Vulkan's result codes to [`BackendError`]s.
//!
//! Calls that can fail go through [`api`] or [`window`](crate::surface::window), so that an error names its call.
//! Results that a caller can act on (out of memory, device lost, surface lost, busy driver) have their own variants.

use ash::vk;
use splatgraph_api::BackendError;

/// Returns a converter for `map_err` that turns the result codes of the Vulkan function `call` into errors.
/// Out-of-memory errors have `bytes` 0, because result codes carry no size.
pub(crate) fn api(call: &'static str) -> impl Fn(vk::Result) -> BackendError {
    move |answer| {
        let text = format!("{answer:?}");
        match answer {
            vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
                BackendError::OutOfMemory { name: call.to_string(), bytes: 0, reason: text }
            }
            vk::Result::ERROR_DEVICE_LOST => BackendError::DeviceLost(format!("{call} returned {text}")),
            vk::Result::TIMEOUT | vk::Result::NOT_READY | vk::Result::ERROR_OUT_OF_DATE_KHR => {
                BackendError::Busy { call, answer: text }
            }
            _ => BackendError::Api { call, answer: text },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_api::Recovery;

    #[test]
    fn errors_name_the_call_and_say_what_can_be_done_about_them() {
        let answer = |result| api("vkQueueSubmit2")(result);
        assert_eq!(answer(vk::Result::ERROR_DEVICE_LOST).recovery(), Recovery::DeviceEnded);
        assert_eq!(answer(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY).recovery(), Recovery::User);
        assert_eq!(answer(vk::Result::TIMEOUT).recovery(), Recovery::Retry);
        let other = answer(vk::Result::ERROR_FEATURE_NOT_PRESENT);
        assert_eq!(other.recovery(), Recovery::Defect);
        assert_eq!(other.to_string(), "vkQueueSubmit2 failed: ERROR_FEATURE_NOT_PRESENT");
    }
}
