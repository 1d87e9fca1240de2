#version 460
#extension GL_GOOGLE_include_directive : require

// Composites the segments of each bin that has several, near to far, and adds the background. An invocation takes a pixel, in the
// order in which the rasteriser stores them.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"
#include "seen.glsl"
#include "../mesh/behind.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Further { uint further[]; };
layout(set = 0, binding = 1, std430) readonly buffer Sums { StoredSum sums[]; };
layout(set = 0, binding = 2, std430) readonly buffer Composited { uint composited_bins[]; };
layout(set = 0, binding = 3, std430) readonly buffer Groups { uint groups[]; };
layout(set = 0, binding = 4, rgba32f) writeonly uniform image2D picture;
#if WITH_OUTPUTS
layout(set = 0, binding = 5, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 6, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 7, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 13, std430) readonly buffer SegmentPixels { Pixel segment_pixels[]; };

#if WITH_RANKS
struct Ranks {
    float median;       // depth of the last splat with a transmittance above one half before it
    uint contributors;  // splats in front of the early stop
};

// Finds the ranks of a segment behind the transmittance `light`, until that falls below `least`. The segment alone knows only its own
// transmittance, so its splats are blended once more.
Ranks ranks_behind(uint bin, uint segment, vec2 pixel, float light, float least) {
    uint begin = ranges[bin].x + segment * uint(SEGMENT_ENTRIES);
    uint end = min(begin + uint(SEGMENT_ENTRIES), ranges[bin].y);
    Ranks ranks = Ranks(0.0, 0u);
#if WRAPS
    float middle = (float(bin % uint(BINS_X)) + 0.5) * float(BIN);
#endif
    for (uint entry = begin; entry < end && light >= least; entry++) {
        uint index = lists[entry];
#if WITH_MESH
        if (depth_of[index] >= surface_depth(uvec2(pixel))) {
            break;
        }
#endif
        Record r = COPY_NEAR(unpack_record(records[index]), middle);
        vec2 d = pixel - r.centre;
        float u = r.root.x * d.x + r.root.y * d.y;
        float v = r.root.z * d.y;
        float alpha = min(alpha_cap, exp2(r.log_alpha - u * u - v * v));
        bool is_blended = alpha >= alpha_floor;
#if EXTENT == EXTENT_TILES
        vec2 columns = tile_range(r.centre.x, r.radius);
        vec2 rows = tile_range(r.centre.y, r.radius);
        is_blended = is_blended && pixel.x >= columns.x && pixel.x <= columns.y && pixel.y >= rows.x && pixel.y <= rows.y;
#endif
        ranks.median = is_blended && light > 0.5 ? depth_of[index] : ranks.median;
        light -= is_blended ? alpha * light : 0.0;
        ranks.contributors += is_blended && light >= stop ? 1u : 0u;
    }
    return ranks;
}
#endif

// Adds the sums of a segment behind the transmittance `front.light`, which scales them. A segment's splat with the largest weight also has
// its largest scaled weight; this does not hold for the median depth, nor for the number of splats in front of the early stop.
void add_segment(inout Pixel front, Pixel back, uint bin, uint segment, vec2 pixel) {
    front.depth += front.light * back.depth;
#if WITH_NORMALS
    front.normal_x += front.light * back.normal_x;
    front.normal_y += front.light * back.normal_y;
    front.normal_z += front.light * back.normal_z;
#endif
#if WITH_RANKS
    float behind = front.light * back.light;
    bool has_median = front.light > 0.5 && back.most > 0.0;
    bool halves = has_median && behind <= 0.5;
    bool stops = behind < stop;
    Ranks ranks = Ranks(back.median, back.contributors);
    if (front.light < 1.0 && (halves || stops)) {
        ranks = ranks_behind(bin, segment, pixel, front.light, stops ? stop : 0.5);
    }
    front.median = has_median ? ranks.median : front.median;
    front.contributors += stops ? ranks.contributors : back.contributors;
    if (front.light * back.most > front.most) {
        front.most = front.light * back.most;
        front.index = back.index;
    }
#endif
    front.light *= back.light;
}
#endif

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    uint number = i / BIN_PIXELS;
    if (number >= groups[6]) {
        return;
    }
    uint bin = composited_bins[number];
    uint place = i % BIN_PIXELS;
    uvec2 pixel = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN_SIZE + pixel_at(place);

    uint first = further[bin];
    uint end = further[bin + 1u];
    vec4 sum = unpack_sum(sums[number * BIN_PIXELS + place]);
    vec3 colour = sum.rgb;
    float transmittance = sum.a;
#if WITH_OUTPUTS
    Pixel outputs = segment_pixels[number * BIN_PIXELS + place];
#endif
    for (uint s = first; s < end && transmittance >= stop; s++) {
        sum = unpack_sum(sums[(FURTHER_SUMS + s) * BIN_PIXELS + place]);
        colour += transmittance * sum.rgb;
        transmittance *= sum.a;
#if WITH_OUTPUTS
        add_segment(outputs, segment_pixels[(FURTHER_SUMS + s) * BIN_PIXELS + place], bin, s - first + 1u, vec2(pixel));
#endif
    }
    if (pixel.x < uint(VIEWPORT_WIDTH) && pixel.y < uint(VIEWPORT_HEIGHT)) {
        // A finished pixel's transmittance is negative; see rasterise.comp.
        imageStore(picture, ivec2(pixel), vec4(colour + abs(transmittance) * BEHIND(pixel, camera.background.rgb), 1.0));
#if WITH_OUTPUTS
        pixels[pixel.y * uint(VIEWPORT_WIDTH) + pixel.x] = outputs;
#endif
    }
}
