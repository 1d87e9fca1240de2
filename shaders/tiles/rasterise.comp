#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_EXT_control_flow_attributes : require

// Blends a segment of a bin's list, near to far. The workgroup takes the entries in chunks: each invocation loads a splat to
// shared memory and notes the cells that it touches. Then every eight invocations walk, for each of their own cells, only the splats
// that touch it, with the sums of its pixels in registers.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"
#include "cells.glsl"

#define LANES DEVICE_SUBGROUP_SIZE
const uint THREADS = RASTER_THREADS;
layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 1, std430) readonly buffer Segments { uint segment_starts[]; };
layout(set = 0, binding = 2, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 3, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 4, std430) readonly buffer Places { uint sum_places[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Sums { StoredSum sums[]; };
layout(set = 0, binding = 6, rgba32f) writeonly uniform image2D picture;

// Cells of an invocation.
const uint OWN = CELLS / CELLS_AT_ONCE;

const uint CHUNK = THREADS;
// Splats that touch more cells than this are noted by ballots.
const uint FEW_CELLS = 16u;
const uint WORDS = CHUNK / 32u;
// The records of the chunk's splats, in the parts of 16 bytes that shared memory reads at once.
shared vec4 chunk_root[CHUNK];
shared uvec4 chunk_rest[CHUNK];
#if RECORD == RECORD_F32
shared vec4 chunk_colour[CHUNK];
#endif
// A row for each 32 splats of the chunk: for each cell, a bit for each of them that touches it.
shared uint touching[WORDS * CELLS];

// Finds the bin of segment `group`: the last that starts at or before it.
uint bin_of(uint group, uint lane) {
    uint bin = 0u;
    uint span = uint(BIN_COUNT);
    while (span > 1u) {
        uint stride = (span + uint(LANES) - 1u) / uint(LANES);
        uint probe = bin + lane * stride;
        bool is_before = lane * stride < span && probe < uint(BIN_COUNT) && segment_starts[probe] <= group;
        bin += (subgroupBallotBitCount(subgroupBallot(is_before)) - 1u) * stride;
        span = stride;
    }
    return bin;
}

// Notes the cells that splat `at` of the chunk touches. Must be called by whole subgroups.
void mark_cells(Cut cut, bool is_valid, uint at, uint lane) {
    uint row = at / 32u * CELLS;
    uvec2 low = uvec2(cut.low / SIDE);
    uvec2 high = uvec2(max(cut.high, vec2(0.0)) / SIDE);
    bool touches = is_valid && cut.low.x <= cut.high.x && cut.low.y <= cut.high.y;
    uint box = touches ? (high.x - low.x + 1u) * (high.y - low.y + 1u) : 0u;
    if (subgroupAll(box <= FEW_CELLS)) {
        for (uint y = low.y; touches && y <= high.y; y++) {
            uint columns = columns_of(cut, y);
            while (columns != 0u) {
                uint x = uint(findLSB(columns));
                columns &= columns - 1u;
                atomicOr(touching[row + y * ACROSS + x], 1u << (at & 31u));
            }
        }
    } else {
        // Atomics of many lanes to one word would wait for each other.
        for (uint y = 0u; y < ACROSS; y++) {
            uint columns = touches && y >= low.y && y <= high.y ? columns_of(cut, y) : 0u;
            if (subgroupAll(columns == 0u)) {
                continue;
            }
            [[unroll]] for (uint x = 0u; x < ACROSS; x++) {
                uvec4 touch = subgroupBallot(((columns >> x) & 1u) != 0u);
                uint word = row + y * ACROSS + x;
#if LANES == 32
                if (lane == x) {
                    touching[word] = touch.x;
                }
#elif LANES > 32
                if (lane == x) {
                    touching[word] = touch.x;
                    touching[word + CELLS] = touch.y;
#if LANES > 64
                    touching[word + 2u * CELLS] = touch.z;
                    touching[word + 3u * CELLS] = touch.w;
#endif
                }
#else
                if (lane == 0u && touch.x != 0u) {
                    atomicOr(touching[word], touch.x << (at & 31u));
                }
#endif
            }
        }
    }
}

void main() {
    uint group = group_index();
    if (group >= segment_starts[BIN_COUNT]) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint thread = gl_SubgroupID * uint(LANES) + lane;
    uint bin = bin_of(group, lane);
    vec2 corner = vec2(uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN);

    uint list = min(starts[bin], uint(ENTRIES));
    uint list_end = min(starts[bin + 1u], uint(ENTRIES));
    uint segment = group - segment_starts[bin];
    uint begin = list + segment * uint(SEGMENT_ENTRIES);
    uint end = min(begin + uint(SEGMENT_ENTRIES), list_end);

    // Colour and transmittance of each pixel; its alpha floor, which no alpha reaches when it is done; whether all of an
    // invocation's pixels in a cell are.
    vec3 colours[OWN][CELL_PIXELS];
    float lights[OWN][CELL_PIXELS];
    float floors[OWN][CELL_PIXELS];
    bool is_done[OWN];
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        is_done[o] = false;
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
            colours[o][p] = vec3(0.0);
            lights[o][p] = 1.0;
            floors[o][p] = alpha_floor;
        }
    }

    for (uint first = begin; first < end; first += CHUNK) {
        StoredRecord stored = records[lists[min(first + thread, end - 1u)]];
        barrier();
        chunk_root[thread] = stored.centre_root;
#if RECORD == RECORD_F32
        chunk_rest[thread] = floatBitsToUint(stored.rest);
        chunk_colour[thread] = stored.colour;
#else
        chunk_rest[thread] = uvec4(floatBitsToUint(stored.rest), stored.colour);
#endif
        for (uint w = thread; w < WORDS * CELLS; w += THREADS) {
            touching[w] = 0u;
        }
        barrier();
        mark_cells(cut_of(unpack_record(stored), corner, float(BIN), alpha_floor), first + thread < end, thread, lane);
        barrier();

        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint cell = o * CELLS_AT_ONCE + thread / CELL_THREADS;
            vec2 place = corner + vec2(pixel_at(pixel_place(thread, o, 0u)));
            uint words = 0u;
            [[unroll]] for (uint w = 0u; w < WORDS; w++) {
                words |= touching[w * CELLS + cell] != 0u ? 1u << w : 0u;
            }
            words = is_done[o] ? 0u : words;
            uint word = 0u;
            uint bits = 0u;
            while ((words | bits) != 0u) {
                if (bits == 0u) {
                    word = uint(findLSB(words));
                    words &= words - 1u;
                    bits = touching[word * CELLS + cell];
                }
                uint at = word * 32u + uint(findLSB(bits));
                bits &= bits - 1u;
                vec4 centre_root = chunk_root[at];
                uvec4 rest = chunk_rest[at];
#if RECORD == RECORD_F32
                Record r = unpack_record(StoredRecord(centre_root, uintBitsToFloat(rest), chunk_colour[at]));
#else
                Record r = unpack_record(StoredRecord(centre_root, uintBitsToFloat(rest.xy), rest.zw));
#endif
                vec2 d = place - r.centre;
                float u = r.root.x * d.x + r.root.y * d.y;
                float v = r.root.z * d.y;
                [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
                    float alpha = min(alpha_cap, exp2(r.log_alpha - u * u - v * v));
                    float light = alpha >= floors[o][p] ? alpha * lights[o][p] : 0.0;
#if STOP_AFTER == STOP_AFTER_SPLAT
                    bool stops = lights[o][p] - light < stop;
                    floors[o][p] = stops ? 2.0 : floors[o][p];
                    light = stops ? 0.0 : light;
#endif
                    colours[o][p] += light * r.colour;
                    lights[o][p] -= light;
                    u += float(ROWS_BETWEEN) * r.root.y;
                    v += float(ROWS_BETWEEN) * r.root.z;
                }
            }
            is_done[o] = true;
            [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
#if STOP_AFTER == STOP_AFTER_CHUNK
                floors[o][p] = lights[o][p] < stop ? 2.0 : floors[o][p];
#endif
                is_done[o] = is_done[o] && floors[o][p] == 2.0;
            }
        }
    }

    bool is_whole = segment_starts[bin + 1u] - segment_starts[bin] == 1u;
    uint sum_place = sum_places[bin] + group - segment_starts[bin];
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
            uint place = pixel_place(thread, o, p);
            if (is_whole) {
                uvec2 at = uvec2(corner) + pixel_at(place);
                if (at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
                    imageStore(picture, ivec2(at), vec4(colours[o][p] + lights[o][p] * camera.background.rgb, 1.0));
                }
            } else {
                // Below 0 if the pixel is done: what is behind it adds nothing.
                float light = floors[o][p] == 2.0 ? -lights[o][p] : lights[o][p];
                sums[sum_place * BIN_PIXELS + place] = pack_sum(vec4(colours[o][p], light));
            }
        }
    }
}
