#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_EXT_control_flow_attributes : require

// Blends the splats of a bin, near to far. One workgroup takes one bin, and its list in chunks: each invocation loads a splat
// to shared memory and finds the subtiles of 8 x 8 pixels that it touches. Then each subgroup walks, for each of its own subtiles,
// only the splats that touch it, with the sums of its pixels in registers. A workgroup ends when no pixel is left that lets
// light through.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "tiles.glsl"

#define LANES DEVICE_SUBGROUP_SIZE
const uint SUBGROUPS = uint(RASTER_SUBGROUPS);
const uint THREADS = SUBGROUPS * uint(LANES);
layout(local_size_x = RASTER_SUBGROUPS * LANES) in;

layout(set = 0, binding = 0, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 1, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 2, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 3, rgba32f) writeonly uniform image2D picture;

// Subtiles of a bin, of a subgroup, and pixels of a lane in a subtile.
const uint COLUMNS = uint(BIN_WIDTH) / 8u;
const uint ROWS = uint(BIN_HEIGHT) / 8u;
const uint SUBTILES = COLUMNS * ROWS;
const uint OWN = (SUBTILES + SUBGROUPS - 1u) / SUBGROUPS;
const uint PIXELS = 64u / uint(LANES);
// From a lane's first pixel to another one.
#define STEP(p) uvec2(((p) * uint(LANES)) & 7u, ((p) * uint(LANES)) >> 3)

const uint CHUNK = uint(RASTER_CHUNK);
const uint WORDS = CHUNK / 32u;
shared StoredRecord chunk[CHUNK];
// For each subtile, a bit for each splat of the chunk: whether it touches.
shared uint touching[SUBTILES * WORDS];
// Subtiles with a pixel that lets light through.
shared uint open_subtiles;

// Returns the subtiles that a splat touches: bit row * COLUMNS + column. `corner` is the bin's first pixel.
//
// The ellipse at the alpha floor is cut by each row of subtiles; its leftmost and rightmost points within a row are those of
// the ellipse if they are in the row, and on the nearer edge of the row otherwise.
uint subtiles_of(Record r, vec2 corner) {
    const float MARGIN = 1.0 / 64.0;
    float limit = r.log_alpha - log2(alpha_floor);
    vec2 centre = r.centre - corner;
    float reach = sqrt(max(limit, 0.0));
    float half_height = reach / r.root.z;
    float lean = -r.root.y / r.root.x;
    // The height of the rightmost point above the centre; the leftmost is as far below.
    float peak = -r.root.y * reach * inversesqrt(r.root.z * r.root.z + r.root.y * r.root.y) / r.root.z;
    vec2 low = vec2(0.0);
    vec2 high = vec2(BIN_WIDTH, BIN_HEIGHT) - 1.0;
#if EXTENT == EXTENT_TILES
    vec2 columns = tile_range(r.centre.x, r.radius) - corner.x;
    vec2 rows = tile_range(r.centre.y, r.radius) - corner.y;
    low = max(low, vec2(columns.x, rows.x));
    high = min(high, vec2(columns.y, rows.y));
#endif
    uint subtiles = 0u;
    [[unroll]] for (uint row = 0u; row < ROWS; row++) {
        // The row's first and last height above the centre, within the ellipse.
        float top = max(float(row * 8u), low.y);
        float bottom = min(float(row * 8u + 7u), high.y);
        float first = max(top - centre.y - MARGIN, -half_height);
        float last = min(bottom - centre.y + MARGIN, half_height);
        float right_at = clamp(peak, first, last);
        float left_at = clamp(-peak, first, last);
        vec2 v = r.root.z * vec2(left_at, right_at);
        vec2 half_width = sqrt(max(limit - v * v, 0.0)) / r.root.x;
        float left = max(centre.x + lean * left_at - half_width.x - MARGIN, low.x);
        float right = min(centre.x + lean * right_at + half_width.y + MARGIN, high.x);
        if (top <= bottom && first <= last && left <= right) {
            uint from = uint(ceil(max(left - 7.0, 0.0) / 8.0));
            uint to = uint(right / 8.0);
            uint bits = from <= to ? ((2u << to) - (1u << from)) & ((1u << COLUMNS) - 1u) : 0u;
            subtiles |= bits << (row * COLUMNS);
        }
    }
    return subtiles;
}

void main() {
    uint bin = group_index();
    if (bin >= uint(BIN_COUNT)) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint thread = gl_SubgroupID * uint(LANES) + lane;
    uvec2 corner = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * uvec2(BIN_WIDTH, BIN_HEIGHT);
    uint list_first = min(starts[bin], uint(ENTRIES));
    uint list_end = min(starts[bin + 1u], uint(ENTRIES));

    // Colour and transmittance of each pixel; its alpha floor, which no alpha reaches when it is done.
    vec4 sums[OWN][PIXELS];
    float floors[OWN][PIXELS];
    bool is_open[OWN];
    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        is_open[o] = gl_SubgroupID + o * SUBGROUPS < SUBTILES;
        [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
            sums[o][p] = vec4(0.0, 0.0, 0.0, 1.0);
            floors[o][p] = alpha_floor;
        }
    }
    if (thread == 0u) {
        open_subtiles = SUBTILES;
    }
    vec2 pixel = vec2(lane & 7u, lane >> 3);
    barrier();

    for (uint start = list_first; start < list_end; start += CHUNK) {
        if (open_subtiles == 0u) {
            break;
        }
#if LANES < 32
        for (uint w = thread; w < SUBTILES * WORDS; w += THREADS) {
            touching[w] = 0u;
        }
        barrier();
#endif
        [[unroll]] for (uint first = 0u; first < CHUNK; first += THREADS) {
            uint at = first + thread;
            uint subtiles = 0u;
            if (start + at < list_end) {
                StoredRecord stored = records[lists[start + at]];
                chunk[at] = stored;
                subtiles = subtiles_of(unpack_record(stored), vec2(corner));
            }
            [[unroll]] for (uint s = 0u; s < SUBTILES; s++) {
                uvec4 touch = subgroupBallot(((subtiles >> s) & 1u) != 0u);
#if LANES == 32
                if (lane == (s & 31u)) {
                    touching[s * WORDS + at / 32u] = touch.x;
                }
#elif LANES > 32
                if (lane == s) {
                    touching[s * WORDS + at / 32u] = touch.x;
                    touching[s * WORDS + at / 32u + 1u] = touch.y;
                }
#else
                if (lane == 0u && touch.x != 0u) {
                    atomicOr(touching[s * WORDS + at / 32u], touch.x << (at & 31u));
                }
#endif
            }
        }
        barrier();

        [[unroll]] for (uint o = 0u; o < OWN; o++) {
            uint s = gl_SubgroupID + o * SUBGROUPS;
            if (!is_open[o]) {
                continue;
            }
            vec2 place = vec2(corner) + pixel + 8.0 * vec2(s % COLUMNS, s / COLUMNS);
            for (uint w = 0u; w < WORDS; w++) {
                uint bits = touching[s * WORDS + w];
                while (bits != 0u) {
                    uint at = w * 32u + uint(findLSB(bits));
                    bits &= bits - 1u;
                    Record r = unpack_record(chunk[at]);
                    vec2 d = place - r.centre;
                    vec2 uv = vec2(r.root.x * d.x + r.root.y * d.y, r.root.z * d.y);
                    [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
                        float u = uv.x + float(STEP(p).x) * r.root.x + float(STEP(p).y) * r.root.y;
                        float v = uv.y + float(STEP(p).y) * r.root.z;
                        float alpha = min(alpha_cap, exp2(r.log_alpha - (u * u + v * v)));
                        if (alpha >= floors[o][p]) {
                            float behind = sums[o][p].a * (1.0 - alpha);
                            if (behind < stop) {
                                floors[o][p] = 2.0;
                            } else {
                                sums[o][p] = vec4(sums[o][p].rgb + (alpha * sums[o][p].a) * r.colour, behind);
                            }
                        }
                    }
                }
                bool done = true;
                [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
                    done = done && floors[o][p] == 2.0;
                }
                if (subgroupAll(done)) {
                    is_open[o] = false;
                    if (lane == 0u) {
                        atomicAdd(open_subtiles, 0xffffffffu);
                    }
                    break;
                }
            }
        }
        barrier();
    }

    [[unroll]] for (uint o = 0u; o < OWN; o++) {
        uint s = gl_SubgroupID + o * SUBGROUPS;
        [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
            uvec2 at = corner + 8u * uvec2(s % COLUMNS, s / COLUMNS) + uvec2(lane & 7u, lane >> 3) + STEP(p);
            if (s < SUBTILES && at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
                vec3 colour = sums[o][p].rgb + sums[o][p].a * camera.background.rgb;
                imageStore(picture, ivec2(at), vec4(colour, 1.0));
            }
        }
    }
}
