#version 460
#extension GL_GOOGLE_include_directive : require

// Paints rings around the middle of the picture. Each invocation paints one pixel.

#include "live.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, rgba32f) writeonly uniform image2D picture;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = imageSize(picture);
    // The last workgroups reach beyond the picture.
    if (any(greaterThanEqual(at, size))) {
        return;
    }
    float distance = length(vec2(at) - 0.5 * vec2(size));
    float ring = 0.5 + 0.5 * cos(6.2831853 * distance / width);
    imageStore(picture, at, vec4(ring, 0.4 * ring, 1.0 - ring, 1.0));
}
