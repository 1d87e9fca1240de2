//! Defines the errors of backends, classified by how to recover.

use splatgraph_framework::ir::Origin;
use std::fmt;

/// An error of a backend call. [`BackendError::recovery`] classifies it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BackendError {
    /// A driver, a usable device or the validation layer is missing, or the window cannot be drawn to.
    #[error("{0}")]
    Unavailable(String),
    /// The plan or the frame exceeds a limit of the device.
    #[error("{0}")]
    Limit(LimitExceeded),
    /// The plan needs something that the device does not support.
    #[error("{0}")]
    Unsupported(String),
    /// Memory could not be allocated.
    #[error("out of memory for {} ({}): {reason}", quoted(name), display_bytes(*bytes))]
    OutOfMemory {
        /// Name of the resource or the plan, or of the call that failed.
        name: String,
        /// The requested size; 0 if unknown.
        bytes: u64,
        /// Reason from the allocator or the driver.
        reason: String,
    },
    /// The plan is inconsistent, the inputs of a frame do not fit it, or the call is wrong, such as a wait for a result
    /// that was already taken.
    #[error("{0}")]
    Invalid(String),
    /// The scene cannot supply an attribute that the plan reads.
    #[error("cannot read plane {plane} of scene attribute `{attribute}`: {reason}")]
    Scene {
        /// The attribute's full name.
        attribute: String,
        /// The index of the plane.
        plane: u32,
        /// The reason that the scene gave.
        reason: String,
    },
    /// The driver was busy, or the window changed during the call.
    #[error("{call} returned {answer}: try again")]
    Busy {
        /// The call that failed.
        call: &'static str,
        /// The driver's result code.
        answer: String,
    },
    /// The window or its display is gone. The surface was lost while the device was opened, or again after it was
    /// replaced.
    #[error(
        "{call} reported that the window's surface is lost: the window was closed, or its display went away"
    )]
    SurfaceLost {
        /// The call that failed.
        call: &'static str,
    },
    /// A pass or an upload ran longer than [`Options::patience`](crate::Options::patience). A frame stays in flight and
    /// can be waited for again; an upload fails its load.
    #[error(
        "{place} has been running for {seconds} s; it may never end, or the driver still compiles its shaders (lavapipe does so at \
         the first dispatch)"
    )]
    Stuck {
        /// Description of the running work, as in [`Running::place`](crate::Running::place).
        place: String,
        /// Seconds for which this work has been observed running.
        seconds: u64,
    },
    /// The driver's compiler did not finish a pipeline in time, or too many compilers are stuck already. The plan can
    /// be loaded once the named pipeline is finished.
    #[error(
        "the driver has been compiling shader `{shader}` for pass `{pass}` of `{plan}` for more than {seconds} s; it may never end"
    )]
    StuckCompiler {
        /// Name of the plan that is being compiled, which can be another plan than the refused one.
        plan: String,
        /// The first pass that uses the pipeline; `?` if the compiler has not begun one.
        pass: String,
        /// The shader, for a draw the vertex shader; `?` as for `pass`.
        shader: String,
        /// Seconds waited.
        seconds: u64,
    },
    /// The caller cancelled the load; see [`Loader::cancelled_by`](crate::Loader::cancelled_by).
    #[error("the load was cancelled")]
    Cancelled,
    /// The device was lost. The text ends with the frame, the last completed pass and the next one, as far as known.
    #[error("device lost: {0}")]
    DeviceLost(String),
    /// Any other error from an API call.
    #[error("{call} failed: {answer}")]
    Api {
        /// The call that failed.
        call: &'static str,
        /// The driver's result code or message.
        answer: String,
    },
}

fn quoted(name: &str) -> String {
    if name.contains('`') { name.to_string() } else { format!("`{name}`") }
}

/// Formats a source location like the location line of a graph error.
fn place(Origin { file, line, column }: &Origin) -> String {
    format!("\n --> {file}:{line}:{column}")
}

/// The class of a [`BackendError`], by the way to recover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recovery {
    /// Retrying the call may succeed.
    Retry,
    /// The user can act: install a driver; choose another device, scene or parameter; free memory; or open another
    /// window.
    User,
    /// A bug in the program or the driver. The plan or the inputs are wrong, or an API call failed unexpectedly.
    Defect,
    /// The device is lost: open another.
    DeviceEnded,
}

impl BackendError {
    /// Adds the declaration of the resource or pass at fault to [`BackendError::Limit`] or
    /// [`BackendError::Unsupported`]; returns other errors unchanged.
    #[must_use]
    pub fn at(self, origin: &Origin) -> BackendError {
        match self {
            BackendError::Limit(limit) => {
                BackendError::Limit(LimitExceeded { origin: Some(origin.clone()), ..limit })
            }
            BackendError::Unsupported(text) => BackendError::Unsupported(text + &place(origin)),
            other => other,
        }
    }

    /// Returns how to recover from the error.
    pub fn recovery(&self) -> Recovery {
        match self {
            BackendError::Busy { .. }
            | BackendError::Stuck { .. }
            | BackendError::StuckCompiler { .. }
            | BackendError::Cancelled => Recovery::Retry,
            BackendError::Unavailable(_)
            | BackendError::SurfaceLost { .. }
            | BackendError::Limit(_)
            | BackendError::Unsupported(_)
            | BackendError::OutOfMemory { .. }
            | BackendError::Scene { .. } => Recovery::User,
            BackendError::Invalid(_) | BackendError::Api { .. } => Recovery::Defect,
            BackendError::DeviceLost(_) => Recovery::DeviceEnded,
        }
    }
}

/// A device limit that a plan or a frame exceeds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LimitExceeded {
    /// The limited quantity, for instance "the size of buffer `keys`".
    pub what: String,
    /// The amount needed.
    pub needed: u64,
    /// The device's maximum.
    pub available: u64,
    /// The unit of both amounts.
    pub unit: Unit,
    /// Declaration of the resource or pass in the graph; `None` if the limit concerns the plan or a frame.
    pub origin: Option<Origin>,
}

/// The unit of a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Bytes, displayed in mebibytes if large.
    Bytes,
    /// A plain number, for instance of pixels, workgroups or bindings.
    Count,
}

impl fmt::Display for LimitExceeded {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let LimitExceeded { what, needed, available, unit, origin } = self;
        let [available, needed] = [*available, *needed].map(|amount| match unit {
            Unit::Bytes => display_bytes(amount),
            Unit::Count => amount.to_string(),
        });
        write!(f, "{what} exceeds the device's limit: expected at most {available}, found {needed}")?;
        origin.as_ref().map_or(Ok(()), |origin| f.write_str(&place(origin)))
    }
}

/// Formats a byte count: `152.6 MiB`, or bytes below a tenth of a mebibyte.
pub fn display_bytes(bytes: u64) -> String {
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
    fn sizes_are_written_in_mebibytes() {
        assert_eq!(display_bytes(160_000_000), "152.6 MiB");
        assert_eq!(display_bytes(4096), "4096 bytes");
    }

    #[test]
    fn what_runs_for_long_is_named_and_can_be_waited_for_again() {
        let stuck = BackendError::Stuck { place: "pass `sort.scan[0]` of `splat`".to_string(), seconds: 12 };
        assert_eq!(
            stuck.to_string(),
            "pass `sort.scan[0]` of `splat` has been running for 12 s; it may never end, or the driver still compiles its shaders \
             (lavapipe does so at the first dispatch)"
        );
        assert_eq!(stuck.recovery(), Recovery::Retry);
        let [plan, pass, shader] = ["splat", "sort.scan[0]", "sort/scan.comp"].map(str::to_string);
        let stuck = BackendError::StuckCompiler { plan, pass, shader, seconds: 60 };
        assert_eq!(
            stuck.to_string(),
            "the driver has been compiling shader `sort/scan.comp` for pass `sort.scan[0]` of `splat` for more than 60 s; \
             it may never end"
        );
        assert_eq!(stuck.recovery(), Recovery::Retry);
    }

    #[test]
    fn a_limit_is_told_with_both_amounts() {
        let mut limit = LimitExceeded {
            what: "the size of buffer `keys`".to_string(),
            needed: 160_000_000,
            available: 4096,
            unit: Unit::Bytes,
            origin: None,
        };
        let text = "the size of buffer `keys` exceeds the device's limit: expected at most 4096 bytes, found 152.6 MiB";
        assert_eq!(limit.to_string(), text);
        limit.unit = Unit::Count;
        assert!(limit.to_string().ends_with("expected at most 4096, found 160000000"));
        let origin = Origin { file: "sort.ron".to_string(), line: 7, column: 9 };
        let placed = BackendError::Limit(limit).at(&origin);
        assert!(placed.to_string().ends_with("found 160000000\n --> sort.ron:7:9"), "{placed}");
        assert_eq!(placed.recovery(), Recovery::User);
    }
}
