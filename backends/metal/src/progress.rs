//! Determines the progress of a submission from the statuses of its command buffers.

/// `MTLCommandBufferStatusCompleted`
const COMPLETED: u64 = 4;
/// `MTLCommandBufferStatusError`
const FAILED: u64 = 5;

/// The progress of a submission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// No command buffer has failed, and at least one has not completed.
    Running,
    /// All command buffers have completed.
    Completed,
    /// The command buffer with this index has failed, the first that did. It signals no event, so the others may never
    /// complete.
    Failed(usize),
}

/// Returns the progress of command buffers with these values of `MTLCommandBufferStatus`.
pub fn progress(statuses: impl IntoIterator<Item = u64>) -> Progress {
    let mut progress = Progress::Completed;
    for (index, status) in statuses.into_iter().enumerate() {
        match status {
            FAILED => return Progress::Failed(index),
            COMPLETED => {}
            _ => progress = Progress::Running,
        }
    }
    progress
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_submission_has_completed_once_all_its_command_buffers_have() {
        assert_eq!(progress([4, 4, 4]), Progress::Completed);
        for unfinished in 0..4 {
            assert_eq!(progress([4, unfinished]), Progress::Running);
            assert_eq!(progress([unfinished, 4]), Progress::Running);
        }
    }

    #[test]
    fn a_submission_has_failed_although_the_window_still_waits_for_its_frame() {
        let committed = 2;
        assert_eq!(progress([5, committed]), Progress::Failed(0));
        assert_eq!(progress([committed, committed, 5]), Progress::Failed(2));
        assert_eq!(progress([4, 5, 5]), Progress::Failed(1));
    }
}
