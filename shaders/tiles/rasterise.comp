#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require
// Loops that a whole subgroup leaves at once contain loops that lanes leave one by one. Subgroup operations after the inner loops need all
// lanes reconverged.
#include "../reconverges.glsl"

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
#if PIXEL_WINDOW > 0
#include "window.glsl"
#endif

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

// Rows of cells in the bin; cells in the bin and per invocation.
const uint ROWS = BIN_ROWS / CELL;
const uint CELLS = ROWS * ACROSS;
const uint OWN = CELLS / CELLS_AT_ONCE;

// Each invocation takes a splat; the first one takes a splat that touches nothing, which pads lists.
const uint CHUNK = THREADS - 1u;
// True if cells are noted only by ballots, which write every word of `touching`. Otherwise a subgroup uses ballots if any of its splats has
// more than FEW_CELLS cells in its rectangle.
#define BALLOTS (LANES >= 32 && BIN_HEIGHT * BIN_SIDE <= 512)
const uint FEW_CELLS = 16u;
// Ballots for all cells of a larger bin would be too much code, and most of its rows are empty.
#define UNROLLS_ROWS (LANES >= 32 && BIN_SIDE == 32)
const uint WORDS = THREADS / 32u;
// The records of the chunk's splats, in the parts of 16 bytes that shared memory reads at once; in place of the centre, u and v of
// the falloff at the corner of the bin's square (record.glsl).
shared vec4 chunk_root[THREADS];
shared uvec4 chunk_rest[THREADS];
#if RECORD == RECORD_F32
shared float chunk_blue[THREADS];
#endif
#if PIXEL_WINDOW == 0 && WITH_OUTPUTS
// The depth and the index of the chunk's splats.
shared uvec2 chunk_seen[THREADS];
#elif PIXEL_WINDOW > 0
// The depths of the chunk's splats (projection.glsl): the change per pixel to the right and down, and the depth at the corner of the bin's
// square. Not vec3, of which some devices pad an array to 16 bytes each.
shared float chunk_across[THREADS];
shared float chunk_down[THREADS];
shared float chunk_depth[THREADS];
layout(set = 0, binding = 14, std430) readonly buffer Planes { float planes[]; };
#endif
// A row for each 32 splats of the chunk, with a word for each of the bin's cells: a bit for each splat that touches it. The row
// length is not a multiple of the number of memory banks, because the invocations of a cell read different rows.
const uint ROW = CELLS + 4u;
shared uint touching[WORDS * ROW];
// The part of each cell's list that is walked at a time: positions in the chunk, one byte each. Every invocation has one word of
// its cell's part.
const uint LISTED = 4u * uint(CELL_LANES);
shared uint listed[THREADS];
// Each invocation of a cell lists an equal part of the chunk's splats: the bits of a word of `touching`, of half a word, or of several.
const uint PART_BITS = min(THREADS / uint(CELL_LANES), 32u);
const uint PARTS = THREADS / (uint(CELL_LANES) * PART_BITS);
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
    uint within = lane % uint(CELL_LANES);
    [[unroll]] for (uint distance = 1u; distance < uint(CELL_LANES); distance *= 2u) {
        uint below = subgroupShuffle(value, max(lane, distance) - distance);
        value += within >= distance ? below : 0u;
    }
    return value;
}

// Notes the cells that the subgroup's splats touch, with a ballot for each cell. Atomics of many lanes to one word would be serialised.
void mark_by_ballots(Cut cut, uvec2 low, uvec2 high, bool touches, uint at, uint lane) {
    // A lane for each of up to 32 cells, in whole rows.
    const uint ROWS_PER_TURN = min(ROWS, 32u / ACROSS);
#if UNROLLS_ROWS
    [[unroll]]
#endif
    for (uint top = 0u; top < ROWS; top += ROWS_PER_TURN) {
        uvec4 words = uvec4(0u);
        [[unroll]] for (uint y = 0u; y < ROWS_PER_TURN; y++) {
            uint row = top + y;
            uint columns = touches && row >= low.y && row <= high.y ? columns_of(cut, row) : 0u;
#if !UNROLLS_ROWS
            if (subgroupAll(columns == 0u)) {
                continue;
            }
#endif
            [[unroll]] for (uint x = 0u; x < ACROSS; x++) {
                uvec4 touch = subgroupBallot(((columns >> x) & 1u) != 0u);
#if LANES >= 32
                words = lane == y * ACROSS + x ? touch : words;
#else
                if (lane == 0u && touch.x != 0u) {
                    atomicOr(touching[at / 32u * ROW + row * ACROSS + x], touch.x << (at & 31u));
                }
#endif
            }
        }
#if LANES >= 32
        if (lane < ROWS_PER_TURN * ACROSS) {
            [[unroll]] for (uint w = 0u; w < uint(LANES) / 32u; w++) {
                touching[(at / uint(LANES) * (uint(LANES) / 32u) + w) * ROW + top * ACROSS + lane] = words[w];
            }
        }
#endif
    }
}

// Notes the cells that splat `at` of the chunk touches. Must be called by whole subgroups.
void mark_cells(Cut cut, bool is_valid, uint at, uint lane) {
    uvec2 low = uvec2(cut.low) / CELL;
    uvec2 high = uvec2(max(cut.high, vec2(0.0))) / CELL;
    bool touches = is_valid && cut.low.x <= cut.high.x && cut.low.y <= cut.high.y;
#if !BALLOTS
    uint box = touches ? (high.x - low.x + 1u) * (high.y - low.y + 1u) : 0u;
    if (subgroupAll(box <= FEW_CELLS)) {
        for (uint y = low.y; touches && y <= high.y; y++) {
            uint columns = columns_of(cut, y);
            while (columns != 0u) {
                uint x = uint(findLSB(columns));
                columns &= columns - 1u;
                atomicOr(touching[at / 32u * ROW + y * ACROSS + x], 1u << (at & 31u));
            }
        }
        return;
    }
#endif
    mark_by_ballots(cut, low, high, touches, at, lane);
}

void main() RECONVERGES {
    uint group = group_index();
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
    // The bin's first pixel. The falloff is computed from the corner of the square with sides of BIN pixels that contains the bin, so that
    // the height of bins changes no rounding.
    uvec2 origin = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN_SIZE;
    uvec2 square = origin / BIN * BIN;
    vec2 corner = vec2(square);

    uvec2 range = ranges[bin];
    uint begin = range.x + segment * uint(SEGMENT_ENTRIES);
    uint end = min(begin + uint(SEGMENT_ENTRIES), range.y);

    // Colour and transmittance of each pixel; its alpha floor, which is above every alpha once the pixel is done; whether all of an
    // invocation's pixels in a cell are done.
    vec3 colours[OWN][CELL_PIXELS];
    float lights[OWN][CELL_PIXELS];
    float floors[OWN][CELL_PIXELS];
    bool is_done[OWN];
#if PIXEL_WINDOW > 0
    Window windows[OWN][CELL_PIXELS];
#endif
#if WITH_OUTPUTS
    Pixel pixels_of[OWN][CELL_PIXELS];
#endif
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        is_done[o] = false;
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
#if WITH_OUTPUTS
            pixels_of[o][p] = empty_pixel();
#if WITH_MESH
            pixels_of[o][p].limit = surface_depth(origin + pixel_at(pixel_place(thread, o, p)));
#endif
#endif
            colours[o][p] = vec3(0.0);
            lights[o][p] = 1.0;
            floors[o][p] = alpha_floor;
#if PIXEL_WINDOW > 0
            windows[o][p] = empty_window();
#endif
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
        chunk_rest[thread] = floatBitsToUint(vec4(r.root.z, r.log_alpha, r.colour.rg));
        chunk_blue[thread] = r.colour.b;
#else
        chunk_rest[thread] = uvec4(floatBitsToUint(vec2(r.root.z, r.log_alpha)), stored.rest.zw);
#endif
#if PIXEL_WINDOW > 0
        vec3 plane = vec3(planes[3u * index], planes[3u * index + 1u], planes[3u * index + 2u]);
        chunk_across[thread] = plane.y;
        chunk_down[thread] = plane.z;
        chunk_depth[thread] = plane.x - dot(plane.yz, centre);
#elif WITH_OUTPUTS
        // The padding splat is before every mesh, so that it ends no list.
        chunk_seen[thread] = uvec2(floatBitsToUint(is_entry ? depth_of[index] : 0.0), index);
#endif
#if !BALLOTS
        for (uint w = thread; w < WORDS * ROW; w += THREADS) {
            touching[w] = 0u;
        }
        barrier();
#endif
        mark_cells(cut_of(r, vec2(origin), vec2(BIN_SIZE), alpha_floor), is_entry, thread, lane);
        barrier();

        bool all_done = true;
        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint cell = o * CELLS_AT_ONCE + thread / uint(CELL_LANES);
            vec2 place = vec2(origin - square + pixel_at(pixel_place(thread, o, 0u)));
            uint open_lanes = subgroupBallot(!is_done[o])[lane / 32u] >> (lane & 31u & ~uint(CELL_LANES - 1));
            bool is_cell_open = (open_lanes & ((1u << CELL_LANES) - 1u)) != 0u;
            // Counts of the splats that touch the cell: in this invocation's parts, up to and including these parts, and in total.
            uint part = thread % uint(CELL_LANES) * PARTS;
            uint rest_of[PARTS];
            uint own_count = 0u;
            [[unroll]] for (uint i = 0u; i < PARTS; i++) {
                uint first_bit = (part + i) * PART_BITS;
                uint word = is_cell_open ? touching[first_bit / 32u * ROW + cell] : 0u;
                rest_of[i] = bitfieldExtract(word, int(first_bit & 31u), int(PART_BITS));
                own_count += uint(bitCount(rest_of[i]));
            }
            uint sum = sum_in_cell(own_count, lane);
            uint total = subgroupShuffle(sum, lane | uint(CELL_LANES - 1));
            uint next = sum - own_count;
            uint list = thread / uint(CELL_LANES) * uint(CELL_LANES);
            for (uint from = 0u; subgroupAny(from < total); from += LISTED) {
                listed[thread] = 0u;
                subgroupBarrier();
                [[unroll]] for (uint i = 0u; i < PARTS; i++) {
                    while (rest_of[i] != 0u && next < from + LISTED) {
                        uint at = (part + i) * PART_BITS + uint(findLSB(rest_of[i]));
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
                        vec3 colour = vec3(uintBitsToFloat(rest.zw), chunk_blue[at]);
#else
                        vec3 colour = vec3(unpackHalf2x16(rest.z), unpackHalf2x16(rest.w).x);
#endif
#if PIXEL_WINDOW > 0
                        float depth = chunk_across[at] * place.x + (chunk_down[at] * place.y + chunk_depth[at]);
#elif WITH_OUTPUTS
                        Seen seen = Seen(uintBitsToFloat(chunk_seen[at].x), chunk_seen[at].y, vec3(0.0));
#if WITH_NORMALS
                        seen.normal = normals[seen.index].xyz;
#endif
#endif
                        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
                            float alpha = min(alpha_cap, exp2(log_alpha - u * u - v * v));
#if PIXEL_WINDOW > 0
#if WITH_MESH
                            alpha = depth < pixels_of[o][p].limit ? alpha : 0.0;
#endif
                            if (alpha >= floors[o][p]) {
                                StoredLight next = pack_light(colour, alpha);
#if WITH_OUTPUTS
                                uint next_index = lists[first + at - 1u];
#endif
                                push(windows[o][p], depth, next AND(next_index));
                                blend(colours[o][p], lights[o][p], floors[o][p], next AND(pixels_of[o][p]) AND(next_index));
                            }
                            depth += float(ROWS_AT_ONCE) * chunk_down[at];
#else
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
#endif
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

#if PIXEL_WINDOW > 0
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
            [[unroll]] for (uint w = 0u; w < uint(PIXEL_WINDOW); w++) {
                blend(colours[o][p], lights[o][p], floors[o][p], windows[o][p].lights[w] AND(pixels_of[o][p])
                      AND(windows[o][p].indices[w]));
            }
        }
    }
#endif

    bool is_whole = segments_of(range.y - range.x) == 1u;
    uint sum_place = is_whole ? 0u : segment == 0u ? numbers[bin] : FURTHER_SUMS + number;
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        [[unroll]] for (uint p = 0u; p < CELL_PIXELS; p++) {
            uint place = pixel_place(thread, o, p);
#if WITH_OUTPUTS
            pixels_of[o][p].light = lights[o][p];
#endif
            if (is_whole) {
                uvec2 at = origin + pixel_at(place);
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
