#version 460
#extension GL_GOOGLE_include_directive : require

// Composites the segments of each bin that has several, near to far, and adds the background. An invocation takes a pixel, in the
// order in which the rasteriser leaves them.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Further { uint further[]; };
layout(set = 0, binding = 1, std430) readonly buffer Sums { StoredSum sums[]; };
layout(set = 0, binding = 2, std430) readonly buffer Composited { uint composited_bins[]; };
layout(set = 0, binding = 3, std430) readonly buffer Groups { uint groups[]; };
layout(set = 0, binding = 4, rgba32f) writeonly uniform image2D picture;

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    uint number = i / BIN_PIXELS;
    if (number >= groups[6]) {
        return;
    }
    uint bin = composited_bins[number];
    uint place = i % BIN_PIXELS;
    uvec2 pixel = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN + pixel_at(place);

    uint first = further[bin];
    uint end = further[bin + 1u];
    vec4 sum = unpack_sum(sums[number * BIN_PIXELS + place]);
    vec3 colour = sum.rgb;
    float transmittance = sum.a;
    for (uint s = first; s < end && transmittance >= stop; s++) {
        sum = unpack_sum(sums[(FURTHER_SUMS + s) * BIN_PIXELS + place]);
        colour += transmittance * sum.rgb;
        transmittance *= sum.a;
    }
    if (pixel.x < uint(VIEWPORT_WIDTH) && pixel.y < uint(VIEWPORT_HEIGHT)) {
        // A done pixel's transmittance is negative: see rasterise.comp.
        imageStore(picture, ivec2(pixel), vec4(colour + abs(transmittance) * camera.background.rgb, 1.0));
    }
}
