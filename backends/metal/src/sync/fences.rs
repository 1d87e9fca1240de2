//! Assigns fences to the waits between encoders. Successive waits share a fence.
//!
//! A wait refers to the last update of its fence that was submitted before it. The fence is in use from that update to
//! the wait: the *span* of the wait. Two spans can share a fence if they do not overlap, and if the encoders' waits
//! order each update after the other span's wait. Then no update of a fence can overtake a wait for the previous one.
//!
//! In a chain of encoders, each of which waits for the previous one, one fence serves all waits, even that of the first
//! encoder for the last one of the previous frame. If two branches follow an encoder, such as the draw of a mesh and
//! the sort of the next frame, neither branch may update the fence that the other waits for. The encoder then updates
//! one fence for each branch.

use super::encoding::RenderStages;
use std::cmp::Reverse;
use std::collections::HashSet;

/// A wait of an encoder for an earlier encoder, `source`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wait {
    pub source: usize,
    /// True if the source ran in the previous frame.
    pub previous: bool,
    pub after: RenderStages,
    pub before: RenderStages,
}

/// The fences that an encoder waits for, then those that it updates, each with the stage.
pub(super) type Uses = (Vec<(u32, RenderStages)>, Vec<(u32, RenderStages)>);

/// A stage of an encoder. Encoders of the next frame have indices that continue those of this frame.
pub(super) type Moment = (usize, RenderStages);

/// Returns true if the end of stage `first` is the end of stage `last`, or is ordered before it.
///
/// `waits` adds the ends that a stage waits for: a stage ends after it began, and after the stages before it.
pub(super) fn ends_before(first: Moment, last: Moment, waits: impl Fn(Moment, &mut Vec<Moment>)) -> bool {
    let (mut open, mut seen) = (vec![last], HashSet::new());
    while let Some(moment) = open.pop() {
        if moment.0 == first.0 && first.1 <= moment.1 {
            return true;
        }
        if moment.0 > first.0 && seen.insert(moment) {
            waits(moment, &mut open);
        }
    }
    false
}

struct Span {
    update: Moment,
    wait: Moment,
    /// Index of the waiting encoder, and of the wait in it.
    place: (usize, usize),
    fence: u32,
}

/// Assigns a fence to each wait; returns the fence uses of each encoder, and the number of fences.
///
/// `turn` is the number of encoders per frame; `None` if they do not repeat.
pub(super) fn number(waits: &[Vec<Wait>], turn: Option<usize>) -> (Vec<Uses>, u32) {
    let order = Order { waits, turn };
    let mut spans = order.spans();
    let mut count = 0;
    for index in 0..spans.len() {
        let (numbered, rest) = spans.split_at_mut(index);
        let span = &mut rest[0];
        let free = |fence: &u32| {
            let mut on_it = numbered.iter().filter(|other| other.fence == *fence);
            on_it.all(|other| order.share(other, span))
        };
        // Prefers fences of the same update: another fence would need an additional update.
        let same_update = numbered.iter().filter(|other| other.update == span.update);
        let fences = same_update.map(|other| other.fence).chain(0..count);
        span.fence = fences.into_iter().find(free).unwrap_or(count);
        count = count.max(span.fence + 1);
    }

    let unnumbered = |waits: &Vec<Wait>| waits.iter().map(|wait| (0, wait.before)).collect();
    let mut uses: Vec<Uses> = waits.iter().map(|waits| (unnumbered(waits), Vec::new())).collect();
    for span in &spans {
        let ((updater, after), (encoder, index)) = (span.update, span.place);
        let updates = &mut uses[updater].1;
        // Waits that share a fence and an update need the update once.
        if !updates.contains(&(span.fence, after)) {
            updates.push((span.fence, after));
        }
        uses[encoder].0[index].0 = span.fence;
    }
    uses.iter_mut().for_each(|(_, updates)| updates.sort_by_key(|(fence, after)| (*after, *fence)));
    (uses, count)
}

/// The order that the waits of encoders establish. They repeat every `turn` encoders, if it is given.
struct Order<'a> {
    waits: &'a [Vec<Wait>],
    turn: Option<usize>,
}

impl Order<'_> {
    /// Lists the spans of all waits, sorted by their updates. Of equal updates, the longest span comes first: it
    /// conflicts with the most others.
    fn spans(&self) -> Vec<Span> {
        let mut spans = Vec::new();
        for (encoder, waits) in self.waits.iter().enumerate() {
            for (index, wait) in waits.iter().enumerate() {
                let at = if wait.previous { encoder + self.turn.unwrap_or(0) } else { encoder };
                let (update, wait) = ((wait.source, wait.after), (at, wait.before));
                spans.push(Span { update, wait, place: (encoder, index), fence: 0 });
            }
        }
        spans.sort_by_key(|span| (span.update, Reverse(span.wait)));
        spans
    }

    /// Returns true if two spans can share a fence. The update of `first` is not later than that of `second`.
    fn share(&self, first: &Span, second: &Span) -> bool {
        let next = self.turn.map(|turn| (first.update.0 + turn, first.update.1));
        first.update == second.update
            || first.update.0 != second.update.0
                && self.before(first.wait, second.update)
                && next.is_none_or(|next| self.before(second.wait, next))
    }

    fn before(&self, first: Moment, last: Moment) -> bool {
        let turn = self.turn.unwrap_or(usize::MAX);
        ends_before(first, last, |(encoder, stage), open| {
            let waits = self.waits[encoder % turn].iter().filter(|wait| wait.before <= stage);
            open.extend(waits.filter_map(|wait| {
                let start = (encoder - encoder % turn).checked_sub(if wait.previous { turn } else { 0 })?;
                Some((start + wait.source, wait.after))
            }));
        })
    }
}
