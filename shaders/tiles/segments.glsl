// The division of a bin's list into segments of SEGMENT entries, which are blended independently of each other, and of the
// segments into phases. A later phase leaves out the cells that earlier ones have covered, and each has as many segments as all
// phases before it.

uint segments_of(uint entries) {
    return (entries + uint(SEGMENT) - 1u) / uint(SEGMENT);
}

// Returns the first segment of a phase; that of phase PHASES is the number of segments.
uint first_segment(uint segments, uint phase) {
    uint shift = uint(PHASES) - phase;
    return phase == 0u ? 0u : (segments + (1u << shift) - 1u) >> shift;
}

// The place of pixel `p` of cell `8 row + column`, within the 64 CELL CELL values of a segment: neighbouring invocations of the
// rasteriser have neighbouring places. Eight of them share a cell, and each takes the cells `group` and `32 + group`.
const uint BIN_PIXELS = BIN * BIN;
