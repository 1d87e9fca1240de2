//! Histories across plan changes, compared with a model of their contents.
//!
//! The graph increments counters and draws a trail. Its constants change how often its ping-pong buffer is swapped, and
//! whether the trail is drawn on. Plans follow one another while frames of the previous plan are in flight. The
//! expected outputs are computed by plain loops.

use super::gpu::{Bench, Pace};
use super::recipe::Settings;
use super::render::Files;

const GRAPH: &str = r#"Graph(
  version: 1, summary: "Counts",
  params: { "flag": Const(Bool(default: true)), "steps": Const(Int(default: 0, range: (0, 4))) },
  resources: {
    "sum": Buffer(stride: 4, count: 16, history: true),
    "trail": Image(format: "r32ui", size: (16, 8), history: true),
    "far": Buffer(stride: 4, count: 16, ping_pong: true, history: true),
    "part": Buffer(stride: 4, count: 16, history: true),
    "seen": Buffer(stride: 4, count: 16),
    "output": Image(format: "rgba32f", size: (16, 8)),
  },
  passes: [
    Dispatch(name: "look back", shader: "look.comp", size: Threads(16), bind: { "Far": "last(far)", "Sum": "last(sum)", "Seen": "seen" }),
    Dispatch(name: "count", shader: "count.comp", size: Threads(16), bind: { "Sum": "sum" }, push: { "steps": "steps" }),
    Dispatch(name: "part", shader: "part.comp", size: Threads(16), bind: { "Sum": "sum", "Part": "part" }),
    Fill(name: "clear", buffer: "far", value: 3),
    Repeat(var: "i", count: "steps", body: [
      Dispatch(name: "step", shader: "step.comp", size: Threads(16), bind: { "In": "front(far)", "Out": "back(far)" }, push: { "i": "i" }),
      Swap("far"),
    ]),
    Dispatch(name: "mark", when: "flag", shader: "mark.comp", size: Threads(128), bind: { "Trail": "trail", "Sum": "sum" }),
    Dispatch(name: "show", shader: "show.comp", size: Threads(128),
      bind: { "Sum": "sum", "Far": "front(far)", "Seen": "seen", "Trail": "trail", "Part": "part", "Shown": "output" }),
  ],
  output: "output",
)
"#;

const SHADERS: [(&str, &str); 6] = [
    // Writes one of sixteen words, another than in the previous frame, and reads none: the other words must be kept.
    (
        "part.comp",
        "layout(set = 0, binding = 0, std430) readonly buffer Sum { uint sum[]; };
        layout(set = 0, binding = 1, std430) writeonly buffer Part { uint part[]; };
        void main() { if (gl_GlobalInvocationID.x == 0) part[sum[0] % 16] = sum[0]; }",
    ),
    (
        "look.comp",
        "layout(set = 0, binding = 0, std430) readonly buffer Far { uint far[]; };
        layout(set = 0, binding = 1, std430) readonly buffer Sum { uint sum[]; };
        layout(set = 0, binding = 2, std430) writeonly buffer Seen { uint seen[]; };
        void main() { uint i = gl_GlobalInvocationID.x; if (i < 16) seen[i] = far[15 - i] * 5 + sum[i]; }",
    ),
    (
        "count.comp",
        "layout(set = 0, binding = 0, std430) buffer Sum { uint sum[]; };
        layout(push_constant) uniform Push { uint steps; };
        void main() { uint i = gl_GlobalInvocationID.x; if (i < 16) sum[i] += 1 + i + steps; }",
    ),
    (
        "step.comp",
        "layout(set = 0, binding = 0, std430) readonly buffer In { uint from[]; };
        layout(set = 0, binding = 1, std430) writeonly buffer Out { uint to[]; };
        layout(push_constant) uniform Push { uint i; };
        void main() { uint at = gl_GlobalInvocationID.x; if (at < 16) to[at] = from[(at + 1) % 16] * 2 + at + i; }",
    ),
    (
        "mark.comp",
        "layout(set = 0, binding = 0, r32ui) uniform uimage2D Trail;
        layout(set = 0, binding = 1, std430) readonly buffer Sum { uint sum[]; };
        void main() {
            uint i = gl_GlobalInvocationID.x;
            ivec2 at = ivec2(i % 16, i / 16);
            if (i < 128) imageStore(Trail, at, uvec4(imageLoad(Trail, at).x * 3 + sum[i % 16]));
        }",
    ),
    (
        "show.comp",
        "layout(set = 0, binding = 0, std430) readonly buffer Sum { uint sum[]; };
        layout(set = 0, binding = 1, std430) readonly buffer Far { uint far[]; };
        layout(set = 0, binding = 2, std430) readonly buffer Seen { uint seen[]; };
        layout(set = 0, binding = 3, r32ui) uniform readonly uimage2D Trail;
        layout(set = 0, binding = 4, rgba32f) uniform writeonly image2D Shown;
        layout(set = 0, binding = 5, std430) readonly buffer Part { uint part[]; };
        void main() {
            uint i = gl_GlobalInvocationID.x;
            ivec2 at = ivec2(i % 16, i / 16);
            uint shown = sum[i % 16] + far[i % 16] * 1000 + seen[i % 16] * 7919 + imageLoad(Trail, at).x * 104729 + part[i % 16] * 31;
            if (i < 128) imageStore(Shown, at, vec4(shown & 0xffff, shown >> 16, 0, 0));
        }",
    ),
];

#[derive(Default)]
struct Model {
    sum: [u32; 16],
    far: [u32; 16],
    part: [u32; 16],
    trail: [[u32; 16]; 8],
}

impl Model {
    /// Computes one frame; returns the expected output.
    fn frame(&mut self, settings: Settings) -> Vec<u32> {
        let seen: [u32; 16] =
            std::array::from_fn(|i| self.far[15 - i].wrapping_mul(5).wrapping_add(self.sum[i]));
        for (i, sum) in self.sum.iter_mut().enumerate() {
            *sum += 1 + i as u32 + settings.steps;
        }
        self.part[self.sum[0] as usize % 16] = self.sum[0];
        self.far = [3; 16];
        for step in 0..settings.steps {
            let from = self.far;
            self.far = std::array::from_fn(|at| from[(at + 1) % 16] * 2 + at as u32 + step);
        }
        for row in self.trail.iter_mut().filter(|_| settings.flag) {
            for (trail, sum) in row.iter_mut().zip(&self.sum) {
                *trail = trail.wrapping_mul(3).wrapping_add(*sum);
            }
        }
        let shown = |(row, at): (&[u32; 16], usize)| {
            let far = self.far[at].wrapping_mul(1000);
            let seen = seen[at].wrapping_mul(7919);
            let trail = row[at].wrapping_mul(104_729);
            let part = self.part[at].wrapping_mul(31);
            self.sum[at].wrapping_add(far).wrapping_add(seen).wrapping_add(trail).wrapping_add(part)
        };
        self.trail.iter().flat_map(|row| (0..16).map(move |at| (row, at))).map(shown).collect()
    }
}

#[test]
fn histories_live_on_through_changes_of_the_plan_as_a_model_says() {
    let shader = |(name, text): (&str, &str)| {
        (name.to_string(), format!("#version 460\nlayout(local_size_x = 16) in;\n{text}\n"))
    };
    let files = Files { graph: GRAPH.into(), shaders: SHADERS.map(shader).into(), parts: Vec::new() };
    let settings = |flag, steps| Settings { flag, steps };
    // Odd and even numbers of swaps, with and without `mark`, for one frame and for several.
    let row = [
        (settings(true, 1), 2),
        (settings(true, 2), 1),
        (settings(false, 3), 1),
        (settings(true, 0), 3),
        (settings(false, 0), 1),
        (settings(true, 4), 1),
        (settings(true, 3), 2),
    ];
    let mut bench = Bench::new();
    for share_memory in [true, false] {
        let plans: Vec<_> = row
            .iter()
            .map(|(settings, frames)| (bench.plan(&files, *settings, share_memory).unwrap(), *frames))
            .collect();
        let plans: Vec<_> = plans.iter().map(|(plan, frames)| (plan, *frames)).collect();
        for pace in [Pace::InFlight, Pace::Waits] {
            let found = bench.run(&plans, pace).unwrap_or_else(|e| panic!("{e}"));
            let mut model = Model::default();
            let settings = row.iter().flat_map(|(settings, frames)| (0..*frames).map(move |_| *settings));
            for (number, (settings, outcome)) in settings.zip(&found).enumerate() {
                let pixels: &[[f32; 4]] = bytemuck::cast_slice(&outcome.output);
                let words: Vec<u32> =
                    pixels.iter().map(|[low, high, ..]| *low as u32 | (*high as u32) << 16).collect();
                assert_eq!(
                    words,
                    model.frame(settings),
                    "frame {number}, {settings:?}, {share_memory}, {pace:?}"
                );
            }
        }
    }
}
