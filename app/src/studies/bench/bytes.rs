//! Estimates the bytes that a pass moves, from the declared sizes of its buffers and images.

use splatgraph_framework::ir::{Pass, ResourceId, Work};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;

/// Sums the declared sizes of the buffers and images that a pass accesses: once if read, and once if written.
///
/// Exports count only the plan's statistics. A target that is cleared is not read. The sum underestimates a pass that
/// reads data several times, and overestimates a pass that uses only a part of its buffers, such as a sort of the
/// visible splats.
pub fn of_pass(plan: &Plan, pass: &Pass) -> u64 {
    if let Work::Export = pass.work {
        // Measured frames export only statistics: 4 bytes each, read once and written once.
        return 8 * plan.stats.len() as u64;
    }
    let mut touched: BTreeMap<ResourceId, (bool, bool)> = BTreeMap::new();
    for used in &pass.uses {
        let (read, written) = touched.entry(used.resource).or_default();
        *read |= used.accesses.reads() && !used.discards;
        *written |= used.accesses.writes();
    }
    let times = |(read, written): (bool, bool)| u64::from(read) + u64::from(written);
    touched.into_iter().map(|(id, how)| times(how) * plan.resource(id).bytes()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts::{self, SceneFacts};
    use crate::draw::planner::{Planner, testing};

    #[test]
    fn a_pass_moves_what_it_reads_and_what_it_writes_once_each() {
        let device = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
        let scene = SceneFacts { sh_degree: 0, ..SceneFacts::NOMINAL };
        let facts = facts::facts(&scene, &device, (640, 480));
        let set = [("target", "rgba16f"), ("digit_bits", "8"), ("key_bits", "32"), ("block_keys", "2048")];
        let plan = Planner::default().plan("splat", &testing::set(&set), &facts, &facts::nominal_catalog());
        let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
        let bytes = |name: &str| {
            let pass = plan.passes.iter().find(|pass| pass.name == name);
            of_pass(&plan, pass.unwrap_or_else(|| panic!("no pass {name}")))
        };
        let (n, args) = (1_000_000, 36);
        let blocks = 489u64;
        let (table, totals) = (4 * 256 * blocks, 4 * 4 * 256 * 8);
        // The table's row per bin is explained in docs/sort.md.
        assert_eq!(bytes("order.sort.scatter[0]"), 16 * n + table + args);
        assert_eq!(bytes("order.sort.histogram[1]"), 4 * n + table + 2 * totals + args);
        assert_eq!(bytes("order.sort.scan[2]"), 2 * table + totals + args);
        assert_eq!(bytes("order.sort.clear"), totals);
        let (camera, pixels) = (256, 640 * 480);
        // The target is cleared, so only its write counts.
        assert_eq!(bytes("back_to_front"), camera + args + 4 * n + (32 + 16) * n + 8 * pixels + LIVE);
        assert_eq!(bytes("compose"), camera + (8 + 16) * pixels);
        assert_eq!(bytes("export"), 2 * 2 * 4);
    }

    /// Size of the live parameters that the draw reads, in bytes.
    const LIVE: u64 = 32;
}
