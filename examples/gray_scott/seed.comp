#version 460
#extension GL_GOOGLE_include_directive : require

// U everywhere, and some squares of V.

layout(local_size_x = 64) in;

#include "cells.glsl"

layout(set = 0, binding = 0, std430) writeonly buffer Cells { vec2 cells[]; };

// A hash of 32 bits (Mueller, https://stackoverflow.com/a/12996028).
uint hash(uint x) {
    x = (x ^ (x >> 16)) * 0x45d9f3bu;
    x = (x ^ (x >> 16)) * 0x45d9f3bu;
    return x ^ (x >> 16);
}

void main() {
    uint i = cell_index();
    if (i >= SIDE * SIDE) return;
    uvec2 square = uvec2(i % SIDE, i / SIDE) / 8u;
    bool seeded = hash(square.y * 4096u + square.x) % 16u == 0u;
    cells[i] = seeded ? vec2(0.5, 0.25) : vec2(1.0, 0.0);
}
