//! Collects validation messages until they are taken.

use std::sync::{Mutex, PoisonError};

/// Maximum number of messages kept; a mistake repeated in every frame must not fill the memory.
const MOST_MESSAGES: usize = 1000;

/// The messages of an API's validation.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Returns the messages since the last call.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Adds a message, unless a thousand are already kept.
    pub fn add(&self, message: String) {
        let mut messages = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if messages.len() < MOST_MESSAGES {
            messages.push(message);
        } else if messages.len() == MOST_MESSAGES {
            messages.push(format!("more than {MOST_MESSAGES} messages: the rest is not kept"));
        }
    }
}
