//! Converts Metal's failures to [`BackendError`]s.
//!
//! Objects that cannot be created are `nil`, and commands fail when they run. The results of a failed command buffer
//! are unreliable, so the device then counts as lost and must be reopened.

use splatgraph_api::BackendError;

/// Returns the error for a call that returned `nil` instead of a new object.
pub fn no_object(call: &'static str) -> BackendError {
    BackendError::Api { call, answer: "nil".to_string() }
}

/// Returns the error for a command buffer that failed with this code and description.
///
/// The codes are those of `MTLCommandBufferError`, and of the driver (`kIOGPUCommandBufferCallbackError`), which Apple
/// does not document.
pub fn of_command_buffer(code: i64, text: &str) -> BackendError {
    let name = match code {
        1 => "Internal",
        2 => "Timeout",
        3 => "PageFault or Hang",
        // `SubmissionsIgnored` follows other failures of the same program.
        4 => "AccessRevoked or SubmissionsIgnored",
        5 => "InnocentVictim",
        7 => "NotPermitted",
        8 => "OutOfMemory",
        9 => "InvalidResource",
        10 => "Memoryless",
        11 => "DeviceRemoved",
        12 => "StackOverflow",
        14 => "ImpactingInteractivity",
        _ => "another error",
    };
    BackendError::DeviceLost(format!("a command buffer ended with {name} ({code}): {text}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_api::Recovery;

    #[test]
    fn a_command_buffer_that_failed_ends_the_device_and_says_why() {
        let error = of_command_buffer(2, "Caused GPU Timeout Error");
        assert_eq!(error.recovery(), Recovery::DeviceEnded);
        assert!(error.to_string().contains("Timeout (2): Caused GPU Timeout Error"), "{error}");
        let slow = of_command_buffer(14, "Impacting Interactivity").to_string();
        assert!(slow.contains("ended with ImpactingInteractivity (14)"), "{slow}");
        assert!(of_command_buffer(4, "Ignored").to_string().contains("SubmissionsIgnored (4)"));
        assert!(of_command_buffer(99, "?").to_string().contains("another error (99)"));
    }

    #[test]
    fn a_call_that_made_nothing_is_named() {
        assert_eq!(no_object("newCommandQueue").to_string(), "newCommandQueue failed: nil");
    }
}
