// Blends splats over blocks of pixels, for the serial rasterisers. A tile of 16 x 16 pixels has BLOCKS blocks of 8 x 4. The lanes of
// a subgroup are pixels of a block, VECTORS times over, so the sums of a pixel are in registers; and they are splats of the list
// when these are loaded and tested against the tile, LOADERS at a time.

#if BIN_SIDE % 16 != 0
#error "expected bins of whole tiles of 16 x 16 pixels"
#endif

#include "cut.glsl"

#define LANES DEVICE_SUBGROUP_SIZE

const uint TILE = 16u;
const uint BLOCKS = 8u;
const uint BLOCK_PIXELS = 32u;
const uint VECTORS = LANES < 32 ? BLOCK_PIXELS / LANES : 1u;
// Tiles along a bin's side.
const uint BIN_TILES = BIN / TILE;
const uint TILES_X = uint(BINS_X) * BIN_TILES;
const uint TILES_Y = uint(BINS_Y) * BIN_TILES;

// Returns the pixel of a lane in vector `vector` of block `block`, from the tile's corner.
uvec2 pixel_in_tile(uint block, uint vector, uint lane) {
    uint pixel = vector * LANES + lane;
    return uvec2(8u * (block & 1u) + (pixel & 7u), 4u * (block >> 1) + ((pixel & 31u) >> 3));
}

// Returns the bin of a tile.
uint bin_of_tile(uvec2 tile) {
    return (tile.y / BIN_TILES) * uint(BINS_X) + tile.x / BIN_TILES;
}

// Returns 2^x, within 2.5e-7 of it relatively, for x below 127; 0 or almost for x below -126.
float power_of_2(float x) {
    const float TO_INTEGER = 12582912.0;  // 1.5 2^23: a sum with it has no fraction
    x = max(x, -126.0);
    precise float rounded = x + TO_INTEGER;
    precise float integer = rounded - TO_INTEGER;
    precise float f = x - integer;
    float p = 0.00132765 * f + 0.00967554;
    p = p * f + 0.05550713;
    p = p * f + 0.2402212;
    p = p * f + 0.69314697;
    p = p * f + 1.00000007;
    return intBitsToFloat(floatBitsToInt(p) + (floatBitsToInt(rounded) << 23));
}

// Blends a splat over a pixel at the distance `d` from its centre. A pixel is done where the light behind the splat would be less
// than the early stop: that splat is left out, and the sign of the transmittance is set.
void blend(inout vec4 sum, Record r, vec2 d, float least, float most, float least_light) {
    float u = r.root.x * d.x + r.root.y * d.y;
    float v = r.root.z * d.y;
    // Positive floats compare like integers, which takes one instruction.
    float alpha = intBitsToFloat(min(floatBitsToInt(most), floatBitsToInt(power_of_2(r.log_alpha - (u * u + v * v)))));
    float light = (alpha >= least ? alpha : 0.0) * sum.a;
    float behind = sum.a - light;
    bool is_open = behind >= least_light;
    light = is_open ? light : 0.0;
    sum = vec4(sum.rgb + light * r.colour, is_open ? behind : -abs(sum.a));
}

// Returns the blocks of a tile that a splat touches, with a margin for rounding: bit 2 row + column. `corner` is the tile's first pixel.
uint blocks_of(Record r, vec2 corner, float least) {
    Cut cut = cut_of(r, corner, float(TILE), least);
    uint blocks = 0u;
    [[unroll]] for (uint row = 0u; row < 4u; row++) {
        vec2 span = span_of(cut, float(row) * 4.0, float(row) * 4.0 + 3.0);
        bool touches = span.x <= span.y;
        blocks |= touches && span.x <= 7.0 ? 1u << (2u * row) : 0u;
        blocks |= touches && span.y >= 8.0 ? 2u << (2u * row) : 0u;
    }
    return blocks;
}

// Returns the bits that any lane has.
uint any_lane(uint bits) {
#if LANES == 8
    // Three steps of one instruction each.
    bits |= subgroupShuffleXor(bits, 1u);
    bits |= subgroupShuffleXor(bits, 2u);
    bits |= subgroupShuffleXor(bits, 4u);
    return bits;
#else
    return subgroupOr(bits);
#endif
}

// Returns the splat that lane `lane` has loaded.
Record record_of_lane(Record r, uint lane) {
    Record s;
    s.centre = subgroupShuffle(r.centre, lane);
    s.root = subgroupShuffle(r.root, lane);
    s.log_alpha = subgroupShuffle(r.log_alpha, lane);
    s.radius = 0.0;
    s.colour = subgroupShuffle(r.colour, lane);
    return s;
}
