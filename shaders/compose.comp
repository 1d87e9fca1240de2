#version 460
#extension GL_GOOGLE_include_directive : require

// Composes the blended splats with the background. Alpha is the transmittance: a half float keeps 11 bits of it at any size. A sum of
// opacities would stop growing near 1.

#include "camera.glsl"
#include "pixels.glsl"
#include "mesh/behind.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

#if TARGET == TARGET_RGBA16F
layout(set = 0, binding = 0, rgba16f) readonly uniform image2D color;
#elif TARGET == TARGET_RGBA8
layout(set = 0, binding = 0, rgba8) readonly uniform image2D color;
#else
layout(set = 0, binding = 0, rgba32f) readonly uniform image2D color;
#endif
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D composed;
#if WITH_OUTPUTS
layout(set = 0, binding = 2, rgba32f) readonly uniform image2D depths;
layout(set = 0, binding = 3, std430) writeonly buffer Pixels { Pixel pixels[]; };
#endif

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (pixel.x >= VIEWPORT_WIDTH || pixel.y >= VIEWPORT_HEIGHT) {
        return;
    }
    vec4 blended = imageLoad(color, pixel);
    imageStore(composed, pixel, vec4(blended.rgb + blended.a * BEHIND(uvec2(pixel), camera.background.rgb), 1.0));
#if WITH_OUTPUTS
    vec4 sums = imageLoad(depths, pixel);
    Pixel outputs = empty_pixel();
    outputs.light = sums.a;
    outputs.depth = sums.r;
    pixels[uint(pixel.y) * uint(VIEWPORT_WIDTH) + uint(pixel.x)] = outputs;
#endif
}
