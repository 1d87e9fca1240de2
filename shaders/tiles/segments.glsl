// The division of a bin's list into segments of SEGMENT_ENTRIES entries, so that a long list keeps many workgroups busy.
// Segments are blended independently of each other and then composited.

// Returns the number of segments of a list; 1 for an empty list.
uint segments_of(uint entries) {
    return max(1u, (entries + uint(SEGMENT_ENTRIES) - 1u) / uint(SEGMENT_ENTRIES));
}

// Invocations per workgroup of the rasteriser.
const uint RASTER_THREADS = 256u;

// The rasteriser divides a bin into *cells* of CELL x CELL pixels, each shared by CELL_LANES neighbouring invocations of a subgroup, which
// take ROWS_AT_ONCE rows at a time.
const uint CELL = 4u;
const uint ACROSS = BIN / CELL;
const uint CELL_PIXELS = CELL * CELL / uint(CELL_LANES);
const uint ROWS_AT_ONCE = uint(CELL_LANES) / CELL;
const uint CELLS_AT_ONCE = RASTER_THREADS / uint(CELL_LANES);
const uint BIN_PIXELS = BIN * BIN_ROWS;

// The place of the sums of further segments, after the sums of first segments, which are indexed by the number of their bin.
const uint FURTHER_SUMS = uint(MOST_SEVERAL);

// Returns the place, in the sums of a bin, of pixel `p` of an invocation in the cell that it takes in `turn`: neighbouring
// invocations have neighbouring places.
uint pixel_place(uint thread, uint turn, uint p) {
    return (turn * CELL_PIXELS + p) * RASTER_THREADS + thread;
}

// Returns the pixel, relative to the bin, at a place in the sums of a bin: the inverse of `pixel_place`.
uvec2 pixel_at(uint place) {
    uint thread = place % RASTER_THREADS;
    uint pass = place / RASTER_THREADS;
    uint cell = pass / CELL_PIXELS * CELLS_AT_ONCE + thread / uint(CELL_LANES);
    uvec2 within = uvec2(thread % CELL, thread % uint(CELL_LANES) / CELL + pass % CELL_PIXELS * ROWS_AT_ONCE);
    return CELL * uvec2(cell % ACROSS, cell / ACROSS) + within;
}
