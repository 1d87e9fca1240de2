//! Vulkan's answers as [`BackendError`]s.
//!
//! Every call of this crate that can fail goes through [`api`], so that an error always names the call. What a
//! caller can act on (memory, a lost device) has a variant of its own.

use ash::vk;
use splatgraph_api::BackendError;

/// For `map_err`: the error of a Vulkan call of this name.
pub(crate) fn api(call: &'static str) -> impl Fn(vk::Result) -> BackendError {
    move |answer| match answer {
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            BackendError::OutOfMemory(format!("{call} answered {answer:?}"))
        }
        vk::Result::ERROR_DEVICE_LOST => BackendError::DeviceLost(format!("{call} answered {answer:?}")),
        _ => BackendError::Api { call, answer: format!("{answer:?}") },
    }
}

/// A byte count as people read it: `152.6 MiB`, or bytes where it is less than a tenth of that.
pub(crate) fn mib(bytes: u64) -> String {
    const MIB: f64 = 1024.0 * 1024.0;
    if (bytes as f64) < 0.1 * MIB {
        format!("{bytes} bytes")
    } else {
        format!("{:.1} MiB", bytes as f64 / MIB)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_call_and_tell_memory_and_loss_apart() {
        let answer = |result| api("vkQueueSubmit2")(result);
        assert!(matches!(answer(vk::Result::ERROR_DEVICE_LOST), BackendError::DeviceLost(_)));
        assert!(matches!(answer(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY), BackendError::OutOfMemory(_)));
        let other = answer(vk::Result::ERROR_FEATURE_NOT_PRESENT).to_string();
        assert_eq!(other, "vkQueueSubmit2 failed: ERROR_FEATURE_NOT_PRESENT");
    }

    #[test]
    fn sizes_are_written_in_mebibytes() {
        assert_eq!(mib(160_000_000), "152.6 MiB");
        assert_eq!(mib(4096), "4096 bytes");
    }
}
