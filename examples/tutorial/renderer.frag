#version 460
#extension GL_GOOGLE_include_directive : require

// Shades one splat at one pixel: the Gaussian times the opacity, premultiplied.

#include "live.glsl"

layout(location = 0) in vec2 sigmas;
layout(location = 1) flat in vec4 colour;

layout(location = 0) out vec4 blended;

void main() {
    float alpha = min(alpha_cap, colour.a * exp(-0.5 * dot(sigmas, sigmas)));
    if (alpha < alpha_floor) {
        discard;
    }
    blended = vec4(colour.rgb * alpha, alpha);
}
