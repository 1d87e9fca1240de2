#version 460
#extension GL_GOOGLE_include_directive : require

// Makes the requested images besides the picture from the per-pixel sums of the rasteriser.

#include "pixels.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, std430) readonly buffer Pixels { Pixel pixels[]; };
layout(set = 0, binding = 1, r32f) writeonly uniform image2D alpha;
layout(set = 0, binding = 2, r32f) writeonly uniform image2D depth;
layout(set = 0, binding = 3, r32f) writeonly uniform image2D expected_depth;
layout(set = 0, binding = 4, r32f) writeonly uniform image2D median_depth;
layout(set = 0, binding = 5, rgba32f) writeonly uniform image2D normal;
layout(set = 0, binding = 6, r32ui) writeonly uniform uimage2D contributors;
layout(set = 0, binding = 7, r32ui) writeonly uniform uimage2D index;

// The minimum alpha that a depth is divided by, as in gsplat.
const float LEAST_ALPHA = 1e-10;

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (at.x >= uint(VIEWPORT_WIDTH) || at.y >= uint(VIEWPORT_HEIGHT)) {
        return;
    }
    ivec2 pixel = ivec2(at);
    Pixel p = pixels[at.y * uint(VIEWPORT_WIDTH) + at.x];
#if GIVES_ALPHA
    imageStore(alpha, pixel, vec4(1.0 - p.light));
#endif
#if GIVES_DEPTH
    imageStore(depth, pixel, vec4(p.depth));
#endif
#if GIVES_EXPECTED_DEPTH
    imageStore(expected_depth, pixel, vec4(p.depth / max(1.0 - p.light, LEAST_ALPHA)));
#endif
#if GIVES_MEDIAN_DEPTH
    imageStore(median_depth, pixel, vec4(p.median));
#endif
#if GIVES_NORMAL
    imageStore(normal, pixel, vec4(p.normal_x, p.normal_y, p.normal_z, 0.0));
#endif
#if GIVES_CONTRIBUTORS
    imageStore(contributors, pixel, uvec4(p.contributors));
#endif
#if GIVES_INDEX
    imageStore(index, pixel, uvec4(p.index));
#endif
}
