//! Numbers the fences, one for each chain of encoders.
//!
//! An encoder that waits for a fence may update it again ("Reuse a fence by waiting first and updating second",
//! `mtlblitcommandencoder/waitforfence(_:)`), provided that all other waits for the earlier update come before: a wait
//! is for the last update. So a chain of encoders, each of which waits for the previous one, needs one fence, even if
//! the first waits for the last of the previous frame. A chain covers at most one frame, so that the next frame can
//! reuse its fences.

use super::encoding::RenderStages;
use std::cmp::Ordering;

/// A wait of an encoder for another, `source`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wait {
    pub source: usize,
    /// True if the source ran in the previous frame.
    pub previous: bool,
    pub after: RenderStages,
    pub before: RenderStages,
}

/// Fences of an encoder's waits and of its updates, with their stages.
pub(super) type Uses = (Vec<(u32, RenderStages)>, Vec<(u32, RenderStages)>);

/// The end of a stage, for which other encoders wait.
struct Source {
    encoder: usize,
    after: RenderStages,
    /// The last encoder that waits for this end, its distance in encoders, and the stage that waits.
    last: (usize, usize, RenderStages),
    fence: Option<u32>,
}

/// Numbers the fences for the waits of all encoders, and counts the fences. `turn` is the number of encoders per frame
/// if they repeat.
pub(super) fn number(waits: &[Vec<Wait>], turn: Option<usize>) -> (Vec<Uses>, u32) {
    let mut sources: Vec<Source> = Vec::new();
    for (encoder, waits) in waits.iter().enumerate() {
        for wait in waits {
            let round = if wait.previous { turn.unwrap_or(0) } else { 0 };
            let last = (encoder, encoder + round - wait.source, wait.before);
            let same = |known: &&mut Source| (known.encoder, known.after) == (wait.source, wait.after);
            match sources.iter_mut().find(same) {
                Some(known) if known.last.1 < last.1 => known.last = last,
                Some(_) => {}
                None => sources.push(Source { encoder: wait.source, after: wait.after, last, fence: None }),
            }
        }
    }
    sources.sort_by_key(|source| (source.encoder, source.after));

    let mut count = 0;
    for start in 0..sources.len() {
        if sources[start].fence.is_some() {
            continue;
        }
        let (mut current, mut gone) = (start, sources[start].last.1);
        sources[current].fence = Some(count);
        loop {
            let (heir, _, before) = sources[current].last;
            let first = sources[start].after;
            let fits = |source: &Source| {
                // A full round ends at the first encoder, which must wait before it updates.
                let goes_round = |turn: usize| match (gone + source.last.1).cmp(&turn) {
                    Ordering::Less => true,
                    Ordering::Equal => source.last.2 <= first,
                    Ordering::Greater => false,
                };
                source.fence.is_none()
                    && source.encoder == heir
                    && before <= source.after
                    && turn.is_none_or(goes_round)
            };
            let Some(next) = sources.iter().position(fits) else { break };
            sources[next].fence = Some(count);
            gone += sources[next].last.1;
            current = next;
        }
        count += 1;
    }

    let of = |encoder, after| {
        let found = sources.iter().find(|source| (source.encoder, source.after) == (encoder, after));
        found.and_then(|source| source.fence).unwrap_or(0)
    };
    let uses = |(encoder, waits): (usize, &Vec<Wait>)| {
        let waits = waits.iter().map(|wait| (of(wait.source, wait.after), wait.before)).collect();
        let own = sources.iter().filter(|source| source.encoder == encoder);
        (waits, own.filter_map(|source| Some((source.fence?, source.after))).collect())
    };
    (waits.iter().enumerate().map(uses).collect(), count)
}
