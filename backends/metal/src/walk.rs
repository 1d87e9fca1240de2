//! Determines when to open, order and close a plan's encoders while a frame is recorded.
//!
//! The runtime announces passes one by one. A walk answers with [`Move`]s: close this encoder, open that one, wait for
//! its fences, record a barrier. Three things depend on the frame: prologue passes, which only the first frame runs;
//! copies of inspected resources in the middle of an encoder; and fences without an update so far, which are not waited
//! for.
//!
//! Every encoder with an announced pass is opened, even if the pass is skipped, because other encoders may be ordered
//! only through it.

use crate::sync::{Division, EncoderKind, Encoders, FenceUse, MemoryBarrier, encoders};
use splatgraph_framework::{ir::*, plan::*};

/// A plan's encoders in both divisions, and which of their fences have been updated.
#[derive(Debug)]
pub struct Walked {
    divisions: [Divided; 2],
    /// The division of the last submitted frame; `None` before the first.
    last: Option<Division>,
}

#[derive(Debug)]
struct Divided {
    encoders: Encoders,
    /// For each pass, the index of its encoder, counted through prologue and frame, and its index in the encoder.
    /// `None` if it is in no encoder.
    places: Vec<Option<(usize, usize)>>,
    /// For each fence, true if a submitted frame has updated it.
    updated: Vec<bool>,
}

impl Walked {
    /// Divides a plan into encoders, in both divisions.
    pub fn new(plan: &Plan) -> Walked {
        let divided = |division| {
            let encoders = encoders(plan, division);
            let mut places = vec![None; plan.passes.len()];
            for (index, encoding) in encoders.all().enumerate() {
                for (place, pass) in encoding.passes.iter().enumerate() {
                    places[pass.pass.index()] = Some((index, place));
                }
            }
            Divided { updated: vec![false; encoders.fences as usize], encoders, places }
        };
        Walked { divisions: [divided(Division::Merged), divided(Division::Passes)], last: None }
    }

    /// Returns the encoders of a division.
    pub fn encoders(&self, division: Division) -> &Encoders {
        &self.of(division).encoders
    }

    fn of(&self, division: Division) -> &Divided {
        &self.divisions[usize::from(division == Division::Passes)]
    }

    /// Records that the frame of this walk was submitted, and its fence updates with it.
    pub fn submitted(&mut self, walk: &Walk) {
        let Some(division) = walk.division else { return };
        self.divisions[usize::from(division == Division::Passes)].updated.clone_from(&walk.updated);
        self.last = Some(division);
    }
}

/// An action for the executor to take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Move {
    /// Wait for all earlier submissions, because fences do not order frames of another division.
    AfterAll,
    /// Order all earlier commands before all later ones, at the end of the prologue.
    HandOver,
    /// Update a fence after the last command of the open encoder.
    Update(FenceUse),
    /// Close the open encoder.
    Close,
    /// Open an encoder.
    Open(EncoderKind),
    /// Wait for a fence before the first command of the encoder just opened.
    Wait(FenceUse),
    /// Record a memory barrier in the open encoder.
    Barrier(MemoryBarrier),
}

/// A walk over a frame's passes, which tracks the open encoder and lists the moves before each pass.
#[derive(Clone, Debug, Default)]
pub struct Walk {
    division: Option<Division>,
    /// Index of the last announced pass's encoder, and true if the encoder is open.
    current: Option<(usize, bool)>,
    updated: Vec<bool>,
}

impl Walk {
    /// Starts the walk over another frame.
    pub fn begin(&mut self) {
        self.division = None;
        self.current = None;
    }

    /// Announces a pass, and appends the actions before its commands to `moves`.
    ///
    /// If `timed`, each pass has its own encoder. The flag must be the same for all passes of a frame.
    pub fn pass(&mut self, walked: &Walked, pass: PassId, timed: bool, moves: &mut Vec<Move>) {
        let division = if timed { Division::Passes } else { Division::Merged };
        let divided = walked.of(division);
        if self.division.is_none() {
            self.division = Some(division);
            self.updated.clone_from(&divided.updated);
            if walked.last.is_some_and(|last| last != division) {
                moves.push(Move::AfterAll);
            }
        }
        // The host pass has no encoder.
        let Some((index, place)) = divided.places[pass.index()] else { return };
        let encoding = divided.encoders.encoder(index);
        match self.current {
            Some((current, true)) if current == index => {
                moves.extend(encoding.passes[place].barrier.map(Move::Barrier));
            }
            // The encoder waited before it was interrupted, and everything before the interruption has completed.
            Some((current, false)) if current == index => moves.push(Move::Open(encoding.kind)),
            _ => {
                self.close(walked, moves);
                let prologue = divided.encoders.prologue.len();
                if divided.encoders.handover
                    && self.current.is_some_and(|(c, _)| c < prologue)
                    && index >= prologue
                {
                    moves.push(Move::HandOver);
                }
                moves.push(Move::Open(encoding.kind));
                let updated = encoding.waits.iter().filter(|wait| self.updated[wait.fence as usize]);
                moves.extend(updated.copied().map(Move::Wait));
            }
        }
        self.current = Some((index, true));
    }

    /// Closes the open encoder, at the end of the frame or for work outside the plan.
    ///
    /// The caller must order such work after everything before it, and before everything after it.
    pub fn interrupt(&mut self, walked: &Walked, moves: &mut Vec<Move>) {
        self.close(walked, moves);
        if let Some((_, open)) = &mut self.current {
            *open = false;
        }
    }

    /// Closes the open encoder after updating its fences. If it is opened again, they are updated again.
    fn close(&mut self, walked: &Walked, moves: &mut Vec<Move>) {
        let (Some(division), Some((index, true))) = (self.division, self.current) else { return };
        for update in &walked.of(division).encoders.encoder(index).updates {
            self.updated[update.fence as usize] = true;
            moves.push(Move::Update(*update));
        }
        moves.push(Move::Close);
    }

    /// Returns the frame's division; `None` before the first pass is announced.
    pub fn division(&self) -> Option<Division> {
        self.division
    }

    /// Returns true if one of the plan's encoders is open.
    pub fn is_open(&self) -> bool {
        self.current.is_some_and(|(_, open)| open)
    }

    /// Returns the fences that a pass's encoder updates. Empty before the first pass is announced, and for a pass
    /// without an encoder.
    ///
    /// An encoder that reads the pass's results later, such as the draw into a window, must wait for these fences and
    /// update them again.
    pub fn updates<'a>(&self, walked: &'a Walked, pass: PassId) -> &'a [FenceUse] {
        let Some(divided) = self.division.map(|division| walked.of(division)) else { return &[] };
        divided.places[pass.index()].map_or(&[], |(index, _)| &divided.encoders.encoder(index).updates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sync::{EncodedPass, Encoding, RenderStages};
    use Move::*;

    const CLEAR: PassId = PassId(0);
    const FIRST: PassId = PassId(1);
    const SECOND: PassId = PassId(2);
    const DRAW: PassId = PassId(3);
    const EXPORT: PassId = PassId(4);
    const HOST: PassId = PassId(5);

    const BUFFERS: MemoryBarrier = MemoryBarrier { buffers: true, textures: false };

    fn fence(fence: u32) -> FenceUse {
        FenceUse { fence, stages: None }
    }

    fn drawn(fence: u32, stages: RenderStages) -> FenceUse {
        FenceUse { fence, stages: Some(stages) }
    }

    fn encoding(
        kind: EncoderKind,
        waits: &[FenceUse],
        passes: &[(PassId, bool)],
        updates: &[FenceUse],
    ) -> Encoding {
        let pass =
            |&(pass, barrier): &(PassId, bool)| EncodedPass { barrier: barrier.then_some(BUFFERS), pass };
        let passes = passes.iter().map(pass).collect();
        Encoding { kind, waits: waits.to_vec(), passes, updates: updates.to_vec() }
    }

    /// Returns four encoders with their fences. They are a prologue that clears (fence 0), two dispatches with a
    /// barrier between them (1), a draw (2) and the export (3).
    fn walked() -> Walked {
        let all = Encoders {
            prologue: vec![encoding(EncoderKind::Compute, &[], &[(CLEAR, false)], &[fence(0)])],
            frame: vec![
                encoding(
                    EncoderKind::Compute,
                    &[fence(0), fence(3)],
                    &[(FIRST, false), (SECOND, true)],
                    &[fence(1)],
                ),
                encoding(
                    EncoderKind::Render,
                    &[drawn(1, RenderStages::Vertex)],
                    &[(DRAW, false)],
                    &[drawn(2, RenderStages::Fragment)],
                ),
                encoding(EncoderKind::Blit, &[fence(2)], &[(EXPORT, false)], &[fence(3)]),
            ],
            handover: true,
            fences: 4,
        };
        let places = vec![Some((0, 0)), Some((1, 0)), Some((1, 1)), Some((2, 0)), Some((3, 0)), None];
        let divided = || Divided { encoders: all.clone(), places: places.clone(), updated: vec![false; 4] };
        Walked { divisions: [divided(), divided()], last: None }
    }

    fn moves(of: impl FnOnce(&mut Vec<Move>)) -> Vec<Move> {
        let mut moves = Vec::new();
        of(&mut moves);
        moves
    }

    fn frame(walked: &mut Walked, passes: &[PassId], timed: bool) -> Vec<Move> {
        let mut walk = Walk::default();
        walk.begin();
        let moves = moves(|moves| {
            passes.iter().for_each(|pass| walk.pass(walked, *pass, timed, moves));
            walk.interrupt(walked, moves);
        });
        walked.submitted(&walk);
        moves
    }

    const FRAME: [PassId; 5] = [FIRST, SECOND, DRAW, EXPORT, HOST];

    #[test]
    fn a_frame_opens_each_encoder_once_and_orders_it_by_its_fences() {
        let mut walked = walked();
        let first = frame(&mut walked, &[&[CLEAR], &FRAME[..]].concat(), false);
        let expected = [
            Open(EncoderKind::Compute),
            Update(fence(0)),
            Close,
            HandOver,
            Open(EncoderKind::Compute),
            // Fence 3, of the previous frame, was never updated.
            Wait(fence(0)),
            Barrier(BUFFERS),
            Update(fence(1)),
            Close,
            Open(EncoderKind::Render),
            Wait(drawn(1, RenderStages::Vertex)),
            Update(drawn(2, RenderStages::Fragment)),
            Close,
            Open(EncoderKind::Blit),
            Wait(fence(2)),
            Update(fence(3)),
            Close,
        ];
        assert_eq!(first, expected);
        let second = frame(&mut walked, &FRAME, false);
        assert_eq!(second[..3], [Open(EncoderKind::Compute), Wait(fence(0)), Wait(fence(3))]);
        assert_eq!(second[3..], expected[6..]);
    }

    #[test]
    fn a_fence_is_waited_for_only_once_a_frame_that_updates_it_was_submitted() {
        let walked = walked();
        let mut walk = Walk::default();
        walk.begin();
        // This frame is recorded but never submitted.
        moves(|moves| FRAME.iter().for_each(|pass| walk.pass(&walked, *pass, false, moves)));
        walk.begin();
        let found = moves(|moves| walk.pass(&walked, FIRST, false, moves));
        assert_eq!(found, [Open(EncoderKind::Compute)]);
    }

    #[test]
    fn an_encoder_that_was_interrupted_is_opened_again_without_waits_and_updates_its_fences_twice() {
        let walked = walked();
        let mut walk = Walk::default();
        walk.begin();
        let found = moves(|moves| {
            walk.pass(&walked, CLEAR, false, moves);
            walk.pass(&walked, FIRST, false, moves);
        });
        assert_eq!(found[3..], [HandOver, Open(EncoderKind::Compute), Wait(fence(0))]);
        assert_eq!(moves(|moves| walk.interrupt(&walked, moves)), [Update(fence(1)), Close]);
        assert!(moves(|moves| walk.interrupt(&walked, moves)).is_empty(), "it is closed");
        let found = moves(|moves| walk.pass(&walked, SECOND, false, moves));
        assert_eq!(found, [Open(EncoderKind::Compute)]);
        let found = moves(|moves| walk.pass(&walked, DRAW, false, moves));
        assert_eq!(found[..2], [Update(fence(1)), Close]);
    }

    #[test]
    fn an_encoder_that_was_interrupted_at_its_end_is_not_opened_again() {
        let walked = walked();
        let mut walk = Walk::default();
        walk.begin();
        moves(|moves| {
            walk.pass(&walked, FIRST, false, moves);
            walk.pass(&walked, SECOND, false, moves);
            walk.interrupt(&walked, moves);
        });
        let found = moves(|moves| walk.pass(&walked, DRAW, false, moves));
        assert_eq!(found, [Open(EncoderKind::Render), Wait(drawn(1, RenderStages::Vertex))]);
    }

    #[test]
    fn the_hosts_step_leaves_the_encoder_open_and_the_end_closes_it() {
        let walked = walked();
        let mut walk = Walk::default();
        walk.begin();
        moves(|moves| walk.pass(&walked, EXPORT, false, moves));
        assert!(moves(|moves| walk.pass(&walked, HOST, false, moves)).is_empty());
        assert_eq!(moves(|moves| walk.interrupt(&walked, moves)), [Update(fence(3)), Close]);
    }

    #[test]
    fn a_frame_divided_otherwise_than_the_one_before_waits_for_all_of_it() {
        let mut walked = walked();
        assert!(!frame(&mut walked, &FRAME, true).contains(&AfterAll));
        assert!(!frame(&mut walked, &FRAME, true).contains(&AfterAll));
        assert_eq!(frame(&mut walked, &FRAME, false)[0], AfterAll);
        assert!(!frame(&mut walked, &FRAME, false).contains(&AfterAll));
        assert_eq!(frame(&mut walked, &FRAME, true)[0], AfterAll);
    }

    #[test]
    fn who_takes_a_place_behind_a_pass_is_told_its_encoders_fences() {
        let walked = walked();
        let mut walk = Walk::default();
        walk.begin();
        assert!(walk.updates(&walked, EXPORT).is_empty(), "no pass was announced");
        moves(|moves| walk.pass(&walked, FIRST, false, moves));
        assert_eq!(walk.updates(&walked, EXPORT), [fence(3)]);
        assert_eq!(walk.updates(&walked, SECOND), [fence(1)]);
        assert!(walk.updates(&walked, HOST).is_empty());
    }

    #[test]
    fn a_plan_is_divided_with_every_pass_but_the_hosts_in_an_encoder() {
        let plan = crate::handmade::plan();
        let walked = Walked::new(&plan);
        for divided in &walked.divisions {
            let places: Vec<bool> = divided.places.iter().map(Option::is_some).collect();
            assert_eq!(places, [true, true, true, true, true, false]);
        }
    }
}
