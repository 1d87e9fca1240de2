//! Compares two dumps, to show the effect of a parameter or another graph.
//!
//! Passes and resources are matched by name, barriers by the pass after them and their image. Origins and barrier
//! numbers do not affect execution and are not compared. The code of shaders is compared as SPIR-V.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use super::form::{DUMP_VERSION, Dump, DumpBarrier, DumpCause, DumpPass, DumpResource, DumpShader};
use super::text::comes_after;
use crate::ir::{Stat, Use};
use crate::plan::Cause;

/// The differences between two dumps, `a` and `b`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diff {
    /// Version of the dumps and of this form.
    pub version: u32,
    /// The first dump.
    pub a: DiffSide,
    /// The second dump.
    pub b: DiffSide,
    /// Parameters with different values.
    pub parameters: Vec<PropertyChange>,
    /// Facts with different values.
    pub facts: Vec<PropertyChange>,
    /// Statistics in other words, or with other parameters that grow with them.
    #[serde(default)]
    pub stats: Vec<PropertyChange>,
    /// The outputs `output` (shown or saved) and `output NAME` (requested) with other images.
    #[serde(default)]
    pub outputs: Vec<PropertyChange>,
    /// All totals, including equal ones.
    pub totals: Vec<TotalChange>,
    /// Passes; `only_a` and `only_b` have their names.
    pub passes: Differences<String, NamedChange>,
    /// Barriers; `only_a` and `only_b` have them in full.
    pub barriers: Differences<DumpBarrier, BarrierChange>,
    /// Resources; `only_a` and `only_b` have their sizes.
    pub resources: Differences<ResourceSize, NamedChange>,
}

/// The name and summary of one of the two compared dumps.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiffSide {
    /// Name under which the graph was requested.
    pub graph: String,
    /// One line that describes the graph.
    pub summary: String,
}

/// A property, parameter or fact with different values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PropertyChange {
    /// Name of the property, parameter or fact.
    pub name: String,
    /// Value in the first dump; `None` if only the second has the property.
    pub a: Option<String>,
    /// Value in the second dump; `None` if only the first has the property.
    pub b: Option<String>,
}

/// A total of the plan, in both dumps.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TotalChange {
    /// Name of the total, such as `barriers of the frame`.
    pub name: String,
    /// The total in the first dump.
    pub a: u64,
    /// The total in the second dump.
    pub b: u64,
    /// `b - a`.
    pub change: i64,
}

/// Items that only one side has, and items that differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Differences<T, C> {
    /// Items of the first dump only.
    pub only_a: Vec<T>,
    /// Items of the second dump only.
    pub only_b: Vec<T>,
    /// Items of both dumps that differ.
    pub changed: Vec<C>,
    /// Number of items equal on both sides.
    pub same: usize,
}

/// A pass or a resource with the properties that differ, like `size`, `define DIGIT_BITS` or `push shift`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NamedChange {
    /// Name of the pass or resource.
    pub name: String,
    /// Properties that differ.
    pub changes: Vec<PropertyChange>,
}

/// A resource that only one side has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResourceSize {
    /// Name of the resource.
    pub name: String,
    /// Shape of the resource, as in [`DumpResource::shape`].
    pub shape: String,
    /// Size in bytes.
    pub bytes: u64,
}

/// A barrier before the same pass and on the same image in both dumps, with different masks, layouts or dependencies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BarrierChange {
    /// The barrier in the first dump.
    pub a: DumpBarrier,
    /// The barrier in the second dump.
    pub b: DumpBarrier,
}

impl Diff {
    /// Returns true if the two plans have equal passes, barriers, resources, statistics and outputs, even if values of
    /// parameters or facts differ.
    pub fn is_empty(&self) -> bool {
        fn none<T, C>(d: &Differences<T, C>) -> bool {
            d.only_a.is_empty() && d.only_b.is_empty() && d.changed.is_empty()
        }
        let listed = self.stats.is_empty() && self.outputs.is_empty();
        listed && none(&self.passes) && none(&self.barriers) && none(&self.resources)
    }
}

/// Compares the parameters, facts, statistics, outputs, totals, passes, barriers and resources of two dumps.
pub fn diff(a: &Dump, b: &Dump) -> Diff {
    let side = |d: &Dump| DiffSide { graph: d.graph.clone(), summary: d.summary.clone() };
    let parameters = |d: &Dump| d.parameters.iter().map(|p| (p.name.clone(), p.value.to_string())).collect();
    let facts = |d: &Dump| d.facts.iter().map(|(name, value)| (name.clone(), value.to_string())).collect();
    let size =
        |r: &DumpResource| ResourceSize { name: r.name.clone(), shape: r.shape.clone(), bytes: r.bytes };
    Diff {
        version: DUMP_VERSION,
        a: side(a),
        b: side(b),
        parameters: changes(&parameters(a), &parameters(b)),
        facts: changes(&facts(a), &facts(b)),
        stats: changes(&stats(a), &stats(b)),
        outputs: changes(&outputs(a), &outputs(b)),
        totals: totals(a).into_iter().zip(totals(b)).map(|((name, a), (_, b))| total(name, a, b)).collect(),
        passes: match_up(
            &a.passes,
            &b.passes,
            |p| p.name.clone(),
            |p| p.name.clone(),
            |a, b| {
                let properties = changes(&pass_properties(a), &pass_properties(b));
                named(&a.name, [properties, code_changes(a, b)].concat())
            },
        ),
        barriers: match_up(
            &a.barriers().cloned().collect::<Vec<_>>(),
            &b.barriers().cloned().collect::<Vec<_>>(),
            |b| (b.before.as_ref().map(|p| p.name.clone()), b.image.as_ref().map(|t| t.image.clone())),
            DumpBarrier::clone,
            |a, b| {
                let same = a.image == b.image && a.masks == b.masks && reasons(a) == reasons(b);
                (!same).then(|| BarrierChange { a: a.clone(), b: b.clone() })
            },
        ),
        resources: match_up(
            &a.resources,
            &b.resources,
            |r| r.name.clone(),
            size,
            |x, y| named(&x.name, changes(&resource_properties(a, x), &resource_properties(b, y))),
        ),
    }
}

/// Pairs the elements of two lists by key, unique within a list. `change` returns `None` for an equal pair.
fn match_up<E, K: Ord, T, C>(
    a: &[E],
    b: &[E],
    key: impl Fn(&E) -> K,
    only: impl Fn(&E) -> T,
    change: impl Fn(&E, &E) -> Option<C>,
) -> Differences<T, C> {
    let in_a: BTreeMap<K, &E> = a.iter().map(|e| (key(e), e)).collect();
    let in_b: BTreeMap<K, &E> = b.iter().map(|e| (key(e), e)).collect();
    let pairs = || a.iter().filter_map(|e| Some((e, *in_b.get(&key(e))?)));
    let changed: Vec<C> = pairs().filter_map(|(a, b)| change(a, b)).collect();
    Differences {
        only_a: a.iter().filter(|e| !in_b.contains_key(&key(e))).map(&only).collect(),
        only_b: b.iter().filter(|e| !in_a.contains_key(&key(e))).map(&only).collect(),
        same: pairs().count() - changed.len(),
        changed,
    }
}

fn named(name: &str, changes: Vec<PropertyChange>) -> Option<NamedChange> {
    (!changes.is_empty()).then(|| NamedChange { name: name.into(), changes })
}

/// Names and values of properties, in reading order.
type Properties = Vec<(String, String)>;

fn changes(a: &Properties, b: &Properties) -> Vec<PropertyChange> {
    let value = |of: &Properties, name: &str| of.iter().find(|(n, _)| n == name).map(|(_, v)| v.clone());
    let only_b = b.iter().filter(|(name, _)| value(a, name).is_none());
    let names = a.iter().chain(only_b).map(|(name, _)| name.clone());
    let change = |name: String| {
        let (a, b) = (value(a, &name), value(b, &name));
        (a != b).then_some(PropertyChange { name, a, b })
    };
    names.filter_map(change).collect()
}

fn total(name: &str, a: u64, b: u64) -> TotalChange {
    TotalChange { name: name.into(), a, b, change: b as i64 - a as i64 }
}

/// Returns the totals of a dump. Names of byte counts end with `bytes`.
fn totals(dump: &Dump) -> Vec<(&'static str, u64)> {
    let t = &dump.totals;
    let count = |n: usize| n as u64;
    vec![
        ("passes", count(t.passes)),
        ("passes of the prologue", count(t.prologue_passes)),
        ("passes of the frame", count(t.frame_passes)),
        ("barrier calls of the frame", count(t.frame.calls)),
        ("barriers of the frame", count(t.frame.barriers)),
        ("barriers on all memory", count(t.frame.memory_barriers)),
        ("barriers on images", count(t.frame.image_barriers)),
        ("dependencies of the frame", count(t.frame.dependencies)),
        ("barriers of the prologue", count(t.prologue.barriers)),
        ("barriers of the handover", count(t.handover.barriers)),
        ("unshared bytes", t.unshared_bytes),
        ("saved bytes", t.saved_bytes),
        ("transient bytes", t.transient_bytes),
        ("scene bytes", t.scene_bytes),
        ("freed bytes", t.freed_bytes),
        ("host bytes", t.host_bytes),
    ]
}

/// Returns the word of each statistic, and the parameters that grow with it: `counters+80, grows entries`.
fn stats(dump: &Dump) -> Properties {
    let grown = |stat: &Stat<String>| -> String {
        stat.grows.iter().map(|parameter| format!(", grows {parameter}")).collect()
    };
    let stats = dump.stats.iter();
    stats.map(|s| (s.name.clone(), format!("{}+{}{}", s.buffer, s.offset, grown(s)))).collect()
}

fn outputs(dump: &Dump) -> Properties {
    let requested = dump.outputs.iter().map(|(name, image)| (format!("output {name}"), image.clone()));
    std::iter::once(("output".into(), dump.output.clone())).chain(requested).collect()
}

fn pass_properties(pass: &DumpPass) -> Properties {
    let mut all = vec![
        ("phase".to_owned(), pass.phase.clone()),
        ("run".into(), format!("{:?}", pass.run)),
        ("kind".into(), pass.kind.clone()),
        ("size".into(), pass.size.clone()),
    ];
    all.extend(pass.topology.map(|t| ("topology".into(), format!("{t:?}"))));
    for (i, target) in pass.targets.iter().enumerate() {
        let value = format!("{} {:?} {:?}", target.image, target.load, target.blend);
        all.push((format!("target {i}"), value));
    }
    all.extend(pass.depth.iter().map(|d| ("depth".into(), format!("{} {:?}", d.image, d.access))));
    for (i, shader) in pass.shaders.iter().enumerate() {
        // A draw has two shaders, which may have defines of equal name.
        let of = if i == 0 { String::new() } else { format!(" of {}", shader.file) };
        all.push((format!("shader {i}"), shader.file.clone()));
        all.push((format!("workgroup{of}"), format!("{:?}", shader.local_size)));
        all.push((format!("shared bytes{of}"), shader.shared_bytes.to_string()));
        all.extend(shader.defines.iter().map(|d| (format!("define {}{of}", d.name), d.value.clone())));
    }
    for b in &pass.bindings {
        let element = if b.element == 0 { String::new() } else { format!("[{}]", b.element) };
        all.push((format!("binding {}{element}", b.name), b.resource.clone()));
    }
    for p in &pass.push {
        let name = p.name.clone().unwrap_or_else(|| format!("at byte {}", p.offset));
        all.push((format!("push {name}"), p.value.to_string()));
    }
    all.push(("reads".into(), uses(&pass.reads)));
    all.push(("writes".into(), uses(&pass.writes)));
    all.push(("comes after".into(), comes_after(pass)));
    all
}

/// Compares the code of shaders that have one name in both graphs. Other defines explain other code of one file.
fn code_changes(a: &DumpPass, b: &DumpPass) -> Vec<PropertyChange> {
    let pairs = a.shaders.iter().zip(&b.shaders);
    let other = pairs.filter(|(a, b)| {
        a.file == b.file && a.code != b.code && (a.path != b.path || a.defines == b.defines)
    });
    let text = |shader: &DumpShader| Some(format!("{}, SPIR-V {}", shader.path, shader.code));
    other
        .map(|(a, b)| PropertyChange { name: format!("code of {}", a.file), a: text(a), b: text(b) })
        .collect()
}

fn uses(uses: &[Use<String>]) -> String {
    let touch = |t: &Use<String>| format!("{} ({} {})", t.resource, t.stages, t.accesses);
    uses.iter().map(touch).collect::<Vec<_>>().join(", ")
}

fn resource_properties(dump: &Dump, resource: &DumpResource) -> Properties {
    let block = resource.block.and_then(|block| dump.blocks.get(block as usize));
    let aliases = block.into_iter().flat_map(|block| &block.aliases);
    let mut aliases: Vec<&str> =
        aliases.map(String::as_str).filter(|alias| *alias != resource.name).collect();
    aliases.sort();
    let name = |i: usize| dump.passes.get(i).map_or("?", |p| p.name.as_str());
    let lifetime = match resource.lifetime {
        _ if resource.freed => "freed after the prologue".into(),
        Some(l) => format!("{} to {}", name(l.first), name(l.last)),
        None => "longer than a frame".into(),
    };
    let mut all = vec![
        ("shape".to_owned(), resource.shape.clone()),
        ("bytes".into(), resource.bytes.to_string()),
        ("source".into(), resource.source.clone()),
        ("usage".into(), resource.usage.to_string()),
        ("shares memory with".into(), aliases.join(", ")),
        ("lifetime".into(), lifetime),
    ];
    all.extend(resource.from.clone().map(|from| ("from".into(), from)));
    all.extend(resource.history.clone().map(|history| ("history".into(), history)));
    all
}

/// Returns a barrier's dependencies without the places of declarations.
fn reasons(barrier: &DumpBarrier) -> Vec<String> {
    barrier.dependencies.iter().map(reason).collect()
}

fn reason(cause: &DumpCause) -> String {
    let DumpCause { conflict: Cause { hazard, before, resource, after, previous_frame, alias }, masks } =
        cause;
    let after: Vec<&str> = after.iter().map(|p| p.name.as_str()).collect();
    let alias = alias.as_ref().map(|p| &p.name);
    format!("{hazard:?} {} {} {after:?} {previous_frame} {alias:?} {masks}", before.name, resource.name)
}
