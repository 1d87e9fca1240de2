//! Defines the exit codes of commands, and prints their last messages.

use crate::io::output::{self, OutputGuard, say};
use splatgraph_framework::reload::Wanted;
use std::io::IsTerminal;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Success: exit code 0.
    Done,
    /// A negative result that was already reported: exit code 1.
    Failed,
}

/// An invalid command line, detected after parsing: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

impl From<output::guard::Conflict> for Usage {
    fn from(conflict: output::guard::Conflict) -> Usage {
        Usage(conflict.to_string())
    }
}

/// Rejects given options. Each entry is an option, and true if it is given; `why` formats the error for the first.
pub fn refuse(options: &[(&str, bool)], why: impl FnOnce(&str) -> String) -> Result<(), Usage> {
    let given = options.iter().find(|(_, is_given)| *is_given);
    given.map_or(Ok(()), |(option, _)| Err(Usage(why(option))))
}

/// Rejects duplicates in the values of an option; `text` formats a value for the message.
pub fn once<T: PartialEq>(option: &str, list: &[T], text: impl Fn(&T) -> String) -> Result<(), Usage> {
    let again = list.iter().enumerate().find(|(at, item)| list[..*at].contains(item));
    match again {
        Some((_, item)) => {
            Err(Usage(format!("{option}: expected each value once, found {} twice", text(item))))
        }
        None => Ok(()),
    }
}

/// Rejects options that need the option `required`, which is not given.
///
/// clap checks this by itself, except where `required` conflicts with another argument that is present.
pub fn refuse_without(required: &str, options: &[(&str, bool)]) -> Result<(), Usage> {
    refuse(options, |option| format!("expected {required} with {option}, found none"))
}

pub fn claim_graph_files(guard: &mut OutputGuard, wanted: &[Wanted]) -> Result<(), Usage> {
    wanted.iter().try_for_each(|file| Ok(guard.input("a file of the graph", &file.path)?))
}

/// Prints validation messages. They make the command fail if validation was requested.
pub fn validated(asked: bool, messages: &[String]) -> Outcome {
    for message in messages {
        say(format!("validation: {message}"));
    }
    match (asked, messages.len()) {
        (false, _) => Outcome::Done,
        (true, 0) => {
            say("validation: no messages");
            Outcome::Done
        }
        (true, count) => {
            say(format!("error: the validation layer reported {count} messages"));
            Outcome::Failed
        }
    }
}

/// Returns true if messages have colours. Standard error is then a terminal that can show them, and `NO_COLOR` is unset
/// or empty.
pub fn colour() -> bool {
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    std::io::stderr().is_terminal()
        && variable("NO_COLOR").is_none()
        && variable("TERM").is_none_or(|term| term != "dumb")
}
