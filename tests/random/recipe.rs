//! Generates the raw material of random graphs with proptest.
//!
//! A recipe is a list of wishes. [`super::sketch`] takes indices modulo the number of things, and drops impossible
//! wishes, such as a read of contents that no pass has written yet. So any part of a recipe can be removed and a valid
//! graph is left. This lets a failure shrink to a few lines.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use splatgraph_framework::ir::DepthAccess::{self, Test, TestAndWrite, Write};

#[derive(Clone, Debug)]
pub struct Recipe {
    pub buffers: Vec<BufferWish>,
    pub images: Vec<ImageWish>,
    pub items: Vec<Item>,
    /// Resources that the output pass reads, besides the one that the passes before it wrote most recently.
    pub shown: Vec<Pick>,
    /// True if the last pass draws to its image, false if it stores to it.
    pub drawn: bool,
    /// Statistics: a buffer, and the word that is read back.
    pub stats: Vec<(Pick, u8)>,
    /// Two settings of the graph's constants; the first are their defaults.
    pub settings: [Settings; 2],
}

/// Values of the constant parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    pub flag: bool,
    /// 0 to 4.
    pub steps: u32,
}

impl Settings {
    pub fn all() -> impl Iterator<Item = Settings> {
        (0..=MAX_STEPS).flat_map(|steps| [false, true].map(|flag| Settings { flag, steps }))
    }
}

pub const MAX_STEPS: u32 = 4;

#[derive(Clone, Debug)]
pub struct BufferWish {
    /// Size in 32-bit words, a multiple of 4.
    pub words: u32,
    /// True if an element has four words, false if it has one.
    pub wide: bool,
    pub role: Role,
    pub history: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Plain,
    PingPong,
    /// Holds arguments of indirect dispatches and draws.
    Args,
}

/// Width and height of the largest images.
pub const LARGEST: (u32, u32) = (16, 8);

#[derive(Clone, Debug)]
pub struct ImageWish {
    pub content: Content,
    /// Width and height. A depth image takes the size of a colour image, if there is one.
    pub size: (u32, u32),
    pub history: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// `rgba32f`, which can be a target.
    Color,
    /// `r32ui`.
    Word,
    /// `depth32f`, which can only be a depth attachment.
    Depth,
}

/// A resource, chosen among the resources that suit the use.
#[derive(Clone, Copy, Debug)]
pub struct Pick {
    pub index: u8,
    /// Uses of the resource; `None` for any resource.
    pub want: Option<Half>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// The front or the back of a ping-pong buffer.
    Front,
    Back,
    /// The contents of the previous frame.
    Last,
}

#[derive(Clone, Debug)]
pub enum Item {
    Pass(PassWish),
    Swap(u8),
    /// The body contains no repeats.
    Repeat(Count, Vec<Item>),
}

#[derive(Clone, Copy, Debug)]
pub enum Count {
    Literal(u32),
    Steps,
    StepsLeft,
}

impl Count {
    pub fn of(self, settings: Settings) -> u32 {
        match self {
            Count::Literal(n) => n,
            Count::Steps => settings.steps,
            Count::StepsLeft => MAX_STEPS - settings.steps,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    Always,
    Flag,
    NotFlag,
    OddSteps,
}

impl When {
    pub fn holds(self, settings: Settings) -> bool {
        match self {
            When::Always => true,
            When::Flag => settings.flag,
            When::NotFlag => !settings.flag,
            When::OddSteps => settings.steps % 2 == 1,
        }
    }
}

#[derive(Clone, Debug)]
pub struct PassWish {
    pub kind: Kind,
    pub reads: Vec<(Pick, Stage)>,
    /// Resources whose length or size the shader asks for, without another access.
    pub sizes: Vec<(Pick, Stage)>,
    /// Resources to write, each with true if the previous contents are read, too. The stage is used only by draws.
    pub writes: Vec<(Pick, bool, Stage)>,
    /// A buffer of arguments, and the index of the arguments in it; `None` for direct work.
    pub indirect: Option<(Pick, u8)>,
    pub when: When,
    pub stands: Stands,
    /// A number in the shader, so that shaders differ.
    pub salt: u32,
    /// True if `salt` is a push constant instead.
    pub push: bool,
}

#[derive(Clone, Debug)]
pub enum Kind {
    Dispatch {
        once: bool,
        local: u32,
    },
    /// Targets by index, each with true if its contents are kept; and the depth attachment.
    Draw {
        targets: Vec<(usize, bool)>,
        depth: Option<(usize, DepthAccess)>,
        /// True to add to the targets, false to replace their contents.
        adds: bool,
        strip: bool,
    },
    /// Fills the bound buffer.
    Fill {
        value: u32,
    },
}

/// Stages of a draw that access a resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Vertex,
    Fragment,
    Both,
}

/// Wished position of a pass in the file. Ignored unless the pass can be moved without changing the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stands {
    InPlace,
    First,
    Last,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    pub buffers: usize,
    pub images: usize,
    /// Maximum number of items in the file.
    pub items: usize,
    /// Maximum number of passes with repeats unrolled, including the last pass.
    pub passes: usize,
    /// True if the shaders are run. Excludes work that no GPU should run: arbitrary indirect arguments.
    pub runs: bool,
}

pub const LARGE: Limits = Limits { buffers: 8, images: 4, items: 24, passes: 40, runs: false };
pub const SMALL: Limits = Limits { buffers: 8, images: 2, items: 10, passes: 7, runs: false };

pub fn recipes(limits: Limits) -> impl Strategy<Value = Recipe> {
    (
        vec(buffer(), 1..=limits.buffers),
        vec(image(), 0..=limits.images),
        vec(item(), 1..=limits.items),
        vec(pick(), 2..=8),
        weighted(1, 4),
        vec((pick(), any::<u8>()), 0..=3),
        [settings(), settings()],
    )
        .prop_map(|(buffers, images, items, shown, drawn, stats, settings)| Recipe {
            buffers,
            images,
            items,
            shown,
            drawn,
            stats,
            settings,
        })
}

/// Generates true with probability `of` / `times`.
fn weighted(of: u32, times: u32) -> impl Strategy<Value = bool> + Clone {
    (0..times).prop_map(move |n| n >= times - of)
}

fn settings() -> impl Strategy<Value = Settings> {
    (any::<bool>(), 0..=MAX_STEPS).prop_map(|(flag, steps)| Settings { flag, steps })
}

fn buffer() -> impl Strategy<Value = BufferWish> {
    let role = prop_oneof![4 => Just(Role::Plain), 2 => Just(Role::PingPong), 2 => Just(Role::Args)];
    let words = select(vec![4, 16, 20, 64, 100, 100]);
    (words, weighted(1, 5), role, weighted(1, 5)).prop_map(|(words, wide, role, history)| BufferWish {
        words,
        wide: wide && role != Role::Args,
        role,
        history,
    })
}

fn image() -> impl Strategy<Value = ImageWish> {
    // The smallest is smaller than most buffers: in shared memory, reads of parts of a buffer lie behind its pixels.
    let size = select(vec![LARGEST, (8, 4), (2, 2), (2, 2)]);
    let content = prop_oneof![1 => Just(Content::Word), 2 => Just(Content::Color), 1 => Just(Content::Depth)];
    (content, size, weighted(1, 4)).prop_map(|(content, size, history)| ImageWish {
        content,
        size,
        history: history && content != Content::Depth,
    })
}

fn pick() -> impl Strategy<Value = Pick> + Clone {
    let want = prop_oneof![6 => Just(None), 1 => Just(Some(Half::Back)), 1 => Just(Some(Half::Last))];
    (any::<u8>(), want).prop_map(|(index, want)| Pick { index, want })
}

fn stage() -> impl Strategy<Value = Stage> {
    prop_oneof![3 => Just(Stage::Fragment), 2 => Just(Stage::Vertex), 1 => Just(Stage::Both)]
}

fn when() -> impl Strategy<Value = When> {
    prop_oneof![
        7 => Just(When::Always),
        1 => Just(When::Flag),
        1 => Just(When::NotFlag),
        1 => Just(When::OddSteps),
    ]
}

fn kind() -> impl Strategy<Value = (Kind, usize)> {
    prop_oneof![
        8 => (weighted(1, 6), select(vec![8u32, 16, 64])).prop_map(|(once, local)| (Kind::Dispatch { once, local }, 1)),
        3 => (
            vec((0..256usize, any::<bool>()), 1..=2),
            proptest::option::of((0..256usize, select(vec![Write, TestAndWrite, Test]))),
            weighted(1, 3),
            any::<bool>(),
        )
            .prop_map(|(targets, depth, adds, strip)| (Kind::Draw { targets, depth, adds, strip }, 0)),
        1 => (0u32..4).prop_map(|value| (Kind::Fill { value }, 1)),
    ]
}

fn pass() -> impl Strategy<Value = PassWish> {
    kind().prop_flat_map(|(kind, least_writes)| {
        let dispatch = matches!(kind, Kind::Dispatch { .. });
        let most_writes = if dispatch { 2 } else { 1 };
        let stands =
            prop_oneof![8 => Just(Stands::InPlace), 1 => Just(Stands::First), 1 => Just(Stands::Last)];
        (
            Just(kind),
            vec((pick(), stage()), 0..=3),
            prop_oneof![3 => Just(Vec::new()), 1 => vec((pick(), stage()), 1..=2)],
            vec((pick(), weighted(1, 3), stage()), least_writes..=most_writes),
            prop_oneof![2 => Just(None), 1 => (pick(), any::<u8>()).prop_map(Some)],
            when(),
            stands,
            0u32..1000,
            any::<bool>(),
        )
            .prop_map(|(kind, reads, sizes, writes, indirect, when, stands, salt, push)| PassWish {
                kind,
                reads,
                sizes,
                writes,
                indirect,
                when,
                stands,
                salt,
                push,
            })
    })
}

fn count() -> impl Strategy<Value = Count> {
    prop_oneof![
        3 => (0..=MAX_STEPS).prop_map(Count::Literal),
        2 => Just(Count::Steps),
        1 => Just(Count::StepsLeft),
    ]
}

fn swap() -> impl Strategy<Value = Item> {
    any::<u8>().prop_map(Item::Swap)
}

fn item() -> impl Strategy<Value = Item> {
    let inner = prop_oneof![4 => pass().prop_map(Item::Pass), 1 => swap()];
    prop_oneof![
        12 => pass().prop_map(Item::Pass),
        1 => swap(),
        1 => (count(), vec(inner, 1..=3)).prop_map(|(count, body)| Item::Repeat(count, body)),
        2 => (count(), any::<u8>(), pass()).prop_map(|(count, buffer, pass)| ping_pong(count, buffer, pass)),
    ]
}

/// Repeats a pass that reads the front, writes the back and swaps: the intended use of ping-pong buffers.
fn ping_pong(count: Count, index: u8, mut pass: PassWish) -> Item {
    pass.kind = Kind::Dispatch { once: false, local: 16 };
    pass.reads.insert(0, (Pick { index, want: Some(Half::Front) }, Stage::Both));
    pass.writes = vec![(Pick { index, want: Some(Half::Back) }, false, Stage::Both)];
    Item::Repeat(count, vec![Item::Pass(pass), Item::Swap(index)])
}
