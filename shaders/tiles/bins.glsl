// The division of the picture into *bins* of BIN x BIN_ROWS pixels. Binning makes a list of the splats that may touch each bin, near to
// far.

// In a graph without the constant, bins are squares.
#ifndef BIN_HEIGHT
#define BIN_HEIGHT BIN_SIDE
#endif

const uint BIN = uint(BIN_SIDE);
const uint BIN_ROWS = uint(BIN_HEIGHT);
const uvec2 BIN_SIZE = uvec2(BIN, BIN_ROWS);

// The bins that a splat may touch: the first and the last column and row.
struct BinRect { uvec2 first, last; };

// Bits of a column in a packed rectangle; a row has the rest of 16.
const uint COLUMN_BITS = BIN_ROWS < BIN ? 7u : 8u;
const uint COLUMN_MASK = (1u << COLUMN_BITS) - 1u;

uint pack_bins(BinRect r) {
    uvec2 corners = uvec2(r.first.x, r.last.x) | (uvec2(r.first.y, r.last.y) << COLUMN_BITS);
    return corners.x | (corners.y << 16);
}

// A graph without the constant draws no panorama.
#ifndef WRAPS
#define WRAPS 0
#endif

BinRect unpack_corners(uint packed) {
    uvec2 corners = uvec2(packed & 0xffffu, packed >> 16);
    uvec2 columns = corners & COLUMN_MASK;
    uvec2 rows = corners >> COLUMN_BITS;
    return BinRect(uvec2(columns.x, rows.x), uvec2(columns.y, rows.y));
}

#if WRAPS
// In a panorama, a rectangle may wrap from the right edge to the left. Packed, its last column is then less than its first; unpacked, it
// is beyond the picture.
const uint ROW_BINS = (uint(VIEWPORT_WIDTH) + BIN - 1u) / BIN;

BinRect unpack_bins(uint packed) {
    BinRect r = unpack_corners(packed);
    r.last.x += r.last.x < r.first.x ? ROW_BINS : 0u;
    return r;
}

// Returns the column in the picture of a rectangle's column.
uint bin_column(uint column) {
    return column < ROW_BINS ? column : column - ROW_BINS;
}
#define BIN_COLUMN(column) bin_column(column)
#else
BinRect unpack_bins(uint packed) {
    return unpack_corners(packed);
}

#define BIN_COLUMN(column) column
#endif

// Returns the number of bins in a rectangle.
uint bins_in(BinRect r) {
    return (r.last.x - r.first.x + 1u) * (r.last.y - r.first.y + 1u);
}

// The published rasteriser draws a splat in tiles of this size; see `tile_range`.
const float PUBLISHED_TILE = 16.0;

// Returns the first and the last pixel, along one axis, of the tiles that a splat with `radius` is drawn in. The published
// rasteriser truncates to integers where this rounds down, which differs only left of the picture.
vec2 tile_range(float centre, float radius) {
    float first = floor((centre - radius) / PUBLISHED_TILE);
    float end = floor((centre + radius + (PUBLISHED_TILE - 1.0)) / PUBLISHED_TILE);
    return vec2(first * PUBLISHED_TILE, end * PUBLISHED_TILE - 1.0);
}
