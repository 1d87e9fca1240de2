//! Lists the ways of blending splats, right and wrong.

/// A way of blending splats.
#[derive(Debug, PartialEq, Eq)]
pub struct Way {
    /// Name of the way on the page.
    pub name: &'static str,
    /// Names and values of the graph's parameters that the way changes.
    pub set: &'static [(&'static str, &'static str)],
    /// True if the splats are sorted by depth.
    pub sorted: bool,
    /// True if the nearest splat is blended first.
    pub nearest_first: bool,
    /// True for `under`, which keeps a transmittance; false for `over`.
    pub under: bool,
    /// The sum that this way computes, as LaTeX.
    pub sum: &'static str,
    /// Explanation of the resulting picture, for the page.
    pub why: &'static str,
}

/// All ways of blending.
pub const WAYS: [Way; 4] = [
    Way {
        name: "unsorted",
        set: &[("sort", "false")],
        sorted: false,
        nearest_first: false,
        under: false,
        sum: r"\sum_i c_i a_i \prod_{p(j) < p(i)} (1 - a_j)",
        why: "The order of the file permutes the index set of the product: splat j dims splat i if it comes before i in the \
              file (p is the place in the file), whichever of the two is nearer. Which splat of a pair covers the other is \
              left to chance.",
    },
    Way {
        name: "back to front",
        set: &[],
        sorted: true,
        nearest_first: false,
        under: false,
        sum: r"\sum_i c_i a_i \prod_{j < i} (1 - a_j)",
        why: "`over`, farthest first: C <- a_i c_i + (1 - a_i) C. Each later, nearer splat multiplies everything below it \
              by its 1 - a, so that in the end i has been dimmed by all j < i: the true product.",
    },
    Way {
        name: "front to back, naive",
        set: &[("blend", "front_to_back_naive")],
        sorted: true,
        nearest_first: true,
        under: false,
        sum: r"\sum_i c_i a_i \prod_{j > i} (1 - a_j)",
        why: "The same `over` on the sorted list from its other end: i is dimmed by the splats that come later, which are \
              those behind it. The index set j < i has become j > i. That is the true sum of the same footprints seen from \
              behind: the farthest surface is in front.",
    },
    Way {
        name: "front to back",
        set: &[("blend", "front_to_back")],
        sorted: true,
        nearest_first: true,
        under: true,
        sum: r"\sum_i c_i a_i T_i, \quad T_i = \prod_{j < i} (1 - a_j)",
        why: "`under`, nearest first: C <- C + T a_i c_i, then T <- (1 - a_i) T. The transmittance T carries the product \
              over j < i along, so that the sum is the true one, term by term.",
    },
];
