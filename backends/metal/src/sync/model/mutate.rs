//! Removes or weakens synchronization, one piece at a time, to test that every piece is needed.

use super::Model;
use crate::sync::*;
use splatgraph_framework::plan::Plan;

/// Position of an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// Index in [`Encoders::prologue`].
    Prologue(usize),
    /// Index in [`Encoders::frame`].
    Frame(usize),
}

/// The removal or weakening of one piece of synchronization.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mutation {
    /// Removes the event between the prologue and the first frame.
    Handover,
    /// Removes a wait, by its index.
    Wait(At, usize),
    /// Weakens a wait before vertices to a wait before fragments.
    LaterWait(At, usize),
    /// Removes an update, by its index.
    Update(At, usize),
    /// Moves an update after fragments to after vertices.
    EarlierUpdate(At, usize),
    /// Removes the barrier before a pass, by the pass's index.
    Barrier(At, usize),
    /// Removes buffers from the scope of a barrier on both kinds of resources.
    Buffers(At, usize),
    /// Removes textures from the scope of a barrier on both kinds of resources.
    Textures(At, usize),
}

/// Lists every possible mutation of the encoders.
pub fn mutations(encoders: &Encoders) -> Vec<Mutation> {
    let mut all: Vec<Mutation> = encoders.handover.then_some(Mutation::Handover).into_iter().collect();
    let prologue = encoders.prologue.iter().enumerate().map(|(index, e)| (At::Prologue(index), e));
    let frame = encoders.frame.iter().enumerate().map(|(index, e)| (At::Frame(index), e));
    for (at, encoding) in prologue.chain(frame) {
        for (index, wait) in encoding.waits.iter().enumerate() {
            all.push(Mutation::Wait(at, index));
            all.extend((wait.stages == Some(RenderStages::Vertex)).then_some(Mutation::LaterWait(at, index)));
        }
        for (index, update) in encoding.updates.iter().enumerate() {
            all.push(Mutation::Update(at, index));
            let late = update.stages == Some(RenderStages::Fragment);
            all.extend(late.then_some(Mutation::EarlierUpdate(at, index)));
        }
        for (index, pass) in encoding.passes.iter().enumerate() {
            let Some(barrier) = pass.barrier else { continue };
            all.push(Mutation::Barrier(at, index));
            if barrier.buffers && barrier.textures {
                all.extend([Mutation::Buffers(at, index), Mutation::Textures(at, index)]);
            }
        }
    }
    all
}

/// Returns the encoders with the mutation applied.
///
/// # Panics
/// Panics if the mutation is not one of the [`mutations`] of these encoders.
pub fn apply(encoders: &Encoders, mutation: Mutation) -> Encoders {
    let mut mutant = encoders.clone();
    let barrier = |encoding: &mut Encoding, index: usize, change: fn(&mut MemoryBarrier)| {
        let barrier = &mut encoding.passes[index].barrier;
        if let Some(barrier) = barrier {
            change(barrier);
        }
    };
    match mutation {
        Mutation::Handover => mutant.handover = false,
        Mutation::Wait(at, index) => drop(encoding(&mut mutant, at).waits.remove(index)),
        Mutation::LaterWait(at, index) => {
            encoding(&mut mutant, at).waits[index].stages = Some(RenderStages::Fragment)
        }
        Mutation::Update(at, index) => drop(encoding(&mut mutant, at).updates.remove(index)),
        Mutation::EarlierUpdate(at, index) => {
            encoding(&mut mutant, at).updates[index].stages = Some(RenderStages::Vertex)
        }
        Mutation::Barrier(at, index) => encoding(&mut mutant, at).passes[index].barrier = None,
        Mutation::Buffers(at, index) => barrier(encoding(&mut mutant, at), index, |b| b.buffers = false),
        Mutation::Textures(at, index) => barrier(encoding(&mut mutant, at), index, |b| b.textures = false),
    }
    mutant
}

fn encoding(encoders: &mut Encoders, at: At) -> &mut Encoding {
    match at {
        At::Prologue(index) => &mut encoders.prologue[index],
        At::Frame(index) => &mut encoders.frame[index],
    }
}

/// Lists the mutations in which the model finds no mistake. It must find none in the unmutated encoders.
pub fn needless(model: &Model, encoders: &Encoders) -> Vec<Mutation> {
    let unnoticed = |mutation: &Mutation| !model.finds_unordered(&apply(encoders, *mutation));
    mutations(encoders).into_iter().filter(unnoticed).collect()
}

impl Mutation {
    /// Describes the mutation, for instance "the wait for fence 1 of the encoder of `compose` in the frame".
    pub fn describe(self, plan: &Plan, encoders: &Encoders) -> String {
        let of = |at: At, what: &dyn Fn(&Encoding) -> String| {
            let (encoding, part) = match at {
                At::Prologue(index) => (&encoders.prologue[index], "prologue"),
                At::Frame(index) => (&encoders.frame[index], "frame"),
            };
            let first = encoding.passes.first().map_or("nothing", |pass| &plan.pass(pass.pass).name);
            format!("{} of the encoder of `{first}` in the {part}", what(encoding))
        };
        let before = |e: &Encoding, index: usize| plan.pass(e.passes[index].pass).name.clone();
        match self {
            Mutation::Handover => "the handover".into(),
            Mutation::Wait(at, index) => of(at, &|e| format!("the wait for fence {}", e.waits[index].fence)),
            Mutation::LaterWait(at, index) => {
                of(at, &|e| format!("the vertices' wait for fence {}", e.waits[index].fence))
            }
            Mutation::Update(at, index) => {
                of(at, &|e| format!("the update of fence {}", e.updates[index].fence))
            }
            Mutation::EarlierUpdate(at, index) => {
                of(at, &|e| format!("the fragments before the update of fence {}", e.updates[index].fence))
            }
            Mutation::Barrier(at, index) => of(at, &|e| format!("the barrier before `{}`", before(e, index))),
            Mutation::Buffers(at, index) => {
                of(at, &|e| format!("the buffers of the barrier before `{}`", before(e, index)))
            }
            Mutation::Textures(at, index) => {
                of(at, &|e| format!("the textures of the barrier before `{}`", before(e, index)))
            }
        }
    }
}
