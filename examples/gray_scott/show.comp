#version 460
#extension GL_GOOGLE_include_directive : require

// V as brightness, from a dark blue to white.

layout(local_size_x = 64) in;

#include "cells.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Cells { vec2 cells[]; };
layout(set = 0, binding = 1, rgba8) writeonly uniform image2D image;

void main() {
    uint i = cell_index();
    if (i >= SIDE * SIDE) return;
    float v = clamp(cells[i].y * 2.5, 0.0, 1.0);
    vec3 colour = mix(vec3(0.02, 0.04, 0.16), vec3(1.0, 0.97, 0.86), smoothstep(0.1, 0.9, v));
    imageStore(image, ivec2(i % SIDE, i / SIDE), vec4(colour, 1.0));
}
