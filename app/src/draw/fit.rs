//! Checks whether a scene fits a device when drawn with a graph, and how many splats would fit.
//!
//! Two limits stop large scenes: the maximum size of a storage buffer, and the device's memory. The graph is first
//! built for the device itself. If that fails, it is built without the buffer limit, to find how large the buffers
//! would be.
//!
//! If the scene does not fit, bisection finds a number of splats that does. It is a lower bound: a few more might fit.

use crate::draw::facts;
use crate::draw::planner::{GraphErrors, Planner};
use crate::io::load::{FileOptions, LoadOptions};
use serde::Serialize;
use splatgraph_api::{Device, DeviceInfo, Heap};
use splatgraph_assets::memory::display;
use splatgraph_assets::{SceneHeader, grouped};
use splatgraph_framework::ir::{Catalog, DeviceFacts, ReflectedKind, Shader, Shape, Source, Usage};
use splatgraph_framework::plan::{Plan, Resource, distinct_bytes};
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

/// A graph and the scene to draw with it.
pub struct Wanted<'a> {
    /// Name of a preset, or a path.
    pub graph: &'a str,
    /// Values of the graph's parameters; later entries override earlier ones.
    pub set: &'a [(String, String)],
    /// Facts of the scene, with its number of splats.
    pub scene: facts::SceneFacts,
    /// Imports of a graph that draws the scene.
    pub catalog: &'a Catalog,
    /// Width and height of a picture, in pixels.
    pub size: (u32, u32),
}

/// A device for which graphs are built, and whose limits a scene should fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Target {
    /// The device's name.
    pub name: String,
    /// Facts of the device, as graphs see them.
    pub facts: DeviceFacts,
    /// The device's memory heap; 0 bytes if unknown.
    pub heap: Heap,
    /// Maximum number of storage buffers in one shader; `None` if unknown, or if no graph can exceed the limit.
    #[serde(skip)]
    pub storage_buffers: Option<usize>,
    /// Maximum number of storage images in one shader; `None` if unknown, or if no graph can exceed the limit.
    #[serde(skip)]
    pub storage_images: Option<usize>,
}

impl Target {
    /// Returns the least capable supported device, with unknown memory.
    pub fn nominal() -> Target {
        let facts = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
        let storage_buffers = Some(facts::DESKTOP_STORAGE_BUFFERS);
        Target { storage_buffers, ..Target::new("the least capable supported device", facts) }
    }

    /// Returns a device with these facts, of which nothing else is known.
    pub fn new(name: &str, facts: DeviceFacts) -> Target {
        let (storage_buffers, storage_images) = (None, None);
        Target { name: name.to_owned(), facts, heap: Heap::default(), storage_buffers, storage_images }
    }

    /// Limits the available memory to `limit` bytes; `None` changes nothing.
    pub fn limited(mut self, limit: Option<u64>) -> Target {
        if limit.is_some() {
            self.heap.available = available(&self.heap).into_iter().chain(limit).min();
        }
        self
    }

    /// Describes an opened device: its name, facts and memory.
    pub fn of(device: &DeviceInfo) -> Target {
        Target { heap: device.heap, ..Target::new(&device.name, device.facts) }
    }

    /// Describes an opened device with the memory that is free now, limited to `limit` bytes.
    pub fn now(device: &impl Device, limit: Option<u64>) -> Target {
        Target { heap: device.heap(), ..Target::of(device.info()) }.limited(limit)
    }

    /// Describes the plan's shaders that bind more storage buffers, or else storage images, than the device allows.
    ///
    /// `None` if there are none, or the limits are unknown.
    pub fn exceeded(&self, plan: &Plan) -> Option<String> {
        let is_image = |kind: &ReflectedKind| matches!(kind, ReflectedKind::StorageImage { .. });
        let is_buffer = |kind: &ReflectedKind| matches!(kind, ReflectedKind::StorageBuffer { .. });
        exceeded_of(plan, self.storage_buffers, "storage buffers", is_buffer)
            .or_else(|| exceeded_of(plan, self.storage_images, "storage images", is_image))
    }
}

/// Describes the shaders that bind more than `most` resources of a kind; `None` if there are none, or `most` is
/// unknown.
fn exceeded_of(
    plan: &Plan,
    most: Option<usize>,
    what: &str,
    is_kind: impl Fn(&ReflectedKind) -> bool,
) -> Option<String> {
    let most = most?;
    let bound = |shader: &Shader| -> usize {
        let bindings = shader.reflection.bindings.iter().filter(|binding| is_kind(&binding.kind));
        bindings.map(|binding| binding.count as usize).sum()
    };
    let found = plan.shaders.iter().filter(|shader| bound(shader) > most);
    let found: Vec<String> = found.map(|shader| format!("{} binds {}", shader.name, bound(shader))).collect();
    (!found.is_empty())
        .then(|| format!("expected at most {most} {what} in a shader, found: {}", found.join(", ")))
}

/// Memory that a graph needs for a scene, compared with the limits of a device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// Device that has the limits.
    pub device: Target,
    /// True if every buffer and the total memory fit the device.
    pub fits: bool,
    /// Number of splats in the scene.
    pub splats: u64,
    /// Bytes of the resources that stay on the device. Memory shared by several resources counts once.
    pub needed_bytes: u64,
    /// Bytes of the resources that are freed after the first frame. The scene's
    /// planes among them may be in host memory if the device is full.
    pub loading_bytes: u64,
    /// Name and bytes of the largest storage buffer; `None` if the plan has no storage buffers.
    pub largest: Option<(String, u64)>,
    /// Names and bytes of the storage buffers that exceed the device's maximum binding size.
    pub too_large: Vec<(String, u64)>,
    /// A number of splats that fits, if the scene's number does not; slightly more may fit.
    ///
    /// `None` if the scene fits, or if no number was found that fits.
    pub most_splats: Option<u64>,
}

/// Memory that a plan needs, in bytes.
struct Needs {
    storage: BTreeMap<String, u64>,
    /// Bytes that stay allocated after the prologue.
    total: u64,
    /// Bytes that are freed after the prologue.
    loading: u64,
}

impl Needs {
    fn of(plan: &Plan) -> Needs {
        let is_storage =
            |r: &&Resource| matches!(r.shape, Shape::Buffer { .. }) && r.usage.contains(Usage::STORAGE);
        let storage = plan.resources.iter().filter(is_storage).map(|r| (r.name.clone(), r.bytes()));
        let others = distinct_bytes(plan.resources.iter().filter(|r| r.source != Source::Transient));
        let all = others.saturating_add(plan.transient_bytes());
        let loading = distinct_bytes(plan.used_once().iter().map(|id| plan.resource(*id)));
        Needs { storage: storage.collect(), total: all.saturating_sub(loading), loading }
    }

    fn too_large(&self, limit: u64) -> Vec<(String, u64)> {
        let mut all: Vec<_> = self.storage.iter().filter(|(_, bytes)| **bytes > limit).collect();
        all.sort_by_key(|(_, bytes)| std::cmp::Reverse(**bytes));
        all.into_iter().map(|(name, bytes)| (name.clone(), *bytes)).collect()
    }
}

/// Counts the bytes of a plan's resources that stay allocated after the first frame.
pub fn resident_bytes(plan: &Plan) -> u64 {
    Needs::of(plan).total
}

/// Estimates whether a scene of `count` splats may exceed the device's free memory or maximum buffer size.
///
/// `size` is the picture's, in pixels. If the result is false, the built-in graphs fit with their default parameters.
pub fn may_exceed(count: u64, size: (u32, u32), device: &DeviceFacts, heap: &Heap) -> bool {
    let free = available(heap).unwrap_or(u64::MAX);
    count.saturating_mul(MAX_SPLAT_BYTES) > device.max_storage_bytes || usual_bytes(count, size) > free
}

/// Estimates like [`may_exceed`] for the least capable supported device, with 512 MiB of memory.
pub fn may_exceed_any(count: u64, size: (u32, u32)) -> bool {
    let heap = Heap { bytes: MIN_MEMORY, available: None };
    may_exceed(count, size, &Target::nominal().facts, &heap)
}

/// Upper estimate of the bytes per splat of a single buffer.
const MAX_SPLAT_BYTES: u64 = 96;

/// Assumed free memory of the least capable device, in bytes.
const MIN_MEMORY: u64 = 512 << 20;

/// Estimates the bytes that stay on the device: an upper bound for every built-in graph with default parameters.
fn usual_bytes(count: u64, (width, height): (u32, u32)) -> u64 {
    let splats = count.saturating_mul(640);
    let pixels = u64::from(width) * u64::from(height) * 64;
    splats.saturating_add(pixels).saturating_add(48 << 20)
}

/// Returns the free bytes of the device's memory, or its size if the free bytes are unknown; `None` if both are
/// unknown.
pub fn available(heap: &Heap) -> Option<u64> {
    heap.available.or(Some(heap.bytes).filter(|bytes| *bytes > 0))
}

/// Builds a plan, and compares its memory needs with the device's limits.
///
/// Returns the plan even if it exceeds the limits. `built` is the plan, if it has already been built for the device.
///
/// # Errors
/// The graph or its shaders have errors that do not depend on the scene's size.
pub fn fit(
    planner: &mut Planner,
    wanted: &Wanted,
    device: &Target,
    built: Option<Plan>,
) -> Result<(Plan, Fit), GraphErrors> {
    let count = wanted.scene.count;
    let plan = built.map_or_else(|| build(planner, wanted, &device.facts, count), Ok);
    let (plan, built) = match plan {
        Ok(plan) => (plan, true),
        // If the plan builds without the buffer limit, only the size was wrong.
        Err(errors) => match build(planner, wanted, &boundless(&device.facts), count) {
            Ok(plan) => (plan, false),
            Err(_) => return Err(errors),
        },
    };
    let needs = Needs::of(&plan);
    let largest = needs.storage.iter().max_by_key(|(_, bytes)| **bytes);
    let within = available(&device.heap).is_none_or(|available| needs.total <= available);
    let fits = built && within;
    let fit = Fit {
        device: device.clone(),
        fits,
        splats: count,
        needed_bytes: needs.total,
        loading_bytes: needs.loading,
        largest: largest.map(|(name, bytes)| (name.clone(), *bytes)),
        too_large: needs.too_large(device.facts.max_storage_bytes),
        most_splats: if fits { None } else { most(planner, wanted, device) },
    };
    Ok((plan, fit))
}

fn boundless(device: &DeviceFacts) -> DeviceFacts {
    DeviceFacts { max_storage_bytes: i64::MAX as u64, ..*device }
}

fn build(
    planner: &mut Planner,
    wanted: &Wanted,
    device: &DeviceFacts,
    count: u64,
) -> Result<Plan, GraphErrors> {
    let scene = facts::SceneFacts { count, ..wanted.scene };
    let catalog = facts::with_count(wanted.catalog.clone(), count);
    planner.plan(wanted.graph, wanted.set, &facts::facts(&scene, device, wanted.size), &catalog)
}

/// Finds a number of splats that fits, within 0.1 % of the largest; `None` if no number was found that fits.
fn most(planner: &mut Planner, wanted: &Wanted, device: &Target) -> Option<u64> {
    let (mut fit, mut none) = (0, wanted.scene.count);
    while none - fit > (fit / 1000).max(1) {
        let middle = fit.midpoint(none);
        let fits = build(planner, wanted, &device.facts, middle).is_ok_and(|plan| {
            available(&device.heap).is_none_or(|available| Needs::of(&plan).total <= available)
        });
        *(if fits { &mut fit } else { &mut none }) = middle;
    }
    (fit > 0).then_some(fit)
}

/// Rejects a scene that cannot fit the device, by its file's header, so that its splats are not loaded first.
///
/// The header does not show which bands of harmonics are used, so only band 0 is counted. The picture has the default
/// size.
///
/// # Errors
/// The header cannot be read, or the scene is too large.
pub fn check_header(
    path: &Path,
    load: &LoadOptions,
    device: &DeviceInfo,
    graph: &str,
    set: &[(String, String)],
) -> anyhow::Result<()> {
    let SceneHeader { count, stored_degree } = load.header(path)?;
    // The header does not show how many splats a condition leaves.
    let may_exceed = || may_exceed(count, facts::DEFAULT_SIZE, &device.facts, &device.heap);
    if load.condition.is_some() || !may_exceed() {
        return Ok(());
    }
    let target = Target::of(device);
    let catalog = facts::nominal_catalog();
    let scene = facts::SceneFacts {
        count,
        sh_degree: 0,
        stored_sh_degree: stored_degree,
        ..facts::SceneFacts::NOMINAL
    };
    let wanted = Wanted { graph, set, scene, catalog: &catalog, size: facts::DEFAULT_SIZE };
    check(&wanted, &target, path, load)
}

/// Rejects a scene that does not fit the device. `path` is the scene's file, which was loaded with `load`.
///
/// # Errors
/// The scene is too large. The graph's other errors are reported later, when it is built.
pub fn check(wanted: &Wanted, device: &Target, path: &Path, load: &LoadOptions) -> anyhow::Result<()> {
    match fit(&mut Planner::default(), wanted, device, None) {
        Ok((_, fit)) if !fit.fits => {
            let text = format!("{fit}{}", fit.advice(path, load));
            anyhow::bail!("{}: {}", path.display(), text.trim_end())
        }
        _ => Ok(()),
    }
}

/// Finds a condition of `--where` that keeps at most `most` of `count` splats, spread over the whole file. Also
/// returns the number of splats that it keeps. `most` must be below `count`, and above 0.
fn evenly(count: u64, most: u64) -> (String, u64) {
    const LONGEST: u64 = 10;
    let kept = |of: u64, keep: u64| count / of * keep + (count % of).min(keep);
    let of = count.div_ceil(most);
    let few = (of, 1, kept(of, 1));
    let all = (2..=LONGEST).flat_map(|of| (1..of).map(move |keep| (of, keep, kept(of, keep))));
    let fits = all.filter(|(_, _, kept)| *kept <= most).chain([few]);
    // Among equal shares, the shortest period comes first. 2520 is a multiple of all periods up to `LONGEST`.
    let (of, keep, kept) = fits.max_by_key(|(of, keep, _)| (2520 * keep / of, u64::MAX - of)).unwrap_or(few);
    let condition = if keep == 1 { format!("index % {of} == 0") } else { format!("index % {of} < {keep}") };
    (condition, kept)
}

fn loading(bytes: u64) -> String {
    if bytes == 0 {
        return String::new();
    }
    format!("; {} more until the first frame is drawn, in the host's memory if need be", display(bytes))
}

impl Fit {
    /// Returns a line that names a coarser level with few enough splats, or else an option that leaves out splats.
    ///
    /// Empty if no number of splats is known to fit, or splats are left out already. The scene at `path` was loaded
    /// with `load`.
    pub fn advice(&self, path: &Path, load: &LoadOptions) -> String {
        let Some(most) = self.most_splats.filter(|_| load.condition.is_none()) else { return String::new() };
        let level = load.file.level;
        let coarser = level.unwrap_or(0).saturating_add(1)..;
        let options = |level| LoadOptions::from(FileOptions { level: Some(level), ..load.file.clone() });
        let count = |level| Some((level, options(level).header(path).ok()?.count));
        if let Some((level, count)) = coarser.map_while(count).find(|(_, count)| *count <= most) {
            return format!("  `--level {level}` has {}\n", grouped(count));
        }
        let (condition, kept) = evenly(self.splats, most);
        format!("  `--where '{condition}'` keeps {}, evenly\n", grouped(kept))
    }
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Target { name, facts, heap, .. } = &self.device;
        let limit = facts.max_storage_bytes;
        write!(f, "on {name}, whose storage buffers have at most {}", display(limit))?;
        match (heap.available, heap.bytes) {
            (Some(available), bytes) => {
                writeln!(f, ", with {} of {} of its memory available", display(available), display(bytes))?;
            }
            (None, 0) => writeln!(f, " (--device names another)")?,
            (None, bytes) => writeln!(f, ", with {} of memory", display(bytes))?,
        }
        if self.fits {
            let largest = self.largest.as_ref();
            let largest = largest.map(|(name, bytes)| {
                format!("; its largest storage buffer, `{name}`, has {}", display(*bytes))
            });
            return writeln!(
                f,
                "  {} splats fit, with {} in all{}{}",
                grouped(self.splats),
                display(self.needed_bytes),
                largest.unwrap_or_default(),
                loading(self.loading_bytes)
            );
        }
        writeln!(f, "  {} splats do not fit:", grouped(self.splats))?;
        for (name, bytes) in &self.too_large {
            writeln!(f, "    `{name}`: expected at most {}, found {}", display(limit), display(*bytes))?;
        }
        if let Some(available) = available(heap).filter(|available| self.needed_bytes > *available) {
            let needed = display(self.needed_bytes);
            writeln!(f, "    all resources: expected at most {}, found {needed}", display(available))?;
        }
        match self.most_splats {
            Some(most) => writeln!(f, "  {} splats would fit", grouped(most)),
            None => writeln!(f, "  fewer splats, a smaller picture or another device may fit"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::builtin;
    use crate::draw::facts::SceneFacts;
    use splatgraph_assets::synth;

    fn fit_of(graph: &str, count: u64, device: &Target) -> (Plan, Fit) {
        let catalog = facts::nominal_catalog();
        let scene = SceneFacts { count, ..SceneFacts::NOMINAL };
        let wanted = Wanted { graph, set: &[], scene, catalog: &catalog, size: facts::DEFAULT_SIZE };
        fit(&mut Planner::default(), &wanted, device, None).unwrap_or_else(|errors| panic!("{errors}"))
    }

    #[test]
    fn five_million_splats_do_not_fit_the_smallest_device_and_what_fits_is_proposed() {
        let (plan, fit) = fit_of("splat", 5_000_000, &Target::nominal());
        assert!(!fit.fits && plan.resources.iter().any(|r| r.name == "splats"));
        assert_eq!(fit.too_large[0], ("splats".to_owned(), 160_000_000));
        let most = fit.most_splats.unwrap();
        assert!((4_000_000..4_194_305).contains(&most), "{most}");
        let text = fit.to_string();
        assert!(text.contains("`splats`: expected at most 128.0 MiB, found 152.6 MiB"), "{text}");
        assert!(text.contains("splats would fit\n"), "{text}");
        let advice = |load: &LoadOptions| fit.advice(Path::new("city.ply"), load);
        let load = LoadOptions::default();
        assert_eq!(advice(&load), "  `--where 'index % 6 < 5'` keeps 4,166,667, evenly\n");
        let fewer = LoadOptions { condition: Some("x > 0".parse().unwrap()), ..load };
        assert_eq!(advice(&fewer), "", "another condition would have to imply this one");
        let (_, fit) = fit_of("splat", most, &Target::nominal());
        assert!(fit.fits && fit.to_string().contains("splats fit, with"), "{fit}");
    }

    #[test]
    fn a_plane_that_two_includes_import_counts_once() {
        let mut planner = Planner::default();
        planner.outputs = vec!["normal".into()];
        for storage in ["f32", "f16"] {
            let set = [("sh_storage".to_owned(), storage.to_owned())];
            let (device, catalog) = (Target::nominal().facts, facts::nominal_catalog());
            let facts = facts::facts(&SceneFacts::NOMINAL, &device, facts::DEFAULT_SIZE);
            let plan = planner.plan("tiled", &set, &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
            let (mut once, mut planes, mut repeated) = (plan.clone(), Vec::new(), 0);
            for resource in &mut once.resources {
                if matches!(resource.source, Source::Scene { .. }) && planes.contains(&resource.source) {
                    (resource.shape, repeated) = (Shape::Buffer { stride: 4, count: 0 }, repeated + 1);
                }
                planes.push(resource.source.clone());
            }
            assert!(repeated > 0, "{storage}: the normals import planes of the splats");
            let [found, expected] = [plan, once].map(|plan| Needs::of(&plan)).map(|n| (n.total, n.loading));
            assert_eq!(found, expected, "{storage}");
        }
    }

    #[test]
    fn a_condition_keeps_the_most_splats_that_fit() {
        for (count, most, condition, kept) in [
            (6_000_000, 4_192_382, "index % 3 < 2", 4_000_000),
            (10, 9, "index % 10 < 9", 9),
            (11, 5, "index % 5 < 2", 5),
            (1000, 10, "index % 100 == 0", 10),
            (3, 1, "index % 3 == 0", 1),
        ] {
            assert_eq!(evenly(count, most), (condition.to_owned(), kept), "{count}, {most}");
        }
    }

    #[test]
    fn a_graph_that_chooses_smaller_formats_where_larger_ones_have_no_room_fits_more_splats() {
        let (_, fit) = fit_of("tiled", 5_000_000, &Target::nominal());
        assert!(!fit.fits);
        let most = fit.most_splats.unwrap();
        assert!((4_000_000..4_194_305).contains(&most), "1.4 M with harmonics in half floats, found {most}");
        assert!(fit_of("tiled", most, &Target::nominal()).1.fits);
    }

    #[test]
    fn the_buffers_of_a_mesh_have_its_own_size() {
        let scene = synth::generate("uniform", 500, 0).unwrap().with_mesh(Some(synth::mesh().into()));
        let (of_scene, catalog) = (SceneFacts::of(&scene), facts::catalog(&scene));
        let size = facts::DEFAULT_SIZE;
        let wanted = Wanted { graph: "mesh", set: &[], scene: of_scene, catalog: &catalog, size };
        let mut planner = Planner::default();
        let (plan, _) = fit(&mut planner, &wanted, &Target::nominal(), None).unwrap();
        let facts = facts::facts(&of_scene, &Target::nominal().facts, size);
        let drawn = planner.plan("mesh", &[], &facts, &catalog).unwrap();
        assert!(drawn.resources.iter().any(|r| r.name.contains("mesh")));
        assert_eq!(plan.resources, drawn.resources);
    }

    #[test]
    fn a_scene_beyond_the_memory_that_is_available_does_not_fit() {
        let heap = Heap { bytes: 8 << 30, available: Some(200 << 20) };
        let mut device = Target { name: "small".to_owned(), heap, ..Target::nominal() };
        let (_, fit) = fit_of("unsorted", 1_000_000, &device);
        let text = fit.to_string();
        assert!(!fit.fits && fit.too_large.is_empty(), "{text}");
        assert!(text.contains("all resources: expected at most 200.0 MiB, found"), "{text}");
        assert!(fit.most_splats.is_some_and(|most| (100_000..1_000_000).contains(&most)), "{text}");
        device.heap.available = Some(4 << 30);
        assert!(fit_of("unsorted", 1_000_000, &device).1.fits);
    }

    #[test]
    fn no_built_in_graph_needs_more_than_the_estimate() {
        let catalog = facts::nominal_catalog();
        let mut planner = Planner::default();
        let mut largest: f64 = 0.0;
        for graph in builtin::names() {
            for (count, size) in [(1000, (3840, 2160)), (1_000_000, (1920, 1080)), (6_000_000, (64, 64))] {
                let scene = SceneFacts { count, ..SceneFacts::NOMINAL };
                let wanted = Wanted { graph, set: &[], scene, catalog: &catalog, size };
                let device = boundless(&Target::nominal().facts);
                let plan =
                    build(&mut planner, &wanted, &device, count).unwrap_or_else(|e| panic!("{graph}: {e}"));
                let (needs, estimate) = (Needs::of(&plan), usual_bytes(count, size));
                assert!(needs.total <= estimate, "{graph}, {count} splats: {} of {estimate}", needs.total);
                let buffer = needs.storage.values().max().copied().unwrap_or(0);
                // Bin and pair lists have a minimum size.
                assert!(
                    buffer <= (MAX_SPLAT_BYTES * count).max(100 << 20),
                    "{graph}, {count} splats: {buffer}"
                );
                largest = largest.max(needs.total as f64 / estimate as f64);
            }
        }
        assert!(largest > 0.3, "the estimate says something: at most {largest} of it are needed");
    }

    #[test]
    fn a_graph_with_errors_of_its_own_is_an_error() {
        let catalog = facts::nominal_catalog();
        let set = [("cutoff".to_owned(), "much".to_owned())];
        let wanted = Wanted {
            graph: "splat",
            set: &set,
            scene: SceneFacts::NOMINAL,
            catalog: &catalog,
            size: facts::DEFAULT_SIZE,
        };
        assert!(fit(&mut Planner::default(), &wanted, &Target::nominal(), None).is_err());
    }
}
