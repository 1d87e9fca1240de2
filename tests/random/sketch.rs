//! Converts a recipe to a valid graph: wishes are resolved to resources, and impossible ones are dropped.
//!
//! A pass may read a buffer only after a write, which depends on conditions, repeats and swaps. So the sketch is walked
//! under every setting of the constants, and everything that is invalid under any of them is dropped. The walk is a
//! small independent model of the language. Where it and the builder disagree, a graph is refused, and refusals are
//! counted.

use splatgraph_framework::ir::DepthAccess;
use std::collections::{BTreeMap, BTreeSet};

use super::recipe::{
    BufferWish, Content, Count, Half, ImageWish, Item, Kind, LARGEST, Limits, PassWish, Pick, Recipe, Role,
    Settings, Stage, Stands, When,
};

#[derive(Clone, Debug)]
pub struct Sketch {
    pub buffers: Vec<BufferWish>,
    /// The images; the last one is the output.
    pub images: Vec<ImageWish>,
    /// The passes in the order of declaration; the last one writes the output.
    pub passes: Vec<Pass>,
    pub nodes: Vec<Node>,
    /// A buffer and the byte offset of the word that is read back.
    pub stats: Vec<(Ref, u32)>,
    pub settings: [Settings; 2],
}

#[derive(Clone, Debug)]
pub enum Node {
    Pass(usize),
    /// The index of a ping-pong buffer.
    Swap(usize),
    Repeat(Count, Vec<Node>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    Buffer(usize),
    Image(usize),
}

/// A resource as a graph names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ref {
    pub of: Target,
    pub half: Half,
}

#[derive(Clone, Debug)]
pub struct Pass {
    pub work: Kind,
    pub binds: Vec<Bind>,
    pub indirect: Option<(Ref, u32)>,
    pub when: When,
    pub stands: Stands,
    pub salt: u32,
    pub push: bool,
}

#[derive(Clone, Copy, Debug)]
pub struct Bind {
    pub what: Ref,
    pub reads: bool,
    pub writes: bool,
    pub stage: Stage,
}

impl Pass {
    pub fn once(&self) -> bool {
        matches!(self.work, Kind::Dispatch { once: true, .. })
    }

    /// Returns everything that the pass accesses, with true for writes.
    pub fn uses(&self) -> impl Iterator<Item = (Ref, bool)> + '_ {
        let (targets, depth) = match &self.work {
            Kind::Draw { targets, depth, .. } => (targets.as_slice(), *depth),
            _ => (&[][..], None),
        };
        let targets = targets.iter().map(|(image, _)| (front(Target::Image(*image)), true));
        let depth = depth.map(|(image, access)| (front(Target::Image(image)), access != DepthAccess::Test));
        let indirect = self.indirect.iter().map(|(what, _)| (*what, false));
        self.binds.iter().map(|bind| (bind.what, bind.writes)).chain(targets).chain(depth).chain(indirect)
    }
}

fn front(of: Target) -> Ref {
    Ref { of, half: Half::Front }
}

/// A half (0 or 1) of a ping-pong buffer, or half 0 of any other resource.
type Real = (Target, usize);

/// A read of contents that no pass wrote, by the index of its binding or target.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    /// Through a binding.
    Read(usize),
    /// Through a target whose contents are kept.
    Keep(usize),
    /// Through a depth attachment that is tested and not cleared.
    Depth,
    Indirect,
}

/// The passes that run under one pair of settings, in the order of the file.
struct Runs {
    /// Indices of the passes, each with the half of every buffer that is the front when the pass runs.
    passes: Vec<(usize, Vec<usize>)>,
    /// The half of every buffer that is the front when the frame ends.
    fronts: Vec<usize>,
}

impl Sketch {
    pub fn of(recipe: &Recipe, limits: Limits) -> Sketch {
        let mut sketch = Sketch {
            buffers: recipe.buffers.clone(),
            images: recipe.images.clone(),
            passes: Vec::new(),
            nodes: Vec::new(),
            stats: Vec::new(),
            settings: recipe.settings,
        };
        if limits.runs {
            // Arguments that start as zeros would make passes write nothing.
            sketch.buffers.iter_mut().filter(|b| b.role == Role::Args).for_each(|b| b.history = false);
        }
        let colors = sketch.images.iter().filter(|image| image.content == Content::Color);
        let mut sizes = colors.map(|image| image.size).collect::<Vec<_>>().into_iter().cycle();
        let depths = sketch.images.iter_mut().filter(|image| image.content == Content::Depth);
        depths.zip(&mut sizes).for_each(|(image, size)| image.size = size);
        sketch.nodes = recipe.items.iter().filter_map(|item| sketch.node(item, limits)).collect();
        while sketch.longest() + 1 > limits.passes {
            sketch.nodes.pop();
        }
        sketch.stats = recipe.stats.iter().filter_map(|(pick, word)| sketch.stat(*pick, *word)).collect();
        sketch.show(recipe);
        while Settings::all().any(|settings| sketch.mend(settings)) {}
        sketch.move_passes();
        sketch
    }

    pub fn output(&self) -> usize {
        self.images.len() - 1
    }

    pub fn stride(&self, buffer: usize) -> u32 {
        if self.buffers[buffer].wide { 16 } else { 4 }
    }

    pub fn size(&self, image: usize) -> (u32, u32) {
        self.images[image].size
    }

    /// Returns the maximum number of passes of the prologue and the frame under any settings.
    pub fn longest(&self) -> usize {
        Settings::all().map(|settings| self.runs(settings).passes.len()).max().unwrap_or(0)
    }

    fn node(&mut self, item: &Item, limits: Limits) -> Option<Node> {
        match item {
            Item::Pass(wish) => {
                let pass = self.pass(wish, limits)?;
                self.passes.push(pass);
                Some(Node::Pass(self.passes.len() - 1))
            }
            Item::Swap(index) => {
                let pick = Pick { index: *index, want: Some(Half::Front) };
                match self.resolve(pick) {
                    Ref { of: Target::Buffer(at), .. } if self.buffers[at].role == Role::PingPong => {
                        Some(Node::Swap(at))
                    }
                    _ => None,
                }
            }
            Item::Repeat(count, body) => {
                let body: Vec<Node> = body.iter().filter_map(|item| self.node(item, limits)).collect();
                Some(Node::Repeat(*count, body))
            }
        }
    }

    /// Returns the resource of a wish; any resource if none suits.
    fn resolve(&self, pick: Pick) -> Ref {
        let buffers = (0..self.buffers.len()).map(Target::Buffer);
        // Shaders cannot access depth attachments.
        let images = (0..self.images.len()).filter(|at| self.images[*at].content != Content::Depth);
        let all: Vec<Target> = buffers.chain(images.map(Target::Image)).collect();
        let found = pick.want.and_then(|half| {
            let fits = |of: &&Target| match (half, **of) {
                (Half::Last, of) => self.history(of),
                (_, Target::Buffer(at)) => self.buffers[at].role == Role::PingPong,
                (_, Target::Image(_)) => false,
            };
            let fitting: Vec<&Target> = all.iter().filter(fits).collect();
            let of = fitting.get(pick.index as usize % fitting.len().max(1))?;
            Some(Ref { of: **of, half })
        });
        found.unwrap_or_else(|| front(all[pick.index as usize % all.len()]))
    }

    fn stat(&self, pick: Pick, word: u8) -> Option<(Ref, u32)> {
        let what = Ref { half: Half::Front, ..self.resolve(pick) };
        match what.of {
            Target::Buffer(at) => Some((what, u32::from(word) % self.buffers[at].words * 4)),
            Target::Image(_) => None,
        }
    }

    /// Converts a wish to a pass, without regard to other passes. `None` if the pass would write nothing or is a draw
    /// without a target.
    fn pass(&self, wish: &PassWish, limits: Limits) -> Option<Pass> {
        let mut work = wish.kind.clone();
        if let Kind::Draw { targets, depth, .. } = &mut work {
            *targets = self.targets(targets)?;
            *depth = depth.and_then(|wish| self.depth(wish, self.size(targets[0].0)));
        }
        let draws = matches!(work, Kind::Draw { .. });
        let drawn: Vec<Target> = match &work {
            Kind::Draw { targets, .. } => targets.iter().map(|(image, _)| Target::Image(*image)).collect(),
            _ => Vec::new(),
        };
        let mut binds: Vec<Bind> = Vec::new();
        for (pick, reads, stage) in &wish.writes {
            let what = self.resolve(*pick);
            let what = if what.half == Half::Last { front(what.of) } else { what };
            let taken = drawn.contains(&what.of) || binds.iter().any(|bind| bind.what == what);
            let fits = match (&work, what.of) {
                // Draws write by atomics, to single words.
                (Kind::Draw { .. }, Target::Buffer(at)) => {
                    !self.buffers[at].wide && self.buffers[at].role != Role::Args
                }
                (Kind::Draw { .. }, Target::Image(at)) => self.images[at].content == Content::Word,
                (Kind::Fill { .. }, Target::Buffer(at)) => {
                    !limits.runs || self.buffers[at].role != Role::Args
                }
                (Kind::Fill { .. }, Target::Image(_)) => false,
                (Kind::Dispatch { .. }, _) => true,
            };
            if fits && !taken {
                binds.push(Bind { what, reads: *reads || draws, writes: true, stage: *stage });
            }
        }
        if binds.is_empty() && !draws {
            return None;
        }
        let fills = matches!(work, Kind::Fill { .. });
        if fills {
            binds.iter_mut().for_each(|bind| bind.reads = false);
        }
        let is_written = |binds: &[Bind], what: Ref| {
            let same = |bind: &&Bind| bind.what == what || what.half == Half::Last && bind.what.of == what.of;
            binds.iter().filter(|bind| bind.writes).any(|bind| same(&bind))
        };
        let reads = wish.reads.iter().map(|read| (read, true));
        let sizes = wish.sizes.iter().map(|size| (size, false));
        for ((pick, stage), reads) in reads.chain(sizes).filter(|_| !fills) {
            let what = self.resolve(*pick);
            let taken = drawn.contains(&what.of)
                || is_written(&binds, what)
                || binds.iter().any(|bind| bind.what == what);
            if !taken {
                binds.push(Bind { what, reads, writes: false, stage: *stage });
            }
        }
        let args: Vec<usize> =
            (0..self.buffers.len()).filter(|at| self.buffers[*at].role == Role::Args).collect();
        let indirect = wish.indirect.filter(|_| !fills && !args.is_empty()).and_then(|(pick, range)| {
            let at = args[pick.index as usize % args.len()];
            let last = pick.want == Some(Half::Last) && self.buffers[at].history;
            let what = Ref { of: Target::Buffer(at), half: if last { Half::Last } else { Half::Front } };
            let offset = u32::from(range) % (self.buffers[at].words / 4) * 16;
            Some((what, offset)).filter(|_| !is_written(&binds, what) && !is_written(&binds, front(what.of)))
        });
        let PassWish { when, stands, salt, .. } = *wish;
        Some(Pass { work, binds, indirect, when, stands, salt, push: wish.push && !fills })
    }

    /// Returns images of one size that can be drawn to; `None` if there are none.
    fn targets(&self, wishes: &[(usize, bool)]) -> Option<Vec<(usize, bool)>> {
        let mut targets: Vec<(usize, bool)> = Vec::new();
        for (index, keep) in wishes {
            let free = |at: &usize| {
                let fits = |(other, _): &(usize, bool)| other != at && self.size(*other) == self.size(*at);
                self.images[*at].content == Content::Color && targets.iter().all(fits)
            };
            let free: Vec<usize> = (0..self.images.len()).filter(free).collect();
            if !free.is_empty() {
                targets.push((free[*index % free.len()], *keep));
            }
        }
        (!targets.is_empty()).then_some(targets)
    }

    /// Returns a depth image of this size, with the access that is wished for; `None` if there is none.
    fn depth(&self, wish: (usize, DepthAccess), size: (u32, u32)) -> Option<(usize, DepthAccess)> {
        let (index, access) = wish;
        let fits = |at: &usize| self.images[*at].content == Content::Depth && self.size(*at) == size;
        let all: Vec<usize> = (0..self.images.len()).filter(fits).collect();
        Some((*all.get(index % all.len().max(1))?, access))
    }

    /// Adds the pass that writes the output.
    fn show(&mut self, recipe: &Recipe) {
        let mut binds: Vec<Bind> = Vec::new();
        let written = self.passes.iter().rev().flat_map(|pass| pass.uses().filter(|(_, writes)| *writes));
        let latest = written.map(|(what, _)| what).take(1);
        for what in recipe.shown.iter().map(|pick| self.resolve(*pick)).chain(latest) {
            if binds.iter().all(|bind| bind.what != what) {
                binds.push(Bind { what, reads: true, writes: false, stage: Stage::Fragment });
            }
        }
        self.images.push(ImageWish { content: Content::Color, size: LARGEST, history: false });
        let output = self.output();
        let work = if recipe.drawn {
            Kind::Draw { targets: vec![(output, false)], depth: None, adds: false, strip: false }
        } else {
            let what = front(Target::Image(output));
            binds.push(Bind { what, reads: false, writes: true, stage: Stage::Fragment });
            Kind::Dispatch { once: false, local: 16 }
        };
        let (when, stands) = (When::Always, Stands::InPlace);
        self.passes.push(Pass { work, binds, indirect: None, when, stands, salt: 7, push: false });
        self.nodes.push(Node::Pass(self.passes.len() - 1));
    }

    fn runs(&self, settings: Settings) -> Runs {
        let mut runs = Runs { passes: Vec::new(), fronts: vec![0; self.buffers.len()] };
        self.unroll(&self.nodes, settings, &mut runs);
        runs
    }

    fn unroll(&self, nodes: &[Node], settings: Settings, runs: &mut Runs) {
        for node in nodes {
            match node {
                Node::Pass(at) if self.passes[*at].when.holds(settings) => {
                    runs.passes.push((*at, runs.fronts.clone()));
                }
                Node::Pass(_) => {}
                Node::Swap(at) => runs.fronts[*at] = 1 - runs.fronts[*at],
                Node::Repeat(count, body) => {
                    (0..count.of(settings)).for_each(|_| self.unroll(body, settings, runs))
                }
            }
        }
    }

    fn history(&self, of: Target) -> bool {
        match of {
            Target::Buffer(at) => self.buffers[at].history,
            Target::Image(at) => self.images[at].history,
        }
    }

    /// Drops the reads and statistics that are invalid under these settings. They are of contents that are not written
    /// yet, or of the last frame's contents after they were overwritten. Kept targets and indirect arguments count as
    /// reads. Returns false if nothing was dropped.
    fn mend(&mut self, settings: Settings) -> bool {
        let runs = self.runs(settings);
        let writers = writers(self, &runs);
        let writers = |real: Real| writers.get(&real).copied().unwrap_or(0);
        let mut written: BTreeSet<Real> = BTreeSet::new();
        let mut faults: BTreeSet<(usize, Fault)> = BTreeSet::new();
        for once in [true, false] {
            let mut framed: BTreeSet<Real> = BTreeSet::new();
            for (at, fronts) in runs.passes.iter().filter(|(at, _)| self.passes[*at].once() == once) {
                let pass = &self.passes[*at];
                let readable = |what: Ref, sole: bool| {
                    let real = real(what, fronts, &runs.fronts);
                    let writers = writers(real);
                    let carried = self.history(what.of) && is_final(real, &runs.fronts);
                    match (what.half, once) {
                        // A resource without writers has no contents to read.
                        (Half::Last, _) if writers == 0 => false,
                        (Half::Last, true) => !written.contains(&real),
                        // The frame's writers come after readers of the previous frame's contents.
                        (Half::Last, false) => !framed.contains(&real),
                        (_, true) => written.contains(&real),
                        // A single writer runs before its readers, wherever it is in the file.
                        (_, false) => written.contains(&real) || carried && (writers > 1 || sole),
                    }
                };
                // A size needs no contents, but keeps its place among the writers.
                let sized = |bind: &Bind| {
                    let real = real(bind.what, fronts, &runs.fronts);
                    let writers = writers(real);
                    !bind.writes && bind.what.half != Half::Last && (writers == 0 || !once && writers > 1)
                };
                let read = |bind: &Bind| bind.reads || !bind.writes && !sized(bind);
                for (number, bind) in pass.binds.iter().enumerate().filter(|(_, bind)| read(bind)) {
                    if !readable(bind.what, bind.writes) {
                        faults.insert((*at, Fault::Read(number)));
                    }
                }
                if let Kind::Draw { targets, depth, .. } = &pass.work {
                    let is_early = |(at, access)| {
                        let writes = access != DepthAccess::Test;
                        access != DepthAccess::Write && !readable(front(Target::Image(at)), writes)
                    };
                    if depth.is_some_and(is_early) {
                        faults.insert((*at, Fault::Depth));
                    }
                    for (number, (image, keep)) in targets.iter().enumerate() {
                        if *keep && !readable(front(Target::Image(*image)), true) {
                            faults.insert((*at, Fault::Keep(number)));
                        }
                    }
                }
                if pass.indirect.is_some_and(|(what, _)| !readable(what, false)) {
                    faults.insert((*at, Fault::Indirect));
                }
                for (what, _) in pass.uses().filter(|(_, writes)| *writes) {
                    let real = real(what, fronts, &runs.fronts);
                    written.insert(real);
                    framed.insert(real);
                }
            }
        }
        // From the back, so that earlier indices stay valid.
        for (at, fault) in faults.iter().rev() {
            let Pass { work, binds, indirect, .. } = &mut self.passes[*at];
            match (fault, work) {
                (Fault::Indirect, _) => *indirect = None,
                (Fault::Keep(number), Kind::Draw { targets, .. }) => targets[*number].1 = false,
                (Fault::Depth, Kind::Draw { depth: Some((_, access @ DepthAccess::TestAndWrite)), .. }) => {
                    *access = DepthAccess::Write;
                }
                (Fault::Depth, Kind::Draw { depth, .. }) => *depth = None,
                // A dispatch keeps the binding and only writes it. A draw cannot write without reading, so it loses the
                // binding.
                (Fault::Read(number), Kind::Dispatch { .. }) if binds[*number].writes => {
                    binds[*number].reads = false;
                }
                (Fault::Read(number), _) => _ = binds.remove(*number),
                (Fault::Keep(_) | Fault::Depth, _) => unreachable!("only draws have targets"),
            }
        }
        let stats = self.stats.len();
        let carried = |real: Real| self.history(real.0) && is_final(real, &runs.fronts) && writers(real) > 1;
        let kept = |(what, _): &(Ref, u32)| {
            let real = real(*what, &runs.fronts, &runs.fronts);
            written.contains(&real) || carried(real)
        };
        let stats_kept: Vec<(Ref, u32)> = self.stats.iter().copied().filter(kept).collect();
        self.stats = stats_kept;
        !faults.is_empty() || self.stats.len() != stats
    }

    /// Moves passes to the start or the end of the file, as wished, if any position is valid.
    ///
    /// Such a pass runs in every frame and outside repeats, and accesses no ping-pong buffer. Except for reads of the
    /// previous frame, it accesses no history and no resource with several writers.
    fn move_passes(&mut self) {
        let mut writers: BTreeMap<Target, usize> = BTreeMap::new();
        count_writers(&self.nodes, &self.passes, 1, &mut writers);
        let is_free = |what: Ref| {
            let pair = matches!(what.of, Target::Buffer(at) if self.buffers[at].role == Role::PingPong);
            let single = writers.get(&what.of).is_none_or(|count| *count <= 1);
            !pair && (what.half == Half::Last || single && !self.history(what.of))
        };
        let moves = |node: &Node, to: Stands| match node {
            Node::Pass(at) => {
                let pass = &self.passes[*at];
                pass.stands == to && !pass.once() && pass.uses().all(|(what, _)| is_free(what))
            }
            _ => false,
        };
        let nodes = self.nodes.clone();
        let (mut ordered, rest): (Vec<Node>, Vec<Node>) =
            nodes.into_iter().partition(|node| moves(node, Stands::First));
        let (last, middle): (Vec<Node>, Vec<Node>) =
            rest.into_iter().partition(|node| moves(node, Stands::Last));
        ordered.extend(middle.into_iter().chain(last));
        self.nodes = ordered;
    }
}

/// Counts the writers of each resource under one pair of settings.
fn writers(sketch: &Sketch, runs: &Runs) -> BTreeMap<Real, usize> {
    let mut writers = BTreeMap::new();
    for (at, fronts) in &runs.passes {
        for (what, _) in sketch.passes[*at].uses().filter(|(_, writes)| *writes) {
            *writers.entry(real(what, fronts, &runs.fronts)).or_default() += 1;
        }
    }
    writers
}

fn real(what: Ref, fronts: &[usize], last: &[usize]) -> Real {
    let half = match (what.of, what.half) {
        (Target::Image(_), _) => 0,
        (Target::Buffer(at), Half::Front) => fronts[at],
        (Target::Buffer(at), Half::Back) => 1 - fronts[at],
        (Target::Buffer(at), Half::Last) => last[at],
    };
    (what.of, half)
}

/// Returns true if the half is the front when the frame ends, or for an image.
fn is_final((of, half): Real, last: &[usize]) -> bool {
    match of {
        Target::Buffer(at) => half == last[at],
        Target::Image(_) => true,
    }
}

/// Counts the passes in the file that write each resource. A pass in a repeat counts as two.
fn count_writers(nodes: &[Node], passes: &[Pass], times: usize, writers: &mut BTreeMap<Target, usize>) {
    for node in nodes {
        match node {
            Node::Pass(at) => {
                for (what, _) in passes[*at].uses().filter(|(_, writes)| *writes) {
                    *writers.entry(what.of).or_default() += times;
                }
            }
            Node::Swap(..) => {}
            Node::Repeat(_, body) => count_writers(body, passes, 2, writers),
        }
    }
}
