#version 460
#extension GL_GOOGLE_include_directive : require

// Darkens a picture where its depth jumps: by `strength` times the length of the depth's gradient.

#include "live.glsl"

layout(local_size_x = 16, local_size_y = 16) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform image2D picture;
layout(set = 0, binding = 1, rgba32f) readonly uniform image2D depth;
layout(set = 0, binding = 2, rgba32f) writeonly uniform image2D outlined;

float depth_at(ivec2 at) {
    return imageLoad(depth, clamp(at, ivec2(0), imageSize(depth) - 1)).r;
}

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, imageSize(picture)))) {
        return;
    }
    vec2 gradient = vec2(
        depth_at(at + ivec2(1, 0)) - depth_at(at - ivec2(1, 0)),
        depth_at(at + ivec2(0, 1)) - depth_at(at - ivec2(0, 1))
    );
    vec4 colour = imageLoad(picture, at);
    imageStore(outlined, at, vec4(colour.rgb * max(1.0 - strength * length(gradient), 0.0), colour.a));
}
