//! Removes or weakens synchronization, one piece at a time, to test that every piece is needed.

use super::Model;
use crate::sync::*;
use splatgraph_framework::plan::Plan;

/// The removal or weakening of one piece of synchronization.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mutation {
    /// Removes the event between the prologue and the first frame.
    Handover,
    /// Changes a piece of the encoder with this [index](Encoders::encoder).
    Encoder(usize, Piece),
}

/// A piece of an encoder, by its index among the encoder's waits, updates or passes, and its change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piece {
    /// Removes a wait.
    Wait(usize),
    /// Weakens a wait before vertices to a wait before fragments.
    LaterWait(usize),
    /// Removes an update.
    Update(usize),
    /// Moves an update after fragments to after vertices.
    EarlierUpdate(usize),
    /// Removes the barrier before a pass.
    Barrier(usize),
    /// Removes buffers from the scope of a barrier on both kinds of resources.
    Buffers(usize),
    /// Removes textures from the scope of a barrier on both kinds of resources.
    Textures(usize),
}

/// Lists every possible mutation of the encoders.
pub fn mutations(encoders: &Encoders) -> Vec<Mutation> {
    let mut all: Vec<Mutation> = encoders.handover.then_some(Mutation::Handover).into_iter().collect();
    for (encoder, encoding) in encoders.all().enumerate() {
        let mut add = |piece: Piece| all.push(Mutation::Encoder(encoder, piece));
        for (index, wait) in encoding.waits.iter().enumerate() {
            add(Piece::Wait(index));
            if wait.stages == Some(RenderStages::Vertex) {
                add(Piece::LaterWait(index));
            }
        }
        for (index, update) in encoding.updates.iter().enumerate() {
            add(Piece::Update(index));
            if update.stages == Some(RenderStages::Fragment) {
                add(Piece::EarlierUpdate(index));
            }
        }
        for (index, pass) in encoding.passes.iter().enumerate() {
            let Some(barrier) = pass.barrier else { continue };
            add(Piece::Barrier(index));
            if barrier.buffers && barrier.textures {
                add(Piece::Buffers(index));
                add(Piece::Textures(index));
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
    let Mutation::Encoder(encoder, piece) = mutation else { return Encoders { handover: false, ..mutant } };
    let prologue = mutant.prologue.len();
    let Encoding { waits, updates, passes, .. } = match encoder.checked_sub(prologue) {
        Some(index) => &mut mutant.frame[index],
        None => &mut mutant.prologue[encoder],
    };
    match piece {
        Piece::Wait(index) => drop(waits.remove(index)),
        Piece::LaterWait(index) => waits[index].stages = Some(RenderStages::Fragment),
        Piece::Update(index) => drop(updates.remove(index)),
        Piece::EarlierUpdate(index) => updates[index].stages = Some(RenderStages::Vertex),
        Piece::Barrier(index) => passes[index].barrier = None,
        Piece::Buffers(index) => {
            passes[index].barrier = Some(MemoryBarrier { buffers: false, textures: true });
        }
        Piece::Textures(index) => {
            passes[index].barrier = Some(MemoryBarrier { buffers: true, textures: false });
        }
    }
    mutant
}

/// Lists the mutations after which the model finds no unordered accesses. The unmutated encoders must have none.
pub fn needless(model: &Model, encoders: &Encoders) -> Vec<Mutation> {
    let unnoticed = |mutation: &Mutation| !model.finds_unordered(&apply(encoders, *mutation));
    mutations(encoders).into_iter().filter(unnoticed).collect()
}

impl Mutation {
    /// Describes the mutation, for instance "the wait for fence 1 of the encoder of `compose` in the frame".
    pub fn describe(self, plan: &Plan, encoders: &Encoders) -> String {
        let Mutation::Encoder(encoder, piece) = self else { return "the handover".into() };
        let part = if encoder < encoders.prologue.len() { "prologue" } else { "frame" };
        let Encoding { waits, updates, passes, .. } = encoders.encoder(encoder);
        let name = |index: usize| passes.get(index).map_or("nothing", |pass| &plan.pass(pass.pass).name);
        let what = match piece {
            Piece::Wait(index) => format!("the wait for fence {}", waits[index].fence),
            Piece::LaterWait(index) => format!("the vertices' wait for fence {}", waits[index].fence),
            Piece::Update(index) => format!("the update of fence {}", updates[index].fence),
            Piece::EarlierUpdate(index) => {
                format!("the fragments before the update of fence {}", updates[index].fence)
            }
            Piece::Barrier(index) => format!("the barrier before `{}`", name(index)),
            Piece::Buffers(index) => format!("the buffers of the barrier before `{}`", name(index)),
            Piece::Textures(index) => format!("the textures of the barrier before `{}`", name(index)),
        };
        format!("{what} of the encoder of `{}` in the {part}", name(0))
    }
}
