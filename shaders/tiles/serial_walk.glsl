// Walks the pairs of a block, for the passes that count and scatter.

// A position among the pairs: the splat, as its position in depth order, with its bins, and the bin.
struct Walk {
    uint splat;
    BinRect bins;
    uvec2 bin;
};

// Returns the position of pair `pair`, which must exist.
Walk walk_from(uint pair, uint count) {
    // The run of the pair: the last that starts at or before it.
    uint run = 0u;
    uint end = (count + uint(RUN_SPLATS) - 1u) / uint(RUN_SPLATS);
    while (end - run > 1u) {
        uint middle = (run + end) / 2u;
        bool is_before = runs[middle] <= pair;
        run = is_before ? middle : run;
        end = is_before ? end : middle;
    }
    Walk w;
    w.splat = run * uint(RUN_SPLATS);
    uint skip = pair - runs[run];
    w.bins = unpack_bins(sorted_bins[w.splat]);
    uint here = bins_in(w.bins);
    while (skip >= here) {
        skip -= here;
        w.splat++;
        w.bins = unpack_bins(sorted_bins[w.splat]);
        here = bins_in(w.bins);
    }
    uint width = w.bins.last.x - w.bins.first.x + 1u;
    w.bin = w.bins.first + uvec2(skip % width, skip / width);
    return w;
}

// Advances to the next pair; there are `count` splats.
//
// Loads a splat's bins for every pair: a conditional load would cost a CPU an unpredictable branch for each lane.
void walk_on(inout Walk w, uint count) {
    bool row_ends = w.bin.x == w.bins.last.x;
    w.bin.x = row_ends ? w.bins.first.x : w.bin.x + 1u;
    bool splat_ends = row_ends && w.bin.y == w.bins.last.y;
    w.bin.y += row_ends ? 1u : 0u;
    w.splat = min(w.splat + (splat_ends ? 1u : 0u), count - 1u);
    w.bins = unpack_bins(sorted_bins[w.splat]);
    w.bin = splat_ends ? w.bins.first : w.bin;
}

uint bin_index(uvec2 bin) {
    return min(bin.y * uint(BINS_X) + BIN_COLUMN(bin.x), uint(BIN_COUNT) - 1u);
}
