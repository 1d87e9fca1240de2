#version 460
#extension GL_GOOGLE_include_directive : require

// Makes the quad around an ellipse.

#include "camera.glsl"
#include "splat.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Splats { Splat splats[]; };
layout(set = 0, binding = 1, std430) readonly buffer Colours { vec4 colours[]; };

layout(location = 0) out vec2 sigmas;
layout(location = 1) flat out vec4 colour;

void main() {
    uint i = gl_InstanceIndex;
    Splat splat = splats[i];
    sigmas = splat.extent * (vec2(gl_VertexIndex & 1, gl_VertexIndex >> 1) * 2.0 - 1.0);
    colour = vec4(colours[i].rgb, splat.opacity);
    vec2 pixel = splat.centre + sigmas.x * splat.major + sigmas.y * splat.minor;
    // Pixel centres are at integers here, at halves in the framebuffer.
    gl_Position = vec4((2.0 * pixel + 1.0) * camera.viewport.zw - 1.0, 0.0, 1.0);
}
