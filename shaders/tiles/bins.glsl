// The division of the picture into *bins*, squares of BIN x BIN pixels. Binning makes a list of the splats that may touch each bin, near
// to far.

const uint BIN = uint(BIN_SIDE);

// The bins that a splat may touch: the first and the last column and row, 8 bits each.
struct BinRect { uvec2 first, last; };

uint pack_bins(BinRect r) {
    return r.first.x | (r.first.y << 8) | (r.last.x << 16) | (r.last.y << 24);
}

// A graph without the constant draws no panorama.
#ifndef WRAPS
#define WRAPS 0
#endif

#if WRAPS
// In a panorama, a rectangle may wrap from the right edge to the left. Packed, its last column is then less than its first; unpacked, it
// is beyond the picture.
const uint ROW_BINS = (uint(VIEWPORT_WIDTH) + BIN - 1u) / BIN;

BinRect unpack_bins(uint packed) {
    BinRect r = BinRect(uvec2(packed, packed >> 8) & 255u, uvec2(packed >> 16, packed >> 24) & 255u);
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
    return BinRect(uvec2(packed, packed >> 8) & 255u, uvec2(packed >> 16, packed >> 24) & 255u);
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
