// The division of a bin's list into segments of SEGMENT_ENTRIES entries, which are blended independently of each other and then composited,
// so that a long list keeps many workgroups busy.

uint segments_of(uint entries) {
    return (entries + uint(SEGMENT_ENTRIES) - 1u) / uint(SEGMENT_ENTRIES);
}

// The invocations of a workgroup of the rasteriser.
const uint RASTER_THREADS = 256u;

// Eight invocations share a cell: two of its rows, and the rows below by turns.
const uint CELL_THREADS = 8u;
const uint CELL_PIXELS = CELL * CELL / CELL_THREADS;
const uint ROWS_BETWEEN = CELL_THREADS / CELL;
const uint CELLS_AT_ONCE = RASTER_THREADS / CELL_THREADS;
const uint BIN_PIXELS = BIN * BIN;

// Returns the place, in the sums of a bin, of pixel `p` of an invocation in the cell that it takes in `turn`: neighbouring
// invocations have neighbouring places.
uint pixel_place(uint thread, uint turn, uint p) {
    return (turn * CELL_PIXELS + p) * RASTER_THREADS + thread;
}

// Returns the pixel of the bin at a place.
uvec2 pixel_at(uint place) {
    uint thread = place % RASTER_THREADS;
    uint pass = place / RASTER_THREADS;
    uint cell = pass / CELL_PIXELS * CELLS_AT_ONCE + thread / CELL_THREADS;
    uvec2 within = uvec2(thread % CELL, thread % CELL_THREADS / CELL + pass % CELL_PIXELS * ROWS_BETWEEN);
    return CELL * uvec2(cell % ACROSS, cell / ACROSS) + within;
}
