#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
// Loops that a whole subgroup leaves at once contain loops that lanes leave one by one. Subgroup operations after the inner loops need all
// lanes reconverged.
#if DEVICE_SUBGROUP_UNIFORM_CONTROL_FLOW
#extension GL_EXT_subgroup_uniform_control_flow : require
#define RECONVERGES [[subgroup_uniform_control_flow]]
#else
#define RECONVERGES
#endif

// Blends a segment of a bin's list, near to far. The workgroup takes the entries in chunks: each invocation loads a splat to
// shared memory and notes the cells that it touches. Then the invocations that share a cell list the splats that touch it, and walk
// this list with the sums of the cell's pixels in registers.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"
#include "cells.glsl"
#include "seen.glsl"
#include "../mesh/behind.glsl"

#define LANES DEVICE_SUBGROUP_SIZE
const uint THREADS = RASTER_THREADS;
layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 1, std430) readonly buffer Further { uint further[]; };
layout(set = 0, binding = 2, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 3, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Sums { StoredSum sums[]; };
layout(set = 0, binding = 6, std430) readonly buffer Numbers { uint numbers[]; };
layout(set = 0, binding = 5, rgba32f) writeonly uniform image2D picture;
#if WITH_OUTPUTS
layout(set = 0, binding = 13, std430) writeonly buffer SegmentPixels { Pixel segment_pixels[]; };
#endif

// The workgroups of a bin share its rows of cells: ROWS for each. Cells per workgroup and per invocation.
const uint ROWS = ACROSS / uint(BIN_GROUPS);
const uint CELLS = ROWS * ACROSS;
const uint OWN = CELLS / CELLS_AT_ONCE;

// Each invocation takes a splat; the first one takes a splat that touches nothing, which pads lists.
const uint CHUNK = THREADS - 1u;
// Splats that touch more cells than this are noted by ballots.
const uint FEW_CELLS = 16u;
const uint WORDS = THREADS / 32u;
// The records of the chunk's splats, in the parts of 16 bytes that shared memory reads at once; in place of the centre, u and v of
// the falloff at the corner of the bin (record.glsl).
shared vec4 chunk_root[THREADS];
shared uvec4 chunk_rest[THREADS];
#if RECORD == RECORD_F32
shared vec4 chunk_colour[THREADS];
#endif
#if WITH_OUTPUTS
// The depth and the index of the chunk's splats, for outputs. With 32-bit records they are in the words above: the smallest devices have
// no more shared memory.
#if RECORD == RECORD_F32
#define DEPTH_OF_CHUNK(at) chunk_colour[at].a
#define INDEX_OF_CHUNK(at) chunk_rest[at].z
#else
shared uvec2 chunk_seen[THREADS];
#define DEPTH_OF_CHUNK(at) uintBitsToFloat(chunk_seen[at].x)
#define INDEX_OF_CHUNK(at) chunk_seen[at].y
#endif
#endif
// A row for each 32 splats of the chunk, with a word for each of the workgroup's cells: a bit for each splat that touches it. The row
// length is not a multiple of the number of memory banks, because the invocations of a cell read different rows.
const uint ROW = CELLS + 4u;
shared uint touching[WORDS * ROW];
// The part of each cell's list that is walked at a time: positions in the chunk, one byte each. Every invocation has one word of
// its cell's part.
const uint LISTED = 4u * CELL_LANES;
shared uint listed[THREADS];
// Words of `touching` for each invocation of a cell.
const uint PARTS = WORDS / CELL_LANES;
// Nonzero if any pixel still has light after a chunk; for even and odd chunks.
shared uint is_open[2];

// Finds the bin of the further segment `number`: the last whose further segments start at or before it.
uint bin_of(uint number, uint lane) {
    uint bin = 0u;
    uint span = uint(BIN_COUNT);
    while (span > 1u) {
        uint stride = (span + uint(LANES) - 1u) / uint(LANES);
        uint probe = bin + lane * stride;
        bool is_before = lane * stride < span && probe < uint(BIN_COUNT) && further[probe] <= number;
        bin += (subgroupBallotBitCount(subgroupBallot(is_before)) - 1u) * stride;
        span = stride;
    }
    return bin;
}

// Returns the splat that this invocation takes of the chunk that starts with entry `first`; an arbitrary splat if it takes none.
uint splat_of_chunk(uint first, uint end, uint thread) {
    uint entry = first + thread - 1u;
    return lists[thread > 0u && entry < end ? entry : end - 1u];
}

// Sums `value` over this and the lower invocations of a cell. Must be called by whole subgroups.
uint sum_in_cell(uint value, uint lane) {
    uint within = lane % CELL_LANES;
    [[unroll]] for (uint distance = 1u; distance < CELL_LANES; distance *= 2u) {
        uint below = subgroupShuffle(value, max(lane, distance) - distance);
        value += within >= distance ? below : 0u;
    }
    return value;
}

// Notes the cells that splat `at` of the chunk touches in the workgroup's rows, which begin at `top`. Must be called by whole subgroups.
void mark_cells(Cut cut, bool is_valid, uint at, uint lane, uint top) {
    uint row = at / 32u * ROW - top * ACROSS;
    uvec2 low = uvec2(cut.low) / CELL;
    uvec2 high = uvec2(max(cut.high, vec2(0.0))) / CELL;
    bool touches = is_valid && cut.low.x <= cut.high.x && cut.low.y <= cut.high.y;
#if BIN_GROUPS > 1
    low.y = max(low.y, top);
    high.y = min(high.y, top + ROWS - 1u);
    touches = touches && low.y <= high.y;
#endif
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
        // Atomics of many lanes to one word would be serialised.
        for (uint y = top; y < top + ROWS; y++) {
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
                    touching[word + ROW] = touch.y;
#if LANES > 64
                    touching[word + 2u * ROW] = touch.z;
                    touching[word + 3u * ROW] = touch.w;
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

void main() RECONVERGES {
    uint group = group_index() / uint(BIN_GROUPS);
    uint share = group_index() % uint(BIN_GROUPS);
    uint number = group - uint(BIN_COUNT);
    if (group >= uint(BIN_COUNT) && number >= further[BIN_COUNT]) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint thread = gl_SubgroupID * uint(LANES) + lane;
    // The first segment of each bin, then the further ones.
    uint bin = group;
    uint segment = 0u;
    if (group >= uint(BIN_COUNT)) {
        bin = bin_of(number, lane);
        segment = number - further[bin] + 1u;
    }
    vec2 corner = vec2(uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN);

    uvec2 range = ranges[bin];
    uint begin = range.x + segment * uint(SEGMENT_ENTRIES);
    uint end = min(begin + uint(SEGMENT_ENTRIES), range.y);

    // Colour and transmittance of each pixel; its alpha floor, which is above every alpha once the pixel is done; whether all of an
    // invocation's pixels in a cell are done.
    vec3 colours[OWN][CELL_PIXELS];
    float lights[OWN][CELL_PIXELS];
    float floors[OWN][CELL_PIXELS];
    bool is_done[OWN];
#if WITH_OUTPUTS
    Pixel pixels_of[OWN][CELL_PIXELS];
#endif
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        is_done[o] = false;
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
#if WITH_OUTPUTS
            pixels_of[o][p] = empty_pixel();
#if WITH_MESH
            pixels_of[o][p].limit = surface_depth(uvec2(corner) + pixel_at(pixel_place(thread, share * OWN + o, p)));
#endif
#endif
            colours[o][p] = vec3(0.0);
            lights[o][p] = 1.0;
            floors[o][p] = alpha_floor;
        }
    }

    // Loaded a chunk ahead, because the load of a record has to wait for its index.
    uint next_index = begin < end ? splat_of_chunk(begin, end, thread) : 0u;
    uint round = 0u;
    for (uint first = begin; first < end; first += CHUNK, round++) {
        uint entry = first + thread - 1u;
        bool is_entry = thread > 0u && entry < end;
        uint index = next_index;
        StoredRecord stored = records[index];
        next_index = splat_of_chunk(first + CHUNK, end, thread);
        barrier();
        if (first != begin && is_open[round & 1u] == 0u) {
            break;
        }
        if (thread == 0u) {
            is_open[(round + 1u) & 1u] = 0u;
        }
        Record r = COPY_NEAR(unpack_record(stored), corner.x + 0.5 * float(BIN));
        // An arbitrary ellipse in the bin, so that mark_cells converts small numbers.
        if (!is_entry) {
            r.centre = corner;
            r.root = vec3(1.0, 0.0, 1.0);
            r.log_alpha = -1e30;
        }
        vec2 centre = r.centre - corner;
        chunk_root[thread] = vec4(r.root.xy, -(r.root.x * centre.x + r.root.y * centre.y), -r.root.z * centre.y);
#if RECORD == RECORD_F32
        chunk_rest[thread] = floatBitsToUint(vec4(r.root.z, r.log_alpha, 0.0, 0.0));
        chunk_colour[thread] = stored.colour;
#if WITH_OUTPUTS
        chunk_rest[thread].z = index;
        // The padding splat is before every mesh, so that it ends no list.
        chunk_colour[thread].a = is_entry ? depth_of[index] : 0.0;
#endif
#else
        chunk_rest[thread] = uvec4(floatBitsToUint(vec2(r.root.z, r.log_alpha)), stored.rest.zw);
#if WITH_OUTPUTS
        chunk_seen[thread] = uvec2(floatBitsToUint(is_entry ? depth_of[index] : 0.0), index);
#endif
#endif
        for (uint w = thread; w < WORDS * ROW; w += THREADS) {
            touching[w] = 0u;
        }
        barrier();
        mark_cells(cut_of(r, corner, float(BIN), alpha_floor), is_entry, thread, lane, share * ROWS);
        barrier();

        bool all_done = true;
        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint cell = o * CELLS_AT_ONCE + thread / CELL_LANES;
            vec2 place = vec2(pixel_at(pixel_place(thread, share * OWN + o, 0u)));
            bool is_cell_open = (subgroupBallot(!is_done[o])[lane / 32u] >> (lane & 31u & ~(CELL_LANES - 1u)) & ((1u << CELL_LANES) - 1u)) != 0u;
            // Counts of the splats that touch the cell: in this invocation's words, up to and including these words, and in total.
            uint part = thread % CELL_LANES * PARTS;
            uint rest_of[PARTS];
            uint own_count = 0u;
            [[unroll]] for (uint i = 0u; i < PARTS; i++) {
                rest_of[i] = is_cell_open ? touching[(part + i) * ROW + cell] : 0u;
                own_count += uint(bitCount(rest_of[i]));
            }
            uint sum = sum_in_cell(own_count, lane);
            uint total = subgroupShuffle(sum, lane | (CELL_LANES - 1u));
            uint next = sum - own_count;
            uint list = thread / CELL_LANES * CELL_LANES;
            for (uint from = 0u; subgroupAny(from < total); from += LISTED) {
                listed[thread] = 0u;
                subgroupBarrier();
                [[unroll]] for (uint i = 0u; i < PARTS; i++) {
                    while (rest_of[i] != 0u && next < from + LISTED) {
                        uint at = (part + i) * 32u + uint(findLSB(rest_of[i]));
                        rest_of[i] &= rest_of[i] - 1u;
                        uint place = next - from;
                        atomicOr(listed[list + place / 4u], at << (8u * (place & 3u)));
                        next++;
                    }
                }
                subgroupBarrier();
                uint count = is_done[o] || from >= total ? 0u : min(total - from, LISTED);
                for (uint k = 0u; k < count; k += 4u) {
                    uint four = listed[list + k / 4u];
                    [[unroll]] for (uint j = 0u; j < 4u; j++) {
                        uint at = (four >> (8u * j)) & 255u;
                        vec4 root = chunk_root[at];
                        uvec4 rest = chunk_rest[at];
                        float u = root.x * place.x + (root.y * place.y + root.z);
                        float v = uintBitsToFloat(rest.x) * place.y + root.w;
                        float log_alpha = uintBitsToFloat(rest.y);
#if RECORD == RECORD_F32
                        vec3 colour = chunk_colour[at].rgb;
#else
                        vec3 colour = vec3(unpackHalf2x16(rest.z), unpackHalf2x16(rest.w).x);
#endif
#if WITH_OUTPUTS
                        Seen seen = Seen(DEPTH_OF_CHUNK(at), INDEX_OF_CHUNK(at), vec3(0.0));
#if WITH_NORMALS
                        seen.normal = normals[seen.index].xyz;
#endif
#endif
                        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
                            float alpha = min(alpha_cap, exp2(log_alpha - u * u - v * v));
#if WITH_MESH
                            floors[o][p] = seen.depth >= pixels_of[o][p].limit ? 2.0 : floors[o][p];
#endif
                            float light = alpha >= floors[o][p] ? alpha * lights[o][p] : 0.0;
#if STOP_AFTER == STOP_AFTER_SPLAT
                            bool stops = lights[o][p] - light < stop;
                            floors[o][p] = stops ? 2.0 : floors[o][p];
                            light = stops ? 0.0 : light;
#endif
#if WITH_OUTPUTS
                            add_splat(pixels_of[o][p], seen, light, lights[o][p], stop);
#endif
                            colours[o][p] += light * colour;
                            lights[o][p] -= light;
                            u += float(ROWS_AT_ONCE) * root.y;
                            v += float(ROWS_AT_ONCE) * uintBitsToFloat(rest.x);
                        }
                    }
                }
                subgroupBarrier();
            }
            is_done[o] = true;
            [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
#if STOP_AFTER == STOP_AFTER_CHUNK
                floors[o][p] = lights[o][p] < stop ? 2.0 : floors[o][p];
#endif
                is_done[o] = is_done[o] && floors[o][p] == 2.0;
            }
            all_done = all_done && is_done[o];
        }
        // One lane per subgroup, because atomics of many lanes to one word would be serialised.
        if (subgroupAny(!all_done) && lane == 0u) {
            atomicOr(is_open[(round + 1u) & 1u], 1u);
        }
    }

    bool is_whole = segments_of(range.y - range.x) == 1u;
    uint sum_place = is_whole ? 0u : segment == 0u ? numbers[bin] : FURTHER_SUMS + number;
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
            uint place = pixel_place(thread, share * OWN + o, p);
#if WITH_OUTPUTS
            pixels_of[o][p].light = lights[o][p];
#endif
            if (is_whole) {
                uvec2 at = uvec2(corner) + pixel_at(place);
                if (at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
                    imageStore(picture, ivec2(at), vec4(colours[o][p] + lights[o][p] * BEHIND(at, camera.background.rgb), 1.0));
#if WITH_OUTPUTS
                    pixels[at.y * uint(VIEWPORT_WIDTH) + at.x] = pixels_of[o][p];
#endif
                }
            } else {
                // Negative if the pixel is finished: further splats add nothing.
                float light = floors[o][p] == 2.0 ? -lights[o][p] : lights[o][p];
                sums[sum_place * BIN_PIXELS + place] = pack_sum(vec4(colours[o][p], light));
#if WITH_OUTPUTS
                segment_pixels[sum_place * BIN_PIXELS + place] = pixels_of[o][p];
#endif
            }
        }
    }
}
