//! Reads the contents of a buffer or an image after a pass.
//!
//! A target is written `RESOURCE@PASS`, with names as in the plan's dump. Short forms are allowed. `keys` is the half
//! of the ping-pong pair `keys#0`, `keys#1` that the pass writes, or else reads. A resource's name may also lack its
//! first parts, `scene.picture` is the output of the include `scene`, and `keys` may be any resource that holds depth
//! keys. `sort.scatter`, or just `scatter`, is the last of `sort.scatter[0]`, `sort.scatter[1]`, ..., and of
//! `sort[0].scatter`, `sort[1].scatter`, ... If the resource holds depth keys, the finding reports whether the keys in
//! use ascend.

mod contents;
mod declared;
mod keys;

use crate::io::image::{ImageError, save_elements, save_words};
use half::f16;
use serde::Serialize;
use splatgraph_api::Inspect;
use splatgraph_framework::ir::{Culled, Format, Pass, PassId, ResourceId, Run, Shape, Source};
use splatgraph_framework::plan::{Plan, Resource};
use splatgraph_framework::source::nearest;
use std::ops::Range;
use std::path::Path;

use contents::shown;
pub use contents::{Histogram, ReadAs, Values, Words};
pub use declared::Channel;
pub use keys::{KeyOrder, holds_keys, sorted_keys};
use keys::{without_half, without_indices};

/// Number of words to show at each end of the contents.
const SHOWN: usize = 8;

/// Maximum number of words per element that are summarised.
const MAX_CHANNELS: usize = 16;

/// Advice for a pass that is left out because nothing reads what it writes.
const KEPT: &str = ". To keep it, list a word of a buffer that it writes in the graph's `stats`, or request an image that it writes as an output";

/// Error about a name that matches no resource or pass of the plan, or several resources.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InspectError(String);

/// Resolves `RESOURCE@PASS` in a plan. If several passes match, prefers the last one that uses the resource.
///
/// # Errors
/// The plan has no such resource or pass, several resources match and the pass does not decide between them, or no pass
/// has written the resource by then.
pub fn resolve(plan: &Plan, resource: &str, pass: &str) -> Result<Inspect, InspectError> {
    let passes = find_passes(plan, pass)?;
    let target = |after: &PassId| {
        let resource = find_resource(plan, resource, plan.pass(*after))?;
        Ok(Inspect { resource, after: *after })
    };
    let uses =
        |target: &Inspect| plan.pass(target.after).uses.iter().any(|touch| touch.resource == target.resource);
    let used = passes.iter().filter_map(|after| target(after).ok()).find(uses);
    let found = used.map_or_else(|| target(&passes[0]), Ok)?;
    check_written(plan, &found)?;
    Ok(found)
}

/// Refuses a resource before its first writer: it would have the contents of the previous frame, or of another camera.
fn check_written(plan: &Plan, target: &Inspect) -> Result<(), InspectError> {
    let Resource { name, source, history, .. } = plan.resource(target.resource);
    if history.is_some() || !matches!(source, Source::Transient | Source::Readback) {
        return Ok(());
    }
    let writes = |id: &PassId| {
        plan.pass(*id).uses.iter().any(|touch| touch.resource == target.resource && touch.accesses.writes())
    };
    let first = plan.order().find(writes);
    if first.is_some() && plan.order().find(|id| Some(*id) == first || *id == target.after) == first {
        return Ok(());
    }
    let pass = |id: PassId| &plan.pass(id).name;
    Err(InspectError(match first {
        Some(first) => format!(
            "`{name}` has no contents yet after `{}`: `{}` is the first pass that writes it",
            pass(target.after),
            pass(first)
        ),
        None => format!("`{name}` has no contents: no pass writes it"),
    }))
}

/// Names the first five passes that are left out because nothing reads what they write, and counts the others.
pub fn unread(culled: &[Culled]) -> String {
    let mut names: Vec<String> = culled
        .iter()
        .filter(|pass| pass.why == Culled::UNREAD)
        .map(|pass| without_indices(&pass.pass))
        .collect();
    names.dedup();
    let others = names.len().saturating_sub(5);
    names.truncate(5);
    if others > 0 {
        names.push(format!("{others} more"));
    }
    names.join(", ")
}

/// Returns true if the target's pass runs only in the first frame after a load.
pub fn in_prologue(plan: &Plan, target: &Inspect) -> bool {
    plan.pass(target.after).run == Run::Once
}

/// Returns true if `name` is the end of a pass's name. Each part may lack its last indices.
///
/// For instance, `scatter`, `sort.scatter` and `scatter[2]` are ends of `order[0].sort.scatter[2][1]`.
fn is_end(name: &str, full: &str) -> bool {
    let mut parts = full.rsplit('.');
    let is_start = |part: &str, full: &str| {
        full.strip_prefix(part).is_some_and(|indices| indices.is_empty() || indices.starts_with('['))
    };
    name.rsplit('.').all(|part| parts.next().is_some_and(|full| is_start(part, full)))
}

/// Lists the passes that match a name, last pass first; at least one. The whole name is preferred, then ends of names
/// with as many parts, then all ends.
fn find_passes(plan: &Plan, name: &str) -> Result<Vec<PassId>, InspectError> {
    let passes = plan.order();
    let named = |is: &dyn Fn(&str) -> bool| -> Vec<PassId> {
        passes.clone().rev().filter(|id| is(&plan.pass(*id).name)).collect()
    };
    let depth = name.matches('.').count();
    let found = [
        named(&|full| full == name),
        named(&|full| full.matches('.').count() == depth && is_end(name, full)),
        named(&|full| is_end(name, full)),
    ];
    found.into_iter().find(|passes| !passes.is_empty()).ok_or_else(|| {
        let is_named = |culled: &&Culled| culled.pass == name || is_end(name, &culled.pass);
        if let Some(Culled { pass, why, .. }) = plan.culled.iter().find(is_named) {
            let advice = if why == Culled::UNREAD { KEPT } else { "" };
            return InspectError(format!("the pass `{pass}` is left out of the plan: {why}{advice}"));
        }
        let names: Vec<&str> = passes.map(|id| plan.pass(id).name.as_str()).collect();
        let stems: Vec<String> = names.iter().map(|name| without_indices(name)).collect();
        let ends = stems.iter().filter_map(|stem| stem.rsplit('.').next());
        let known = names.iter().copied().chain(stems.iter().map(String::as_str)).chain(ends);
        InspectError(match nearest(name, known) {
            Some(near) => format!("no pass `{name}` runs; did you mean `{near}`?"),
            None => format!("no pass `{name}` runs; the plan runs {}", names.join(", ")),
        })
    })
}

fn find_resource(plan: &Plan, name: &str, pass: &Pass) -> Result<ResourceId, InspectError> {
    let picture = || plan.pictures.iter().find(|picture| picture.name == name).map(|picture| picture.image);
    if let Some(id) = plan.find_resource(name).or_else(picture) {
        return Ok(id);
    }
    let named = |is: &dyn Fn(&str) -> bool| -> Vec<ResourceId> {
        let found = plan.resources.iter().enumerate();
        found.filter(|(_, r)| is(&r.name)).map(|(index, _)| ResourceId(index as u32)).collect()
    };
    let ends = |full: &str| full.strip_suffix(name).is_some_and(|front| front.ends_with('.'));
    let mut halves = named(&|full| without_half(full) == name);
    if halves.is_empty() {
        halves = named(&|full| ends(full) || ends(without_half(full)));
    }
    if halves.is_empty() && name == "keys" {
        halves = named(&holds_keys);
    }
    if halves.is_empty() {
        let mut names: Vec<&str> = plan.resources.iter().map(|r| without_half(&r.name)).collect();
        names.dedup();
        return Err(InspectError(match nearest(name, names.iter().copied()) {
            Some(near) => format!("the plan has no resource `{name}`; did you mean `{near}`?"),
            None => {
                let known = format!("the plan has no resource `{name}`; it has {}", names.join(", "));
                let unread = unread(&plan.culled);
                if unread.is_empty() {
                    known
                } else {
                    format!("{known}; what only these passes use is left out with them: {unread}{KEPT}")
                }
            }
        }));
    }
    let touched = |writes: bool| -> Vec<ResourceId> {
        let uses =
            |id: &ResourceId| pass.uses.iter().any(|t| t.resource == *id && (t.accesses.writes() || !writes));
        halves.iter().copied().filter(uses).collect()
    };
    match (touched(true).as_slice(), touched(false).as_slice(), halves.as_slice()) {
        (&[id], ..) | (_, &[id], _) | (.., &[id]) => Ok(id),
        _ => {
            let names: Vec<&str> = halves.iter().map(|id| plan.resource(*id).name.as_str()).collect();
            let names = names.join(" or ");
            Err(InspectError(format!(
                "`{name}` is {names}, and `{}` does not say which: name one",
                pass.name
            )))
        }
    }
}

/// Contents of a resource after a pass.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Full name of the resource.
    pub resource: String,
    /// Name of the pass.
    pub pass: String,
    /// `[count, words per element]` for a buffer, `[height, width, channels]` for an image; a trailing 1 is omitted. A
    /// buffer whose stride is not a multiple of 4 bytes has `[words]`.
    pub shape: Vec<u64>,
    /// Summaries of the first 16 of `channels`.
    pub values: Vec<Values>,
    /// Order of the keys; `None` unless the resource has keys (see [`holds_keys`]) and the order is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<KeyOrder>,
    /// Reason why the order of the keys is unknown; `None` if it is known, or if there are no keys.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown_order: Option<String>,
    /// Number of compared keys, as in [`KeyOrder::keys`]; `None` if `order` is `None`.
    #[serde(skip)]
    pub counted: Option<u64>,
    /// True for an image, false for a buffer.
    #[serde(skip)]
    pub is_image: bool,
    /// Channels of an image, or words of a buffer's elements, as the shaders declare them; at least one.
    #[serde(skip)]
    pub channels: Vec<Channel>,
    /// Contents as 32-bit words.
    #[serde(skip)]
    pub words: Words,
}

impl Finding {
    /// Interprets the bytes of a resource. `stats` are the statistics of the frame that wrote them.
    pub fn new(plan: &Plan, target: &Inspect, bytes: &[u8], stats: &[(String, u32)]) -> Finding {
        let resource = plan.resource(target.resource);
        let (shape, words) = words(resource, bytes);
        let pass = plan.pass(target.after);
        let (mut order, mut unknown_order) = (None, None);
        if let Words::Uint(words) = &words
            && holds_keys(&resource.name)
        {
            let count = keys::count(plan, pass, stats);
            let found =
                KeyOrder::of(words, count.unwrap_or(words.len() as u64), keys::lowest_bit(plan, pass));
            match found.first_descent {
                Some(ascending) if count.is_none() => {
                    unknown_order = Some(keys::unknown_order(plan, pass, ascending));
                }
                _ => order = Some(found),
            }
        }
        let pass = pass.name.clone();
        let is_image = matches!(resource.shape, Shape::Image { .. });
        let count = shape.iter().skip(if is_image { 2 } else { 1 }).product::<u64>().max(1) as usize;
        let channels = match is_image {
            true => vec![Channel { name: String::new(), read: ReadAs::Uint }; count],
            false => declared::of_buffer(plan, target.after, target.resource, count),
        };
        let shown = channels.iter().take(MAX_CHANNELS).enumerate();
        let values = shown.map(|(first, channel)| Values {
            name: channel.name.clone(),
            ..words.values(first, count, channel.read)
        });
        let counted = order.as_ref().map(|order: &KeyOrder| order.keys);
        Finding {
            resource: resource.name.clone(),
            pass,
            values: values.collect(),
            shape,
            order,
            unknown_order,
            counted,
            is_image,
            channels,
            words,
        }
    }

    /// Saves the words as a NumPy array.
    ///
    /// The type is float32 for images of floats, and uint32 for images of integers. Buffers have the type that a shader
    /// declares: float32, int32, uint32, or a structured array of them, one field per scalar or vector.
    ///
    /// # Errors
    /// The extension is not `.npy`, or the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ImageError> {
        let words = match &self.words {
            Words::Float(words) => return save_words(path, &self.shape, words),
            Words::Uint(words) => words,
        };
        match declared::only_type(&self.channels) {
            Some(ReadAs::Uint) => save_words(path, &self.shape, words),
            Some(ReadAs::Int) => save_words(path, &self.shape, bytemuck::cast_slice::<u32, i32>(words)),
            Some(ReadAs::Float) => save_words(path, &self.shape, bytemuck::cast_slice::<u32, f32>(words)),
            None => save_elements(path, &declared::fields(&self.channels), words),
        }
    }

    /// Formats the word at `index` as the shaders declare it; `None` beyond the end.
    fn word(&self, index: usize) -> Option<String> {
        self.words.number(index, self.channels[index % self.channels.len()].read).map(shown)
    }

    /// Formats the shape, the order of the keys, the range of each channel, and the first and last words.
    ///
    /// Up to 16 words are all shown.
    pub fn text(&self) -> String {
        let shape: Vec<String> = self.shape.iter().map(u64::to_string).collect();
        let mut text = format!("{} after {}: {} words", self.resource, self.pass, shape.join(" x "));
        if let (Some(order), Words::Uint(keys)) = (&self.order, &self.words) {
            text += &format!("\n  {order}");
            if let Some(at) = order.first_descent {
                text += &format!(": {} after {}", keys[at as usize], keys[at as usize - 1]);
            }
        }
        if let Some(reason) = &self.unknown_order {
            text += &format!("\n  {reason}");
        }
        for (index, values) in self.values.iter().enumerate() {
            text += &match self.values.len() {
                1 => format!("\n  {values}"),
                _ => format!("\n  {}: {values}", self.name(index)),
            };
        }
        text + &self.ends()
    }

    /// Formats the first and last words; all words if there are few.
    fn ends(&self) -> String {
        let words =
            |range: Range<usize>| range.filter_map(|index| self.word(index)).collect::<Vec<_>>().join(" ");
        match self.words.len() {
            n if n <= 2 * SHOWN => format!("\n  all: {}", words(0..n)),
            n => format!("\n  first: {}\n  last: {}", words(0..SHOWN), words(n - SHOWN..n)),
        }
    }

    /// Returns the name of a channel: the shader's, or its number.
    pub fn name(&self, channel: usize) -> String {
        match self.channels.get(channel).map(|channel| channel.name.as_str()) {
            None | Some("") => format!("{} {channel}", if self.is_image { "channel" } else { "word" }),
            Some(name) => name.to_string(),
        }
    }
}

fn words(resource: &Resource, bytes: &[u8]) -> (Vec<u64>, Words) {
    let uint = || bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let float = || bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let half = || bytes.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
    match resource.shape {
        Shape::Buffer { stride, count } if stride % 4 == 0 && stride > 4 => {
            (vec![count, stride / 4], Words::Uint(uint()))
        }
        Shape::Buffer { .. } => (vec![bytes.len() as u64 / 4], Words::Uint(uint())),
        Shape::Image { format, width, height } => {
            let (height, width) = (height.into(), width.into());
            match format {
                Format::R32Uint => (vec![height, width], Words::Uint(uint())),
                Format::R32Float | Format::Depth32Float => (vec![height, width], Words::Float(float())),
                Format::Rgba32Float => (vec![height, width, 4], Words::Float(float())),
                Format::Rgba16Float => (vec![height, width, 4], Words::Float(half())),
                Format::Rgba8Unorm => {
                    let unit = bytes.iter().map(|b| f32::from(*b) / 255.0).collect();
                    (vec![height, width, 4], Words::Float(unit))
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_framework::ir::{Accesses, Origin, Stages, Usage, Use, Work};

    fn origin() -> Origin {
        Origin { file: "test.ron".into(), line: 1, column: 1 }
    }

    fn pass(name: &str, reads: u32, writes: u32) -> Pass {
        let touch = |resource, accesses| Use {
            resource: ResourceId(resource),
            stages: Stages::COMPUTE,
            accesses,
            layout: None,
            discards: false,
        };
        Pass {
            name: name.into(),
            phase: "sort".into(),
            run: Run::Frame,
            work: Work::Export,
            bindings: vec![],
            push: vec![],
            uses: vec![touch(reads, Accesses::STORAGE_READ), touch(writes, Accesses::STORAGE_WRITE)],
            origin: origin(),
        }
    }

    /// Makes a plan with two ping-pong scatter passes, and a pass that reads the result.
    fn plan() -> Plan {
        let buffer = |name: &str, stride| Resource {
            name: name.into(),
            shape: Shape::Buffer { stride, count: 6 },
            usage: Usage::STORAGE,
            source: Source::Transient,
            block: None,
            history: None,
            origin: origin(),
        };
        let passes = vec![
            pass("sort.scatter[0]", 0, 1),
            pass("sort.scatter[1]", 1, 0),
            pass("draw", 2, 2),
            pass("both", 0, 1),
        ];
        Plan {
            name: "test".into(),
            resources: vec![buffer("keys#0", 4), buffer("keys#1", 4), buffer("args", 8)],
            frame: (0..3).map(PassId).collect(),
            passes,
            output: ResourceId(2),
            ..Plan::default()
        }
    }

    fn resolved(resource: &str, pass: &str) -> (u32, u32) {
        let found = resolve(&plan(), resource, pass).unwrap();
        (found.resource.0, found.after.0)
    }

    #[test]
    fn a_pair_means_the_half_that_the_pass_writes_and_a_repeat_its_last_pass() {
        assert_eq!(resolved("keys", "sort.scatter[0]"), (1, 0));
        assert_eq!(resolved("keys", "sort.scatter[1]"), (0, 1));
        assert_eq!(resolved("keys", "sort.scatter"), (0, 1));
        assert_eq!(resolved("keys", "scatter"), (0, 1));
        assert_eq!(resolved("keys#1", "sort.scatter"), (1, 1));
        assert_eq!(resolved("keys", "scatter[0]"), (1, 0));
        assert_eq!(resolved("args", "draw"), (2, 2));
    }

    #[test]
    fn the_last_indices_of_each_part_of_a_name_can_be_left_out() {
        let mut plan = plan();
        // It has contents after any pass.
        plan.resources[2].history = Some("args".into());
        let names = ["turn[0].sort.scatter[1]", "turn[1].sort.scatter[0]", "turn[1].sort.scatter[1]"];
        plan.passes.iter_mut().zip(names).for_each(|(pass, name)| pass.name = name.into());
        let after = |name: &str| resolve(&plan, "args", name).map(|found| found.after.0);
        for name in ["turn[0].sort.scatter[1]", "turn[0].sort.scatter"] {
            assert_eq!(after(name), Ok(0), "{name}");
        }
        assert_eq!(after("sort.scatter[0]"), Ok(1));
        for name in ["scatter", "sort.scatter", "scatter[1]", "turn.sort.scatter", "turn[1].sort.scatter"] {
            assert_eq!(after(name), Ok(2), "{name}");
        }
        plan.passes
            .iter_mut()
            .zip(["step[0][3]", "step[1][2]", "step[1][3]"])
            .for_each(|(pass, name)| pass.name = name.into());
        let after = |name: &str| resolve(&plan, "args", name).map(|found| found.after.0);
        let found = ["step", "step[0]", "step[1]", "step[1][2]"].map(after);
        assert_eq!(found, [Ok(2), Ok(0), Ok(2), Ok(1)]);
        for name in ["turn", "sort", "turn.scatter", "atter"] {
            assert!(after(name).is_err(), "{name}");
        }
    }

    #[test]
    fn what_cannot_be_meant_is_an_error_with_a_hint() {
        let error = |resource, pass| resolve(&plan(), resource, pass).unwrap_err().to_string();
        assert_eq!(error("keys", "sort.scater"), "no pass `sort.scater` runs; did you mean `sort.scatter`?");
        assert_eq!(error("colours", "draw"), "the plan has no resource `colours`; it has keys, args");
        assert_eq!(error("key", "draw"), "the plan has no resource `key`; did you mean `keys`?");
        assert!(
            error("keys", "draw").starts_with("`keys` is keys#0 or keys#1, and `draw` does not say which")
        );
        // No step of the plan runs `both`.
        assert!(error("keys", "both").starts_with("no pass `both` runs"));
        assert_eq!(
            error("args", "scatter"),
            "`args` has no contents yet after `sort.scatter[1]`: `draw` is the first pass that writes it"
        );
    }

    #[test]
    fn a_pass_that_is_left_out_is_named_with_the_reason_and_the_way_to_keep_it() {
        let culled = |pass: &str, why: &str| Culled { pass: pass.into(), why: why.into(), origin: origin() };
        let mut plan = plan();
        plan.culled = vec![
            culled("sum.add[0]", Culled::UNREAD),
            culled("sum.add[1]", Culled::UNREAD),
            culled("mesh", "its condition is false: with_mesh"),
        ];
        let error = |resource, pass| resolve(&plan, resource, pass).unwrap_err().to_string();
        let found = error("score", "add");
        let begin = "the pass `sum.add[0]` is left out of the plan: nothing reads what it writes. To keep it, list a word";
        assert!(found.starts_with(begin) && found.contains("`stats`"), "{found}");
        assert_eq!(
            error("score", "mesh"),
            "the pass `mesh` is left out of the plan: its condition is false: with_mesh"
        );
        let found = error("score", "draw");
        let end = "it has keys, args; what only these passes use is left out with them: sum.add. To keep it,";
        assert!(found.starts_with("the plan has no resource `score`; ") && found.contains(end), "{found}");
        let many: Vec<Culled> = (0..7).map(|i| culled(&format!("p{i}"), Culled::UNREAD)).collect();
        assert_eq!(unread(&many), "p0, p1, p2, p3, p4, 2 more");
    }

    #[test]
    fn the_order_of_keys_is_judged_over_the_visible_ones() {
        let keys = [1u32, 1, 4, 3, 9, 0];
        let bytes: Vec<u8> = keys.iter().flat_map(|k| k.to_le_bytes()).collect();
        let target = Inspect { resource: ResourceId(0), after: PassId(1) };
        let found = |visible: Option<u32>| {
            let stats: Vec<_> = visible.map(|count| ("visible".to_owned(), count)).into_iter().collect();
            Finding::new(&plan(), &target, &bytes, &stats)
        };

        let order = found(Some(3)).order.unwrap();
        assert_eq!(
            order,
            KeyOrder { keys: 3, ignored_bits: 0, ascending: true, descents: 0, first_descent: None }
        );
        assert!(found(Some(3)).text().contains("monotonic: the first 3 keys ascend"));
        let order = found(Some(6)).order.unwrap();
        assert_eq!(
            order,
            KeyOrder { keys: 6, ignored_bits: 0, ascending: false, descents: 2, first_descent: Some(3) }
        );
        assert!(found(Some(6)).text().contains("the first at 3: 3 after 4"), "{}", found(Some(6)).text());
        assert_eq!(found(None).order, None);
        assert!(
            found(None).text().contains("\n  unknown order: the first 3 keys ascend"),
            "{}",
            found(None).text()
        );
        assert!(found(Some(0)).order.unwrap().ascending);
    }

    #[test]
    fn elements_of_several_words_have_a_second_dimension_and_no_order() {
        let found =
            Finding::new(&plan(), &Inspect { resource: ResourceId(2), after: PassId(2) }, &[0; 48], &[]);
        assert_eq!(found.shape, [6, 2]);
        assert!(
            found.text().contains("\n  word 0: 0 to 0, 6 zeros\n  word 1: 0 to 0, 6 zeros\n"),
            "{}",
            found.text()
        );
        assert_eq!(found.order, None);
    }

    #[test]
    fn a_buffer_is_saved_as_the_types_that_its_shader_declares() {
        let words = [0.5f32, 0.25, -8.0, 0.0, -1.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0].map(f32::to_le_bytes);
        let target = Inspect { resource: ResourceId(2), after: PassId(2) };
        let found = Finding::new(&plan(), &target, words.as_flattened(), &[]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let channel = |name: &str, read| Channel { name: name.into(), read };
        for (channels, descr, text) in [
            ([channel("", ReadAs::Uint), channel("", ReadAs::Uint)], "'descr': '<u4'", "all: 1056964608 10"),
            (
                [channel("a.x", ReadAs::Float), channel("a.y", ReadAs::Float)],
                "'descr': '<f4'",
                "all: 0.5 0.25 -8 ",
            ),
            (
                [channel("", ReadAs::Int), channel("", ReadAs::Int)],
                "'descr': '<i4'",
                "all: 1056964608 1048576000 -10",
            ),
            (
                [channel("a", ReadAs::Float), channel("b", ReadAs::Int)],
                "'descr': [('a', '<f4'), ('b', '<i4')",
                "all: 0.5 1048576000 -8 0 -1 1069547520 0 ",
            ),
            (
                [channel("a", ReadAs::Float), channel("", ReadAs::Uint)],
                "'descr': [('a', '<f4'), ('', '|V4')",
                "all: 0.5 1048576000 -8 0 -1 1069547520 0 ",
            ),
        ] {
            let found = Finding { channels: channels.to_vec(), ..found.clone() };
            found.save(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            assert!(String::from_utf8_lossy(&bytes).contains(descr), "{descr}");
            assert!(bytes.ends_with(words.as_flattened()), "{descr}: the bits are those of the buffer");
            assert!(found.text().contains(text), "{}", found.text());
        }
    }

    #[test]
    fn components_of_vectors_are_one_field() {
        use ReadAs::{Float, Uint};
        let names =
            [("s.a.x", Float), ("s.a.y", Float), ("s.n", Uint), ("", Uint), ("b.x", Uint), ("b.y", Float)];
        let channels = names.map(|(name, read)| Channel { name: name.into(), read });
        let fields = declared::fields(&channels);
        let found: Vec<_> = fields.iter().map(|field| (&*field.name, field.kind, field.words)).collect();
        assert_eq!(
            found,
            [("s.a", "<f", 2), ("s.n", "<u", 1), ("", "|V", 1), ("b.x", "<u", 1), ("b.y", "<f", 1)]
        );
    }
}
