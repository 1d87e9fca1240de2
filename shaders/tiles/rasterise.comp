#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_EXT_control_flow_attributes : require

// Blends a segment of a bin's list, near to far. The workgroup takes the entries in chunks: each invocation loads a splat to
// shared memory and finds the cells that it touches. Then every eight invocations walk, for each of their own two cells, only the
// splats that touch it, with the sums of its pixels in registers.

#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"
#include "cells.glsl"

#define LANES DEVICE_SUBGROUP_SIZE
const uint THREADS = 256u;
layout(local_size_x = 256) in;

layout(push_constant) uniform Phase { uint phase; };

layout(set = 0, binding = 0, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 1, std430) readonly buffer Segments { uint segment_starts[]; };
layout(set = 0, binding = 2, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 3, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 4, std430) readonly buffer Open { uint open_cells[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Partials { StoredSum partials[]; };

// Cells and pixels of a cell that an invocation has a share of.
const uint OWN = 64u * 8u / THREADS;
const uint PIXELS = uint(CELL) * uint(CELL) / 8u;

const uint CHUNK = THREADS;
const uint WORDS = CHUNK / 32u;
// The records of the chunk's splats, in the parts of 16 bytes that shared memory reads at once.
#if RECORD == RECORD_F32
shared vec4 chunk_colour[CHUNK];
#endif
shared vec4 chunk_root[CHUNK];
shared uvec4 chunk_rest[CHUNK];
// For each cell, a bit for each splat of the chunk: whether it touches.
shared uint touching[64u * WORDS];
// For each cell, the pixels that let no more light through.
shared uint closed_pixels[64];

// Finds the bin of segment `group` of the phase: the last that starts at or before it.
uint bin_of(uint group, uint lane) {
    const uint ROW = uint(BIN_COUNT) + 1u;
    uint bin = 0u;
    uint span = uint(BIN_COUNT);
    while (span > 1u) {
        uint stride = (span + uint(LANES) - 1u) / uint(LANES);
        uint probe = bin + lane * stride;
        bool is_before = lane * stride < span && probe < uint(BIN_COUNT) && segment_starts[phase * ROW + probe] <= group;
        bin += (subgroupBallotBitCount(subgroupBallot(is_before)) - 1u) * stride;
        span = stride;
    }
    return bin;
}

void main() {
    const uint ROW = uint(BIN_COUNT) + 1u;
    uint group = group_index();
    if (group >= segment_starts[phase * ROW + uint(BIN_COUNT)]) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint thread = gl_SubgroupID * uint(LANES) + lane;
    uint bin = bin_of(group, lane);
    vec2 corner = vec2(uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN);

    uint list = min(starts[bin], uint(ENTRIES));
    uint list_end = min(starts[bin + 1u], uint(ENTRIES));
    uint segment = first_segment(segments_of(list_end - list), phase) + group - segment_starts[phase * ROW + bin];
    uint begin = list + segment * uint(SEGMENT);
    uint end = min(begin + uint(SEGMENT), list_end);

    uvec2 open = uvec2(open_cells[2u * bin], open_cells[2u * bin + 1u]);
    if ((open.x | open.y) == 0u) {
        return;
    }
    if (thread < 64u) {
        closed_pixels[thread] = 0u;
    }

    // Colour and transmittance of each pixel; its alpha floor, which no alpha reaches when it is done; the pixels of each cell
    // that are counted as closed.
    vec4 sums[OWN][PIXELS];
    float floors[OWN][PIXELS];
    uint counted[OWN];
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        counted[o] = 0u;
        [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
            sums[o][p] = vec4(0.0, 0.0, 0.0, 1.0);
            floors[o][p] = alpha_floor;
        }
    }
    // An invocation's first pixel in a cell; the others are below it.
    const uint ROWS_BETWEEN = 8u / uint(CELL);
    uint eighth = thread & 7u;
    vec2 pixel = corner + vec2(eighth % uint(CELL), eighth / uint(CELL));

    for (uint first = begin; first < end; first += CHUNK) {
        barrier();
#if LANES < 32
        for (uint w = thread; w < 64u * WORDS; w += THREADS) {
            touching[w] = 0u;
        }
        barrier();
#endif
        uvec2 cells = uvec2(0u);
        if (first + thread < end) {
            StoredRecord stored = records[lists[first + thread]];
            chunk_root[thread] = stored.centre_root;
#if RECORD == RECORD_F32
            chunk_rest[thread] = floatBitsToUint(stored.rest);
            chunk_colour[thread] = stored.colour;
#else
            chunk_rest[thread] = uvec4(floatBitsToUint(stored.rest), stored.colour);
#endif
            cells = cells_of(unpack_record(stored), corner) & open;
        }
        [[unroll]] for (uint c = 0u; c < 64u; c++) {
            uvec4 touch = subgroupBallot(((c < 32u ? cells.x : cells.y) & (1u << (c & 31u))) != 0u);
#if LANES == 32
            if (lane == (c & 31u)) {
                touching[c * WORDS + thread / 32u] = touch.x;
            }
#elif LANES > 32
            if (lane == c) {
                touching[c * WORDS + thread / 32u] = touch.x;
                touching[c * WORDS + thread / 32u + 1u] = touch.y;
            }
#else
            if (lane == 0u && touch.x != 0u) {
                atomicOr(touching[c * WORDS + thread / 32u], touch.x << (thread & 31u));
            }
#endif
        }
        barrier();

        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint cell = o * (THREADS / 8u) + thread / 8u;
            if (closed_pixels[cell] == uint(CELL) * uint(CELL)) {
                continue;
            }
            vec2 place = pixel + float(CELL) * vec2(cell % 8u, cell / 8u);
            uint words = 0u;
            [[unroll]] for (uint w = 0u; w < WORDS; w++) {
                words |= touching[cell * WORDS + w] != 0u ? 1u << w : 0u;
            }
            uint word = 0u;
            uint bits = 0u;
            while ((words | bits) != 0u) {
                if (bits == 0u) {
                    word = uint(findLSB(words));
                    words &= words - 1u;
                    bits = touching[cell * WORDS + word];
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
                [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
                    float alpha = min(alpha_cap, exp2(r.log_alpha - (u * u + v * v)));
                    float light = alpha >= floors[o][p] ? alpha * sums[o][p].a : 0.0;
                    float behind = sums[o][p].a - light;
                    bool is_done = behind < stop;
                    floors[o][p] = is_done ? 2.0 : floors[o][p];
                    light = is_done ? 0.0 : light;
                    sums[o][p] = vec4(sums[o][p].rgb + light * r.colour, sums[o][p].a - light);
                    u += float(ROWS_BETWEEN) * r.root.y;
                    v += float(ROWS_BETWEEN) * r.root.z;
                }
            }
            uint closed = 0u;
            [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
                closed += floors[o][p] == 2.0 ? 1u : 0u;
            }
            if (closed > 0u) {
                atomicAdd(closed_pixels[o * (THREADS / 8u) + thread / 8u], closed - counted[o]);
                counted[o] = closed;
            }
        }
    }

    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
            vec4 sum = sums[o][p];
            // Below 0 if the pixel is done: what is behind it adds nothing.
            sum.a = floors[o][p] == 2.0 ? -sum.a : sum.a;
            partials[group * BIN_PIXELS + (o * PIXELS + p) * THREADS + thread] = pack_sum(sum);
        }
    }
}
