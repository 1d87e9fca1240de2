#version 460
#extension GL_GOOGLE_include_directive : require

// Mixes each pixel with its brightness.

#include "live.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform image2D picture;
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D faded;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, imageSize(picture)))) {
        return;
    }
    vec4 colour = imageLoad(picture, at);
    float brightness = dot(colour.rgb, vec3(0.2126, 0.7152, 0.0722));
    imageStore(faded, at, vec4(mix(colour.rgb, vec3(brightness), grey), colour.a));
}
