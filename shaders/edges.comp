#version 460
#extension GL_GOOGLE_include_directive : require

// Darkens a picture at edges: subtracts `strength` times the length of the brightness gradient (Sobel operator).

#include "live.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform image2D picture;
layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D edges;

float brightness(ivec2 at, ivec2 size) {
    return dot(imageLoad(picture, clamp(at, ivec2(0), size - 1)).rgb, vec3(0.2126, 0.7152, 0.0722));
}

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = imageSize(picture);
    if (any(greaterThanEqual(at, size))) {
        return;
    }
    vec2 gradient = vec2(0.0);
    for (int side = -1; side <= 1; side++) {
        float weight = side == 0 ? 2.0 : 1.0;
        gradient.x += weight * (brightness(at + ivec2(1, side), size) - brightness(at + ivec2(-1, side), size));
        gradient.y += weight * (brightness(at + ivec2(side, 1), size) - brightness(at + ivec2(side, -1), size));
    }
    vec4 colour = imageLoad(picture, at);
    imageStore(edges, at, vec4(max(colour.rgb - strength * length(gradient), 0.0), colour.a));
}
