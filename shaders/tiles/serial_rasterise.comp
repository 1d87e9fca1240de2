#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// Blends the first SERIAL_SEGMENT entries of a tile's list, near to far, and writes the tile. A workgroup is one subgroup, without
// barriers or shared memory. It takes the entries CHUNK at a time: each lane loads splats and finds the blocks that they touch.
// Then each block walks the splats that touch it, which lanes share by shuffles. A CPU driver executes both sides of an `if`, and
// branches only for loops. So each block has its own loop, whose first iteration runs without a test. An iteration blends two
// splats, because at its end a CPU writes all sums, with a mask.
//
// If a list is longer and a pixel of the tile still has light, the picture holds colour and transmittance, and serial_deep.comp continues.

#include "../camera.glsl"
#include "serial.glsl"
#include "live.glsl"
#include "record.glsl"
#include "serial_blend.glsl"
#include "../mesh/behind.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 1, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 2, std430) readonly buffer Records { StoredRecord records[]; };
// Words 0 to 2: the indirect dispatch of serial_deep.comp; 3: the number of tiles left to it; then these tiles.
layout(set = 0, binding = 3, std430) buffer Deep { uint deep[]; };
layout(set = 0, binding = 4, rgba32f) writeonly uniform image2D picture;

// Splats that a lane loads at a time. More would make the blocks' loops longer, and a CPU mispredicts their ends.
const uint OWN = LOADERS <= 16 ? 2u : 1u;
const uint CHUNK = OWN * uint(LOADERS);
// Masks of the chunk's splats, one per block, are packed PER_WORD to a word.
const uint PER_WORD = 32u / CHUNK;
const uint WORDS = BLOCKS / PER_WORD;

// Returns the index of the lowest set bit; an arbitrary index below CHUNK if there is none.
uint lowest_bit(uint bits) {
#if LOADERS < 16
    // Through a float: AVX2 has no vector instruction for finding bits.
    return uint((floatBitsToInt(float(int(bits & (~bits + 1u)))) >> 23) - 127) & (CHUNK - 1u);
#else
    return uint(findLSB(bits)) & (CHUNK - 1u);
#endif
}

// Selects `a` or `b`.
Splat choose(bool first, Splat a, Splat b) {
    return Splat(first ? a.at : b.at, first ? a.root : b.root, first ? a.log_alpha : b.log_alpha, first ? a.colour : b.colour,
                 first ? a.bend : b.bend AND(first ? a.seen : b.seen));
}

// Clears the lowest set bit and returns its splat; an invisible splat if no bit is set.
Splat next_splat(Splat own[OWN], inout uint bits) {
    uint next = lowest_bit(bits);
    Splat s = splat_of_lane(own[0], next & uint(LOADERS - 1));
    if (OWN > 1u) {
        s = choose(next < uint(LOADERS), s, splat_of_lane(own[OWN - 1u], next & uint(LOADERS - 1)));
    }
    s.log_alpha = bits != 0u ? s.log_alpha : -1e6;
    bits &= bits - 1u;
    return s;
}

// Returns the tile of workgroup `index`, which may be to the right of the picture.
//
// A CPU driver gives each thread an equal range of consecutive workgroups. Tiles go row by row through strips of STRIP columns,
// because neighbouring tiles share records in the cache. Strips are in bit-reversed order, which spreads every range over the whole
// width of the picture, to balance the threads' load.
uvec2 tile_at(uint index) {
    const uint STRIP_TILES = uint(STRIP) * TILES_Y;
    uint strip = index / STRIP_TILES;
    uint within = index % STRIP_TILES;
    strip = STRIP_BITS == 0 ? 0u : bitfieldReverse(strip) >> (32 - STRIP_BITS);
    return uvec2(strip * uint(STRIP) + within % uint(STRIP), within / uint(STRIP));
}

void main() {
    // A dispatch with several rows of workgroups may have more than TILE_PLACES of them.
    uint index = group_index();
    uvec2 tile = tile_at(index);
    if (index >= uint(TILE_PLACES) || tile.x >= TILES_X) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uvec2 first_pixel = tile * TILE;
    vec2 corner = vec2(first_pixel);
    uint bin = bin_of_tile(tile);
    uint begin = min(ranges[bin].x, uint(ENTRIES));
    uint list_end = min(ranges[bin].y, uint(ENTRIES));
    uint end = min(list_end, begin + uint(SERIAL_SEGMENT));
    Limits limits = limits();

    vec4 sums[BLOCKS][VECTORS];
    [[unroll]] for (uint b = 0u; b < BLOCKS; b++) {
        [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
            sums[b][v] = vec4(0.0, 0.0, 0.0, 1.0);
        }
    }
#if WITH_OUTPUTS
    Pixel pixels_of[BLOCKS][VECTORS];
    [[unroll]] for (uint b = 0u; b < BLOCKS; b++) {
        [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
            pixels_of[b][v] = empty_pixel();
#if WITH_MESH
            pixels_of[b][v].limit = surface_depth(first_pixel + pixel_in_tile(b, v, lane));
#endif
        }
    }
#endif
    // Blocks that still have light.
    uint open = (1u << BLOCKS) - 1u;

    for (uint first = begin; first < end && open != 0u; first += CHUNK) {
        Splat own[OWN];
        uint words[WORDS];
        [[unroll]] for (uint w = 0u; w < WORDS; w++) {
            words[w] = 0u;
        }
        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint at = first + o * uint(LOADERS) + lane;
            uint index = lists[min(at, end - 1u)];
            Record r = COPY_NEAR(unpack_record(records[index]), corner.x + 0.5 * float(TILE));
            own[o] = seen_from(corner, r, limits AND(index));
            uint touched = lane < uint(LOADERS) && at < end ? blocks_of(r, corner, alpha_floor) & open : 0u;
            [[unroll]] for (uint b = 0u; b < BLOCKS; b++) {
                words[b / PER_WORD] |= ((touched >> b) & 1u) << ((b % PER_WORD) * CHUNK + o * uint(LOADERS) + (lane & uint(LOADERS - 1)));
            }
        }
        [[unroll]] for (uint w = 0u; w < WORDS; w++) {
            words[w] = any_lane(words[w]);
        }
        uint lit = 0u;

#define BLEND_BLOCK(b) { \
        uint bits = bitfieldExtract(words[b / PER_WORD], int((b % PER_WORD) * CHUNK), int(CHUNK)); \
        do { \
            Splat one = next_splat(own, bits); \
            Splat other = next_splat(own, bits); \
            blend_block(sums[b], one, vec2(pixel_in_tile(b, 0u, lane)), limits AND(pixels_of[b])); \
            blend_block(sums[b], other, vec2(pixel_in_tile(b, 0u, lane)), limits AND(pixels_of[b])); \
        } while (bits != 0u); \
        lit |= has_light(sums[b], limits) ? 1u << b : 0u; }

        BLEND_BLOCK(0u)
        BLEND_BLOCK(1u)
        BLEND_BLOCK(2u)
        BLEND_BLOCK(3u)
        open = any_lane(lit);
    }

    bool is_whole = end == list_end || open == 0u;
    if (!is_whole && lane == 0u) {
        uint slot = atomicAdd(deep[3], 1u);
        deep[4u + slot] = tile.y * TILES_X + tile.x;
        atomicMax(deep[0], BLOCKS);
        atomicMax(deep[1], min(slot + 1u, 65535u));
        atomicMax(deep[2], slot / 65535u + 1u);
    }
    vec3 background = camera.background.rgb;
    [[unroll]] for (uint b = 0u; b < BLOCKS; b++) {
        [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
            uvec2 at = first_pixel + pixel_in_tile(b, v, lane);
            vec4 sum = sums[b][v];
            vec4 whole = vec4(sum.rgb + abs(sum.a) * BEHIND(at, background), 1.0);
            if (at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
                imageStore(picture, ivec2(at), is_whole ? whole : sum);
#if WITH_OUTPUTS
                pixels_of[b][v].light = abs(sum.a);
                pixels[at.y * uint(VIEWPORT_WIDTH) + at.x] = pixels_of[b][v];
#endif
            }
        }
    }
}
