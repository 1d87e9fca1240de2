#version 460
#extension GL_GOOGLE_include_directive : require

#include "live.glsl"

layout(location = 0) in vec2 sigmas;
layout(location = 1) flat in vec4 colour;

layout(location = 0) out vec4 opaque;

void main() {
    if (length(sigmas) > extent) {
        discard;
    }
    opaque = vec4(colour.rgb, 1.0);
}
