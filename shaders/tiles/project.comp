#version 460
#extension GL_GOOGLE_include_directive : require
#if LOADS_LONGS
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#define LONG_SH
#endif
#if !SORTS_SPLATS
#include "../reconverges.glsl"
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require
#endif

// Projects Gaussians for the tiled rasterisers: cull, project, colour. Each invocation takes one splat. A visible splat gets
// a record. If splats are sorted, it also gets the bins that it may touch, and its depth; an invisible splat gets the depth -1. Otherwise
// workgroups write the pairs of their splats and bins, and depths only for outputs.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "../spherical_harmonics.glsl"
#include "../projection.glsl"

layout(set = 0, binding = 3, std430) writeonly buffer Records { StoredRecord records[]; };
#ifdef HAS_PLANE
layout(set = 0, binding = 9, std430) writeonly buffer Planes { float planes[]; };
#endif

#if RECORD == RECORD_F32
const float BRIGHTEST = BRIGHTEST_FLOAT;
#else
const float BRIGHTEST = BRIGHTEST_HALF;
#endif

// sqrt(log2(e) / 2), because the falloff is a power of 2.
const float ROOT_SCALE = 0.8493218002880191;

// Returns the published rasteriser's radius of a splat, in pixels: three standard deviations, rounded up.
float published_radius(Projection p) {
    // The published rasteriser bounds half of the eigenvalues' difference from below, by sqrt(0.1) square pixels.
    float least = sqrt(0.1) / (p.unit * p.unit);
    float spread = max(length(vec2(0.5 * (p.xx - p.yy), p.xy)), least);
    return ceil(3.0 * sqrt(0.5 * (p.xx + p.yy) + spread) * p.unit);
}

// Returns log2 of an opacity that is not below the alpha floor. Rounds it so that its power of 2 is not below the floor either.
float log_of_alpha(float alpha) {
    float log_alpha = log2(alpha);
    // Two float steps between -8 and -4, more than the rounding of both functions.
    return exp2(log_alpha) < alpha_floor ? log_alpha + 1e-6 : log_alpha;
}

#if WRAPS
// Finds the bins between two corners in a panorama; returns false if there is none, above or below the picture.
bool bins_around(vec2 low, vec2 high, out BinRect rect) {
    float width = camera.viewport.x;
    vec2 rows = vec2(max(ceil(low.y), 0.0), min(floor(high.y), camera.viewport.y - 1.0));
    if (!(rows.x <= rows.y)) {
        return false;
    }
    vec2 columns = vec2(0.0, width - 1.0);
    if (high.x - low.x < width) {
        vec2 ends = vec2(floor(low.x), ceil(high.x));
        ends -= width * floor(ends / width);
        ends = min(ends, width - 1.0);
        // If both ends are in one bin and the first is after the last, the splat covers the whole width.
        bool is_round = ends.x > ends.y && uint(ends.x) / BIN == uint(ends.y) / BIN;
        columns = is_round ? columns : ends;
    }
    rect = BinRect(uvec2(columns.x, rows.x) / BIN_SIZE, uvec2(columns.y, rows.y) / BIN_SIZE);
    return true;
}
#endif

// Projects splat `i`; finds its published radius and the bins that it may touch. Returns false if it is not visible.
bool project_to_bins(uint i, out Projection p, out float radius, out BinRect rect) {
    if (!project_splat(i, p)) {
        return false;
    }
    vec2 low = p.centre - p.bounds - MARGIN;
    vec2 high = p.centre + p.bounds + MARGIN;
    radius = 0.0;
#if EXTENT == EXTENT_TILES
    radius = published_radius(p);
    vec2 columns = tile_range(p.centre.x, radius);
    vec2 rows = tile_range(p.centre.y, radius);
    low = max(low, vec2(columns.x, rows.x));
    high = min(high, vec2(columns.y, rows.y));
#if WRAPS
    // The copy across the edge has other tile borders, unless the picture's width is a multiple of the tile's.
    low.x -= PUBLISHED_TILE;
    high.x += PUBLISHED_TILE;
#endif
#endif
#if WRAPS
    return bins_around(low, high, rect);
#else
    vec2 first = max(ceil(low), vec2(0.0));
    vec2 last = min(floor(high), camera.viewport.xy - 1.0);
    if (!(first.x <= last.x && first.y <= last.y)) {
        return false;
    }
    rect = BinRect(uvec2(first) / BIN_SIZE, uvec2(last) / BIN_SIZE);
    return true;
#endif
}

void write_record(uint i, Projection p, float radius) {
    Record r;
    r.centre = p.centre;
    float width = sqrt(p.yy / p.determinant);
    r.root = (ROOT_SCALE / p.unit) * vec3(width, -width * (p.xy / p.yy), inversesqrt(p.yy));
    r.log_alpha = log_of_alpha(p.alpha);
    r.radius = radius;
    r.colour = finite_colour(i, p.from_camera, BRIGHTEST);
    records[i] = pack_record(r);
#ifdef HAS_PLANE
    planes[3u * i] = p.plane.x;
    planes[3u * i + 1u] = p.plane.y;
    planes[3u * i + 2u] = p.plane.z;
#endif
}

#if !SORTS_SPLATS
#include "../args.glsl"
#define KEYS_FILL_THEIR_BITS
#include "../depth_key.glsl"

const uint THREADS = 256u;
const uint BLOCK = 256u;
layout(local_size_x = 256) in;
#include "scan.glsl"
#include "emit.glsl"

layout(set = 0, binding = 7, std430) buffer PairCounts { uint pair_counts[]; };
#if WITH_OUTPUTS
layout(set = 0, binding = 4, std430) writeonly buffer Depth { float depth_of[]; };
#endif

shared uint visible_count;
shared uint start;

void main() RECONVERGES {
    uint first = group_index() * BLOCK;
    uint thread = thread_index();
    uint i = first + thread;
    if (first >= uint(SCENE_COUNT)) {
        return;
    }
    if (thread == 0u) {
        visible_count = 0u;
    }
    Projection p;
    float radius;
    BinRect rect;
    uint pairs = 0u;
    if (i < uint(SCENE_COUNT) && project_to_bins(i, p, radius, rect)) {
        splat_bins[thread] = pack_bins(rect);
#ifdef HAS_PLANE
        splat_centre[thread] = p.centre;
        splat_plane[thread] = p.plane;
#else
        splat_word[thread] = depth_key(p.depth);
#endif
        // Unpacked, because a panorama's rectangle may wrap around the edge.
        pairs = bins_in(unpack_bins(splat_bins[thread]));
    }
    // Invocations return from project_to_bins at different places. Below, exclusive_sum needs whole subgroups.
    barrier();
    if (pairs > 0u) {
        atomicAdd(visible_count, 1u);
    }
    uint total = 0u;
    splat_ends[thread] = exclusive_sum(pairs, 0u, total) + pairs;
    if (thread == 0u) {
        // Blocks take their places in any order: order_ties.comp orders pairs of equal depth.
        start = atomicAdd(pair_counts[COUNTED_PAIRS], total);
        if (start + total < start) {
            atomicOr(pair_counts[COUNTED_WRAPPED], 1u);
        }
        atomicAdd(pair_counts[COUNTED_VISIBLE], visible_count);
    }
    if (pairs > 0u) {
        write_record(i, p, radius);
#if WITH_OUTPUTS
        depth_of[i] = p.depth;
#endif
    }
    barrier();
    write_pairs(start, total);
}
#else
layout(set = 0, binding = 6, std430) writeonly buffer Bins { uint bins_of[]; };

// Projects splat `i` and returns its depth, or -1 if it is invisible. Writes the bins and the record of a visible splat.
float project(uint i) {
    Projection p;
    float radius;
    BinRect rect;
    if (!project_to_bins(i, p, radius, rect)) {
        return -1.0;
    }
    bins_of[i] = pack_bins(rect);
    write_record(i, p, radius);
    return p.depth;
}

#if SERIAL
// On a CPU each workgroup costs memory, so workgroups are large.
layout(local_size_x = 256) in;

layout(set = 0, binding = 4, std430) writeonly buffer Depth { float depth_of[]; };

// Counting needs barriers, so serial_visible.comp does it.
void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i < uint(SCENE_COUNT)) {
        depth_of[i] = project(i);
    }
}
#else
void leave_out(uint i) {}

#include "../project_all.glsl"

void main() {
    project_all();
}
#endif
#endif
