//! Chooses the storage of a scene's splats: the most accurate one that fits in the available memory.
//!
//! A graph that can pack splats has the parameters `sh_storage` and `storage`. Their values form a ladder, from the
//! most accurate to the smallest. The plan of each rung is built in order, until its resident bytes fit. Rungs whose
//! plan cannot be built are skipped. If the user sets one of these parameters, `covariance` or `position_storage`,
//! there is nothing to choose.

use crate::draw::fit::{self, Target, Wanted};
use crate::draw::planner::GraphErrors;
use crate::io::load::LoadOptions;
use serde_json::{Value as Json, json};
use splatgraph_api::Heap;
use splatgraph_assets::grouped;
use splatgraph_assets::memory::display;
use splatgraph_framework::plan::Plan;
use std::fmt;
use std::path::Path;

/// Rung of the ladder: a value of a storage parameter.
struct Rung {
    set: (&'static str, &'static str),
    /// PSNR against `storage=separate`, in decibels, rounded down: the lower of two captures, docs/accuracy-tables.md.
    psnr: u32,
}

/// Rungs after the graph's own storage, from the most accurate to the smallest.
const LADDER: [Rung; 4] = [
    Rung { set: ("sh_storage", "q8"), psnr: 79 },
    Rung { set: ("storage", "b64"), psnr: 70 },
    Rung { set: ("storage", "b32"), psnr: 54 },
    Rung { set: ("storage", "b24"), psnr: 45 },
];

/// Parameters that decide the storage: if one is set, there is nothing to choose.
const PARAMETERS: [&str; 4] = ["storage", "sh_storage", "covariance", "position_storage"];

/// Setting of a storage; `None` is the graph's own.
type Setting = Option<(String, String)>;

/// Storage that was chosen, and the settings that were tried before it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Setting to add to the user's; `None` if the graph's own storage fits.
    pub set: Setting,
    /// Tried settings with their resident bytes; the chosen one is last.
    tried: Vec<(Setting, u64)>,
    psnr: Option<u32>,
    memory: u64,
}

/// Error while choosing a storage.
#[derive(Debug, thiserror::Error)]
pub enum StorageError {
    /// No plan can be built.
    // Not transparent: the graph's errors are found among the causes, and printed with their source text.
    #[error("{0}")]
    Plan(#[from] GraphErrors),
    /// Even the smallest storage exceeds the available memory.
    #[error(
        "expected a plan of at most {memory} bytes, found that the smallest storage ({}) needs {needed} bytes",
        name(.set)
    )]
    TooLarge {
        /// Available memory, in bytes.
        memory: u64,
        /// Setting that needs the least memory.
        set: Setting,
        /// Resident bytes with that setting.
        needed: u64,
    },
}

impl StorageError {
    /// Adds to an error about memory how many splats of the scene at `path` would fit with the smallest storage.
    /// `device` and `wanted` are those of the choice, and the scene was loaded with `load`.
    pub fn with_fit(
        self,
        wanted: &Wanted,
        device: &Target,
        path: &Path,
        load: &LoadOptions,
    ) -> anyhow::Error {
        let StorageError::TooLarge { set, .. } = &self else { return self.into() };
        let set: Vec<_> = wanted.set.iter().cloned().chain(set.clone()).collect();
        match fit::check(&Wanted { set: &set, ..*wanted }, device, path, load) {
            Err(error) => error.context(self),
            Ok(()) => self.into(),
        }
    }
}

impl Choice {
    /// Returns the setting with the smallest storage; `None` if the user's parameters `set` leave no choice.
    pub fn smallest(set: &[(String, String)]) -> Option<(String, String)> {
        let last = LADDER.last().filter(|_| !decided(set))?;
        Some((last.set.0.to_owned(), last.set.1.to_owned()))
    }

    /// Chooses the most accurate storage whose plan fits in the heap's free memory, and returns its plan.
    ///
    /// The plan may keep at most `limit` bytes on the device. Bytes that are freed after the first frame do not count.
    /// `set` are the user's parameters. `plan` builds a plan from a list of parameters.
    ///
    /// `None` if neither the limit nor the memory is known. Without a limit, also if no plan can be built or fits: the
    /// caller reports why when it draws.
    ///
    /// # Errors
    /// There is a limit, and no plan can be built, or all plans need too much memory.
    pub fn within(
        limit: Option<u64>,
        heap: &Heap,
        set: &[(String, String)],
        plan: impl FnMut(&[(String, String)]) -> Result<Plan, GraphErrors>,
    ) -> Result<Option<(Choice, Plan)>, StorageError> {
        let Some(memory) = limit.into_iter().chain(fit::available(heap)).min() else { return Ok(None) };
        match Choice::of(set, memory, plan) {
            Err(_) if limit.is_none() => Ok(None),
            chosen => chosen.map(Some),
        }
    }

    fn of(
        set: &[(String, String)],
        memory: u64,
        mut plan: impl FnMut(&[(String, String)]) -> Result<Plan, GraphErrors>,
    ) -> Result<(Choice, Plan), StorageError> {
        let ladder = if decided(set) { &[][..] } else { &LADDER[..] };
        let (mut tried, mut error) = (Vec::new(), None);
        for rung in [None].into_iter().chain(ladder.iter().map(Some)) {
            let own = rung.map(|rung| (rung.set.0.to_owned(), rung.set.1.to_owned()));
            let all: Vec<_> = set.iter().cloned().chain(own.clone()).collect();
            match plan(&all) {
                Ok(plan) => {
                    let needed = fit::resident_bytes(&plan);
                    tried.push((own.clone(), needed));
                    if needed <= memory {
                        let choice = Choice { set: own, tried, psnr: rung.map(|rung| rung.psnr), memory };
                        return Ok((choice, plan));
                    }
                }
                Err(found) => _ = error.get_or_insert(found),
            }
        }
        match (tried.into_iter().min_by_key(|(_, needed)| *needed), error) {
            (Some((set, needed)), _) => Err(StorageError::TooLarge { memory, set, needed }),
            (None, Some(error)) => Err(StorageError::Plan(error)),
            (None, None) => unreachable!("the graph's own storage is always tried"),
        }
    }

    /// Converts to JSON: the memory, and the tried settings with their resident bytes, the chosen one last.
    pub fn json(&self) -> Json {
        let row = |(set, needed): &(Setting, u64)| json!({ "setting": name(set), "bytes": needed });
        json!({ "memory": self.memory, "tried": self.tried.iter().map(row).collect::<Vec<_>>() })
    }
}

/// Returns true if the user's parameters `set` leave no choice.
fn decided(set: &[(String, String)]) -> bool {
    set.iter().any(|(name, _)| PARAMETERS.contains(&name.as_str()))
}

fn name(set: &Setting) -> String {
    set.as_ref()
        .map_or_else(|| "the graph's own storage".to_owned(), |(name, value)| format!("{name}={value}"))
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(((chosen, needed), larger)) = self.tried.split_last() else { return Ok(()) };
        let memory = display(self.memory);
        write!(f, "storage: {} needs {} bytes of {memory}", name(chosen), grouped(*needed))?;
        for (index, (set, needed)) in larger.iter().enumerate() {
            let before = if index == 0 { "; " } else { ", " };
            write!(f, "{before}{} would need {}", name(set), grouped(*needed))?;
        }
        if let Some(psnr) = self.psnr {
            write!(f, ". Captures keep {psnr} dB with it (docs/accuracy-tables.md)")?;
        }
        Ok(())
    }
}

/// Parses a memory size: a number of bytes, or a number with a unit, such as `8GiB` or `500MB`.
///
/// # Errors
/// The text is not a size, or the size is less than a byte or not less than 2^64 bytes.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let expected = || format!("expected bytes, such as 8GiB, 500MB or 1073741824, found `{text}`");
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let number: f64 = number.parse().map_err(|_| expected())?;
    let unit = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1024f64.powi(2),
        "g" | "gib" => 1024f64.powi(3),
        "t" | "tib" => 1024f64.powi(4),
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        _ => return Err(expected()),
    };
    match number * unit {
        bytes if bytes >= 1.0 && bytes < u64::MAX as f64 => Ok(bytes as u64),
        _ => Err(expected()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts;
    use crate::draw::planner::{Planner, testing};

    fn choose(graph: &str, set: &[(&str, &str)], memory: u64) -> Result<Choice, StorageError> {
        let (mut planner, facts, catalog) = (Planner::default(), facts::nominal(8), facts::nominal_catalog());
        let set = testing::set(set);
        let choice = Choice::of(&set, memory, |set| planner.plan(graph, set, &facts, &catalog));
        choice.map(|(choice, _)| choice)
    }

    #[test]
    fn the_most_accurate_storage_that_fits_is_chosen_and_each_needs_less_than_the_one_before() {
        let own = choose("tiled_cpu", &[], u64::MAX).unwrap();
        let (mut memory, mut chosen) = (own.tried[0].1, vec![own.set]);
        while let Ok(choice) = choose("tiled_cpu", &[], memory) {
            assert!(choice.tried.windows(2).all(|pair| pair[0].1 > pair[1].1), "{choice}");
            let (last, needed) = choice.tried.last().unwrap();
            assert!(*needed <= memory && choice.to_string().contains(&name(last)), "{choice}");
            memory = needed - 1;
            chosen.push(choice.set);
        }
        let settings = LADDER.map(|rung| Some((rung.set.0.to_owned(), rung.set.1.to_owned())));
        // Chosen twice: without a limit, and with a limit of exactly its bytes.
        assert_eq!(chosen[0], chosen[1]);
        assert_eq!(chosen[2..], settings);
        match choose("tiled_cpu", &[], memory) {
            Err(StorageError::TooLarge { set, needed, .. }) => {
                assert_eq!((name(&set).as_str(), needed), ("storage=b24", memory + 1));
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_users_own_storage_is_kept_and_a_graph_that_packs_nothing_has_no_choice() {
        let needed = |choice: Result<Choice, StorageError>| match choice {
            Err(StorageError::TooLarge { set, needed, .. }) => (name(&set), needed),
            other => panic!("{other:?}"),
        };
        let (setting, b32) = needed(choose("tiled_cpu", &[("storage", "b32")], 1));
        assert_eq!(setting, "the graph's own storage");
        let b24 = needed(choose("tiled_cpu", &[], 1));
        assert!(b24.0 == "storage=b24" && b24.1 < b32);
        assert!(matches!(choose("tiled_cpu", &[("storage", "much")], 1), Err(StorageError::Plan(_))));
    }

    #[test]
    fn sizes_have_units_of_1024_or_of_1000() {
        for (text, bytes) in [("8GiB", 8 << 30), ("1.5 g", 3 << 29), ("500MB", 500_000_000), ("77", 77)] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "GiB", "0", "-1", "8 parsecs", "1e40", "99999999999TiB"] {
            assert!(parse_bytes(text).unwrap_err().contains("expected bytes"), "{text}");
        }
    }
}
