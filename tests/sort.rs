//! The shipped radix sorts compared with a stable sort of the standard library, bit for bit.
//!
//! `tests/graphs/sort_only.ron` runs the includes that the presets use, on pairs that a shader generates from a
//! description. The test generates the same pairs, sorts them, and compares keys and values.

use splatgraph::draw::backend::Backend;
use splatgraph::draw::planner::{GraphErrors, Planner};
use splatgraph_api::{Device, FrameInputs, Inspect, NoScene};
use splatgraph_framework::ir::{Catalog, DeviceFacts, Facts, Value};
use splatgraph_framework::plan::Plan;
use splatgraph_reference::sort_pairs;

use crate::common;

/// The pairs of a run, as `sort_only_load.comp` generates them.
#[derive(Clone, Copy, Debug)]
struct Run {
    count: u32,
    seed: u32,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Random,
    Equal,
    Ascending,
    Descending,
    FewDistinct,
}

const SORTERS: [&str; 3] = ["sweep", "subgroup", "serial"];

const KINDS: [Kind; 5] = [Kind::Random, Kind::Equal, Kind::Ascending, Kind::Descending, Kind::FewDistinct];

fn mixed(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

impl Run {
    fn pairs(self, key_bits: u32) -> Vec<(u32, u32)> {
        let mask = u32::MAX >> (32 - key_bits);
        let key = |i: u32| match self.kind {
            Kind::Random => mixed(i.wrapping_add(self.seed)),
            Kind::Equal => self.seed,
            Kind::Ascending => i,
            Kind::Descending => self.count - i,
            Kind::FewDistinct => mixed(mixed(i.wrapping_add(self.seed)) % 3),
        };
        (0..self.count).map(|i| (key(i) & mask, mixed(i))).collect()
    }

    fn sorted(self, key_bits: u32) -> (Vec<u32>, Vec<u32>) {
        sort_pairs(self.pairs(key_bits))
    }
}

struct Sorter<'a> {
    device: &'a mut Backend,
    plan: Plan,
    key_bits: u32,
    name: String,
}

struct Bench {
    device: Backend,
    planner: Planner,
}

/// Builds the plan of a sort of up to `capacity` pairs.
pub fn plan(
    planner: &mut Planner,
    device: &DeviceFacts,
    capacity: u32,
    set: &[(String, String)],
) -> Result<Plan, GraphErrors> {
    let host = [("scene.count".into(), Value::Int(capacity.into()))].into();
    let facts = Facts { host, ..(*device).into() };
    let catalog = Catalog { uniforms: [("test.run".to_string(), 16)].into(), ..Catalog::default() };
    let graph = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/sort_only.ron");
    planner.plan(graph, set, &facts, &catalog)
}

impl Bench {
    fn new() -> Bench {
        Bench { device: common::device(), planner: Planner::default() }
    }

    fn lanes(&self) -> u32 {
        self.device.info().facts.subgroup_size
    }

    fn sorter(&mut self, sorter: &str, digit_bits: u32, key_bits: u32, capacity: u32) -> Sorter<'_> {
        let set = [("digit_bits", digit_bits), ("key_bits", key_bits)];
        self.with(sorter, &set, capacity).unwrap_or_else(|text| panic!("{text}"))
    }

    /// Builds and loads the sort with these parameters, or returns the errors of its graph.
    fn with(&mut self, sorter: &str, set: &[(&str, u32)], capacity: u32) -> Result<Sorter<'_>, String> {
        let facts = self.device.info().facts;
        self.with_facts(&facts, sorter, set, capacity)
    }

    /// Builds and loads the sort like [`Self::with`], for other device facts. The plan must be valid on the device.
    fn with_facts(
        &mut self,
        facts: &DeviceFacts,
        sorter: &str,
        set: &[(&str, u32)],
        capacity: u32,
    ) -> Result<Sorter<'_>, String> {
        let value = |name| set.iter().find(|(k, _)| *k == name).map_or(0, |(_, v)| *v);
        let (digit_bits, key_bits) = (value("digit_bits"), value("key_bits"));
        let set = set.iter().map(|(k, v)| (k.to_string(), v.to_string()));
        let set: Vec<_> = set.chain([("sorter".to_string(), sorter.to_string())]).collect();
        let plan = plan(&mut self.planner, facts, capacity, &set).map_err(|errors| errors.to_string())?;
        self.device.load(plan.clone(), &NoScene, &mut |_| {}).expect("the plan loads");
        let name =
            format!("{sorter}, {digit_bits}-bit digits of {key_bits}-bit keys, {} lanes", self.lanes());
        Ok(Sorter { device: &mut self.device, plan, key_bits, name })
    }
}

impl Sorter<'_> {
    fn block_keys(&self) -> u32 {
        match self.plan.params.iter().find(|p| p.name == "block_keys").expect("a parameter").value {
            Value::Int(keys) => keys as u32,
            ref other => panic!("a block of {other} keys"),
        }
    }

    fn check(&mut self, run: Run) {
        self.expect(run, &run.sorted(self.key_bits));
    }

    fn expect(&mut self, run: Run, (keys, values): &(Vec<u32>, Vec<u32>)) {
        let mut passes = self.plan.frame.iter().copied();
        let finish = passes.find(|pass| self.plan.pass(*pass).name == "finish").expect("the last pass");
        let fronts = ["Keys", "Values"].map(|block| {
            let bindings = &self.plan.pass(finish).bindings;
            bindings.iter().find(|b| b.name == block).expect("bound").resource
        });
        let words = [run.count, run.seed, KINDS.iter().position(|k| *k == run.kind).unwrap_or(0) as u32, 0];
        let inputs = FrameInputs {
            uniforms: [("test.run".to_string(), words.iter().flat_map(|w| w.to_le_bytes()).collect())].into(),
            inspect: fronts.map(|resource| Inspect { resource, after: finish }).to_vec(),
            ..FrameInputs::default()
        };
        let frame = self.device.submit(&inputs).expect("the frame is submitted");
        let result = self.device.wait(frame).expect("the frame is done");
        for (what, bytes, expected) in
            [("key", &result.inspected[0], keys), ("value", &result.inspected[1], values)]
        {
            let got: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes[..4 * run.count as usize]);
            if got != *expected {
                let at = got.iter().zip(expected).position(|(got, expected)| got != expected);
                let at = at.expect("a difference");
                panic!("{}: {run:?}: {what} {at} is {:x}, not {:x}", self.name, got[at], expected[at]);
            }
        }
        common::assert_silent(self.device, &self.name);
    }
}

/// Returns boundary sizes up to `most`. They are 0 to 2, 65,535, 65,536, those around the number of lanes, and those
/// around multiples of the block and of another step, `block * lanes` for the serial sort and `8 * lanes` for others.
///
/// A long run has all multiples up to 65,536; other runs have only the multiples by 1, 2, 3 and 7.
fn boundary_sizes(block: u32, lanes: u32, serial: bool, most: u32) -> Vec<u32> {
    let mut sizes = vec![0, 1, 2, lanes - 1, lanes, lanes + 1, 65_535, 65_536];
    for step in [block, if serial { block * lanes } else { 8 * lanes }] {
        let all = 65_536 / step;
        let multiples = (1..=all).filter(|n| common::long() || matches!(n, 1 | 2 | 3 | 7));
        sizes.extend(multiples.flat_map(|n| [n * step - 1, n * step, n * step + 1]));
    }
    sizes.retain(|s| *s <= most);
    sizes.sort();
    sizes.dedup();
    sizes
}

/// Tests every combination of two of sorter, digit width and key width; in a long run, of all three.
///
/// For each digit width, each sorter has another key width, with every boundary size up to 2^16. The fourth key width
/// has one of the sorters, with every third size up to 2^15. Sizes up to 2^16 take most of the time. The kind of keys
/// is pseudo-random. With an unusual vector width, all sorters have one key width for each digit width, and only digits
/// of 4 and 8 bits have sizes up to 2^16.
fn boundaries() {
    let mut bench = Bench::new();
    let lanes = bench.lanes();
    let every = common::long() || common::lanes_are_usual();
    let mut turn = 0;
    for (s, sorter) in SORTERS.into_iter().enumerate() {
        for digit_bits in 1..=11 {
            for (i, key_bits) in [8, 16, 24, 32].into_iter().enumerate() {
                let digit = digit_bits as usize;
                let chosen = (digit + if every { s } else { 0 }) % 4 == i;
                let fourth = (digit + SORTERS.len()) % 4 == i && digit % SORTERS.len() == s;
                if !(common::long() || chosen || every && fourth) {
                    continue;
                }
                let largest = common::long() || chosen && (every || i == 0);
                let most = if largest { 1 << 16 } else { 1 << 15 };
                let mut sorter_here = bench.sorter(sorter, digit_bits, key_bits, 65_536);
                let sizes = boundary_sizes(sorter_here.block_keys(), lanes, sorter == "serial", most);
                let (skipped, step) = if largest { (0, 1) } else { ((digit + i) % 3, 3) };
                for count in sizes.into_iter().skip(skipped).step_by(step) {
                    let kinds = if common::long() { 5 } else { 1 };
                    let first = mixed(turn) as usize;
                    for kind in 0..kinds {
                        sorter_here.check(Run { count, seed: mixed(turn), kind: KINDS[(first + kind) % 5] });
                        turn += 1;
                    }
                }
            }
        }
    }
    println!("{turn} sorts of up to 65,536 pairs, {lanes} lanes");
}

#[test]
fn the_shipped_sorts_equal_a_stable_sort() {
    boundaries();
}

#[test]
fn the_shipped_sorts_equal_a_stable_sort_with_subgroups_of_4_lanes() {
    common::again_with_vectors_of(128, "sort::the_shipped_sorts_equal_a_stable_sort");
}

#[test]
fn the_shipped_sorts_equal_a_stable_sort_with_subgroups_of_16_lanes() {
    common::again_with_vectors_of(512, "sort::the_shipped_sorts_equal_a_stable_sort");
}

/// Sorts up to 2^19 pairs. Every combination of two of sorter, digit width, key width, size and kind of keys occurs; in
/// a long run, every combination of the first four.
#[test]
fn larger_sorts_are_right_too() {
    let mut bench = Bench::new();
    let sizes = [100_003, 1 << 17, 1 << 19];
    let mut sorts = 0;
    for digit_bits in 1..=11 {
        for (j, key_bits) in [8, 16, 24, 32].into_iter().enumerate() {
            let i = digit_bits as usize;
            let runs: Vec<(usize, usize)> = if common::long() {
                (0..3).flat_map(|size| [i + j, i + j + 2].map(|kind| (size, kind))).collect()
            } else {
                // Narrow digits of wide keys take many passes, so they have the smaller sizes. From 8 bits on, each key
                // width has another size at each digit width.
                let size = [2, 1, 0, 0][(j + i.saturating_sub(7)) % 4];
                // Four key widths give four kinds of keys; the fifth is added to one of them.
                [(size, i + j)].into_iter().chain((j == 0).then_some((0, i + 4))).collect()
            };
            let runs = runs.into_iter().map(|(size, kind)| {
                sorts += 1;
                let run = Run { count: sizes[size], seed: mixed(sorts), kind: KINDS[kind % 5] };
                (run, run.sorted(key_bits))
            });
            let runs: Vec<_> = runs.collect();
            let sorters = SORTERS.into_iter().enumerate();
            for (_, sorter) in sorters.filter(|(s, _)| common::long() || *s == (i + j) % SORTERS.len()) {
                let mut sorter_here = bench.sorter(sorter, digit_bits, key_bits, 1 << 19);
                runs.iter().for_each(|(run, expected)| sorter_here.expect(*run, expected));
            }
        }
    }
    println!("{sorts} inputs of up to 2^19 pairs");
}

/// Tests the limit on the number of blocks. Lavapipe ends loops after 65,535 iterations, and the scan of the serial
/// sort loops over the blocks.
#[test]
fn the_serial_sort_refuses_blocks_that_are_too_many_to_loop_over_and_is_right_with_the_smallest_others() {
    let count = 1 << 21;
    let mut bench = Bench::new();
    let set = |block_keys| [("digit_bits", 8), ("key_bits", 16), ("block_keys", block_keys)];
    let refused = bench.with("serial", &set(16), count).err().expect("131,072 blocks are too many");
    assert!(refused.contains("block_keys") && refused.contains("34"), "{refused}");
    let mut smallest = bench.with("serial", &set(34), count).unwrap_or_else(|text| panic!("{text}"));
    smallest.check(Run { count, seed: 5, kind: Kind::Random });
}

/// Takes the blocks from last to first (`starve`), or, on lavapipe, from two places (by index), so that predecessors
/// have not counted yet.
#[test]
fn a_sweep_whose_workgroups_wait_in_vain_counts_the_earlier_blocks_itself() {
    let mut bench = Bench::new();
    for (digit_bits, starve, by_index) in [(3, 1, 0), (8, 1, 0), (8, 1, 1), (8, 0, 1)] {
        let set = [("digit_bits", digit_bits), ("key_bits", 16), ("starve", starve), ("by_index", by_index)];
        let mut starved = bench.with("sweep", &set, 20_000).unwrap_or_else(|text| panic!("{text}"));
        for kind in KINDS {
            starved.check(Run { count: 20_000, seed: 7, kind });
        }
    }
}

/// Sweeps many blocks, several per workgroup. Their number times a workgroup's index needs more than 32 bits. With
/// small workgroups, a test of so many blocks is fast.
#[test]
fn a_sweep_counts_each_key_once_however_many_blocks_there_are() {
    let mut bench = Bench::new();
    let count = 24_000_000;
    let facts = DeviceFacts { max_invocations: 64, ..bench.device.info().facts };
    let set = [("digit_bits", 1), ("key_bits", 1), ("block_keys", 16)];
    let mut sweep = bench.with_facts(&facts, "sweep", &set, count).unwrap_or_else(|text| panic!("{text}"));
    sweep.check(Run { count, seed: 24, kind: Kind::Random });
}

#[test]
fn sixteen_million_pairs_are_sorted_with_digits_of_4_8_and_11_bits() {
    let mut bench = Bench::new();
    let every = SORTERS.into_iter().flat_map(|s| [4, 8, 11].map(|d| (s, d)));
    // By default, each sorter is tested at one digit width, and each digit width with one sorter.
    let short = [("serial", 11), ("subgroup", 4), ("sweep", 8)];
    for (sorter, digit_bits) in every.filter(|sort| common::long() || short.contains(sort)) {
        let key_bits = if common::long() || sorter == "sweep" { 32 } else { 16 };
        let mut sorter = bench.sorter(sorter, digit_bits, key_bits, 1 << 24);
        sorter.check(Run { count: 1 << 24, seed: digit_bits, kind: Kind::Random });
    }
    if common::long() {
        let count = 1 << 28;
        bench.sorter("sweep", 8, 32, count).check(Run { count, seed: 28, kind: Kind::Random });
    }
}
