// The division of the picture into *bins*, squares of BIN x BIN pixels. Binning makes a list of the splats that may touch each bin, near
// to far.

const uint BIN = uint(BIN_SIDE);

// The bins that a splat may touch: the first and the last column and row, 8 bits each.
struct BinRect { uvec2 first, last; };

uint pack_bins(BinRect r) {
    return r.first.x | (r.first.y << 8) | (r.last.x << 16) | (r.last.y << 24);
}

BinRect unpack_bins(uint packed) {
    return BinRect(uvec2(packed, packed >> 8) & 255u, uvec2(packed >> 16, packed >> 24) & 255u);
}

// The empty rectangle.
const uint NO_BINS = 1u;

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
