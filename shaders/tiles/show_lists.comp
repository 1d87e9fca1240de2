#version 460
#extension GL_GOOGLE_include_directive : require

// Shows the length of each bin's list instead of the picture: black for none, then blue, magenta, orange, yellow and white, a colour for
// each four doublings, up to 2^20 splats.

#include "bins.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D picture;

const vec3 COLOURS[6] = vec3[](vec3(0.0), vec3(0.1, 0.1, 0.6), vec3(0.7, 0.1, 0.5), vec3(0.95, 0.4, 0.1),
                               vec3(1.0, 0.85, 0.2), vec3(1.0));

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (pixel.x >= uint(VIEWPORT_WIDTH) || pixel.y >= uint(VIEWPORT_HEIGHT)) {
        return;
    }
    uvec2 at = pixel / BIN_SIZE;
    uint bin = at.y * uint(BINS_X) + at.x;
    float doublings = log2(1.0 + float(ranges[bin].y - ranges[bin].x));
    float step = clamp(doublings / 4.0, 0.0, 4.999);
    vec3 colour = mix(COLOURS[uint(step)], COLOURS[uint(step) + 1u], fract(step));
    // A line between bins.
    bool is_edge = any(equal(pixel % BIN_SIZE, uvec2(0u)));
    imageStore(picture, ivec2(pixel), vec4(is_edge ? 0.7 * colour : colour, 1.0));
}
