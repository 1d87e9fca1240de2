// The division of a bin's list into segments of SEGMENT entries, which are blended independently of each other and then composited,
// so that a long list keeps many workgroups busy.

uint segments_of(uint entries) {
    return (entries + uint(SEGMENT) - 1u) / uint(SEGMENT);
}

// As many invocations as a cell has columns share a cell, and each takes one of its columns.
const uint CELLS_AT_ONCE = uint(RASTER_THREADS) / CELL;
const uint BIN_PIXELS = BIN * BIN;

// Returns the place of a pixel in the sums of its bin: neighbouring invocations have neighbouring places.
uint pixel_place(uint cell, uvec2 pixel) {
    return (cell / CELLS_AT_ONCE * CELL + pixel.y) * uint(RASTER_THREADS) + cell % CELLS_AT_ONCE * CELL + pixel.x;
}
