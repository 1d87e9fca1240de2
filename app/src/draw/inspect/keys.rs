//! Checks whether sorted keys ascend. Only keys in use and only bits that the sort reads are compared.
//!
//! In `splat` and `tiled_cpu`, a key is the depth of a visible splat. In `tiled`, a key is a bin and a depth, whose
//! lowest bits (`tie_bits`) the radix sort does not read: a later pass orders keys that agree in the other bits.

use serde::Serialize;
use splatgraph_framework::ir::{Pass, Work};
use splatgraph_framework::plan::Plan;
use std::fmt;

/// Byte offset of the number of keys to sort in `args`; see shaders/args.glsl.
const KEYS_BYTE: u64 = 12;

/// Returns true if a resource of this name holds sort keys: `order.keys#1` or `pair_keys`, but not `last(keys)`.
pub fn holds_keys(name: &str) -> bool {
    let last = name.rsplit_once('.').map_or(name, |(_, last)| last);
    (last.starts_with("keys") || without_half(last).ends_with("_keys")) && !name.starts_with("last(")
}

/// Finds the last pass of a frame that writes sort keys. Returns the names of the resource and the pass; `None` if
/// there is no such pass.
pub fn sorted_keys(plan: &Plan) -> Option<(String, String)> {
    plan.frame.iter().rev().find_map(|id| {
        let pass = plan.pass(*id);
        if matches!(pass.work, Work::Export | Work::Host) {
            return None;
        }
        let written = pass.uses.iter().filter(|touch| touch.accesses.writes());
        let name = written.map(|touch| &plan.resource(touch.resource).name).find(|name| holds_keys(name))?;
        Some((name.clone(), pass.name.clone()))
    })
}

/// Result of checking the order of sorted keys.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyOrder {
    /// Number of compared keys: as many as the frame sorted, or all if that number is unknown and all ascend.
    pub keys: u64,
    /// Number of lowest bits that are not compared: the sort leaves them to a later pass.
    #[serde(skip_serializing_if = "is_zero")]
    pub ignored_bits: u32,
    /// True if no key is smaller than the previous one.
    pub ascending: bool,
    /// Number of keys that are smaller than the previous key.
    pub descents: u64,
    /// Index of the first key that is smaller than the previous one; `None` if all keys ascend.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_descent: Option<u64>,
}

impl fmt::Display for KeyOrder {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let KeyOrder { keys, descents, .. } = self;
        match self.first_descent {
            None => write!(f, "monotonic: the first {keys} keys ascend")?,
            Some(at) => write!(
                f,
                "not monotonic: {descents} of the first {keys} keys are smaller than the one before, the first at {at}"
            )?,
        }
        match self.ignored_bits {
            0 => Ok(()),
            1 => f.write_str(" (without the lowest bit, which the sort leaves to a later pass)"),
            bits => write!(f, " (without the lowest {bits} bits, which the sort leaves to a later pass)"),
        }
    }
}

impl KeyOrder {
    /// Checks the first `count` keys, or all if there are fewer, without their lowest `ignored_bits`.
    pub(super) fn of(keys: &[u32], count: u64, ignored_bits: u32) -> KeyOrder {
        let count = keys.len().min(count as usize);
        let compared = |i: usize| keys[i].checked_shr(ignored_bits).unwrap_or(0);
        let descents = || (1..count).filter(|&i| compared(i) < compared(i - 1));
        let first_descent = descents().next().map(|i| i as u64);
        KeyOrder {
            keys: count as u64,
            ignored_bits,
            ascending: first_descent.is_none(),
            descents: descents().count() as u64,
            first_descent,
        }
    }
}

fn is_zero(bits: &u32) -> bool {
    *bits == 0
}

/// Returns the number of keys that a frame sorted, from its statistics; `None` if no statistic contains it.
///
/// The number is word 3 of the buffer that the pass binds as `Args`. If no statistic reads that word, pairs are counted
/// by `entries_needed` (a frame without capacity for all pairs is drawn again), and other keys by `visible`.
pub(super) fn count(plan: &Plan, pass: &Pass, stats: &[(String, u32)]) -> Option<u64> {
    let value = |name: &str| stats.iter().find(|(other, _)| other == name).map(|(_, value)| (*value).into());
    let Some(args) = pass.bindings.iter().find(|binding| binding.name == "Args") else {
        return value("visible");
    };
    let at = |byte| {
        let stat = plan.stats.iter().find(|stat| stat.buffer == args.resource && stat.offset == byte)?;
        value(&stat.name)
    };
    let pairs = plan.resource(args.resource).name.ends_with("pair_args");
    at(KEYS_BYTE).or_else(|| value(if pairs { "entries_needed" } else { "visible" }))
}

/// Explains why the order is unknown: after `ascending` keys comes a smaller one, which the frame may not have sorted.
pub(super) fn unknown_order(plan: &Plan, pass: &Pass, ascending: u64) -> String {
    let statistic = match pass.bindings.iter().find(|binding| binding.name == "Args") {
        Some(args) => {
            format!("`stats: {{ \"visible\": (\"{}\", {KEYS_BYTE}) }}`", plan.resource(args.resource).name)
        }
        None => "a statistic `visible` with that number".to_owned(),
    };
    format!(
        "unknown order: the first {ascending} keys ascend, and no statistic tells how many keys the frame sorted; \
         add {statistic} to the graph"
    )
}

/// Returns the lowest key bit that a sort reads: the smallest push constant `shift` of its iterations, or 0.
pub(super) fn lowest_bit(plan: &Plan, pass: &Pass) -> u32 {
    let stem = without_indices(&pass.name);
    let iterations = plan.passes.iter().filter(|other| without_indices(&other.name) == stem);
    iterations.filter_map(|pass| pushed(plan, pass, "shift")).min().unwrap_or(0)
}

fn pushed(plan: &Plan, pass: &Pass, member: &str) -> Option<u32> {
    let Work::Dispatch { shader, .. } = &pass.work else { return None };
    let block = plan.shader(*shader).reflection.push.as_ref()?;
    let start = block.members.iter().find(|other| other.name == member)?.offset as usize;
    let bytes = pass.push.get(start..start + 4)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}

/// Removes the indices of a part of a name: `scatter[2]` becomes `scatter`.
fn without_index(part: &str) -> &str {
    part.split_once('[').map_or(part, |(stem, _)| stem)
}

/// Removes the indices of all parts: `sort[1].scatter[2]` becomes `sort.scatter`.
pub(super) fn without_indices(name: &str) -> String {
    name.split('.').map(without_index).collect::<Vec<_>>().join(".")
}

/// Removes the index of a ping-pong buffer: `keys#1` becomes `keys`.
pub(super) fn without_half(name: &str) -> &str {
    name.split_once('#').map_or(name, |(stem, _)| stem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts::{self, SceneFacts};
    use crate::draw::inspect::{Finding, resolve};
    use crate::draw::planner::Planner;

    const PAIRS: (&str, &str) = ("pair_bits", "27");

    fn plan(graph: &str, lanes: u32, set: &[(&str, &str)]) -> Plan {
        let scene = SceneFacts { count: 5_000_000, ..SceneFacts::NOMINAL };
        let device = splatgraph_framework::ir::DeviceFacts {
            max_storage_bytes: 1 << 31,
            ..facts::portable_device(lanes)
        };
        let facts = facts::facts(&scene, &device, facts::DEFAULT_SIZE);
        let mut catalog = facts::nominal_catalog();
        catalog.attributes.values_mut().for_each(|attribute| attribute.count = scene.count);
        let set: Vec<_> = set.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
        Planner::default().plan(graph, &set, &facts, &catalog).unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn every_graph_that_sorts_has_keys_to_look_at_by_button_and_by_name() {
        for (graph, lanes, set, keys, pass) in [
            ("splat", 32, ("sorter", "sweep"), "order.keys#", "order.sort.sweep.scatter["),
            ("splat", 32, ("sorter", "subgroup"), "order.keys#", "order.sort.scatter["),
            ("splat", 32, ("sorter", "serial"), "order.keys#", "order.sort.scatter["),
            ("tiled", 32, PAIRS, "splats.pair_keys#", "bins.sort.scatter["),
            ("tiled_cpu", 8, ("sorter", "serial"), "order.keys#", "order.sort.scatter["),
        ] {
            let plan = plan(graph, lanes, &[set]);
            let (resource, after) = sorted_keys(&plan).expect("keys");
            assert!(resource.starts_with(keys) && after.starts_with(pass), "{resource} {after}");
            let target = resolve(&plan, "keys", "scatter").expect("short names");
            assert_eq!(
                (&plan.resource(target.resource).name, &plan.pass(target.after).name),
                (&resource, &after)
            );
        }
        // Without a sort, these are the keys as the splats were compacted.
        let unsorted = Some(("order.keys#0".to_owned(), "order.compact".to_owned()));
        assert_eq!(sorted_keys(&plan("unsorted", 32, &[])), unsorted);
    }

    #[test]
    fn pair_keys_are_judged_over_the_pairs_and_without_the_bits_that_the_sort_leaves_alone() {
        let plan = plan("tiled", 32, &[PAIRS]);
        let target = resolve(&plan, "keys", "scatter").expect("short names");
        // Ascending above the lowest 5 of 32 bits. The last key is not a pair of this frame.
        let keys = [5 << 5 | 7, 5 << 5, 9 << 5 | 1, 9 << 5, 0];
        let bytes: Vec<u8> = keys.iter().flat_map(|key: &u32| key.to_le_bytes()).collect();
        let stats = [("visible".to_owned(), 2), ("entries_needed".to_owned(), 4)];
        let order = Finding::new(&plan, &target, &bytes, &stats).order.expect("an order");
        assert_eq!((order.keys, order.ignored_bits, order.ascending), (4, 5, true));
        assert!(
            order.to_string().ends_with("(without the lowest 5 bits, which the sort leaves to a later pass)")
        );
        // Without the number of pairs, the last word may be unused.
        let found = Finding::new(&plan, &target, &bytes, &[]);
        assert_eq!((found.order, found.counted), (None, None));
        let reason = "unknown order: the first 4 keys ascend, and no statistic tells how many keys the frame sorted; \
            add `stats: { \"visible\": (\"bins.pair_args\", 12) }` to the graph";
        assert_eq!(found.unknown_order.as_deref(), Some(reason));
        let order = Finding::new(&plan, &target, &bytes[..16], &[]).order.expect("an order");
        assert_eq!(
            (order.keys, order.ascending),
            (4, true),
            "all ascend, so that their number does not matter"
        );
    }
}
