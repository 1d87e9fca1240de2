//! Collects validation messages until they are taken.

use crate::lock::lock;
use std::sync::Mutex;

/// Maximum number of messages kept, so that an error repeated in every frame does not fill the memory.
const MAX_MESSAGES: usize = 1000;

/// Messages of the API's validation, collected from any thread.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Removes and returns the messages collected since the last call.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.0))
    }

    /// Adds a message. Once `MAX_MESSAGES` are kept, adds a note in place of the first further one, and drops the
    /// rest.
    pub fn add(&self, message: String) {
        let mut messages = lock(&self.0);
        if messages.len() < MAX_MESSAGES {
            messages.push(message);
        } else if messages.len() == MAX_MESSAGES {
            messages.push(format!("more than {MAX_MESSAGES} messages: the rest is dropped"));
        }
    }
}
