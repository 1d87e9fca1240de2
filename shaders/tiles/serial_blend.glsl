// Blends splats over blocks of pixels, for the serial rasterisers. A tile of 16 x 16 pixels has BLOCKS blocks of 8 x 8. To blend, each
// lane has VECTORS pixels of a block, with their sums in registers. To load splats and test them against the tile, each of LOADERS lanes
// has one splat.

#if BIN_SIDE % 16 != 0
#error "expected bins of whole tiles of 16 x 16 pixels"
#endif

#include "cut.glsl"
#include "seen.glsl"

#define LANES DEVICE_SUBGROUP_SIZE

const uint TILE = 16u;
const uint BLOCKS = 4u;
const uint BLOCK_PIXELS = 64u;
const uint VECTORS = LANES < 64 ? BLOCK_PIXELS / LANES : 1u;
// Vectors of a row, and rows of a vector.
const uint COLUMNS = LANES < 8 ? 8u / LANES : 1u;
const uint ROWS = LANES < 8 ? 1u : LANES / 8u;
// Vectors of a column, one below the other.
const uint STEPS = VECTORS / COLUMNS;

// 1 if the falloff is multiplied from row to row (see `blend_column`): where many rows share the cost, and rounding and the splats'
// minimum width allow it. Outputs besides the picture need more accuracy.
#define ACCURATE (RECORD == RECORD_F32 || WITH_OUTPUTS)
#define FALLOFF_BY_PRODUCTS (LANES <= 8 && !ACCURATE && LOW_PASS != LOW_PASS_NONE && LOW_PASS != LOW_PASS_MIP)
// Tiles along a bin's side.
const uint BIN_TILES = BIN / TILE;
const uint TILES_X = uint(BINS_X) * BIN_TILES;
const uint TILES_Y = uint(BINS_Y) * BIN_TILES;

// Returns the pixel of a lane in vector `vector` of block `block`, from the tile's corner.
uvec2 pixel_in_tile(uint block, uint vector, uint lane) {
    uint pixel = vector * LANES + lane;
    return uvec2(8u * (block & 1u) + (pixel & 7u), 8u * (block >> 1) + ((pixel & 63u) >> 3));
}

// Returns the bin of a tile.
uint bin_of_tile(uvec2 tile) {
    return (tile.y / BIN_TILES) * uint(BINS_X) + tile.x / BIN_TILES;
}

// Returns 2^x for x from -126 to 127, undefined otherwise. The relative error is at most 2.9e-6, or 2.5e-7 if ACCURATE; 2^0 is exact.
float power_of_2(float x) {
    const float TO_INTEGER = 12582912.0;  // 1.5 2^23: adding it removes the fraction
    precise float rounded = x + TO_INTEGER;
    precise float integer = rounded - TO_INTEGER;
    precise float f = x - integer;
#if ACCURATE
    float p = 0.00132764709 * f + 0.00967554162;
    p = p * f + 0.0555071328;
    p = p * f + 0.240221197;
    p = p * f + 0.693146967;
    p = p * f + 1.00000007;
#else
    float p = 0.00958286412 * f + 0.0559064299;
    p = p * f + 0.240240991;
    p = p * f + 0.693124175;
    p = p * f + 1.0;
#endif
    return intBitsToFloat(floatBitsToInt(p) + (floatBitsToInt(rounded) << 23));
}

// A splat relative to a tile.
struct Splat {
    vec2 at;          // u and v of the falloff (record.glsl) at the tile's first pixel
    vec3 root;
    float log_alpha;  // binary logarithm of the opacity; with FALLOFF_BY_PRODUCTS, of its ratio to the alpha floor
    vec3 colour;
    float bend;       // factor from one vector's alpha ratio to the next one's down, for FALLOFF_BY_PRODUCTS
#if WITH_OUTPUTS
    Seen seen;
#endif
};

#if WITH_OUTPUTS
// Returns the `Seen` of lane `lane`.
Seen seen_of_lane(Seen s, uint lane) {
    return Seen(subgroupShuffle(s.depth, lane), subgroupShuffle(s.index, lane), subgroupShuffle(s.normal, lane));
}
#endif

// The limits of blending.
struct Limits {
    float floor;  // the alpha floor
    float least;  // its binary logarithm
    float most;   // the alpha cap
    float stop;   // the transmittance of the early stop
};

// Returns the limits of this frame.
Limits limits() {
    // The cap is below 1, where no light would be left to compare with the early stop. The stop is not 0: arithmetic with denormal
    // floats is slow.
    return Limits(alpha_floor, log2(alpha_floor), min(alpha_cap, 0.9999999), max(stop, 1e-35));
}

// Returns a splat relative to the tile at `corner`.
Splat seen_from(vec2 corner, Record r, Limits limits AND(uint index)) {
    vec2 d = corner - r.centre;
    vec2 down = float(ROWS) * r.root.yz;
#if FALLOFF_BY_PRODUCTS
    float log_alpha = r.log_alpha - limits.least;
#else
    float log_alpha = r.log_alpha;
#endif
    // Exactly 1 if no float is between: exp2() near 0 may be one float too low.
    float bend = -2.0 * dot(down, down);
    bend = bend > -4e-8 ? 1.0 : exp2(bend);
    return Splat(vec2(r.root.x * d.x + r.root.y * d.y, r.root.z * d.y), r.root, log_alpha, r.colour, bend AND(seen_splat(index)));
}

// Blends a splat over a pixel; `alpha` is uncapped, and 0 below the alpha floor.
//
// With STOP_AFTER_SPLAT, a pixel ends before the splat that would bring its transmittance below the early stop: it is left out, and
// the sign of the transmittance is set.
void blend(inout vec4 sum, float alpha, vec3 colour, Limits limits AND(inout Pixel pixel) AND(Seen seen)) {
    // Positive floats compare like integers.
    float capped = intBitsToFloat(min(floatBitsToInt(limits.most), floatBitsToInt(alpha)));
#if WITH_MESH
    // Splats behind the mesh are hidden in this pixel; the list continues for the others.
    capped = seen.depth < pixel.limit ? capped : 0.0;
#endif
    float light = capped * sum.a;
    float behind = sum.a - light;
#if STOP_AFTER == STOP_AFTER_SPLAT
    bool is_open = behind >= limits.stop;
    light = is_open ? light : 0.0;
#if WITH_OUTPUTS
    add_splat(pixel, seen, light, sum.a, limits.stop);
#endif
    sum = vec4(sum.rgb + light * colour, is_open ? behind : -abs(sum.a));
#else
#if WITH_OUTPUTS
    add_splat(pixel, seen, light, sum.a, limits.stop);
#endif
    sum = vec4(sum.rgb + light * colour, behind);
#endif
}

// Returns log2 of a splat's alpha (see `log_alpha`) at a pixel with `u` and `v` of its falloff.
float power_at(Splat s, vec2 uv) {
    return s.log_alpha - (uv.x * uv.x + uv.y * uv.y);
}

#if FALLOFF_BY_PRODUCTS
// If the power in the middle row of a block's column is below this, no row of the column reaches the alpha floor. The length of
// (u, v) changes by at most 1.551 per row, the root of log2(e) / 2 / 0.3, since the low pass leaves no splat narrower. Four rows
// nearer, it is at least 3.28: 0.0006 of the alpha floor.
const float FAR = -90.0;
// The minimum of alpha products: arithmetic with denormal floats is slow. From this value, no row of the column returns to the
// alpha floor.
const float UNSEEN = 1e-20;

// Blends a splat over a column of a block, from the middle up and down. `uv` are u and v of the falloff in its first row.
//
// The power is a quadratic function of the row, so the ratio of a row's alpha to the last one's changes by a constant factor. That takes
// two products a row instead of a power of 2.
//
// Alphas are powers of 2 times the alpha floor: a splat whose opacity is the floor has exactly that alpha, not one rounded below it.
void blend_column(inout vec4 sums[VECTORS], uint column, Splat s, vec2 uv, vec2 down, Limits limits) {
    const uint MIDDLE = STEPS / 2u;
    uv += float(MIDDLE) * down;
    float power = power_at(s, uv);
    float middle = limits.floor * power_of_2(max(power, FAR));
    float to_below = power_of_2(power < FAR ? 0.0 : power_at(s, uv + down) - power);
    float to_above = s.bend / to_below;
    float alpha = middle;
    // Counts from 0, so that drivers unroll the loop.
    [[unroll]] for (uint i = 0u; i < STEPS - MIDDLE; i++) {
        blend(sums[(MIDDLE + i) * COLUMNS + column], alpha >= limits.floor ? alpha : 0.0, s.colour, limits);
        alpha = max(alpha * to_below, UNSEEN);
        to_below *= s.bend;
    }
    alpha = middle;
    [[unroll]] for (uint i = 0u; i < MIDDLE; i++) {
        alpha = max(alpha * to_above, UNSEEN);
        to_above *= s.bend;
        blend(sums[(MIDDLE - 1u - i) * COLUMNS + column], alpha >= limits.floor ? alpha : 0.0, s.colour, limits);
    }
}
#else
// Blends a splat over a column of a block. `uv` are u and v of the falloff in its first row.
//
// u and v advance from row to row, not the power: only a sum of squares cannot be rounded to a power far above 0.
void blend_column(inout vec4 sums[VECTORS], uint column, Splat s, vec2 uv, vec2 down, Limits limits AND(inout Pixel pixels_of[VECTORS])) {
    // Counts from 0, so that drivers unroll the loop.
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        float power = power_at(s, uv);
        blend(sums[i * COLUMNS + column], power >= limits.least ? power_of_2(power) : 0.0, s.colour, limits
              AND(pixels_of[i * COLUMNS + column]) AND(s.seen));
        uv += down;
    }
}
#endif

// Blends a splat over the pixels of a block. `first` is the lane's pixel of the first vector, from the tile's first pixel.
void blend_block(inout vec4 sums[VECTORS], Splat s, vec2 first, Limits limits AND(inout Pixel pixels_of[VECTORS])) {
    vec2 down = float(ROWS) * s.root.yz;
    [[unroll]] for (uint column = 0u; column < COLUMNS; column++) {
        float u = s.at.x + (s.root.x * (first.x + float(column * LANES)) + s.root.y * first.y);
        float v = s.at.y + s.root.z * first.y;
        blend_column(sums, column, s, vec2(u, v), down, limits AND(pixels_of));
    }
}

// Returns true if any pixel of a block still has light.
bool has_light(inout vec4 sums[VECTORS], Limits limits) {
    float most = sums[0].a;
    [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
        most = max(most, sums[v].a);
#if STOP_AFTER == STOP_AFTER_CHUNK
        // The pixels of a block continue together, and a finished one must not produce denormal floats.
        sums[v].a = max(sums[v].a, 1e-20);
#endif
    }
    return most >= limits.stop;
}

// Returns the blocks of a tile that a splat touches, with a margin for rounding: bit 2 row + column. `corner` is the tile's first pixel.
uint blocks_of(Record r, vec2 corner, float least) {
    Cut cut = cut_of(r, corner, vec2(TILE), least);
    uint blocks = 0u;
    [[unroll]] for (uint row = 0u; row < 2u; row++) {
        vec2 span = span_of(cut, float(row) * 8.0, float(row) * 8.0 + 7.0);
        bool touches = span.x <= span.y;
        blocks |= touches && span.x <= 7.0 ? 1u << (2u * row) : 0u;
        blocks |= touches && span.y >= 8.0 ? 2u << (2u * row) : 0u;
    }
    return blocks;
}

// Returns the bits that are set in any lane.
uint any_lane(uint bits) {
#if LANES == 8
    // Three shuffles replace the reduction.
    bits |= subgroupShuffleXor(bits, 1u);
    bits |= subgroupShuffleXor(bits, 2u);
    bits |= subgroupShuffleXor(bits, 4u);
    return bits;
#else
    return subgroupOr(bits);
#endif
}

// Returns the splat loaded by lane `lane`.
Splat splat_of_lane(Splat s, uint lane) {
    return Splat(subgroupShuffle(s.at, lane), subgroupShuffle(s.root, lane), subgroupShuffle(s.log_alpha, lane), subgroupShuffle(s.colour, lane),
                 subgroupShuffle(s.bend, lane) AND(seen_of_lane(s.seen, lane)));
}
