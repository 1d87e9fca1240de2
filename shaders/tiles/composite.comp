#version 460
#extension GL_GOOGLE_include_directive : require

// Composites the segments of each bin that has several, near to far, and adds the background; a bin without splats has the background
// alone. An invocation takes a pixel, in the order in which the rasteriser leaves them.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Segments { uint segment_starts[]; };
layout(set = 0, binding = 1, std430) readonly buffer Places { uint sum_places[]; };
layout(set = 0, binding = 2, std430) readonly buffer Sums { StoredSum sums[]; };
layout(set = 0, binding = 3, rgba32f) writeonly uniform image2D picture;

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    uint bin = i / BIN_PIXELS;
    if (bin >= uint(BIN_COUNT)) {
        return;
    }
    uint place = i % BIN_PIXELS;
    uvec2 pixel = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN + pixel_at(place);

    uint segments = segment_starts[bin + 1u] - segment_starts[bin];
    if (segments == 1u) {
        return;  // the rasteriser has written the picture
    }
    vec3 colour = vec3(0.0);
    float transmittance = 1.0;
    uint first = sum_places[bin];
    for (uint s = 0u; s < segments && transmittance >= stop; s++) {
        vec4 sum = unpack_sum(sums[(first + s) * BIN_PIXELS + place]);
        colour += transmittance * sum.rgb;
        transmittance *= sum.a;
    }
    if (pixel.x < uint(VIEWPORT_WIDTH) && pixel.y < uint(VIEWPORT_HEIGHT)) {
        // A done pixel's transmittance is negative: see rasterise.comp.
        imageStore(picture, ivec2(pixel), vec4(colour + abs(transmittance) * camera.background.rgb, 1.0));
    }
}
