#version 460
#extension GL_GOOGLE_include_directive : require

// Fills the picture with the background (`--background`), over which the splats are drawn.

#include "camera.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, rgba32f) writeonly uniform image2D picture;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (all(lessThan(pixel, imageSize(picture)))) {
        imageStore(picture, pixel, vec4(camera.background.rgb, 1.0));
    }
}
